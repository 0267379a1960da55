"""Lashes that follow their lids: they turn with the lash cards and, on shut eyes, stand on the seam. Needs numpy only.

Strands bound to triangles (see `hair`) twist with the small triangles at a lid's edge, and a shut upper lid of the head model
reaches below the edge of the lower one, which would hide its lashes inside the skin. `scene` uses this class instead of
`hair.Strands` for lashes; on the neutral head both give the same points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .face_hair import lash_edges
from .hair import Strands
from .mesh import Head

SEAM_LIFT = np.array([0.0, 0.0003, 0.0007])  # metres from the lower lid's lash roots to those of a shut upper lid
SHUT = 0.0015  # metres of overlap at which a lid counts as shut
DROOP = 0.35  # of a lash's length that its tip sinks on a shut lid


@dataclass
class Lashes:
    """Lashes in the interface of `Strands`.

    Attributes:
        strands: The strands bound to the neutral head.
        offsets: Points relative to the roots on the neutral head, metres, [N, K, 3].
        tips: Outer card vertices behind the bound edge of each strand, [N, 2].
        direction: Unit direction of the card at each strand on the neutral head, [N, 3].
        upper: Whether a strand is on an upper lid, [N].
        seams: Lower lid's root vertices of the strand's eye from the middle outwards, by sign of x.
        sides: Sign of x of each strand, [N].
        rest: Neutral vertices of the seams, [M, 3].
    """

    strands: Strands
    offsets: np.ndarray
    tips: np.ndarray
    direction: np.ndarray
    upper: np.ndarray
    seams: dict[int, np.ndarray]
    sides: np.ndarray
    rest: np.ndarray

    @staticmethod
    def build(head: Head, neutral: np.ndarray, strands: Strands) -> Lashes:
        """Prepare the lash strands of a person with neutral vertices [V, 3]."""
        behind: dict[tuple[int, int], tuple[int, int, bool]] = {}
        seams: dict[int, np.ndarray] = {}
        for root, tip, _, upper in lash_edges(head):
            for i in range(len(root) - 1):
                behind[int(root[i]), int(root[i + 1])] = (int(tip[i]), int(tip[i + 1]), upper)
            if not upper:
                x = neutral[root, 0]
                seams[1 if x.mean() > 0 else -1] = np.asarray(root)[np.argsort(np.abs(x))]
        found = [behind[int(a), int(b)] for a, b in strands.faces[:, :2]]
        tips = np.array([f[:2] for f in found])
        points = strands.points(neutral)
        result = Lashes(
            strands,
            points - points[:, :1],
            tips,
            np.zeros(0),
            np.array([f[2] for f in found]),
            seams,
            np.where(points[:, 0, 0] > 0, 1, -1),
            neutral[np.concatenate(list(seams.values()))],
        )
        result.direction = result._directions(neutral)
        return result

    @property
    def faces(self) -> np.ndarray:
        """Bound triangles, [N, 3]."""
        return self.strands.faces

    @property
    def local(self) -> np.ndarray:
        """Points in the triangles' frames, [N, K, 3]."""
        return self.strands.local

    @property
    def radius(self) -> np.ndarray:
        """Radius at the root in metres, [N]."""
        return self.strands.radius

    def points(self, vertices: np.ndarray) -> np.ndarray:
        """World positions on a posed head [V, 3] -> [N, K, 3]."""
        rigid = _rigid(self.rest, vertices[np.concatenate(list(self.seams.values()))])
        turn = _between(self.direction @ rigid, self._directions(vertices))
        offsets = self.offsets @ rigid @ turn.transpose(0, 2, 1)
        roots = self._roots(vertices)
        upwards = np.array([0.0, 1.0, 0.0]) @ rigid
        shift, shut = self._to_seam(vertices, roots, upwards)
        length = np.linalg.norm(self.offsets[:, -1], axis=1)
        along = np.linspace(0, 1, self.offsets.shape[1]) ** 1.5
        offsets -= DROOP * (shut * length)[:, None, None] * along[:, None] * upwards
        return (roots + shift)[:, None] + offsets

    def _roots(self, vertices: np.ndarray) -> np.ndarray:
        return (vertices[self.strands.faces] * self.strands.weights[..., None]).sum(1)

    def _directions(self, vertices: np.ndarray) -> np.ndarray:
        share = self.strands.weights[:, 1:2]
        outer = vertices[self.tips[:, 0]] * (1 - share) + vertices[self.tips[:, 1]] * share
        direction = outer - self._roots(vertices)
        return direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-9)

    def _to_seam(self, vertices: np.ndarray, roots: np.ndarray, upwards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Shift [N, 3] that brings buried roots of upper lashes to the lower lid's edge, and how far each lid is shut, [N].

        Heights are compared in a frame of the eye: across its corners, upwards [3] in the posed head, forward.
        """
        shift, shut = np.zeros_like(roots), np.zeros(len(roots))
        for side, seam in self.seams.items():
            own = np.flatnonzero(self.upper & (self.sides == side))
            line = vertices[seam]
            base = line[0]
            across = line[-1] - base
            width = np.linalg.norm(across)
            across = across / width
            forward = np.cross(across, upwards) * side
            forward /= np.linalg.norm(forward)
            up = np.cross(forward, across) * side
            frame = np.stack([across, up, forward])
            seam_local = (line - base) @ frame.T
            order = np.argsort(seam_local[:, 0])
            local = (roots[own] - base) @ frame.T
            place = np.clip(local[:, 0], 0, width)
            target = np.stack([np.interp(place, seam_local[order, 0], seam_local[order, k]) for k in (1, 2)], 1)
            overlap = target[:, 0] + SEAM_LIFT[1] - local[:, 1]
            amount = np.clip(overlap / SHUT, 0, 1)
            move = np.zeros_like(local)
            move[:, 1] = np.maximum(overlap, 0)
            move[:, 2] = amount * np.maximum(target[:, 1] + SEAM_LIFT[2] - local[:, 2], 0)
            shift[own], shut[own] = move @ frame, amount
        return shift, shut


def _rigid(rest: np.ndarray, posed: np.ndarray) -> np.ndarray:
    """Rotation [3, 3] that takes rows of points `rest` [M, 3] best to `posed`, by multiplication from the right."""
    u, _, v = np.linalg.svd((rest - rest.mean(0)).T @ (posed - posed.mean(0)))
    proper = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    return u @ proper @ v


def _between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Smallest rotations that turn unit vectors a [N, 3] into b [N, 3], [N, 3, 3]."""
    axis, cosine = np.cross(a, b), (a * b).sum(1)
    zero = np.zeros(len(a))
    x, y, z = axis.T
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], 1).reshape(-1, 3, 3)
    return np.eye(3) + skew + skew @ skew / np.maximum(1 + cosine, 1e-6)[:, None, None]
