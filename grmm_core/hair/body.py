"""What strands stay outside of: a head's skin with the hull of its ears, as heights on a grid. Needs numba where it is made.

Height is measured above the tangent planes of the skin's vertices around a point, so that it is smooth, about the distance near
the skin, and negative inside. An ear counts as the bulge around it, which falls off to all sides: hair lies over ears, not
between their folds, and leans out before them.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.triangles import vertex_normals
from ..head import HeadModel
from .grids import sample
from .groom import Groom, join
from .pigment import locks_of
from .roots import SCALP, RootFrames
from .strands import lengths_of

CELL = 0.008  # metres
MARGIN = 0.05  # metres around the skin
EAR = 0.018  # metres: how far around a vertex of an ear its hull is the highest that there is
# what the hull falls by upwards, and to the other sides, metres a metre: hair leans out before an ear and does not break there
LEAN, STEEP = 0.38, 1.0
HULL, OVER = 0.05, 0.012  # metres around an ear where strands may lie on its hull; below its top, where they go over it
STRAIGHT, BEND = 0.025, 300.0  # metres that it has fallen where skin is reached, and how it falls away below that, 1/m
REACH = 0.015  # metres: see `body_kernels.heights_into`
BURIED = 0.05  # metres: what is deeper is left, it is no strand on a head
# of contact while hair swings: share of what it is inside the skin that a step pushes out, metres at most, and the share of
# its speed that it keeps; what is deeper than the last, as where a face turns into hair, is pushed out to there at once
SOFT, MOST, SLIDE, DEEP = 0.5, 0.002, 0.3, 0.003
BUST = 0.075  # metres above the lowest vertex: an edge of the skin below that is the rim
RAGGED, ABOVE = 0.010, 0.006  # metres: how far locks end apart at the rim, and how far above it on average
SHORT, LONG = 0.03, 0.06  # metres: hair so short stays on the skin that it grows on and beside the ears; longer is pushed
CLEARANCE, LYING = 0.001, 0.025  # metres that hair stays above the skin; share of its length that ends lie higher, in layers
# a segment that gets so many times longer, or keeps no more of its direction, when it is pushed out from so deep, metres, ends
# its strand
TORN, TURNED, UNDER = 1.5, 0.3, 0.012
_INSIDE = ("mouth_interior", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes")
_ROUNDS = 3  # of pushing
TINY = 1e-6


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
    def of(
        head: HeadModel, vertices: np.ndarray, near: np.ndarray | None = None, below: float = np.inf, ears: bool = True
    ) -> Body:  # fmt: skip
        """Measure a head.

        Args:
            head: For its topology.
            vertices: The head, upright, metres, [V, 3].
            near: Points [P, 3] around which heights are asked, up to `BLOCK` cells away; anywhere when None.
            below: Height up to which heights are asked, below the ears; what is above is high. It saves time.
            ears: With their hull.
        """
        from ..compute.threads import for_rows
        from .body_kernels import BLOCK, heights_into

        vertices = np.asarray(vertices, float)
        points, normals = _skin(head, vertices)
        some = points[:, 1] < below + MARGIN
        points, normals = points[some], normals[some]
        low = points.min(0) - MARGIN
        size = np.ceil((points.max(0) + MARGIN - low) / CELL).astype(int) + 1
        heights = np.full(tuple(size), MARGIN, np.float32)
        blocks = -(-size // BLOCK)
        wanted = np.full(tuple(blocks), near is None)
        if near is not None:
            near = near[near[:, 1] < below + CELL]
            wanted[tuple(np.clip(((near - low) / (CELL * BLOCK)).astype(int), 0, blocks - 1).T)] = True
            for axis in range(3):  # and the blocks around these
                some = np.moveaxis(wanted, axis, 0)
                before = some.copy()
                some[1:] |= before[:-1]
                some[:-1] |= before[1:]
        planes = (np.ascontiguousarray(part, np.float32) for part in (points, normals, low))
        for_rows(heights_into, int(blocks[0]), *planes, CELL, REACH, wanted, heights, smallest=1)
        if ears and not np.isfinite(below):
            _over_ears(head, vertices, low, heights)
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

    def pushed(self, strands: np.ndarray, clearance: float | np.ndarray = CLEARANCE) -> np.ndarray:
        """Strands [N, K, 3], root first, moved out to a clearance in metres, or each point's [N, K]; their first fifth less."""
        from ..compute.threads import for_rows
        from .body_kernels import push

        count = strands.shape[1]
        t = np.minimum(np.arange(count) / (0.2 * (count - 1)), 1.0)
        wanted = clearance * (2.0 * t * t * (3.0 - 2.0 * t) - 1.0)
        wanted = np.ascontiguousarray(np.broadcast_to(wanted, strands.shape[:2]), np.float32)
        points = np.array(strands, np.float32, order="C")
        low = self.low.astype(np.float32)
        for_rows(
            push, len(points), self.field, low, np.float32(CELL), np.float32(BURIED), wanted, _ROUNDS, points, smallest=256
        )
        return points

    def untorn(self, strands: np.ndarray, pushed: np.ndarray) -> np.ndarray:
        """Pushed strands [N, K, 3], cut where they were on their way through the head: they would lie across a face."""
        steps, moved = np.diff(strands, axis=1), np.diff(pushed, axis=1)
        before, after = np.linalg.norm(steps, axis=2), np.linalg.norm(moved, axis=2)
        torn = (after > TORN * before + CLEARANCE) | ((steps * moved).sum(2) < TURNED * before * after)
        some = np.flatnonzero(torn.any(1))
        heights = self.heights(strands[some].reshape(-1, 3))[0].reshape(len(some), strands.shape[1])
        torn = torn[some] & (np.minimum(heights[:, 1:], heights[:, :-1]) < -UNDER)
        some, torn = some[torn.any(1)], torn[torn.any(1)]
        result = pushed.copy()
        result[some] = cut(pushed[some], np.maximum(torn.argmax(1), 1) / (strands.shape[1] - 1))
        return result


