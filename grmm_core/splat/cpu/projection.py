"""Projection of Gaussians onto the picture plane and its gradient, compiled.

The twin of `reference.project`; `function.py` calls it. Numbers are float64 inside a Gaussian and float32 in memory, which
keeps needle-thin and huge Gaussians exact. As many Gaussians as a register has float64 lanes are projected at a time.

A Gaussian's record (`geometry`, one cache line of 16 float32) holds its centre mx, my [px]; the Cholesky factor l11, l12, l22
of its conic, so that -ln(alpha / opacity) = (s^2 + q^2) / 2 with s = l11 dx + l12 dy and q = l22 dy, which lose no digits
where Gaussians are long and thin; its opacity; the largest SQUEEZE^2 (s^2 + q^2) at which alpha still reaches ALPHA_MIN, and a
spare number; its values r, g, b, depth; and, as integers, the rectangle of tiles that it may touch, its first slot and its
number of tiles (see `binning.py`).

The camera is one float64 array; the constants below name its entries.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..rules import ALPHA_MIN, COMPENSATION_MIN, DILATION, NEAR, TILE, View
from .jit import kernel
from .simd import DOUBLES, larger, load, root, smaller, spread_wide, store

ROTATION, TRANSLATION, FOCAL, CENTRE, CLAMP, SIZE, ORTHOGRAPHIC, ANTIALIASED = 0, 9, 12, 14, 16, 20, 22, 23
CAMERA_LENGTH = 24
RECORD = 16  # float32 numbers per Gaussian in `geometry`
REACH = 6  # where a record says how large SQUEEZE^2 (s^2 + q^2) may be
REACH_MARGIN = 1e-3  # for rounding, also of Gaussians far outside a tile
VALUES, DEPTH = 8, 11  # where r, g, b and the depth are
# Where, as int32, the tiles' x0 | y0 << 16 and x1 | y1 << 16, the first slot, and the number of tiles are.
RECT, SLOT, TOUCHED = 12, 14, 15
# Leading entries of a gradient row: sums of g, g s, g q, g s^2, g s q, g q^2 with g = alpha dL/dalpha, and two spare ones.
MOMENTS = 8
SQUEEZE = 0.25  # the tile kernels work with SQUEEZE s and SQUEEZE q, and so do the sums
TILES_MAX = 1 << 14  # tiles in a row or column of the grid
OUT, SCRATCH = 10, 20  # rows of a projection's scratch: where its results begin, and all
FAR_AWAY = 1e9  # pixels; Gaussians projected farther out or larger than this are dropped


def camera_array(view: View, antialiased: bool) -> np.ndarray:
    """Return a view as the float64 array [CAMERA_LENGTH] that the kernels read."""
    camera = np.empty(CAMERA_LENGTH)
    camera[ROTATION:TRANSLATION] = view.rotation.reshape(9)
    camera[TRANSLATION:FOCAL] = view.translation
    camera[FOCAL:CLAMP] = view.fx, view.fy, view.cx, view.cy
    camera[CLAMP:SIZE] = view.clamp
    camera[SIZE:] = view.width, view.height, view.orthographic, antialiased
    return camera


@kernel
def _finite(row: np.ndarray) -> bool:
    total = np.float32(0.0)
    for i in range(row.shape[0]):
        total += row[i] * np.float32(0.0)
    return total == 0.0


@kernel
def _transpose(count: int, numbers: np.ndarray, first: int, flat: np.ndarray) -> None:
    """Copy columns of `numbers` [count, K] float32 to the rows from `first` on of the scratch, as float64."""
    for k in range(numbers.shape[1]):
        to = (first + k) * DOUBLES
        for j in range(count):
            flat[to + j] = numbers[j, k]


@kernel
def _expand(camera: np.ndarray, flat: np.ndarray) -> None:
    """Project as many Gaussians as there are float64 lanes.

    Args:
        camera: [CAMERA_LENGTH].
        flat: Scratch [SCRATCH * DOUBLES]. Its rows hold mean, quaternion, scale; those from OUT on get camera z, squared length
            of the quaternion, centre x, y, dilated variances a, c, l11, l12, l22, and antialiasing's factor on opacity.
    """
    mx, my, mz = load(flat, 0), load(flat, DOUBLES), load(flat, 2 * DOUBLES)
    qw, qx = load(flat, 3 * DOUBLES), load(flat, 4 * DOUBLES)
    qy, qz = load(flat, 5 * DOUBLES), load(flat, 6 * DOUBLES)
    s0, s1, s2 = load(flat, 7 * DOUBLES), load(flat, 8 * DOUBLES), load(flat, 9 * DOUBLES)
    one, two = spread_wide(1.0), spread_wide(2.0)
    r0, r1, r2 = spread_wide(camera[0]), spread_wide(camera[1]), spread_wide(camera[2])
    r3, r4, r5 = spread_wide(camera[3]), spread_wide(camera[4]), spread_wide(camera[5])
    r6, r7, r8 = spread_wide(camera[6]), spread_wide(camera[7]), spread_wide(camera[8])
    x = r0 * mx + r1 * my + r2 * mz + spread_wide(camera[9])
    y = r3 * mx + r4 * my + r5 * mz + spread_wide(camera[10])
    z = r6 * mx + r7 * my + r8 * mz + spread_wide(camera[11])
    norm = qw * qw + qx * qx + qy * qy + qz * qz
    turn = two / norm  # twice the products of a unit quaternion's parts
    xx, yy, zz = turn * qx * qx, turn * qy * qy, turn * qz * qz
    xy, xz, yz = turn * qx * qy, turn * qx * qz, turn * qy * qz
    wx, wy, wz = turn * qw * qx, turn * qw * qy, turn * qw * qz
    v00, v01, v02 = s0 * (one - yy - zz), s1 * (xy - wz), s2 * (xz + wy)
    v10, v11, v12 = s0 * (xy + wz), s1 * (one - xx - zz), s2 * (yz - wx)
    v20, v21, v22 = s0 * (xz - wy), s1 * (yz + wx), s2 * (one - xx - yy)
    fx, fy = spread_wide(camera[12]), spread_wide(camera[13])
    centre_x, centre_y = spread_wide(camera[14]), spread_wide(camera[15])
    if camera[22] != 0.0:
        centre_x, centre_y = fx * x + centre_x, fy * y + centre_y
        m00, m01, m02 = fx * r0, fx * r1, fx * r2
        m10, m11, m12 = fy * r3, fy * r4, fy * r5
    else:
        near = one / z
        u, v = x * near, y * near
        centre_x, centre_y = fx * u + centre_x, fy * v + centre_y
        u = smaller(larger(u, spread_wide(camera[16])), spread_wide(camera[17]))
        v = smaller(larger(v, spread_wide(camera[18])), spread_wide(camera[19]))
        j00, j11 = fx * near, fy * near
        m00, m01, m02 = j00 * (r0 - u * r6), j00 * (r1 - u * r7), j00 * (r2 - u * r8)
        m10, m11, m12 = j11 * (r3 - v * r6), j11 * (r4 - v * r7), j11 * (r5 - v * r8)
    w00 = m00 * v00 + m01 * v10 + m02 * v20
    w01 = m00 * v01 + m01 * v11 + m02 * v21
    w02 = m00 * v02 + m01 * v12 + m02 * v22
    w10 = m10 * v00 + m11 * v10 + m12 * v20
    w11 = m10 * v01 + m11 * v11 + m12 * v21
    w12 = m10 * v02 + m11 * v12 + m12 * v22
    a, b, c = w00 * w00 + w01 * w01 + w02 * w02, w00 * w10 + w01 * w11 + w02 * w12, w10 * w10 + w11 * w11 + w12 * w12
    k0, k1, k2 = w01 * w12 - w02 * w11, w02 * w10 - w00 * w12, w00 * w11 - w01 * w10
    det = k0 * k0 + k1 * k1 + k2 * k2
    dilation = spread_wide(DILATION)
    det_dilated = det + dilation * (a + c) + dilation * dilation
    a, c = a + dilation, c + dilation
    l22 = one / root(c)
    whole = one / root(det_dilated)
    out = OUT * DOUBLES
    store(flat, out, z)
    store(flat, out + DOUBLES, norm)
    store(flat, out + 2 * DOUBLES, centre_x)
    store(flat, out + 3 * DOUBLES, centre_y)
    store(flat, out + 4 * DOUBLES, a)
    store(flat, out + 5 * DOUBLES, c)
    store(flat, out + 6 * DOUBLES, c * l22 * whole)
    store(flat, out + 7 * DOUBLES, spread_wide(-1.0) * b * l22 * whole)
    store(flat, out + 8 * DOUBLES, l22)
    store(flat, out + 9 * DOUBLES, root(larger(det / det_dilated, spread_wide(COMPENSATION_MIN))))


@kernel
def _place(lane: int, flat: np.ndarray, opacity: float, camera: np.ndarray, record: np.ndarray) -> Any:
    """Fill the record of the Gaussian in a lane of `_expand`; return (seen, tile rectangle x0, y0, x1, y1, ends exclusive)."""
    nothing = (False, 0, 0, 0, 0)
    at = OUT * DOUBLES + lane
    z, norm = flat[at], flat[at + DOUBLES]
    if not (np.float32(z) >= np.float32(NEAR) and 0.0 < norm < np.inf and ALPHA_MIN < opacity < np.inf):
        return nothing
    centre_x, centre_y = flat[at + 2 * DOUBLES], flat[at + 3 * DOUBLES]
    cover = min(np.float64(opacity), 1.0)
    if camera[23] != 0.0:
        cover *= flat[at + 9 * DOUBLES]
    if not cover > ALPHA_MIN:
        return nothing
    reach = 2.0 * math.log(cover / ALPHA_MIN)
    half_x, half_y = math.sqrt(reach * flat[at + 4 * DOUBLES]), math.sqrt(reach * flat[at + 5 * DOUBLES])
    low_x, high_x, low_y, high_y = centre_x - half_x, centre_x + half_x, centre_y - half_y, centre_y + half_y
    # The comparisons are also false for NaN.
    if not (high_x > 0.0 and low_x < camera[20] and high_y > 0.0 and low_y < camera[21]):
        return nothing
    if not (abs(centre_x) < FAR_AWAY and abs(centre_y) < FAR_AWAY and half_x < FAR_AWAY and half_y < FAR_AWAY):
        return nothing
    record[0] = centre_x
    record[1] = centre_y
    record[2] = flat[at + 6 * DOUBLES]
    record[3] = flat[at + 7 * DOUBLES]
    record[4] = flat[at + 8 * DOUBLES]
    record[5] = cover
    record[REACH] = reach * SQUEEZE * SQUEEZE + REACH_MARGIN
    record[DEPTH] = z
    x0, y0 = int(max(low_x, 0.0)) // TILE, int(max(low_y, 0.0)) // TILE
    x1 = int(min(high_x, camera[20] - 1.0)) // TILE + 1
    y1 = int(min(high_y, camera[21] - 1.0)) // TILE + 1
    return (True, x0, y0, x1, y1)


@kernel
def project(
    low: int,
    high: int,
    means: np.ndarray,
    quats: np.ndarray,
    scales: np.ndarray,
    opacities: np.ndarray,
    colors: np.ndarray,
    features: np.ndarray,
    camera: np.ndarray,
    geometry: np.ndarray,
    whole: np.ndarray,
    tiles_x: int,
    counts: np.ndarray,
) -> int:
    """Project the Gaussians low..high and count their tiles.

    Arguments by group:
        means, quats, scales, opacities, colors, features: As in `Gaussians`, float32; features [N, 0] when there are none.
        camera: [CAMERA_LENGTH] float64.
        geometry: Output [N, RECORD] float32; undefined for Gaussians that are not seen, except for TOUCHED = 0.
        whole: [N, RECORD] int32 view of `geometry`.
        tiles_x: Tiles in a row of the grid.
        counts: Output [tiles] int32, zero on entry: Gaussians of the chunk that may touch each tile.

    Returns:
        The sum of `counts`.
    """
    total = 0
    flat = np.ones(SCRATCH * DOUBLES)
    for i in range(low, high):
        lane = (i - low) % DOUBLES
        if lane == 0:
            end = min(i + DOUBLES, high)
            _transpose(end - i, means[i:end], 0, flat)
            _transpose(end - i, quats[i:end], 3, flat)
            _transpose(end - i, scales[i:end], 7, flat)
            _expand(camera, flat)
        seen, x0, y0, x1, y1 = _place(lane, flat, opacities[i], camera, geometry[i])
        if seen and _finite(colors[i]) and _finite(features[i]):
            for c in range(3):
                geometry[i, VALUES + c] = colors[i, c]
            whole[i, RECT] = x0 | y0 << 16
            whole[i, RECT + 1] = x1 | y1 << 16
            touched = (x1 - x0) * (y1 - y0)
            whole[i, TOUCHED] = touched
            total += touched
            for y in range(y0, y1):
                for tile in range(y * tiles_x + x0, y * tiles_x + x1):
                    counts[tile] += 1
        else:
            whole[i, TOUCHED] = 0
    return total


@kernel
def unproject_one(
    mean: np.ndarray,
    quat: np.ndarray,
    scale: np.ndarray,
    opacity: float,
    camera: np.ndarray,
    record: np.ndarray,
    moments: np.ndarray,
    d_depth: float,
    d_mean: np.ndarray,
    d_quat: np.ndarray,
    d_scale: np.ndarray,
) -> float:
    """Carry a Gaussian's moments [MOMENTS] and depth gradient back to its mean, quaternion and scale; return dL/dopacity."""
    mx, my, mz = np.float64(mean[0]), np.float64(mean[1]), np.float64(mean[2])
    x = camera[0] * mx + camera[1] * my + camera[2] * mz + camera[9]
    y = camera[3] * mx + camera[4] * my + camera[5] * mz + camera[10]
    z = camera[6] * mx + camera[7] * my + camera[8] * mz + camera[11]
    qw, qx, qy, qz = np.float64(quat[0]), np.float64(quat[1]), np.float64(quat[2]), np.float64(quat[3])
    s0, s1, s2 = np.float64(scale[0]), np.float64(scale[1]), np.float64(scale[2])
    inverse = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    qw, qx, qy, qz = qw * inverse, qx * inverse, qy * inverse, qz * inverse
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    v00, v01, v02 = s0 * r00, s1 * r01, s2 * r02
    v10, v11, v12 = s0 * r10, s1 * r11, s2 * r12
    v20, v21, v22 = s0 * r20, s1 * r21, s2 * r22
    fx, fy = camera[12], camera[13]
    orthographic = camera[22] != 0.0
    near = 1.0 / z
    u, v = x * near, y * near
    clamped_u, clamped_v = min(max(u, camera[16]), camera[17]), min(max(v, camera[18]), camera[19])
    if orthographic:
        j00, j02, j11, j12 = fx, 0.0, fy, 0.0
    else:
        j00, j11 = fx * near, fy * near
        j02, j12 = -j00 * clamped_u, -j11 * clamped_v
    m00, m01, m02 = j00 * camera[0] + j02 * camera[6], j00 * camera[1] + j02 * camera[7], j00 * camera[2] + j02 * camera[8]
    m10, m11, m12 = j11 * camera[3] + j12 * camera[6], j11 * camera[4] + j12 * camera[7], j11 * camera[5] + j12 * camera[8]
    w00 = m00 * v00 + m01 * v10 + m02 * v20
    w01 = m00 * v01 + m01 * v11 + m02 * v21
    w02 = m00 * v02 + m01 * v12 + m02 * v22
    w10 = m10 * v00 + m11 * v10 + m12 * v20
    w11 = m10 * v01 + m11 * v11 + m12 * v21
    w12 = m10 * v02 + m11 * v12 + m12 * v22

    # Centre and dilated covariance [[a, b], [b, c]] from the whitened moments, with L = [[l11, l12], [0, l22]]:
    # d_centre = L^T (g w), d_covariance = L^T (g w w^T) L / 2 with w = (s, q).
    l11, l12, l22 = np.float64(record[2]), np.float64(record[3]), np.float64(record[4])
    once, twice = 1.0 / SQUEEZE, 1.0 / (SQUEEZE * SQUEEZE)
    g, gs, gq = np.float64(moments[0]), once * moments[1], once * moments[2]
    gss, gsq, gqq = twice * moments[3], twice * moments[4], twice * moments[5]
    d_centre_x = l11 * gs
    d_centre_y = l12 * gs + l22 * gq
    d_a = 0.5 * l11 * l11 * gss
    d_b = l11 * (l12 * gss + l22 * gsq)  # b stands twice in the matrix
    d_c = 0.5 * (l12 * l12 * gss + 2.0 * l12 * l22 * gsq + l22 * l22 * gqq)
    d_peak = g / np.float64(record[5])  # of the opacity after cap and compensation
    d_opacity = d_peak if opacity <= 1.0 else 0.0
    if camera[23] != 0.0:
        a, b, c = w00 * w00 + w01 * w01 + w02 * w02, w00 * w10 + w01 * w11 + w02 * w12, w10 * w10 + w11 * w11 + w12 * w12
        k0, k1, k2 = w01 * w12 - w02 * w11, w02 * w10 - w00 * w12, w00 * w11 - w01 * w10
        det = k0 * k0 + k1 * k1 + k2 * k2
        det_dilated = det + DILATION * (a + c) + DILATION * DILATION
        compensation = math.sqrt(max(det / det_dilated, COMPENSATION_MIN))
        d_compensation = d_peak * min(np.float64(opacity), 1.0)
        d_opacity *= compensation
        if det / det_dilated > COMPENSATION_MIN:
            d_ratio = 0.5 * d_compensation / compensation
            d_det, d_dilated = d_ratio / det_dilated, -d_ratio * det / (det_dilated * det_dilated)
            d_a += d_det * c + d_dilated * (c + DILATION)
            d_c += d_det * a + d_dilated * (a + DILATION)
            d_b -= 2.0 * b * (d_det + d_dilated)

    # a = W0 W0, b = W0 W1, c = W1 W1; W = M V; M = J R.
    e00, e01, e02 = 2 * d_a * w00 + d_b * w10, 2 * d_a * w01 + d_b * w11, 2 * d_a * w02 + d_b * w12
    e10, e11, e12 = 2 * d_c * w10 + d_b * w00, 2 * d_c * w11 + d_b * w01, 2 * d_c * w12 + d_b * w02
    # Gradient of V = M^T E, column by column split into rotation and scale.
    t00, t01, t02 = m00 * e00 + m10 * e10, m00 * e01 + m10 * e11, m00 * e02 + m10 * e12
    t10, t11, t12 = m01 * e00 + m11 * e10, m01 * e01 + m11 * e11, m01 * e02 + m11 * e12
    t20, t21, t22 = m02 * e00 + m12 * e10, m02 * e01 + m12 * e11, m02 * e02 + m12 * e12
    d_scale[0] = t00 * r00 + t10 * r10 + t20 * r20
    d_scale[1] = t01 * r01 + t11 * r11 + t21 * r21
    d_scale[2] = t02 * r02 + t12 * r12 + t22 * r22
    t00, t01, t02 = t00 * s0, t01 * s1, t02 * s2
    t10, t11, t12 = t10 * s0, t11 * s1, t12 * s2
    t20, t21, t22 = t20 * s0, t21 * s1, t22 * s2
    dw = 2 * (qx * (t21 - t12) + qy * (t02 - t20) + qz * (t10 - t01))
    dx = 2 * (qy * (t01 + t10) + qz * (t02 + t20) + qw * (t21 - t12)) - 4 * qx * (t11 + t22)
    dy = 2 * (qx * (t01 + t10) + qz * (t12 + t21) + qw * (t02 - t20)) - 4 * qy * (t00 + t22)
    dz = 2 * (qx * (t02 + t20) + qy * (t12 + t21) + qw * (t10 - t01)) - 4 * qz * (t00 + t11)
    along = dw * qw + dx * qx + dy * qy + dz * qz
    d_quat[0] = (dw - along * qw) * inverse
    d_quat[1] = (dx - along * qx) * inverse
    d_quat[2] = (dy - along * qy) * inverse
    d_quat[3] = (dz - along * qz) * inverse

    if orthographic:
        d_x, d_y, d_z = d_centre_x * fx, d_centre_y * fy, d_depth
    else:
        # Gradient of M = E V^T, then of the Jacobian's entries = (gradient of M) R^T.
        n00, n01, n02 = e00 * v00 + e01 * v01 + e02 * v02, e00 * v10 + e01 * v11 + e02 * v12, e00 * v20 + e01 * v21 + e02 * v22
        n10, n11, n12 = e10 * v00 + e11 * v01 + e12 * v02, e10 * v10 + e11 * v11 + e12 * v12, e10 * v20 + e11 * v21 + e12 * v22
        d_j00 = n00 * camera[0] + n01 * camera[1] + n02 * camera[2]
        d_j02 = n00 * camera[6] + n01 * camera[7] + n02 * camera[8]
        d_j11 = n10 * camera[3] + n11 * camera[4] + n12 * camera[5]
        d_j12 = n10 * camera[6] + n11 * camera[7] + n12 * camera[8]
        d_u, d_v = d_centre_x * fx, d_centre_y * fy
        if clamped_u == u:
            d_u -= d_j02 * j00
        if clamped_v == v:
            d_v -= d_j12 * j11
        d_near = d_j00 * fx - d_j02 * fx * clamped_u + d_j11 * fy - d_j12 * fy * clamped_v + d_u * x + d_v * y
        d_x, d_y, d_z = d_u * near, d_v * near, d_depth - d_near * near * near
    d_mean[0] = camera[0] * d_x + camera[3] * d_y + camera[6] * d_z
    d_mean[1] = camera[1] * d_x + camera[4] * d_y + camera[7] * d_z
    d_mean[2] = camera[2] * d_x + camera[5] * d_y + camera[8] * d_z
    return d_opacity
