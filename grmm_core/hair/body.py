"""What strands stay outside of: a head's skin with the hull of its ears, as heights on a grid. Needs numba where it is made.

Height is measured above the tangent planes of the skin's vertices around a point, so that it is smooth, about the distance near
the skin, and negative inside. An ear counts as the bulge around it: hair lies over ears, not between their folds.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..head import HeadModel
from .occlusion import sample

CELL = 0.008  # metres
MARGIN = 0.05  # metres around the skin
EAR = 0.018  # metres: how far around a vertex of an ear its hull is the highest that there is
REACH = 0.015  # metres: see `strand_kernels.heights_into`
BURIED = 0.05  # metres: what is deeper is left, it is no strand on a head
# of contact while hair swings: share of what it is inside the skin that a step pushes out, metres at most, and the share of
# its speed that it keeps
SOFT, MOST, SLIDE = 0.5, 0.002, 0.3
_INSIDE = ("mouth_interior", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes")
_ROUNDS = 3  # of pushing


@dataclass(frozen=True)
class Body:
    """Heights above a skin.

    Attributes:
        low: The first cell's centre, metres, [3].
        field: Height in metres and the direction in which it grows, in every cell, float32 [X, Y, Z, 4].
    """

    low: np.ndarray
    field: np.ndarray

    @staticmethod
    def of(head: HeadModel, vertices: np.ndarray, among: np.ndarray | None = None) -> Body:
        """Measure a head.

        Args:
            head: For its topology.
            vertices: The head, metres, [V, 3].
            among: Which vertices count, [V] bool; all of the outer skin when None.
        """
        from .strand_kernels import heights_into

        points, normals, kept = _skin(head, np.asarray(vertices, float))
        kept = kept if among is None else kept & among
        points, normals = points[kept], normals[kept]
        low = points.min(0) - MARGIN
        size = np.ceil((points.max(0) + MARGIN - low) / CELL).astype(int) + 1
        heights = np.empty(tuple(size), np.float32)
        heights_into(*(np.ascontiguousarray(part, np.float32) for part in (points, normals, low)), CELL, REACH, heights)
        slope = np.stack(np.gradient(heights, CELL), -1)
        slope /= np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-6)
        return Body(low, np.concatenate([heights[..., None], slope], -1).astype(np.float32))

    def heights(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Heights [P] of points [P, 3], and the unit directions in which they grow, [P, 3]; far away outside the grid."""
        at = (points - self.low) / CELL
        found = sample(self.field, at)
        outside = ((at < 0) | (at > np.array(self.field.shape[:3]) - 1)).any(1)
        direction = found[:, 1:] / np.maximum(np.linalg.norm(found[:, 1:], axis=1, keepdims=True), 1e-6)
        return np.where(outside, MARGIN, found[:, 0]), direction

    def pushed(self, strands: np.ndarray, clearance: float = 0.001) -> np.ndarray:
        """Strands [N, K, 3], root first, moved out to a clearance in metres, their first fifth less and less."""
        count = strands.shape[1]
        t = np.minimum(np.arange(count) / (0.2 * (count - 1)), 1.0)
        wanted = np.broadcast_to(clearance * (2.0 * t * t * (3.0 - 2.0 * t) - 1.0), strands.shape[:2])[:, 1:].ravel()
        points = strands[:, 1:].reshape(-1, 3).astype(np.float32)
        for _ in range(_ROUNDS):
            heights, direction = self.heights(points)
            push = np.where(heights > -BURIED, np.maximum(wanted - heights, 0.0), 0.0)
            if not push.any():
                break
            points = points + push[:, None] * direction
        return np.concatenate([strands[:, :1], points.reshape(len(strands), count - 1, 3)], 1).astype(np.float32)


def _skin(head: HeadModel, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points and normals of the planes at the vertices, and which belong to the outer skin: [V, 3], [V, 3], [V]."""
    faces = np.asarray(head.faces)[np.asarray(head.uv_islands) == 0]
    corners = vertices[faces]
    normals = np.zeros_like(vertices)
    np.add.at(normals, faces, np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, None])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-15)
    outer = np.zeros(len(vertices), bool)
    outer[faces] = True
    for name in _INSIDE:
        outer[head.regions.get(name, np.zeros(0, int))] = False
    points = vertices.copy()
    ears = np.asarray(head.regions.get("ears", np.zeros(0, int)))
    side = np.sign(vertices[ears, 0])
    normals[ears] = side[:, None] * np.array([1.0, 0.0, 0.0])
    near = np.linalg.norm(vertices[ears, None, 1:] - vertices[None, ears, 1:], axis=2) < EAR
    near &= side[:, None] == side[None]
    points[ears, 0] = side * np.where(near, np.abs(vertices[ears, 0])[None], 0.0).max(1, initial=0.0)
    return points, normals, outer