@dataclass(frozen=True)
class Rim:
    """The edge at which a bust ends, around its middle; hair ends there too, as below it nothing hides it.

    Attributes:
        middle: x and z, metres, [2].
        angles: Around it, ascending, radians, [A].
        heights: There, metres, [A].
    """

    middle: np.ndarray
    angles: np.ndarray
    heights: np.ndarray

    @staticmethod
    def of(head: HeadModel, vertices: np.ndarray) -> Rim:
        """Find the rim of a head with vertices [V, 3]."""
        edge = vertices[_edge(head)]
        edge = edge[edge[:, 1] < vertices[:, 1].min() + BUST]
        middle = edge[:, [0, 2]].mean(0) if len(edge) else np.zeros(2)
        angles = np.arctan2(*(edge[:, [0, 2]] - middle).T)
        order = np.argsort(angles)
        return Rim(middle, angles[order], edge[order, 1])

    def ended(self, strands: np.ndarray, lock: np.ndarray) -> np.ndarray:
        """Strands [N, K, 3] cut where they get below the rim, each lock, -1..1 [N], somewhat higher or lower."""
        if not len(self.angles):
            return strands
        x, z = strands[..., 0] - self.middle[0], strands[..., 2] - self.middle[1]
        height = np.interp(np.arctan2(x, z), self.angles, self.heights, period=2 * np.pi)
        over = strands[..., 1] - height - ABOVE - RAGGED * lock[:, None]
        over[:, 0] = np.maximum(over[:, 0], TINY)
        some = np.flatnonzero((over < 0).any(1))
        last = (over[some] < 0).argmax(1)  # the first point that is below
        part = over[some, last - 1] / (over[some, last - 1] - over[some, last])
        result = strands.copy()
        result[some] = cut(strands[some], (last - 1 + part) / (strands.shape[1] - 1))
        return result


def on_person(head: HeadModel, still: np.ndarray, frames: RootFrames, local: np.ndarray, lock: np.ndarray) -> np.ndarray:
    """Scalp hair [M, K, 3] in the frames of its roots, pushed out of a person's skin and ended at the bust's rim.

    Args:
        head: For its topology.
        still: The person at rest, metres, [V, 3].
        frames: Of the roots.
        local: The strands.
        lock: See `Rim.ended`.
    """
    origin, axes = (part.astype(np.float32) for part in frames.at(still))
    fitted = outside(head, still, np.matmul(local, axes) + origin[:, None], lock)
    fitted = Rim.of(head, still).ended(fitted, lock)
    result: np.ndarray = np.matmul(fitted - origin[:, None], axes.transpose(0, 2, 1))
    return result


def outside(head: HeadModel, still: np.ndarray, strands: np.ndarray, lock: np.ndarray | float = 0.0) -> np.ndarray:
    """Scalp hair [M, K, 3] pushed out of the skin of a person at rest [V, 3] and of the ears; `lock` as of `Rim.ended`."""
    lengths = lengths_of(strands)
    wanted = CLEARANCE + (LYING * lengths * (1.0 + 0.5 * lock))[:, None] * np.linspace(0, 1, strands.shape[1]) ** 2
    body = Body.of(head, still, near=strands.reshape(-1, 3))
    fitted = body.untorn(strands, body.pushed(strands, wanted))
    above = np.flatnonzero(_above_ears(head, still, strands) & (lengths > SHORT))
    if len(above):
        skin = Body.of(head, still, near=strands[above].reshape(-1, 3), ears=False)
        fitted[above] = skin.untorn(strands[above], skin.pushed(strands[above], wanted[above]))
    over_ears = np.clip((lengths - SHORT) / (LONG - SHORT), 0.0, 1.0)[:, None, None]
    result: np.ndarray = strands + over_ears * (fitted - strands)
    return result


