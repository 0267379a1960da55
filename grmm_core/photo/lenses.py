"""Outlines of the lenses of glasses, whatever their frames look like: closed lines around both eyes. Needs numpy only.

A frame is darker, lighter or of another color than what is on both sides of it. Around each eye the closed path of the
strongest such lines is sought (dynamic programming over angles and radii), first for both eyes together, one of them mirrored,
since glasses are the same on both sides of the nose. Below the eyes skin has no such line that goes all the way round, nor one
that both eyes have alike, nor one that goes on over the bridge of the nose.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..pictures.polygons import polygon
from ..pictures.sampling import bilinear

EYES = ((33, 246, 161, 160, 159, 158, 157, 173, 133, 155, 154, 153, 145, 144, 163, 7),
        (263, 466, 388, 387, 386, 385, 384, 398, 362, 382, 381, 380, 374, 373, 390, 249))  # fmt: skip
"""Landmarks around each eye."""
BROWS = (70, 63, 105, 66, 107, 55, 65, 52, 53, 46), (300, 293, 334, 296, 336, 285, 295, 282, 283, 276)
"""Likewise around each brow."""
OUTER, INNER, SIDES = (33, 263), (133, 362), (234, 454)
# all lengths are in distances of the eyes' outer corners
LEAST_PIXELS, SURE_PIXELS = 48.0, 72.0  # of that distance: in fewer no outline is found, or none that tells of glasses
LOWER = 0.04  # middle of a lens below that of the eye
ANGLES, STEP, RADII = 72, 0.006, (0.10, 0.48)
NEAREST, FARTHEST, NOSE = (0.19, 0.115), (0.40, 0.36), 0.33  # half width and height of the smallest and largest lens
LINES = (0.03, 0.055, 0.09)  # how far from the middle of a line the colors on both sides are
ALIKE = (0.3, 0.8)  # cosine between the differences to these: below the first it is an edge, above the second a line
STRONG, SEEN = 0.15, 0.045  # a line's contrast, display sRGB: more counts no more; from where on it is there
JUMP, BEND = 3, 0.004  # steps of the radius from one angle to the next, and what one costs
LOOSE, NEAR = 2, 5  # steps by which the two eyes may differ from one another, and each from the common outline
BELOW = 0.2  # sine of the angle from which on an outline is below the eye
# there: share that must be seen, that each eye finds alone, how much stronger than others these lines are; if glasses are known
COVERED, AGREED, STANDING_OUT, COVERED_KNOWN = 0.9, 0.8, 2.5, 0.6
# of a frame, inwards and outwards: most of its thickness beside the line, and how like the line it is, of what that stands out
THICKEST, HALF = (0.05, 0.11), 0.5
BRIDGE_ROWS, BRIDGE_HEIGHT, COLUMNS = (-0.34, 0.40), (-0.22, 0.26), 24  # above and below the inner corners; where bars can be
BRIDGE_SEEN, BRIDGE_COST = 0.03, 0.003
BAR = 0.03  # half height of bridge and temples
TEMPLE_ROWS, TEMPLE = (-0.30, 0.15), 0.85  # above and below the eye's middle; share of a temple that must be seen
RIM = 0.02  # by which frames are widened


class Outlines(NamedTuple):
    """Lenses in a picture.

    Attributes:
        inside: What the frames enclose, [H, W] bool.
        frames: With bridge and temples, likewise.
        sure: Whether the lines themselves are enough to say that somebody wears glasses.
    """

    inside: np.ndarray
    frames: np.ndarray
    sure: bool


def lens_outlines(image: np.ndarray, landmarks: np.ndarray, known: bool = False) -> Outlines | None:
    """Find them; None where there are none.

    Args:
        image: Display sRGB, [H, W, 3].
        landmarks: The 478 of the face, pixels, [478, 2].
        known: That the person wears glasses.
    """
    marks = np.asarray(landmarks, np.float64)[:, :2]
    outer = marks[list(OUTER)]
    unit = float(np.linalg.norm(outer[1] - outer[0]))
    if unit < LEAST_PIXELS:
        return None
    across = (outer[1] - outer[0]) / unit
    down = np.array([-across[1], across[0]])
    picture = np.asarray(image, np.float64)
    middles = [marks[list(outline)].mean(0) for outline in EYES]
    eyes = [_Polar.of(picture, at, side * across, down, unit) for side, at in zip((-1, 1), middles, strict=True)]
    lines = [np.minimum(eye.lines, STRONG) for eye in eyes]
    together = _path(sum(np.max([np.roll(one, j, 1) for j in range(-LOOSE, LOOSE + 1)], 0) for one in lines))
    near = np.abs(np.arange(len(_RADII)) - together[:, None]) <= NEAR
    paths = [_path(np.where(near, eye.lines, -1.0)) for eye in eyes]
    seen = min(float((eye.at(path)[_UNDER] > SEEN).mean()) for eye, path in zip(eyes, paths, strict=True))
    if seen < (COVERED_KNOWN if known else COVERED):
        return None
    bar = _bar(picture, marks, [eye.points(path) for eye, path in zip(eyes, paths, strict=True)], across, down, unit)
    alone = float(np.mean([(np.abs(_path(one) - together) <= NEAR - 1)[_UNDER].mean() for one in lines]))
    beside = _ALLOWED & ~near & _UNDER[:, None]
    out = min(eye.at(path)[_UNDER].mean() / max(eye.lines[beside].mean(), 1e-3) for eye, path in zip(eyes, paths, strict=True))
    sure = unit >= SURE_PIXELS and seen >= COVERED and alone >= AGREED and out >= STANDING_OUT and bar.seen >= 1.0
    if not (sure or known):
        return None
    shape = picture.shape[:2]
    inside, frames = np.zeros(shape, bool), bar.covers(shape, BAR * unit)
    for eye, path, number in zip(eyes, paths, SIDES, strict=True):
        first, last = eye.thickness(path)
        within = polygon(shape, eye.points(first, -RIM))
        frames |= polygon(shape, eye.points(last, RIM)) & ~within
        inside |= within
        frames |= _temple(picture, eye, last, marks[number]).covers(shape, BAR * unit)
    return Outlines(inside, frames & ~inside, sure)


_RADII, _ANGLES = np.arange(*RADII, STEP), np.arange(ANGLES) / ANGLES * 2.0 * np.pi  # from the temple downwards
_COS, _SIN = np.cos(_ANGLES), np.sin(_ANGLES)
_UNDER = _SIN > BELOW


def _allowed() -> np.ndarray:
    """Where outlines can be, [A, R] bool."""
    low = 1.0 / np.hypot(_COS / NEAREST[0], _SIN / NEAREST[1])
    high = (np.abs(_COS / FARTHEST[0]) ** 3 + np.abs(_SIN / FARTHEST[1]) ** 3) ** (-1 / 3)
    high = np.where(_COS < 0, np.minimum(high, NOSE / np.maximum(-_COS, 1e-3)), high)
    allowed: np.ndarray = (low[:, None] <= _RADII) & (high[:, None] >= _RADII)
    return allowed


_ALLOWED = _allowed()


class _Polar(NamedTuple):
    """A picture around an eye: colors [A, R, 3] and how much lines along the angle stand out, [A, R]."""

    centre: np.ndarray
    outwards: np.ndarray
    down: np.ndarray
    unit: float
    colors: np.ndarray
    lines: np.ndarray

    @staticmethod
    def of(picture: np.ndarray, eye: np.ndarray, outwards: np.ndarray, down: np.ndarray, unit: float) -> _Polar:
        here = _Polar(eye + LOWER * unit * down, outwards, down, unit, np.zeros(0), np.zeros(0))
        colors = bilinear(picture, here.centre + unit * _RADII[None, :, None] * here._directions()[:, None])
        return here._replace(colors=colors, lines=_lines(colors))

    def _directions(self) -> np.ndarray:
        directions: np.ndarray = _COS[:, None] * self.outwards + _SIN[:, None] * self.down
        return directions

    def at(self, path: np.ndarray) -> np.ndarray:
        """Lines along a path, [A]."""
        along: np.ndarray = self.lines[np.arange(ANGLES), path]
        return along

    def points(self, path: np.ndarray, more: float = 0.0) -> np.ndarray:
        """Pixels of a path, [A, 2], so much farther out."""
        points: np.ndarray = self.centre + self.unit * (_RADII[path] + more)[:, None] * self._directions()
        return points

    def thickness(self, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Radii at which the frame along a path begins and ends, as numbers, [A] each."""
        rows, last = np.arange(ANGLES), len(_RADII) - 1
        middle, stands, ends = self.colors[rows, path], self.at(path), []
        for side, most in zip((-1, 1), THICKEST, strict=True):
            going, reached = np.ones(ANGLES, bool), path.copy()
            for step in range(1, round(most / STEP)):
                at = np.clip(path + side * step, 0, last)
                going = going & (np.linalg.norm(self.colors[rows, at] - middle, axis=1) < HALF * stands)
                reached = np.where(going, at, reached)
            around = np.stack([np.roll(reached, turn) for turn in range(-2, 3)])
            ends.append(np.median(around, 0).astype(int))
        return ends[0], ends[1]


