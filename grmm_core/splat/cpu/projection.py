"""Projection of Gaussians onto the picture plane, compiled. The twin of `reference.project`; `drawing.py` calls it.

Numbers are float64 inside a Gaussian and float32 in memory, which keeps needle-thin and huge Gaussians exact. As many Gaussians
as a register has float64 lanes are projected at a time. `projection_gradient.py` is the way back.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..rules import ALPHA_MIN, COMPENSATION_MIN, DILATION, NEAR, TILE
from .jit import kernel, part
from .records import CAMERA, RECORD, SQUEEZE, VALUES
from .simd import DOUBLES, larger, load, root, smaller, spread_wide, store
from .tiling import GROUP

REACH_MARGIN = 1e-3  # for rounding, also of Gaussians far outside a tile
TILES_MAX = 1 << 14  # tiles in a row or column of the grid
FAR_AWAY = 1e9  # pixels; Gaussians projected farther out or larger than this are dropped

# Rows of the scratch, one number of every lane's Gaussian each: what goes in, and what comes out (camera z, squared length of
# the quaternion, centre, dilated variances, Cholesky factor, antialiasing's factor on opacity).
MEAN, QUAT, SCALE = 0, 3, 7
Z, NORM, X, Y, VARIANCE_X, VARIANCE_Y, ROOT_11, ROOT_12, ROOT_22, COMPENSATION = range(10, 20)
SCRATCH = 20


@part
def footprint(m: tuple[Any, ...], v: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return W = M V (2 x 3) of EWA splatting, for M = J R (2 x 3) and V = rotation times scales (3 x 3).

    Each row by row, numbers or lanes of them.
    """
    m00, m01, m02, m10, m11, m12 = m
    v00, v01, v02, v10, v11, v12, v20, v21, v22 = v
    return (
        m00 * v00 + m01 * v10 + m02 * v20,
        m00 * v01 + m01 * v11 + m02 * v21,
        m00 * v02 + m01 * v12 + m02 * v22,
        m10 * v00 + m11 * v10 + m12 * v20,
        m10 * v01 + m11 * v11 + m12 * v21,
        m10 * v02 + m11 * v12 + m12 * v22,
    )


@part
def covariance(w: tuple[Any, ...]) -> tuple[Any, ...]:
    """Return entries xx, xy, yy of a footprint's covariance W W^T, and its determinant |W0 x W1|^2, free of cancellation."""
    w00, w01, w02, w10, w11, w12 = w
    k0, k1, k2 = w01 * w12 - w02 * w11, w02 * w10 - w00 * w12, w00 * w11 - w01 * w10
    return (
        w00 * w00 + w01 * w01 + w02 * w02,
        w00 * w10 + w01 * w11 + w02 * w12,
        w10 * w10 + w11 * w11 + w12 * w12,
        k0 * k0 + k1 * k1 + k2 * k2,
    )


@kernel
def _finite(numbers: np.ndarray, i: int) -> bool:
    """Return whether the numbers of Gaussian i are finite: a sum of zeros is zero only then."""
    total = np.float32(0.0)
    for k in range(numbers.shape[1]):
        total += numbers[i, k] * np.float32(0.0)
    return total == 0.0


@kernel
def _groups(features: np.ndarray, i: int) -> int:
    """Return `records.Record.groups` of Gaussian i, or 0 where its features are not finite."""
    total, used = np.float32(0.0), 0
    for k in range(features.shape[1]):
        total += features[i, k] * np.float32(0.0)
        used = k + 1 if features[i, k] != 0.0 else used
    return (VALUES + used + GROUP - 1) // GROUP if total == 0.0 else 0


@kernel
def _transpose(low: int, count: int, numbers: np.ndarray, first: int, flat: np.ndarray) -> None:
    """Copy `count` rows of `numbers` [N, K] float32 from `low` on to columns of the scratch from row `first` on, as float64."""
    for k in range(numbers.shape[1]):
        to = (first + k) * DOUBLES
        for j in range(count):
            flat[to + j] = numbers[low + j, k]