def _above_ears(head: HeadModel, still: np.ndarray, strands: np.ndarray) -> np.ndarray:
    """Whether strands [M, K, 3] pass above an ear and not over it, [M]; those of a ponytail do not lean out before it."""
    ears = still[head.regions.get("ears", np.zeros(0, int))]
    above, over = np.zeros((2, len(strands)), bool)
    for side in (1.0, -1.0):
        ear = ears[side * ears[:, 0] > 0.0]
        if not len(ear):
            continue
        (_, _, back), (_, top, front) = ear.min(0), ear.max(0)
        own, y, z = side * strands[..., 0] > 0.0, strands[..., 1], strands[..., 2]
        over |= (own & (z > back) & (z < front) & (y < top - OVER)).any(1)
        above |= (own & (z > back - HULL) & (z < front + HULL) & (y < top + HULL)).any(1)
    result: np.ndarray = above & ~over
    return result


def cut(strands: np.ndarray, shares: np.ndarray) -> np.ndarray:
    """Strands [N, K, 3] of which the first part is left, each of its own share 0..1 [N], with as many points."""
    count = strands.shape[1]
    at = np.linspace(0, 1, count) * ((count - 1) * shares)[:, None]
    base = np.minimum(at.astype(int), count - 2)
    part = (at - base)[..., None].astype(strands.dtype)
    rows = np.arange(len(strands))[:, None]
    result: np.ndarray = strands[rows, base] * (1 - part) + strands[rows, base + 1] * part
    return result


def worn(head: HeadModel, still: np.ndarray, groom: Groom) -> Groom:
    """A groom whose scalp hair is as it is drawn `on_person`; strands get as many points, evenly, as any of their group has."""
    template = np.asarray(head.v_template, float)
    parts = []
    for group in np.unique(groom.groups):
        some = groom.select(groom.groups == group)
        count = int(some.counts.max())
        if group == SCALP and count > 1:
            some = some.resampled(count)
            local, frames = some.points.reshape(len(some), count, 3).astype(np.float32), some.frames(template, head.faces)
            lock = locks_of(some, template, head.faces)
            some = replace(some, points=on_person(head, still, frames, local, lock).reshape(-1, 3).astype(np.float32))
        parts.append(some)
    return join(parts) if parts else groom


@functools.lru_cache(maxsize=4)
def _edge(head: HeadModel) -> np.ndarray:
    """Vertices on the border of the outer skin, [E]."""
    faces = np.asarray(head.faces)[np.asarray(head.uv_islands) == 0]
    edges, number = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), 1), axis=0, return_counts=True)
    return np.unique(edges[number == 1])


def _skin(head: HeadModel, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points and normals of the planes at the vertices of the outer skin without the ears, [S, 3] each."""
    faces = np.asarray(head.faces)[np.asarray(head.uv_islands) == 0]
    normals = vertex_normals(vertices, faces)
    outer = np.zeros(len(vertices), bool)
    outer[faces] = True
    for name in (*_INSIDE, "ears"):
        outer[head.regions.get(name, np.zeros(0, int))] = False
    return vertices[outer], normals[outer]


def _over_ears(head: HeadModel, vertices: np.ndarray, low: np.ndarray, heights: np.ndarray) -> None:
    """Lower heights [X, Y, Z] of cells from `low` on to what they are above the hull of the ears."""
    x, y, z = (low[axis] + CELL * np.arange(count) for axis, count in enumerate(heights.shape))
    ears = vertices[head.regions.get("ears", np.zeros(0, int))]
    for side in (1.0, -1.0):
        ear = ears[side * ears[:, 0] > 0.0]
        if not len(ear):
            continue
        near = np.linalg.norm(ear[:, None, 1:] - ear[None, :, 1:], axis=2) < EAR
        out = np.where(near, side * ear[:, 0], 0.0).max(1)  # the highest around
        up, across = y[:, None] - ear[:, 1], STEEP * (z[:, None] - ear[:, 2])
        fall = np.hypot(np.where(up > 0.0, LEAN, STEEP)[:, None] * up[:, None], across[None])
        top = (out - fall - BEND * np.maximum(fall - STRAIGHT, 0.0) ** 2).max(2)  # [Y, Z]
        flat = 1.0 / np.sqrt(1.0 + sum(part**2 for part in np.gradient(top, CELL)))
        own = side * x > 0.0
        heights[own] = np.minimum(heights[own], (side * x[own, None, None] - top) * flat)