class _Bar(NamedTuple):
    """A line across columns of a picture: its points [C, 2], across [2], and the share of it that is seen."""

    points: np.ndarray
    down: np.ndarray
    seen: float

    def covers(self, shape: tuple[int, ...], half: float) -> np.ndarray:
        """Pixels of a bar of a half height, [H, W] bool; none where nothing is seen."""
        if self.seen <= 0.0:
            return np.zeros(shape, bool)
        return polygon(shape, np.concatenate([self.points - half * self.down, (self.points + half * self.down)[::-1]]))


def _bar(
    picture: np.ndarray, marks: np.ndarray, lenses: list[np.ndarray], across: np.ndarray, down: np.ndarray, unit: float
) -> _Bar:  # fmt: skip
    """The bridge between two lenses' outlines."""
    middle = marks[list(INNER)].mean(0)
    left, right = (float(end((lens - middle) @ across)) for lens, end in zip(lenses, (np.max, np.min), strict=True))
    if right - left < 0.1 * unit:  # they meet over the nose
        left, right = -0.1 * unit, 0.1 * unit
    edge = 0.15 * (right - left)
    columns = middle + np.linspace(left + edge, right - edge, COLUMNS)[:, None] * across
    return _course(picture, columns, down, unit, BRIDGE_ROWS, BRIDGE_HEIGHT)


