"""Lashes that follow their lids: they turn with them about the eyes and, on shut eyes, stand on the seam. Needs numpy only.

Strands bound to triangles twist with the small triangles at a lid's edge, and a shut upper lid of the head model reaches below
the edge of the lower one, which would hide its lashes inside the skin. Sessions and the capture studio pose lashes by this
class; on the head that it was built for it gives the points of the groom.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..head import HeadModel
from ..head.lash_cards import lash_edges
from .groom import Groom

SEAM_LIFT = np.array([0.0, 0.0003, 0.0007])  # metres from the lower lid's lash roots to those of a shut upper lid
SHUT = 0.0015  # metres of overlap at which a lid counts as shut
DROOP = 0.35  # of a lash's length that its tip sinks on a shut lid
# metres that drawn lashes stand before their lids and towards the opening of the eye, those of lower lids half as far: skin of
# Gaussians, as thick as texels, hides the first millimetre of what stands on the mesh's edge, and that lid has a pale rim
BEFORE, TOWARDS = 0.0004, 0.0005
HANG = 0.25  # how steeply the lashes of a shut lid hang at least, of how far they reach


@dataclass
class Lashes:
    """The lashes of one person.

    Attributes:
        edge: The piece of a card's root edge under each strand, as two vertices, [N, 2].
        share: How far along it the root is, 0..1, [N].
        offsets: Points relative to the roots on the neutral head, metres, [N, K, 3].
        eyes: Vertices of the eyeball by sign of x, about whose middle lids turn.
        direction: Unit direction from there to each root on the neutral head, [N, 3].
        upper: Whether a strand is on an upper lid, [N].
        seams: Lower lid's root vertices of the strand's eye from the middle outwards, by sign of x.
        sides: Sign of x of each strand, [N].
        rest: Neutral vertices of the seams, [M, 3].
    """

    edge: np.ndarray
    share: np.ndarray
    offsets: np.ndarray
    eyes: dict[int, np.ndarray]
    direction: np.ndarray
    upper: np.ndarray
    seams: dict[int, np.ndarray]
    sides: np.ndarray
    rest: np.ndarray

    @staticmethod
    def build(head: HeadModel, neutral: np.ndarray, groom: Groom) -> Lashes | None:
        """Prepare a groom of lashes alone, strands of one number of points, on neutral vertices [V, 3].

        None where the head has no lash cards, or strands stand beside the cards' edges.
        """
        if "lashes" not in head.regions:
            return None
        pieces: dict[int, list[tuple[int, int, bool]]] = {}
        seams: dict[int, np.ndarray] = {}
        for card in lash_edges(head):
            root = card.root
            for i, triangle in enumerate(card.triangles):
                pieces.setdefault(int(triangle), []).append((int(root[i]), int(root[i + 1]), card.upper))
            if not card.upper:
                x = neutral[root, 0]
                seams[1 if x.mean() > 0 else -1] = root[np.argsort(np.abs(x))]
        if len(seams) < 2 or not np.isin(groom.triangles, list(pieces)).all():
            return None
        corners = np.asarray(head.faces)[groom.triangles]
        found = np.zeros((len(groom), 3), np.int64)
        for i, triangle in enumerate(groom.triangles):
            # a triangle in a corner has two pieces of the edge; the root lies on one of them
            found[i] = max(pieces[int(triangle)], key=lambda piece: groom.weights[i][np.isin(corners[i], piece[:2])].sum())
        edge = found[:, :2]
        share = (groom.weights * (corners == edge[:, 1:])).sum(1)
        points = groom.posed(groom.frames(head.v_template, head.faces), neutral).reshape(len(groom), -1, 3).astype(float)
        rest = neutral[np.concatenate(list(seams.values()))]
        sides = np.where(points[:, 0, 0] > 0, 1, -1)
        offsets = points - points[:, :1]
        eyes = {1: head.regions["left_eyeball"], -1: head.regions["right_eyeball"]}
        result = Lashes(edge, share, offsets, eyes, np.zeros(0), found[:, 2] > 0, seams, sides, rest)
        result.direction = result._directions(neutral)
        return result

    def points(self, vertices: np.ndarray) -> np.ndarray:
        """World positions on a posed head [V, 3] -> [N, K, 3]."""
        whole = rigid(self.rest, vertices[np.concatenate(list(self.seams.values()))])
        turn = _between(self.direction @ whole, self._directions(vertices))
        offsets = self.offsets @ whole @ turn.transpose(0, 2, 1)
        roots = self.edge_points(vertices)
        upwards = np.array([0.0, 1.0, 0.0]) @ whole
        shift, shut = self._to_seam(vertices, roots, upwards)
        length = np.linalg.norm(self.offsets[:, -1], axis=1)
        along = np.linspace(0, 1, self.offsets.shape[1]) ** 1.5
        offsets -= DROOP * (shut * length)[:, None, None] * along[:, None] * upwards
        rise = offsets @ upwards
        reach = np.linalg.norm(offsets - rise[..., None] * upwards, axis=2)
        offsets -= (shut[:, None] * np.maximum(rise + HANG * reach, 0.0))[..., None] * upwards
        return (roots + shift)[:, None] + offsets

    def drawn_points(self, vertices: np.ndarray) -> np.ndarray:
        """Likewise before skin of Gaussians, whose lids are thicker than the mesh's, [N, K, 3]."""
        upwards = np.array([0.0, 1.0, 0.0]) @ rigid(self.rest, vertices[np.concatenate(list(self.seams.values()))])
        towards = TOWARDS * np.where(self.upper, -1.0, 0.5)[:, None] * upwards
        return self.points(vertices) + (BEFORE * self._directions(vertices) + towards)[:, None]

    def edge_points(self, vertices: np.ndarray) -> np.ndarray:
        """Where lashes begin on the edges of their cards, on a head [V, 3], [N, 3]."""
        share = self.share[:, None]
        return vertices[self.edge[:, 0]] * (1 - share) + vertices[self.edge[:, 1]] * share

    def _directions(self, vertices: np.ndarray) -> np.ndarray:
        middles = {side: vertices[eye].mean(0) for side, eye in self.eyes.items()}
        direction = self.edge_points(vertices) - np.where(self.sides[:, None] > 0, middles[1], middles[-1])
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


def rigid(rest: np.ndarray, posed: np.ndarray) -> np.ndarray:
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
