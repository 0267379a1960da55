"""Frames at the roots of strands that turn with the skin around them. Needs numpy only.

The triangle under a root tilts by several degrees with every raised brow, and a strand of 25 cm would swing by centimetres. So
a frame follows a patch of skin around its triangle, larger for scalp hair than for brows. Both axes of a patch are fixed linear
combinations of its vertices: a rotation of the head turns them exactly, a translation does nothing, small dents average out.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..errors import ShapeError

SCALP, BROWS, BEARD, LASHES = range(4)
GROUPS = ("scalp", "brows", "beard", "lashes")
RINGS = {SCALP: 3, BROWS: 1, BEARD: 1, LASHES: 0}  # of neighbouring vertices that a patch takes in around its triangle


@dataclass(frozen=True)
class RootFrames:
    """Origin and axes at N roots, as functions of the head's vertices.

    Attributes:
        corners: Vertices of each root's triangle, [N, 3].
        weights: Barycentric coordinates of each root, [N, 3].
        patch: Number of each root's patch, [N].
        members: Vertices of each patch, padded, [U, K].
        first, second: Coefficients of the patches' vertices in their two axes; they sum to 0, [U, K].
    """

    corners: np.ndarray
    weights: np.ndarray
    patch: np.ndarray
    members: np.ndarray
    first: np.ndarray
    second: np.ndarray

    @staticmethod
    def build(
        template: np.ndarray, faces: np.ndarray, triangles: np.ndarray, weights: np.ndarray, groups: np.ndarray
    ) -> RootFrames:
        """Prepare the frames of some roots.

        Args:
            template: Vertices of the head model's mean, metres, [V, 3].
            faces: Its triangles, [F, 3].
            triangles: Number of each root's triangle, [N].
            weights: Barycentric coordinates, [N, 3].
            groups: One of `SCALP`, `BROWS`, `BEARD`, `LASHES` each, [N].

        Raises:
            ShapeError: A triangle that the head does not have, or a group that there is not.
        """
        template, faces = np.asarray(template, float), np.asarray(faces)
        if len(triangles) and not 0 <= int(np.min(triangles)) <= int(np.max(triangles)) < len(faces):
            raise ShapeError(
                f"The hair stands on a triangle that the head ({len(faces)} triangles) does not have; use its own head."
            )
        if len(groups) and int(np.max(groups)) >= len(GROUPS):
            raise ShapeError(f"There is no hair group {int(np.max(groups))}; use 0 to {len(GROUPS) - 1}.")
        rings = np.array([RINGS[g] for g in range(len(GROUPS))])[np.asarray(groups, int)]
        kinds, patch = np.unique(np.stack([np.asarray(triangles, int), rings], 1), axis=0, return_inverse=True)
        patches = _patches(template, faces, kinds)
        width = max((len(patch.members) for patch in patches), default=3)
        members = np.zeros((len(patches), width), np.int64)
        first, second = np.zeros((2, len(patches), width))
        for i, one in enumerate(patches):
            members[i, : len(one.members)] = one.members
            first[i, : len(one.members)], second[i, : len(one.members)] = one.first, one.second
        return RootFrames(
            faces[np.asarray(triangles, int)], np.asarray(weights, float), patch.reshape(-1), members, first, second
        )

    def at(self, vertices: np.ndarray, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Origins [N, 3] and axes as rows [N, 3, 3] (along, across, out of the skin) on posed vertices [V, 3].

        Of the first `count` roots, if that is given.
        """
        near = np.asarray(vertices, float)[self.members]
        both = np.matmul(np.stack([self.first, self.second], 1), near)  # [U, 2, 3]
        along, across = _unit(both[:, 0]), both[:, 1]
        out = _unit(np.cross(along, across))
        axes = np.stack([along, np.cross(out, along), out], 1)
        origin = np.einsum("nij,ni->nj", np.asarray(vertices, float)[self.corners[:count]], self.weights[:count])
        return origin, axes[self.patch[:count]]

    def standing(self, vertices: np.ndarray, count: int | None = None) -> tuple[np.ndarray, np.ndarray]:
        """What `at` returns, in float32 and compiled, which takes a tenth of the time; needs numba."""
        from .root_kernels import stand_roots, turn_patches

        vertices = np.ascontiguousarray(vertices, np.float32)
        turned = np.empty((len(self.members), 3, 3), np.float32)
        turn_patches(vertices, self.members, self.first, self.second, turned)
        some = len(self.corners[:count])
        origin, axes = np.empty((some, 3), np.float32), np.empty((some, 3, 3), np.float32)
        stand_roots(vertices, self.corners, self.weights, self.patch, turned, origin, axes)
        return origin, axes


class _Patch(NamedTuple):
    """Vertices around a triangle, and their coefficients in its two axes, [k] each."""

    members: np.ndarray
    first: np.ndarray
    second: np.ndarray


@functools.lru_cache(maxsize=2)
def _known(template: bytes, faces: bytes) -> dict[tuple[int, int], _Patch]:
    """The patches of one head that were made so far, by triangle and rings: its grooms stand on the same skin."""
    return {}


def _patches(template: np.ndarray, faces: np.ndarray, kinds: np.ndarray) -> list[_Patch]:
    """The patch of each (triangle, rings) of [U, 2]."""
    known = _known(template.tobytes(), faces.tobytes())
    wanted = [(triangle, rings) for triangle, rings in kinds.tolist()]
    missing = [kind for kind in wanted if kind not in known]
    if missing:
        order = np.argsort(faces.ravel(), kind="stable") // 3
        start = np.searchsorted(np.sort(faces.ravel()), np.arange(len(template) + 1))
    for triangle, rings in missing:
        own = np.unique(faces[triangle])
        for _ in range(rings):
            touching = np.unique(np.concatenate([order[start[v] : start[v + 1]] for v in own]))
            own = np.unique(faces[touching])
        a, b, c = template[faces[triangle]]
        along = (b - a) / max(float(np.linalg.norm(b - a)), 1e-12)
        normal = np.cross(b - a, c - a)
        across = np.cross(normal / max(float(np.linalg.norm(normal)), 1e-15), along)
        offsets = template[own] - template[own].mean(0)
        known[triangle, rings] = _Patch(own, offsets @ along, offsets @ across)
    return [known[kind] for kind in wanted]


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-15)