def _temple(picture: np.ndarray, eye: _Polar, outline: np.ndarray, side: np.ndarray) -> _Bar:
    """The bar from a lens to the ear, as far as the face's side at a pixel [2]; not seen where there is none."""
    lens = eye.points(outline)
    begin = float(((lens - eye.centre) @ eye.outwards).max()) + 0.02 * eye.unit
    end = float((side - eye.centre) @ eye.outwards)
    bar = _Bar(np.zeros((0, 2)), eye.down, 0.0)
    if end - begin < 0.06 * eye.unit:
        return bar
    columns = eye.centre + np.linspace(begin, end, COLUMNS)[:, None] * eye.outwards
    rows = TEMPLE_ROWS[0] - max(LINES), TEMPLE_ROWS[1] + max(LINES)
    bar = _course(picture, columns, eye.down, eye.unit, rows, TEMPLE_ROWS)
    return bar if bar.seen >= TEMPLE else bar._replace(seen=0.0)


def _course(
    picture: np.ndarray, columns: np.ndarray, down: np.ndarray, unit: float, rows: tuple[float, float],
    allowed: tuple[float, float],
) -> _Bar:  # fmt: skip
    """The strongest line across columns that begin at pixels [C, 2]."""
    heights = np.arange(*rows, STEP)
    places = columns[:, None] + unit * heights[None, :, None] * down
    lines = _lines(bilinear(picture, places))
    allowed_rows = (heights > allowed[0]) & (heights < allowed[1])
    path = _best(np.where(allowed_rows, np.minimum(lines, STRONG), -STRONG), 2, BRIDGE_COST)
    numbers = np.arange(len(columns))
    return _Bar(places[numbers, path], down, float((lines[numbers, path] > BRIDGE_SEEN).mean()))


def _lines(colors: np.ndarray) -> np.ndarray:
    """How much a color differs from those on both sides of it along the second axis, the same way from both, [A, R]."""
    count, found = colors.shape[1], np.zeros(colors.shape[:2])
    numbers = np.arange(count)
    for width in LINES:
        step = max(1, round(width / STEP))
        before, after = (colors - colors[:, np.clip(numbers + side, 0, count - 1)] for side in (-step, step))
        lengths = np.linalg.norm(before, axis=-1), np.linalg.norm(after, axis=-1)
        cosine = (before * after).sum(-1) / np.maximum(lengths[0] * lengths[1], 1e-6)
        stands = np.minimum(*lengths) * np.clip((cosine - ALIKE[0]) / (ALIKE[1] - ALIKE[0]), 0.0, 1.0)
        stands[:, (numbers < step) | (numbers + step >= count)] = 0.0
        found = np.maximum(found, stands)
    return found


def _path(lines: np.ndarray) -> np.ndarray:
    """The closed path of the strongest lines [A, R] around an eye, as numbers of radii, [A]."""
    allowed = np.where(_ALLOWED, lines, -1.0)
    return _best(np.concatenate([allowed] * 3), JUMP, BEND)[ANGLES : 2 * ANGLES]


def _best(gains: np.ndarray, jump: int, cost: float) -> np.ndarray:
    """The path over columns of [C, R] that gains most, its numbers differing by at most `jump` at a `cost` each, [C]."""
    count = gains.shape[1]
    total, came = gains[0], []
    steps = np.arange(-jump, jump + 1)
    for gain in gains[1:]:
        padded = np.pad(total, jump, constant_values=-np.inf)
        from_each = np.stack([padded[jump - step : jump - step + count] - cost * abs(step) for step in steps])
        best = from_each.argmax(0)
        came.append(np.arange(count) - steps[best])
        total = from_each.max(0) + gain
    path = [int(total.argmax())]
    for back in came[::-1]:
        path.append(int(back[path[-1]]))
    return np.array(path[::-1])
