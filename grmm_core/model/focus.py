"""Where the texels go: a UV map that gives lids, lips, teeth and irises more of them than neck and scalp. Needs numpy only.

The head's own UV map is drawn for textures: a texel of it covers 1.4 mm of the lips and 2.4 of the neck. `focused_uv` moves its
corners by a density-equalising flow (Gastner, Seguy and More 2018, "Fast flow-based algorithm for creating
density-equalizing map projections"), a smooth one-to-one map of the square, so that islands stay apart.
Weights store the result: trained maps belong to exactly these texels.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import ShapeError
from .layout import texel_layout

if TYPE_CHECKING:
    from ..head import HeadModel

SIZES_MM = {
    "neck": 3.2, "scalp": 2.6, "face": 1.45, "ears": 1.8, "mouth_interior": 3.0, "tongue": 1.8, "left_eyeball": 3.0,
    "right_eyeball": 3.0, "upper_teeth": 1.15, "lower_teeth": 1.15, "brows": 0.95, "lids": 0.75, "lashes": 1.2, "lips": 0.8,
}  # fmt: skip
"""Wanted side of a texel by region, millimetres; of several regions the last one counts, elsewhere `ELSEWHERE_MM`."""
ELSEWHERE_MM = 3.0
IRIS_MM, IRIS_COSINE = 0.75, 0.72  # the front of the eyeballs: directions within this cosine of straight ahead
_RASTER = 512  # cells along a side in which densities are counted
_GAP_DENSITY = 0.8  # of cells without a face, relative to the mean of those with one: gaps stay
_BLURS = (10.0, 6.0, 4.0, 3.0)  # cells, of the density in each round: coarse first, so that small faces do not fold
_STEPS = 24  # of time in a round


def wanted_sizes(head: HeadModel) -> np.ndarray:
    """Wanted side of a texel on each face by `SIZES_MM`, millimetres, [F]."""
    size = np.full(len(head.faces), ELSEWHERE_MM)
    for name, wanted in SIZES_MM.items():
        size[head.marked(name)[head.faces].all(1)] = wanted
    for name in ("left_eyeball", "right_eyeball"):
        if name in head.regions:
            points = head.v_template[head.regions[name]]
            centre = 0.5 * (points.min(0) + points.max(0))
            ahead = (points - centre)[:, 2] > IRIS_COSINE * np.linalg.norm(points - centre, axis=1)
            front = np.zeros(len(head.v_template), bool)
            front[np.asarray(head.regions[name])[ahead]] = True
            size[front[head.faces].all(1)] = IRIS_MM
    return size


def focused_uv(head: HeadModel) -> np.ndarray:
    """Move the corners of a head's UV map until texels have the wanted sizes relative to one another.

    Returns:
        UV coordinates 0..1, [T, 2] float32, for `head.uv_faces`.

    Raises:
        ShapeError: The map would fold: the head's UV map has overlapping or degenerate parts.
    """
    uv = np.asarray(head.uv, np.float64)
    corners = head.v_template[head.faces].astype(np.float64)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    wanted = area / (wanted_sizes(head) * 1e-3) ** 2
    turn = np.sign(_areas(uv, head.uv_faces))
    for blur in _BLURS:
        uv = _flow(_density(uv, head.uv_faces, wanted, blur), uv)
    folded = (np.sign(_areas(uv, head.uv_faces)) != turn) & (turn != 0)
    if folded.mean() > 0.002:
        raise ShapeError(
            f"{int(folded.sum())} faces of the head's UV map fold when texels are moved; train with focus = false."
        )
    return uv.astype(np.float32)


def _areas(uv: np.ndarray, uv_faces: np.ndarray) -> np.ndarray:
    a, b, c = (uv[uv_faces[:, k]] for k in range(3))
    signed: np.ndarray = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    return signed


def _density(uv: np.ndarray, uv_faces: np.ndarray, wanted: np.ndarray, blur: float) -> np.ndarray:
    """Wanted texels in each cell of a raster over the square, [R, R], mean 1."""
    cells = texel_layout(uv, uv_faces, _RASTER)
    density = np.full(_RASTER * _RASTER, np.nan)
    density[cells.texel] = wanted[cells.face] / np.maximum(np.abs(_areas(uv, uv_faces))[cells.face], 1e-9)
    middle = np.nanmean(density)
    density = np.clip(np.where(np.isnan(density), _GAP_DENSITY * middle, density), 0.15 * middle, 8.0 * middle)
    frequencies, mirrored = _spectrum(density.reshape(_RASTER, _RASTER))
    blurred = np.fft.irfft2(mirrored * np.exp(-0.5 * blur**2 * frequencies), (2 * _RASTER,) * 2)[:_RASTER, :_RASTER]
    result: np.ndarray = blurred / blurred.mean()
    return result


def _spectrum(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Squared frequencies in radians a cell and the transform of values mirrored at the square's edges (nothing flows out)."""
    doubled = np.concatenate([values, values[::-1]], 0)
    doubled = np.concatenate([doubled, doubled[:, ::-1]], 1)
    down = 2 * np.pi * np.fft.fftfreq(len(doubled))[:, None]
    across = 2 * np.pi * np.fft.rfftfreq(len(doubled))[None]
    return down**2 + across**2, np.fft.rfft2(doubled)


def _flow(density: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Carry points [T, 2] along the flow that evens out a density.

    The flux is the gradient of a potential psi with laplacian(psi) = density - 1 at all times, while the density goes linearly
    to 1: so continuity holds.
    """
    squares, transform = _spectrum(density - 1.0)
    squares[0, 0] = 1.0
    potential = -transform / squares
    potential[0, 0] = 0.0
    psi = np.fft.irfft2(potential, (2 * _RASTER,) * 2)
    flux_v = (0.5 * (np.roll(psi, -1, 0) - np.roll(psi, 1, 0)))[:_RASTER, :_RASTER]
    flux_u = (0.5 * (np.roll(psi, -1, 1) - np.roll(psi, 1, 1)))[:_RASTER, :_RASTER]
    points = uv * _RASTER - 0.5

    def speed(at: np.ndarray, time: float) -> np.ndarray:
        now = (1.0 - time) * _sample(density, at) + time
        return np.stack([_sample(flux_u, at), _sample(flux_v, at)], -1) / now[:, None]

    step = 1.0 / _STEPS
    for i in range(_STEPS):
        half = points + 0.5 * step * speed(points, i * step)
        points = points + step * speed(half, (i + 0.5) * step)
    moved: np.ndarray = np.clip((points + 0.5) / _RASTER, 0.0, 1.0)
    return moved


def _sample(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Values of cells at points [T, 2] (across, down, in cells), bilinearly."""
    x, y = (np.clip(at[:, k], 0, values.shape[1 - k] - 1.001) for k in (0, 1))
    column, row = x.astype(np.int64), y.astype(np.int64)
    x, y = x - column, y - row
    upper = values[row, column] * (1 - x) + values[row, column + 1] * x
    lower = values[row + 1, column] * (1 - x) + values[row + 1, column + 1] * x
    mixed: np.ndarray = upper * (1 - y) + lower * y
    return mixed