@kernel
def _expand(camera: np.ndarray, flat: np.ndarray) -> None:
    """Project as many Gaussians as there are float64 lanes.

    Args:
        camera: See `records.Camera`.
        flat: Scratch [SCRATCH * DOUBLES]: means, quaternions and scales on entry; the other rows are written.
    """
    mx, my, mz = load(flat, MEAN * DOUBLES), load(flat, (MEAN + 1) * DOUBLES), load(flat, (MEAN + 2) * DOUBLES)
    qw, qx = load(flat, QUAT * DOUBLES), load(flat, (QUAT + 1) * DOUBLES)
    qy, qz = load(flat, (QUAT + 2) * DOUBLES), load(flat, (QUAT + 3) * DOUBLES)
    s0, s1, s2 = load(flat, SCALE * DOUBLES), load(flat, (SCALE + 1) * DOUBLES), load(flat, (SCALE + 2) * DOUBLES)
    one, two = spread_wide(1.0), spread_wide(2.0)
    r00, r01, r02 = spread_wide(camera[CAMERA.r00]), spread_wide(camera[CAMERA.r01]), spread_wide(camera[CAMERA.r02])
    r10, r11, r12 = spread_wide(camera[CAMERA.r10]), spread_wide(camera[CAMERA.r11]), spread_wide(camera[CAMERA.r12])
    r20, r21, r22 = spread_wide(camera[CAMERA.r20]), spread_wide(camera[CAMERA.r21]), spread_wide(camera[CAMERA.r22])
    x = r00 * mx + r01 * my + r02 * mz + spread_wide(camera[CAMERA.tx])
    y = r10 * mx + r11 * my + r12 * mz + spread_wide(camera[CAMERA.ty])
    z = r20 * mx + r21 * my + r22 * mz + spread_wide(camera[CAMERA.tz])
    norm = qw * qw + qx * qx + qy * qy + qz * qz
    turn = two / norm  # twice the products of a unit quaternion's parts
    xx, yy, zz = turn * qx * qx, turn * qy * qy, turn * qz * qz
    xy, xz, yz = turn * qx * qy, turn * qx * qz, turn * qy * qz
    wx, wy, wz = turn * qw * qx, turn * qw * qy, turn * qw * qz
    v = (
        s0 * (one - yy - zz), s1 * (xy - wz), s2 * (xz + wy),
        s0 * (xy + wz), s1 * (one - xx - zz), s2 * (yz - wx),
        s0 * (xz - wy), s1 * (yz + wx), s2 * (one - xx - yy),
    )  # fmt: skip
    fx, fy = spread_wide(camera[CAMERA.fx]), spread_wide(camera[CAMERA.fy])
    centre_x, centre_y = spread_wide(camera[CAMERA.cx]), spread_wide(camera[CAMERA.cy])
    if camera[CAMERA.orthographic] != 0.0:
        centre_x, centre_y = fx * x + centre_x, fy * y + centre_y
        m = (fx * r00, fx * r01, fx * r02, fy * r10, fy * r11, fy * r12)
    else:
        near = one / z
        x, y = x * near, y * near
        centre_x, centre_y = fx * x + centre_x, fy * y + centre_y
        x = smaller(larger(x, spread_wide(camera[CAMERA.low_u])), spread_wide(camera[CAMERA.high_u]))
        y = smaller(larger(y, spread_wide(camera[CAMERA.low_v])), spread_wide(camera[CAMERA.high_v]))
        jx, jy = fx * near, fy * near
        m = (
            jx * (r00 - x * r20), jx * (r01 - x * r21), jx * (r02 - x * r22),
            jy * (r10 - y * r20), jy * (r11 - y * r21), jy * (r12 - y * r22),
        )  # fmt: skip
    a, b, c, det = covariance(footprint(m, v))
    dilation = spread_wide(DILATION)
    det_dilated = det + dilation * (a + c) + dilation * dilation
    a, c = a + dilation, c + dilation
    l22 = one / root(c)
    scale = l22 / root(det_dilated)
    store(flat, Z * DOUBLES, z)
    store(flat, NORM * DOUBLES, norm)
    store(flat, X * DOUBLES, centre_x)
    store(flat, Y * DOUBLES, centre_y)
    store(flat, VARIANCE_X * DOUBLES, a)
    store(flat, VARIANCE_Y * DOUBLES, c)
    store(flat, ROOT_11 * DOUBLES, c * scale)
    store(flat, ROOT_12 * DOUBLES, spread_wide(-1.0) * b * scale)
    store(flat, ROOT_22 * DOUBLES, l22)
    store(flat, COMPENSATION * DOUBLES, root(larger(det / det_dilated, spread_wide(COMPENSATION_MIN))))


@kernel
def compensate(
    means: np.ndarray, quats: np.ndarray, scales: np.ndarray, camera: np.ndarray, factors: np.ndarray, low: int, high: int
) -> None:
    """Write antialiasing's factor on opacity of the Gaussians low..high, float32, to `factors` [N]."""
    flat = np.ones(SCRATCH * DOUBLES)
    for i in range(low, high, DOUBLES):
        count = min(DOUBLES, high - i)
        _transpose(i, count, means, MEAN, flat)
        _transpose(i, count, quats, QUAT, flat)
        _transpose(i, count, scales, SCALE, flat)
        _expand(camera, flat)
        for j in range(count):
            factors[i + j] = flat[COMPENSATION * DOUBLES + j]


