"""Relief finer than a head's mesh: pores and furrows of skin, deeper where an expression presses it together.

Light at a point says how its highlights change where the normal tilts (`shading.Transport.tilts`); at each pixel they are
multiplied by what the relief there makes of it. The relief lies on the UV map, so that it moves with the skin. Where skin is
shorter than at rest its tilts across grow, where it is stretched they shrink (after Nagano et al. 2015), which draws the
furrows of a lifted brow. What is finer than a pixel is no tilt but roughness, as it is without relief, for over all tilts the
factor's mean is 1: so highlights neither sparkle nor change their strength with the distance (as by Toksvig 2005, who widens
lobes instead). In close-ups it stands in irradiance, too, where light rakes: there light that wanders inside the skin leaves
some of it, of blue most (`SOFTENED`). Needs numpy only; `skin_relief_kernel` is the compiled twin of `gleam`.
"""

from __future__ import annotations

import functools
import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from ..head import HeadModel

SIDE, LEVELS = 256, 6
"""Texels along a side of the tile, and its sizes: each half of the last."""
REPEATS = 12.0  # of the tile along the UV map: 32 mm each on a face
FALL, STEEPEST, BRIGHTEST, DARKEST = 0.3, 1.0, 1.1, -3.0
"""How much of a lobe's fall to all sides is believed, and limits of logarithms: by a usual tilt, and of the factor."""
CAVITY = 3.0  # by how much less of light leaves what lies deep, 1/mm
GATHER, SMOOTHEST, ROUGHEST = 5.0, 0.5, 4.0
"""By how much tilts grow with the share of its length that skin has lost, and the least and the most."""
FAINT = 1e-5  # highlights of which it does not matter how they change
DULL = 0.002  # radiance of highlights that are left as they are
VALUES = 4  # of `lying`: lengths along the grid (2), strength, and nothing; of `Transport.tilts`: change with a tilt (3), fall
SOFTENED = (0.10, 0.18, 0.25)
"""How much of the relief stands in light from inside the skin, by color: what wanders a millimetre has no pores."""
DIMMEST, LIGHTEST = 0.4, 1.8  # limits of its factor
_SMALL, _SMALLEST = 0.25, 0.5  # mm of a pixel up to which it is there, and from which on it is not: pores are 1.5 mm apart
_MM = 0.125  # of a texel of the tile
_UNDULATING = ((6.0, 0.030), (3.0, 0.020), (1.6, 0.008))  # wavelength and height of smooth relief, mm
_FURROWS = (0.9, 0.030, 0.12)  # spacing of cells, depth and half width of the furrows between them, mm
_PORES = (1.5, 0.090, 0.22)  # spacing, depth and radius, mm
_STRENGTHS = {"face": 1.0, "neck": 0.6, "ears": 0.6, "scalp": 0.5, "lids": 0.6, "lips": 0.5}  # other parts are smooth
_LONG, _LONGER = 0.0025, 0.0035  # metres of texels from which on there is less, and none: it would be too coarse


class Tile(NamedTuple):
    """Relief that repeats.

    Attributes:
        values: Tilt of the normal along columns and rows (against the slope), and height in mm, of all sizes, the largest
            first, [T, 3].
        spread: Mean square of a tilt along one axis, by size, and 0 behind, [LEVELS + 1].
    """

    values: np.ndarray
    spread: np.ndarray


@functools.lru_cache(maxsize=1)
def tile() -> Tile:
    """The relief of skin, the same every time."""
    generator, length = np.random.default_rng(1907), SIDE * _MM
    frequency = np.hypot(*np.meshgrid(*2 * (np.fft.fftfreq(SIDE, _MM),)))  # 1/mm
    height = np.zeros((SIDE, SIDE))
    for wavelength, deep in _UNDULATING:
        band = np.exp(-((frequency * wavelength - 1.0) ** 2) / 0.18)
        noise = np.fft.ifft2(np.fft.fft2(generator.normal(size=(SIDE, SIDE))) * band).real
        height += deep * noise / noise.std()

    def nearest(spacing: float) -> np.ndarray:
        """Distances to the two nearest of scattered points, mm, [SIDE, SIDE, 2]."""
        count = round(length / spacing)
        points = generator.random((count, count, 2))
        at = (np.arange(SIDE) + 0.5) * (count / SIDE)
        away = []
        for i, j in np.ndindex(5, 5):
            row, column = (at.astype(int) + step - 2 for step in (i, j))
            point = points[row % count][:, column % count]
            away.append(np.hypot(at[:, None] - row[:, None] - point[..., 0], at - column - point[..., 1]))
        return np.sort(np.stack(away, -1), -1)[..., :2] * (length / count)

    spacing, deep, wide = _FURROWS
    cells = nearest(spacing)
    height -= deep * np.exp(-(((cells[..., 1] - cells[..., 0]) / (2 * wide)) ** 2))
    spacing, deep, wide = _PORES
    height -= deep * np.exp(-((nearest(spacing)[..., 0] / wide) ** 2))
    height -= height.mean()
    across, down = ((np.roll(height, 1, axis) - np.roll(height, -1, axis)) / (2 * _MM) for axis in (1, 0))
    level = np.stack([across, down, height], -1)
    levels, spread = [], []
    for _ in range(LEVELS):
        levels.append(level.reshape(-1, 3))
        spread.append(0.5 * (level[..., :2] ** 2).sum(-1).mean())
        level = 0.25 * (level[::2, ::2] + level[1::2, ::2] + level[::2, 1::2] + level[1::2, 1::2])
    return Tile(np.concatenate(levels).astype(np.float32), np.array([*spread, 0.0], np.float32))


