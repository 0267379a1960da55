"""The gradient of `projection.py`, compiled: from a Gaussian's sums over pixels to its mean, quaternion, scale and opacity."""

from __future__ import annotations

import math

import numpy as np

from ..rules import COMPENSATION_MIN, DILATION
from .jit import kernel
from .projection import covariance, footprint
from .records import CAMERA, RECORD, ROW, SQUEEZE


@kernel
def unproject(
    i: int,
    gaussians: tuple[np.ndarray, ...],
    camera: np.ndarray,
    geometry: np.ndarray,
    row: np.ndarray,
    gradients: tuple[np.ndarray, ...],
) -> None:
    """Carry the summed row of gradients of Gaussian i back through its projection.

    Whole arrays come in, not Gaussian i's part of each: making a view counts references.

    Arguments by group:
        gaussians, camera, geometry: As in `projection.project`.
        row: See `records.Row`.
        gradients: Outputs, like `gaussians`: those of mean, quaternion, scale and opacity.
    """
    means, quats, scales, opacities, _, _ = gaussians
    d_means, d_quats, d_scales, d_opacities, _, _ = gradients
    opacity = opacities[i]
    mx, my, mz = np.float64(means[i, 0]), np.float64(means[i, 1]), np.float64(means[i, 2])
    x = camera[CAMERA.r00] * mx + camera[CAMERA.r01] * my + camera[CAMERA.r02] * mz + camera[CAMERA.tx]
    y = camera[CAMERA.r10] * mx + camera[CAMERA.r11] * my + camera[CAMERA.r12] * mz + camera[CAMERA.ty]
    z = camera[CAMERA.r20] * mx + camera[CAMERA.r21] * my + camera[CAMERA.r22] * mz + camera[CAMERA.tz]
    qw, qx, qy, qz = np.float64(quats[i, 0]), np.float64(quats[i, 1]), np.float64(quats[i, 2]), np.float64(quats[i, 3])
    s0, s1, s2 = np.float64(scales[i, 0]), np.float64(scales[i, 1]), np.float64(scales[i, 2])
    inverse = 1.0 / math.sqrt(qw * qw + qx * qx + qy * qy + qz * qz)
    qw, qx, qy, qz = qw * inverse, qx * inverse, qy * inverse, qz * inverse
    r00, r01, r02 = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qw * qz), 2 * (qx * qz + qw * qy)
    r10, r11, r12 = 2 * (qx * qy + qw * qz), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qw * qx)
    r20, r21, r22 = 2 * (qx * qz - qw * qy), 2 * (qy * qz + qw * qx), 1 - 2 * (qx * qx + qy * qy)
    v00, v01, v02 = s0 * r00, s1 * r01, s2 * r02
    v10, v11, v12 = s0 * r10, s1 * r11, s2 * r12
    v20, v21, v22 = s0 * r20, s1 * r21, s2 * r22
    fx, fy = camera[CAMERA.fx], camera[CAMERA.fy]
    near = 1.0 / z
    u, v = x * near, y * near
    clamped_u, clamped_v = (
        min(max(u, camera[CAMERA.low_u]), camera[CAMERA.high_u]),
        min(max(v, camera[CAMERA.low_v]), camera[CAMERA.high_v]),
    )
    if camera[CAMERA.orthographic] != 0.0:
        j00, j02, j11, j12 = fx, 0.0, fy, 0.0
    else:
        j00, j11 = fx * near, fy * near
        j02, j12 = -j00 * clamped_u, -j11 * clamped_v
    m00, m01, m02 = (
        j00 * camera[CAMERA.r00] + j02 * camera[CAMERA.r20],
        j00 * camera[CAMERA.r01] + j02 * camera[CAMERA.r21],
        j00 * camera[CAMERA.r02] + j02 * camera[CAMERA.r22],
    )
    m10, m11, m12 = (
        j11 * camera[CAMERA.r10] + j12 * camera[CAMERA.r20],
        j11 * camera[CAMERA.r11] + j12 * camera[CAMERA.r21],
        j11 * camera[CAMERA.r12] + j12 * camera[CAMERA.r22],
    )
    w = footprint((m00, m01, m02, m10, m11, m12), (v00, v01, v02, v10, v11, v12, v20, v21, v22))
    w00, w01, w02, w10, w11, w12 = w

    # Centre and dilated covariance [[a, b], [b, c]] from the whitened moments, with L = [[l11, l12], [0, l22]]:
    # d_centre = L^T (g w), d_covariance = L^T (g w w^T) L / 2 with w = (s, q).
    l11, l12, l22 = (
        np.float64(geometry[i, RECORD.l11]),
        np.float64(geometry[i, RECORD.l12]),
        np.float64(geometry[i, RECORD.l22]),
    )
    once, twice = 1.0 / SQUEEZE, 1.0 / (SQUEEZE * SQUEEZE)
    g, gs, gq = np.float64(row[ROW.g]), once * row[ROW.gs], once * row[ROW.gq]
    gss, gsq, gqq = twice * row[ROW.gss], twice * row[ROW.gsq], twice * row[ROW.gqq]
    d_centre_x = l11 * gs
    d_centre_y = l12 * gs + l22 * gq
    d_a = 0.5 * l11 * l11 * gss
    d_b = l11 * (l12 * gss + l22 * gsq)  # b stands twice in the matrix
    d_c = 0.5 * (l12 * l12 * gss + 2.0 * l12 * l22 * gsq + l22 * l22 * gqq)
    d_depth = np.float64(row[ROW.depth])
    d_peak = g / np.float64(geometry[i, RECORD.opacity])  # of the opacity after cap and compensation
    d_opacity = d_peak if opacity <= 1.0 else 0.0
    if camera[CAMERA.antialiased] != 0.0:
        a, b, c, det = covariance(w)
        det_dilated = det + DILATION * (a + c) + DILATION * DILATION
        compensation = math.sqrt(max(det / det_dilated, COMPENSATION_MIN))
        d_compensation = d_peak * min(float(opacity), 1.0)
        d_opacity *= compensation
        if det / det_dilated > COMPENSATION_MIN:
            d_ratio = 0.5 * d_compensation / compensation
            d_det, d_dilated = d_ratio / det_dilated, -d_ratio * det / (det_dilated * det_dilated)
            d_a += d_det * c + d_dilated * (c + DILATION)
            d_c += d_det * a + d_dilated * (a + DILATION)
            d_b -= 2.0 * b * (d_det + d_dilated)

    # a = W0 W0, b = W0 W1, c = W1 W1; W = M V; M = J R.
    e00, e01, e02 = (
        2 * d_a * w00 + d_b * w10,
        2 * d_a * w01 + d_b * w11,
        2 * d_a * w02 + d_b * w12,
    )
    e10, e11, e12 = (
        2 * d_c * w10 + d_b * w00,
        2 * d_c * w11 + d_b * w01,
        2 * d_c * w12 + d_b * w02,
    )
    # Gradient of V = M^T E, column by column split into rotation and scale.
    t00, t01, t02 = m00 * e00 + m10 * e10, m00 * e01 + m10 * e11, m00 * e02 + m10 * e12
    t10, t11, t12 = m01 * e00 + m11 * e10, m01 * e01 + m11 * e11, m01 * e02 + m11 * e12
    t20, t21, t22 = m02 * e00 + m12 * e10, m02 * e01 + m12 * e11, m02 * e02 + m12 * e12
    d_scales[i, 0] = t00 * r00 + t10 * r10 + t20 * r20
    d_scales[i, 1] = t01 * r01 + t11 * r11 + t21 * r21
    d_scales[i, 2] = t02 * r02 + t12 * r12 + t22 * r22
    t00, t01, t02 = t00 * s0, t01 * s1, t02 * s2
    t10, t11, t12 = t10 * s0, t11 * s1, t12 * s2
    t20, t21, t22 = t20 * s0, t21 * s1, t22 * s2
    dw = 2 * (qx * (t21 - t12) + qy * (t02 - t20) + qz * (t10 - t01))
    dx = 2 * (qy * (t01 + t10) + qz * (t02 + t20) + qw * (t21 - t12)) - 4 * qx * (t11 + t22)
    dy = 2 * (qx * (t01 + t10) + qz * (t12 + t21) + qw * (t02 - t20)) - 4 * qy * (t00 + t22)
    dz = 2 * (qx * (t02 + t20) + qy * (t12 + t21) + qw * (t10 - t01)) - 4 * qz * (t00 + t11)
    along = dw * qw + dx * qx + dy * qy + dz * qz
    d_quats[i, 0] = (dw - along * qw) * inverse
    d_quats[i, 1] = (dx - along * qx) * inverse
    d_quats[i, 2] = (dy - along * qy) * inverse
    d_quats[i, 3] = (dz - along * qz) * inverse

    if camera[CAMERA.orthographic] != 0.0:
        d_x, d_y, d_z = d_centre_x * fx, d_centre_y * fy, d_depth
    else:
        # Gradient of M = E V^T, then of the Jacobian's entries = (gradient of M) R^T.
        n00, n01, n02 = e00 * v00 + e01 * v01 + e02 * v02, e00 * v10 + e01 * v11 + e02 * v12, e00 * v20 + e01 * v21 + e02 * v22
        n10, n11, n12 = e10 * v00 + e11 * v01 + e12 * v02, e10 * v10 + e11 * v11 + e12 * v12, e10 * v20 + e11 * v21 + e12 * v22
        d_j00 = n00 * camera[CAMERA.r00] + n01 * camera[CAMERA.r01] + n02 * camera[CAMERA.r02]
        d_j02 = n00 * camera[CAMERA.r20] + n01 * camera[CAMERA.r21] + n02 * camera[CAMERA.r22]
        d_j11 = n10 * camera[CAMERA.r10] + n11 * camera[CAMERA.r11] + n12 * camera[CAMERA.r12]
        d_j12 = n10 * camera[CAMERA.r20] + n11 * camera[CAMERA.r21] + n12 * camera[CAMERA.r22]
        d_u, d_v = d_centre_x * fx, d_centre_y * fy
        if clamped_u == u:
            d_u -= d_j02 * j00
        if clamped_v == v:
            d_v -= d_j12 * j11
        d_near = d_j00 * fx - d_j02 * fx * clamped_u + d_j11 * fy - d_j12 * fy * clamped_v + d_u * x + d_v * y
        d_x, d_y, d_z = d_u * near, d_v * near, d_depth - d_near * near * near
    d_means[i, 0] = camera[CAMERA.r00] * d_x + camera[CAMERA.r10] * d_y + camera[CAMERA.r20] * d_z
    d_means[i, 1] = camera[CAMERA.r01] * d_x + camera[CAMERA.r11] * d_y + camera[CAMERA.r21] * d_z
    d_means[i, 2] = camera[CAMERA.r02] * d_x + camera[CAMERA.r12] * d_y + camera[CAMERA.r22] * d_z
    d_opacities[i] = d_opacity
