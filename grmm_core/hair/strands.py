"""A groom made ready for drawing: more strands than were stored, in the order in which levels of detail take them. Numpy only.

`StrandBlock` holds the strands of one group. Stored strands are parents; around each stand further ones that follow it, so that
a file of a few thousand strands gives a head of hair. Strands are ordered so that any first part of them is spread evenly: a
level of detail is a first part, wider by as much as is missing, the last of them fading in, so that nothing pops in a zoom.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from .crowding import crowding
from .grids import nearest
from .groom import Groom
from .knots import tied
from .occlusion import openness
from .pigment import albedos, locks_of
from .roots import BEARD, GROUPS, SCALP, RootFrames
from .settings import HairSettings

DENSE = (SCALP, BEARD)  # groups of many strands, which cover one another
HAIRS = 100_000  # on a head
SOFT = 0.35  # power of the strands that a drawn one stands for: how much fainter it is, and wider
SOFTEST = 0.9  # likewise of the shortest: wide bundles of these are dots
STUBBLE, CROPPED = 0.004, 0.02  # metres: strands so short are the shortest, longer ones are not short
SKY, DIM = 0.5, 1e-4  # openness of skin without hair, and what counts as none
FADE = 0.15  # share of a level's strands that are fading in
POINTS = (4, 6, 8, 12, 16, 24, 32, 40)  # numbers of points that a group may be drawn with
BEND = 0.0006  # metres that a coarser number of points may be off
FINEST, SHORN = 0.00012, 0.6  # metres: parents are split until strands are about this wide; of short hair, share of it
FEW = 0.03  # of the scalp's strands: so few long or short ones are not told apart
MOST_CHILDREN = 8
ROOT_SPREAD, TIP_SPREAD = 0.95, 0.45  # of the distance between parents, how far their children are at root and tip
TOGETHER, APART = 0.33, 0.75  # share of the former that is left at the tip: of curls and ropes, and of straight hair
STRAIGHT = (0.96, 0.985)  # way of a strand's second half over its length, of curls and of straight hair
SHORTER = 0.3  # of its length by which a child of a short parent is shorter at most
BEARD_HAIRS, BEARD_WIDE, BEARD_CHILDREN = 20_000, 0.00009, 4  # of a beard, the diameter of long ones, and children at most
BEARD_SHORTER, BEARD_FLAT = 0.65, 0.5  # as `SHORTER`, so that beards end softly; share of its height that a beard loses
COMBED, AROUND = 0.6, 12  # how far hairs of a beard go the way of so many around them
CURL = 0.007  # metres: radius of the waves of the setting 1
FRIZZ = 0.006  # metres, likewise
_PARENT_STEPS = 16
_WIDER = 0.6  # power of the share of its strands that a level draws by which these are wider
_GOLDEN, _PLASTIC, _THIRD = 0.6180339887498949, 0.7548776662466927, 0.5698402909980532


@dataclass(frozen=True)
class StrandBlock:
    """Strands of one group: M parents of K points and N strands.

    Attributes:
        group: Number in `roots.GROUPS`.
        rows: The parents' numbers in the groom, [M].
        part: Share of the group's parents that these are; shorn hair has a block of its own.
        frames: Of the parents' roots.
        points: The parents, in the frames of their roots, metres, float32 [M, K, 3].
        widths: Diameters of a strand at root and tip where all are drawn, metres, float32 [M, 2].
        light: Openness in the axes of the root, float32 [M, K, 4].
        lock: Tone of the parent's lock, about -1..1, [M].
        tied: Parents that a knot holds, whose length is none of the settings', bool [M].
        owner: Parent of each strand, int32 [N].
        spread: How far each is from it at root and tip, axes of the root, metres, float32 [N, 2, 3].
        chance: Even random numbers 0..1 for density, grey and tone, float32 [N, 3].
        tints: The parents' own colors, see `Groom.tints`, float32 [M, TINTS, 3], or None; their children have the same.
    """

    group: int
    rows: np.ndarray
    part: float
    frames: RootFrames
    points: np.ndarray
    widths: np.ndarray
    light: np.ndarray
    lock: np.ndarray
    tied: np.ndarray
    owner: np.ndarray
    spread: np.ndarray
    chance: np.ndarray
    tints: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.owner)

    @property
    def segments(self) -> int:
        """Gaussians of a strand."""
        return int(self.points.shape[1]) - 1

    @property
    def hairs(self) -> float:
        """Of a real head, those that each strand stands for."""
        return max(HAIRS * self.part / len(self), 1.0) if self.group == SCALP else 1.0

    @functools.cached_property
    def lengths(self) -> np.ndarray:
        """Of the parents, metres, [M]."""
        return lengths_of(self.points)

    @property
    def length(self) -> float:
        """Of the parents on average, metres."""
        return float(self.lengths.mean())

    @functools.cached_property
    def sparse(self) -> tuple[StrandBlock, np.ndarray]:
        """The same strands with every second point and the last, and these points' numbers: for playback."""
        some = np.append(np.arange(0, self.segments, 2), self.segments)
        return replace(self, points=self.points[:, some], light=np.ascontiguousarray(self.light[:, some])), some

    def crowded(self, points: np.ndarray, axes: np.ndarray) -> np.ndarray:
        """What each strand's segments have of `light`, as they lie on top or below, float32 [N, K - 1] (`crowding`).

        Args:
            points: The parents on a person at rest, head space, metres, [M, K, 3].
            axes: Of their roots, as rows, [M, 3, 3].
        """
        axes, t = np.asarray(axes, np.float32), np.linspace(0, 1, points.shape[1], dtype=np.float32)[:, None]
        around = self.spread @ axes[self.owner]  # in head space, [N, 2, 3]
        lying = np.asarray(points, np.float32)[self.owner] + around[:, :1] * (1 - t) + around[:, 1:] * t
        return crowding(lying, self.widths.mean(1)[self.owner], (self.light[..., 1:] @ axes)[self.owner])

    @functools.cached_property
    def softness(self) -> np.ndarray:
        """Power of the strands that a drawn one stands for by which it is fainter and wider, of the parents, float32 [M]."""
        return (SOFT + (SOFTEST - SOFT) * shortness(self.lengths)).astype(np.float32)

    @functools.cached_property
    def segment_tints(self) -> np.ndarray | None:
        """`tints` of each segment of the parents at their stored length, float32 [M, K - 1, 3], or None."""
        return self._tinted(1.0)

    def tinted(self, length: float) -> np.ndarray | None:
        """Likewise with strands so many times as long: what is cut takes its colors along, what grows on keeps the tip's."""
        return self.segment_tints if length == 1.0 else self._tinted(length)

    def _tinted(self, length: float) -> np.ndarray | None:
        if self.tints is None:
            return None
        middles = (np.arange(self.segments) + 0.5) / self.segments
        reached, whole = (between(self.tints, np.minimum(factor * middles, 1.0)) for factor in (length, 1.0))
        return np.where(self.tied[:, None, None], whole, reached).astype(np.float32)

    def styled(self, settings: HairSettings, points: np.ndarray | None = None) -> np.ndarray:
        """The parents' points, or others in their place, [M, K, 3] with length, waves and frizz as set; continuous in these."""
        points = self.points if points is None else points
        count = points.shape[1]
        t = np.linspace(0, 1, count, dtype=np.float32)
        if settings.curl < 0:
            points = points + np.float32(-settings.curl) * (smoothed(points) - points)
        if settings.length != 1.0:
            points = np.where(self.tied[:, None, None], points, lengthened(points, settings.length))
        long = lengths_of(points)
        swing = (np.minimum(long / 0.12, 1.0)[:, None] * t).astype(np.float32)
        phase = 6.2831853 * self.chance[: len(points), :, None]
        if settings.curl > 0:
            turns = np.clip(long / 0.045, 1.0, count / 5.0)[:, None]
            angle = 6.2831853 * turns * t + 3.0 * self.lock[:, None]
            side, other = across(points)
            wave = np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * other
            points = points + np.float32(settings.curl * CURL) * swing[..., None] * wave
        if settings.frizz > 0:
            turns = np.clip(long / 0.025, 1.0, count / 3.0)[:, None, None]
            noise = np.sin(6.2831853 * turns * t[None, None] + phase) + 0.5 * np.sin(14.1 * turns * t[None, None] + 2.0 * phase)
            shy = self.chance[: len(points), 2:3, None] ** 2  # most hairs keep to their course
            points = points + np.float32(settings.frizz * FRIZZ) * shy * swing[..., None] * noise.transpose(0, 2, 1)
        return np.ascontiguousarray(points, np.float32)

    def resampled(self, groom: Groom, points: np.ndarray) -> np.ndarray:
        """The parents' points [M, K, 3] out of all points [P, 3] of the groom that the block was made from."""
        moved = replace(groom, points=points).select(self.rows).resampled(self.points.shape[1])
        return moved.points.reshape(self.points.shape)

    def parents(self, share: float, detail: float = 1.0) -> int:
        """How many parents, the first ones, a level is made from; a little more, so that few numbers occur."""
        step = -(-len(self.points) // _PARENT_STEPS)
        return min(-(-self._end(share, detail) // step) * step, len(self.points))

    def _end(self, share: float, detail: float) -> int:
        return int(np.ceil(min(int(np.ceil(_top(share) * len(self))), len(self)) * detail))

    def level(self, share: float, settings: HairSettings, detail: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Which strands are drawn and how wide each is, continuous in both arguments.

        One that stands for several is a loose bundle: wider than these side by side, and by as much fainter.

        Args:
            share: 0..1 of the strands.
            settings: Density and thickness.
            detail: 0..1 of the strands of that level, a little wider and not fainter: so hair keeps its look.

        Returns:
            Number of strands n as a slice's end is the length of what is returned: half the diameters [n, 2] float32 at root
            and tip, and weights 0..1 [n] by which strands are there.
        """
        top, end = _top(share), self._end(share, 1.0)
        rank = (np.arange(len(self), dtype=np.float32) + 0.5) / len(self)
        fade = max(FADE * top * (1.0 - share), 1e-6)
        there = np.clip((top - rank[:end]) / fade, 0.0, 1.0)
        wider = len(self) / max(float(there.sum()), 1e-6)
        fainter = (np.float32(wider) ** self.softness)[self.owner[:end]]
        there = there * np.clip((settings.density * 1.08 - self.chance[:end, 0]) / 0.08, 0.0, 1.0) / fainter
        end = self._end(share, detail)
        there, wider = there[:end], wider * detail**-_WIDER
        radii = (0.5 * wider * settings.thickness * fainter[:end])[:, None] * self.widths[self.owner[:end]]
        return np.ascontiguousarray(radii, np.float32), there.astype(np.float32)

    def drawn(self, share: float, settings: HairSettings, detail: float = 1.0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of each strand of a level half the diameters [n, 2], the weight [n] and the linear RGB at root and tip [n, 2, 3].

        As `level` and `albedos` give them. Those of the last arguments are kept: they stay the same while a head is played.
        """
        key = share, settings, detail
        known = self._drawn.get("last")
        if known is None or known[0] != key:
            radii, there = self.level(share, settings, detail)
            count = len(there)
            colors = albedos(settings, self.lock[self.owner[:count]], self.chance[:count, 1:], self.hairs, share)
            known = self._drawn["last"] = key, (radii, there, colors)
        return known[1]

    def lit(self, settings: HairSettings) -> np.ndarray:
        """`light` with as much hair as settings leave: on the way to that of bare skin. That of the last settings is kept."""
        if settings.shading == 1.0:
            return self.light
        known = self._lit.get("last")
        if known is None or known[0] != settings.shading:
            more = (np.clip(self.light[..., :1], DIM, SKY) / SKY) ** np.float32(settings.shading - 1.0)
            known = self._lit["last"] = settings.shading, self.light * more
        return known[1]

    @functools.cached_property
    def _lit(self) -> dict[str, tuple[float, np.ndarray]]:
        return {}

    @functools.cached_property
    def _drawn(self) -> dict[str, tuple[tuple[float, HairSettings, float], tuple[np.ndarray, np.ndarray, np.ndarray]]]:
        return {}


def _top(share: float) -> float:
    """Up to which rank strands are drawn; with every strand asked for, none is fading in."""
    return share / (1.0 - FADE * (1.0 - share))


def blocks_of(
    groom: Groom, vertices: np.ndarray, faces: np.ndarray, lies: Callable[[np.ndarray], np.ndarray] | None = None
) -> tuple[StrandBlock, ...]:
    """Make a groom ready.

    Args:
        groom: The strands.
        vertices: The head model's mean, metres, [V, 3].
        faces: Its triangles, [F, 3].
        lies: Where scalp hair [N, K, 3] is drawn on that head, for its light (`body.outside`); None: as recorded.

    Raises:
        ShapeError: The groom is of another head.
    """
    vertices = np.asarray(vertices, np.float64)
    groom.frames(vertices, faces)
    made = []
    for group in range(len(GROUPS)):
        rows = np.flatnonzero(groom.groups == group)
        if len(rows):
            order = np.argsort((np.arange(len(rows)) * _GOLDEN) % 1.0)
            lock = locks_of(groom.select(rows), vertices, faces)[order]
            rows = rows[order]
            some = groom.select(rows)
            count = points_needed(some)
            even = some.resampled(count)
            posed = even.posed(even.frames(vertices, faces), vertices).reshape(len(even), count, 3)
            lying = lies(posed) if lies is not None and group == SCALP else posed
            seen = openness(lying, even.widths.mean(1), vertices, faces)
            long = lengths_of(posed) > CROPPED
            apart = group == SCALP and FEW < long.mean() < 1.0 - FEW  # each with levels of detail of its own
            held = tied(some, vertices, faces)
            for part in (long, ~long) if apart else (np.ones(len(rows), bool),):
                own = (array[part] for array in (seen, lock, held))
                made.append(_block(some.select(part), rows[part], group, part.mean(), vertices, faces, *own))
    return tuple(made)


def _block(
    groom: Groom, rows: np.ndarray, group: int, part: float, vertices: np.ndarray, faces: np.ndarray, seen: np.ndarray,
    lock: np.ndarray, held: np.ndarray,
) -> StrandBlock:  # fmt: skip
    count = points_needed(groom)
    groom = groom.resampled(count)
    frames = groom.frames(vertices, faces)
    posed = groom.posed(frames, vertices).reshape(len(groom), count, 3)
    widths = groom.widths.astype(np.float32)
    seen = evened(seen, count)
    _, axes = frames.at(vertices)
    light = np.concatenate([seen[..., :1], np.einsum("mij,mkj->mki", axes, seen[..., 1:])], 2).astype(np.float32)
    local = groom.points.reshape(len(groom), count, 3)
    lengths, children = lengths_of(local), 1
    if group == SCALP:
        fine = FINEST if lengths.mean() > CROPPED else SHORN * FINEST
        children = int(np.clip(round(float(widths[:, 0].mean()) / fine), 1, MOST_CHILDREN))
    elif group == BEARD:  # a record has too few: they are more by these, and finer where they are long
        children = int(np.clip(round(BEARD_HAIRS / len(groom)), 1, BEARD_CHILDREN))
        finer = np.minimum(widths, widths * (BEARD_WIDE / widths[:, :1].clip(1e-6)))
        widths = widths + (1.0 - shortness(lengths))[:, None] * (children * finer - widths)
    g = np.random.default_rng(len(groom))
    total = len(groom) * children
    owner = np.tile(np.arange(len(groom), dtype=np.int32), children)
    spread = _spread(groom, owner, vertices, faces, g)
    if group in DENSE:
        fresh = slice(len(groom), total)  # the children
        shorter = shortness(lengths)[:, None] * SHORTER if group == SCALP else np.full((len(groom), 1), BEARD_SHORTER)
        left = 1.0 - g.random((total, 1))[fresh] * shorter[owner[fresh]]
        ends = local[:, -1].astype(float)
        if group == BEARD:  # one that was grown hair by hair stands off, each its own way
            way = posed[:, -1] - posed[:, 0]
            others = way[nearest(posed[:, 0], posed[:, 0], min(AROUND, len(groom)))[0]].mean(1)
            ends += COMBED * np.einsum("mij,mj->mi", axes, others - way)
            ends[:, 2] -= BEARD_FLAT * ends[:, 2].clip(0.0)
            spread[:, 1] += (ends - local[:, -1])[owner]
        spread[fresh, 1] += (left - 1.0) * ends[owner[fresh]]
    numbers = np.arange(total)
    parents, turns = numbers % len(groom), numbers // len(groom)
    # even among the strands of each parent, however many parents there are: thin hair has no tufts, grey hair no white locks
    steps = ((_PLASTIC, _GOLDEN), (_THIRD, _PLASTIC), (_GOLDEN, _THIRD))
    chance = np.stack([(parents * first + turns * then + 0.37) % 1.0 for first, then in steps], 1)
    return StrandBlock(
        group, rows, part, frames, local, widths / children, light, lock, held, owner, spread.astype(np.float32),
        chance.astype(np.float32), groom.tints if groom.tints is not None and groom.tints.any() else None,
    )  # fmt: skip


def lengths_of(points: np.ndarray) -> np.ndarray:
    """Of strands [M, K, 3], metres [M]."""
    lengths: np.ndarray = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1)
    return lengths


def shortness(lengths: np.ndarray) -> np.ndarray:
    """How far strands of lengths in metres count as short, 1..0."""
    return np.clip((CROPPED - lengths) / (CROPPED - STUBBLE), 0.0, 1.0)


def points_needed(groom: Groom) -> int:
    """The smallest of `POINTS` with which most strands keep their shape."""
    some = groom.select(np.linspace(0, len(groom) - 1, min(len(groom), 400)).astype(int))
    fine = some.resampled(2 * POINTS[-1] - 1)
    for count in POINTS:
        if count >= int(groom.counts.max()):
            break
        back = some.resampled(count).resampled(2 * POINTS[-1] - 1)
        off = np.linalg.norm(back.points - fine.points, axis=1).reshape(len(some), -1).max(1)
        if np.percentile(off, 80) < BEND:
            return count
    return min(POINTS[-1], max(4, int(groom.counts.max())))


def root_distance(groom: Groom, vertices: np.ndarray, faces: np.ndarray) -> float:
    """How far strands stand apart on the skin that they grow on, metres."""
    corners = vertices[np.asarray(faces)[np.unique(groom.triangles)]]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    return float(np.sqrt(area / max(len(groom), 1)))


def _spread(groom: Groom, owner: np.ndarray, vertices: np.ndarray, faces: np.ndarray, g: np.random.Generator) -> np.ndarray:
    """Where children stand around their parents, [N, 2, 3] metres; the parents themselves come first and stay."""
    total = len(owner)
    turn, far = np.arange(total) // len(groom) / (total // len(groom)), np.sqrt(g.random(total))
    angle = 2 * np.pi * (g.random(len(groom))[owner] + turn)
    root = np.stack([far * np.cos(angle), far * np.sin(angle), np.zeros(total)], 1) * ROOT_SPREAD
    points = groom.points.reshape(len(groom), -1, 3)
    short = shortness(lengths_of(points))  # does not hang together in wisps
    half = points[:, points.shape[1] // 2 :]
    way = np.linalg.norm(half[:, -1] - half[:, 0], axis=1) / np.maximum(lengths_of(half), 1e-9)
    left = np.interp(way, STRAIGHT, (TOGETHER, APART))  # locks that end in points make a comb of a hem
    tip = (left + (1.0 - left) * short)[owner, None] * root + g.normal(0, 0.5, (total, 3)) * TIP_SPREAD
    spread = root_distance(groom, vertices, faces) * np.stack([root, tip], 1)
    spread[: len(groom)] = 0.0
    return spread


def means_between(segments: np.ndarray, some: np.ndarray) -> np.ndarray:
    """What segments [N, K-1] of strands have in the mean between `some` of their points, the first and last among them."""
    found: np.ndarray = np.add.reduceat(segments, some[:-1], 1) / np.diff(some).astype(np.float32)
    return found


def smoothed(points: np.ndarray) -> np.ndarray:
    """Strands [M, K, 3] without their curls; ends stay."""
    result = points
    for _ in range(2 * points.shape[1] // 3):
        middle = 0.25 * (result[:, :-2] + result[:, 2:]) + 0.5 * result[:, 1:-1]
        result = np.concatenate([result[:, :1], middle, result[:, -1:]], 1)
    return result


def lengthened(points: np.ndarray, length: float) -> np.ndarray:
    """Strands [M, K, 3] cut to a share of their length, or grown on as their last third goes, with its coils and waves.

    That is turned about its ends by half a turn again and again: in the mean it goes on straight, and nowhere is a kink.
    """
    at = np.linspace(0, length, points.shape[1])
    inside = between(points, np.minimum(at, 1.0)).astype(points.dtype)
    if length <= 1.0:
        return inside
    over = np.maximum(at - 1.0, 0.0) * 3.0
    number = np.maximum(np.ceil(over) - 1.0, 0.0)
    odd = number % 2 == 1
    again = between(points, np.where(odd, 2.0 + over - number, 3.0 - over + number) / 3.0)
    end, third = points[:, -1:], points[:, -1:] - between(points, np.array([2.0 / 3.0]))
    number, odd = number[:, None], odd[:, None]
    beyond = np.where(odd, again + (number + 1.0) * third, 2.0 * end + number * third - again)
    return np.where(at[:, None] > 1.0, beyond.astype(points.dtype), inside)


def across(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit directions across each strand, [M, K, 3] each."""
    along = np.gradient(points, axis=1)
    along /= np.maximum(np.linalg.norm(along, axis=2, keepdims=True), 1e-12)
    side = np.cross(along, np.array([0.31, 0.42, 0.85], np.float32))
    side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-12)
    return side, np.cross(along, side)


def evened(strands: np.ndarray, count: int) -> np.ndarray:
    """Strands [N, K, C] with `count` points by number."""
    return between(strands, np.linspace(0, 1, count))


def between(strands: np.ndarray, places: np.ndarray) -> np.ndarray:
    """What strands [N, K, C] have at places 0..1 [P] between the first and the last of their points, [N, P, C]."""
    at = places * (strands.shape[1] - 1)
    base = np.minimum(at.astype(int), strands.shape[1] - 2)
    part = (at - base)[:, None]
    return strands[:, base] * (1 - part) + strands[:, base + 1] * part