def lying(head: HeadModel, vertices: np.ndarray, uv: np.ndarray, grid: int, face: np.ndarray) -> np.ndarray:
    """How the relief lies on a head at rest: lengths of texels in metres (2), strength (1) and 0, [N, VALUES] float32.

    Args:
        head: Head model.
        vertices: At rest, [V, 3] metres.
        uv: Corners of the UV map, [U, 2].
        grid: Texels along a side.
        face: Of each texel, [N].
    """
    found = np.zeros((len(face), VALUES), np.float32)
    ways = texel_ways(vertices[head.faces[face]], uv[head.uv_faces[face]] * grid)
    found[:, :2] = np.linalg.norm(ways, axis=-1)
    strength = np.zeros(len(vertices), np.float32)
    for name, value in _STRENGTHS.items():
        strength[head.marked(name)] = value
    short = ((_LONGER - found[:, :2].max(1)) / (_LONGER - _LONG)).clip(0.0, 1.0)
    found[:, 2] = strength[head.faces[face]].mean(1) * short
    return found


def softened(pixels_per_metre: float) -> np.ndarray:
    """`SOFTENED` in a picture with so many pixels for a metre, [3] float32; [0] where they are too large for any of it."""
    size = math.log2(1000.0 / max(pixels_per_metre, 1.0) / _SMALL) / math.log2(_SMALLEST / _SMALL)
    share = min(max(1.0 - size, 0.0), 1.0)
    return np.array(SOFTENED, np.float32) * np.float32(share) if share > 0.0 else np.zeros(0, np.float32)


def texel_ways(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How far a texel reaches along columns and rows of the grid, [N, 2, 3].

    Args:
        corners: Of faces, [N, 3, 3] metres.
        places: Of them on the grid, [N, 3, 2] texels.
    """
    b, c = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    (bx, by), (cx, cy) = ((places[:, k] - places[:, 0]).T for k in (1, 2))
    area = bx * cy - cx * by
    area = np.where(np.abs(area) < 1e-12, 1e-12, area)[:, None]
    return np.stack([b * cy[:, None] - c * by[:, None], c * bx[:, None] - b * cx[:, None]], 1) / area[..., None]


def gleam(
    tilts: np.ndarray, relief: np.ndarray, ways: np.ndarray, places: np.ndarray, step: np.ndarray, grid: int, detail: float
) -> tuple[np.ndarray, np.ndarray]:
    """What relief makes of highlights, a factor, [N], and by which share irradiance changes if light does not wander, [N].

    Args:
        tilts: How light changes at pixels, as of `shading.Transport.tilts` and perhaps `leanings`, [N, VALUES or VALUES + 3].
        relief: As of `lying`, at pixels, [N, VALUES].
        ways: Of `texel_ways` of what is seen there, [N, 2, 3].
        places: On the grid, texels, column and row, [N, 2].
        step: How far a pixel reaches on it, texels, [N].
        grid: Texels along its side.
        detail: Factor of the tilts.
    """
    found, spread = _read(places, step, grid)
    lengths = np.linalg.norm(ways, axis=-1)
    gathered = (1.0 + GATHER * (1.0 - lengths / np.maximum(relief[:, :2], 1e-9))).clip(SMOOTHEST, ROUGHEST)
    strength = relief[:, 2:3] * detail * gathered
    squares = spread[:, None] * strength**2
    change = np.einsum("nkx,nx->nk", ways, tilts[:, :3]) / np.maximum(lengths, 1e-9)
    change = change / np.sqrt(1.0 + (change**2 * squares).sum(1, keepdims=True) / STEEPEST**2)
    fall = FALL * tilts[:, 3:4]
    fall = fall / (1.0 + 2.0 * fall * squares.max(1, keepdims=True))
    wide = 1.0 + 2.0 * fall * squares
    tilt = found[:, :2] * strength
    mean = 0.5 * (np.log(wide) - change**2 * squares / wide)
    logarithm = (change * tilt - fall * tilt**2 + mean).sum(1) + CAVITY * relief[:, 2] * detail * found[:, 2]
    if tilts.shape[1] == VALUES:
        return np.exp(logarithm.clip(DARKEST, BRIGHTEST)), np.zeros(len(tilts))
    lean = np.einsum("nkx,nx->nk", ways, tilts[:, VALUES:]) / np.maximum(lengths, 1e-9)
    return np.exp(logarithm.clip(DARKEST, BRIGHTEST)), (lean * tilt).sum(1)


def _read(places: np.ndarray, step: np.ndarray, grid: int) -> tuple[np.ndarray, np.ndarray]:
    """The tile's values [N, 3] and spread [N] at places of a grid, of the size that a pixel needs, and between sizes."""
    values, spread = tile()
    scale = REPEATS * SIDE / grid
    size = np.log2(np.maximum(step * scale, 1.0))
    level = np.minimum(size.astype(int), LEVELS - 1)
    part = np.minimum(size - level, 1.0)
    found, square = np.zeros((len(places), 3)), (1.0 - part) * spread[level] + part * spread[level + 1]
    for nearer, weight in ((0, 1.0 - part), (1, part)):
        side = SIDE >> (level + nearer)
        begin = (4 * SIDE * SIDE - 4 * side * side) // 3
        at = (places + 0.5) * (scale * side / SIDE)[:, None] - 0.5
        low = np.floor(at).astype(int)
        for down, across in np.ndindex(2, 2):
            share = np.prod(np.where((across, down), at - low, 1.0 - (at - low)), 1)
            column, row = ((low[:, k] + more) % side for k, more in ((0, across), (1, down)))
            there = np.where(level + nearer < LEVELS, begin + row * side + column, 0)
            found += (weight * share * (level + nearer < LEVELS))[:, None] * values[there]
    return found, square
