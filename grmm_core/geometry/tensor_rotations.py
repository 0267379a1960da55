"""Rotations of torch tensors that are differentiated: no square root of zero, no division by small numbers. Imports torch."""

from __future__ import annotations

import torch
from torch import Tensor

_SMALL_ANGLE = 1e-6  # radians
_SMALL_SQUARE = 1e-8  # squared radians below which sin(x / 2) / x is 1/2 to the last digit
_TINY_NORM = 1e-20


def unit(vectors: Tensor) -> Tensor:
    """Vectors [..., K] scaled to length 1; zero stays zero."""
    return vectors / vectors.square().sum(-1, keepdim=True).clamp(min=_TINY_NORM).sqrt()


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Turn vectors [..., 3] by unit quaternions wxyz [..., 4]."""
    w, axis = quats[..., :1], quats[..., 1:]
    twice = 2.0 * torch.linalg.cross(axis, vectors)
    return vectors + w * twice + torch.linalg.cross(axis, twice)


def matrix_to_quaternion(matrix: Tensor) -> Tensor:
    """Unit quaternions wxyz [..., 4] of rotation matrices [..., 3, 3].

    The four rows of 4 q q^T are linear in the matrix; the row with the largest diagonal, normalised, is q.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = matrix.flatten(-2).unbind(-1)
    wx, wy, wz = m21 - m12, m02 - m20, m10 - m01
    xy, xz, yz = m10 + m01, m20 + m02, m21 + m12
    rows = torch.stack(
        [
            torch.stack([1 + m00 + m11 + m22, wx, wy, wz], -1),
            torch.stack([wx, 1 + m00 - m11 - m22, xy, xz], -1),
            torch.stack([wy, xy, 1 - m00 + m11 - m22, yz], -1),
            torch.stack([wz, xz, yz, 1 - m00 - m11 + m22], -1),
        ],
        -2,
    )
    best = rows.diagonal(dim1=-2, dim2=-1).argmax(-1)  # [...]
    row = rows.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    return unit(row)


def rotvec_to_quaternion(vector: Tensor) -> Tensor:
    """Unit quaternions wxyz [..., 4] of axis-angle vectors [..., 3], radians; smooth at zero."""
    square = vector.square().sum(-1, keepdim=True)
    small = square < _SMALL_SQUARE
    angle = torch.where(small, torch.ones_like(square), square).sqrt()  # no square root of zero in the gradient
    factor = torch.where(small, 0.5 - square / 48, torch.sin(angle / 2) / angle)
    real = torch.where(small, 1 - square / 8, torch.cos(angle / 2))
    return torch.cat([real, vector * factor], -1)


def euler_to_rotvec(euler: Tensor) -> Tensor:
    """Axis-angle vectors of XYZ Euler angles (R = Rz Ry Rx), radians, [..., 3] to [..., 3]; smooth at zero."""
    cx, cy, cz = torch.cos(euler / 2).unbind(-1)
    sx, sy, sz = torch.sin(euler / 2).unbind(-1)
    w = cz * cy * cx + sz * sy * sx
    axis = torch.stack([cz * cy * sx - sz * sy * cx, cz * sy * cx + sz * cy * sx, sz * cy * cx - cz * sy * sx], -1)
    axis = torch.where(w[..., None] < 0, -axis, axis)  # the shorter way round
    w = w.abs()
    square = axis.square().sum(-1)
    small = square < _SMALL_ANGLE**2
    length = torch.where(small, torch.ones_like(square), square).sqrt()
    factor = torch.where(small, 2.0 / w.clamp(min=0.5), 2.0 * torch.atan2(length, w) / length)
    return axis * factor[..., None]