@kernel
def _record(i: int, lane: int, flat: np.ndarray, opacity: Any, camera: np.ndarray, geometry: np.ndarray) -> Any:
    """Fill the record of Gaussian i, in a lane of `_expand`; return (seen, tile rectangle x0, y0, x1, y1, ends exclusive)."""
    nothing = (False, 0, 0, 0, 0)
    z, norm = flat[Z * DOUBLES + lane], flat[NORM * DOUBLES + lane]
    if not (np.float32(z) >= np.float32(NEAR) and 0.0 < norm < np.inf and ALPHA_MIN < opacity < np.inf):
        return nothing
    centre_x, centre_y = flat[X * DOUBLES + lane], flat[Y * DOUBLES + lane]
    cover = min(float(opacity), 1.0)
    if camera[CAMERA.antialiased] != 0.0:
        cover *= flat[COMPENSATION * DOUBLES + lane]
    if not cover > ALPHA_MIN:
        return nothing
    reach = 2.0 * math.log(cover / ALPHA_MIN)
    half_x = math.sqrt(reach * flat[VARIANCE_X * DOUBLES + lane])
    half_y = math.sqrt(reach * flat[VARIANCE_Y * DOUBLES + lane])
    low_x, high_x, low_y, high_y = centre_x - half_x, centre_x + half_x, centre_y - half_y, centre_y + half_y
    # The comparisons are also false for NaN.
    if not (high_x > 0.0 and low_x < camera[CAMERA.width] and high_y > 0.0 and low_y < camera[CAMERA.height]):
        return nothing
    if not (abs(centre_x) < FAR_AWAY and abs(centre_y) < FAR_AWAY and half_x < FAR_AWAY and half_y < FAR_AWAY):
        return nothing
    geometry[i, RECORD.x] = centre_x
    geometry[i, RECORD.y] = centre_y
    geometry[i, RECORD.l11] = flat[ROOT_11 * DOUBLES + lane]
    geometry[i, RECORD.l12] = flat[ROOT_12 * DOUBLES + lane]
    geometry[i, RECORD.l22] = flat[ROOT_22 * DOUBLES + lane]
    geometry[i, RECORD.opacity] = cover
    geometry[i, RECORD.reach] = reach * SQUEEZE * SQUEEZE + REACH_MARGIN
    geometry[i, RECORD.depth] = z
    x0, y0 = int(max(low_x, 0.0)) // TILE, int(max(low_y, 0.0)) // TILE
    x1 = int(min(high_x, camera[CAMERA.width] - 1.0)) // TILE + 1
    y1 = int(min(high_y, camera[CAMERA.height] - 1.0)) // TILE + 1
    return (True, x0, y0, x1, y1)


@kernel
def project(
    low: int,
    high: int,
    gaussians: tuple[np.ndarray, ...],
    camera: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    tiles_x: int,
    counts: np.ndarray,
    needs: np.ndarray,
) -> int:
    """Project the Gaussians low..high and count their tiles.

    Arguments by group:
        gaussians: The parts of `GaussianArrays`, float32.
        camera: See `records.Camera`.
        geometry: Output [N, RECORD_LENGTH] float32, see `records.Record`.
        whole: [N, RECORD_LENGTH] int32 view of `geometry`.
        tiles_x: Tiles in a row of the grid.
        counts: Output [tiles] int32, zero on entry: Gaussians of the chunk that may touch each tile.
        needs: Output [groups of channels + 1] int32, zero on entry: tiles touched by Gaussians that need so many groups.

    Returns:
        The sum of `counts`.
    """
    means, quats, scales, opacities, colors, features = gaussians
    total = 0
    flat = np.ones(SCRATCH * DOUBLES)
    for i in range(low, high):
        lane = (i - low) % DOUBLES
        if lane == 0:
            count = min(DOUBLES, high - i)
            shown = False  # neighbours are often hidden together
            for j in range(i, i + count):
                shown = shown or opacities[j] > ALPHA_MIN
            if shown:
                _transpose(i, count, means, MEAN, flat)
                _transpose(i, count, quats, QUAT, flat)
                _transpose(i, count, scales, SCALE, flat)
                _expand(camera, flat)
        seen, x0, y0, x1, y1 = _record(i, lane, flat, opacities[i], camera, geometry)
        groups = _groups(features, i) if seen and _finite(colors, i) else 0
        if groups:
            for k in range(3):
                geometry[i, RECORD.red + k] = colors[i, k]
            whole[i, RECORD.tiles_low] = x0 | y0 << 16
            whole[i, RECORD.tiles_high] = x1 | y1 << 16
            touched = (x1 - x0) * (y1 - y0)
            whole[i, RECORD.touched] = touched
            total += touched
            geometry[i, RECORD.groups] = groups
            needs[groups] += touched
            for y in range(y0, y1):
                for tile in range(y * tiles_x + x0, y * tiles_x + x1):
                    counts[tile] += 1
        else:
            whole[i, RECORD.touched] = 0
    return total
