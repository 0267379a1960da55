"""Rotations as animators and trackers write them: XYZ Euler angles, axis-angle vectors, quaternions wxyz; whole tracks.

Needs numpy only. What takes an `Array` takes tensors as well; what else is differentiated is in `tensor_rotations`.
"""

from __future__ import annotations

import numpy as np

from .libraries import Array, library_of

_SMALL_ANGLE = 1e-8
_GIMBAL = 1e-7


def axis_angle_to_matrix(vectors: np.ndarray) -> np.ndarray:
    """Rodrigues' formula. [..., 3] radians to [..., 3, 3]."""
    vectors = np.asarray(vectors, np.float64)
    angle = np.linalg.norm(vectors, axis=-1)[..., None, None]
    safe = np.where(angle < _SMALL_ANGLE, 1.0, angle)
    sine = np.where(angle < _SMALL_ANGLE, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
    cosine = np.where(angle < _SMALL_ANGLE, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
    x, y, z = np.moveaxis(vectors, -1, 0)
    zero = np.zeros_like(x)
    skew = np.stack([zero, -z, y, z, zero, -x, -y, x, zero], -1).reshape(*x.shape, 3, 3)
    return np.eye(3) + sine * skew + cosine * (skew @ skew)


def matrix_to_axis_angle(matrices: np.ndarray) -> np.ndarray:
    """Inverse of `axis_angle_to_matrix`, angles 0..pi, stable near pi. [..., 3, 3] to [..., 3] radians."""
    quaternion = matrix_to_quaternion(matrices)
    quaternion = np.where(quaternion[..., :1] < 0, -quaternion, quaternion)
    length = np.linalg.norm(quaternion[..., 1:], axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(length, quaternion[..., :1])
    return quaternion[..., 1:] * np.where(length < _SMALL_ANGLE, 2.0, angle / np.where(length < _SMALL_ANGLE, 1.0, length))


def matrix_to_quaternion(matrices: np.ndarray) -> np.ndarray:
    """Unit quaternions wxyz of rotation matrices, [..., 3, 3] to [..., 4]: the largest component is solved for first."""
    m = np.asarray(matrices, np.float64)
    d0, d1, d2 = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    squares = np.stack([1 + d0 + d1 + d2, 1 + d0 - d1 - d2, 1 - d0 + d1 - d2, 1 - d0 - d1 + d2], -1)  # 4 q_i^2
    wx, wy, wz = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    xy, xz, yz = m[..., 0, 1] + m[..., 1, 0], m[..., 0, 2] + m[..., 2, 0], m[..., 1, 2] + m[..., 2, 1]
    rows = np.stack(
        [
            np.stack([squares[..., 0], wx, wy, wz], -1),
            np.stack([wx, squares[..., 1], xy, xz], -1),
            np.stack([wy, xy, squares[..., 2], yz], -1),
            np.stack([wz, xz, yz, squares[..., 3]], -1),
        ],
        -2,
    )
    best = np.argmax(squares, -1)[..., None, None]
    quaternion = np.take_along_axis(rows, best, -2)[..., 0, :]
    return quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)


def multiply_quaternions(first: Array, second: Array) -> Array:
    """Hamilton product of quaternions wxyz, both [..., 4]: the rotation `second`, and then `first`."""
    (a, b, c, d), (w, x, y, z) = ([q[..., i] for i in range(4)] for q in (first, second))
    product = (
        a * w - b * x - c * y - d * z,
        a * x + b * w + c * z - d * y,
        a * y - b * z + c * w + d * x,
        a * z + b * y - c * x + d * w,
    )
    return library_of(first).stack(product, -1)


def quaternion_to_matrix(quaternions: Array) -> Array:
    """Rotation matrices of quaternions wxyz of any length but zero, [..., 4] to [..., 3, 3]."""
    lengths = (quaternions * quaternions).sum(-1) ** 0.5
    w, x, y, z = (quaternions[..., i] / lengths for i in range(4))
    entries = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return library_of(quaternions).stack(entries, -1).reshape((*quaternions.shape[:-1], 3, 3))


def euler_to_matrix(angles: Array) -> Array:
    """Rotation matrices R = Rz Ry Rx of XYZ Euler angles (Blender's 'XYZ'), radians, [..., 3] to [..., 3, 3]."""
    lib = library_of(angles)
    cx, cy, cz = (lib.cos(angles[..., i]) for i in range(3))
    sx, sy, sz = (lib.sin(angles[..., i]) for i in range(3))
    entries = (
        cy * cz, sx * sy * cz - cx * sz, cx * sy * cz + sx * sz,
        cy * sz, sx * sy * sz + cx * cz, cx * sy * sz - sx * cz,
        -sy, sx * cy, cx * cy,
    )  # fmt: skip
    return lib.stack(entries, -1).reshape((*angles.shape[:-1], 3, 3))


def matrix_to_euler(matrices: np.ndarray) -> np.ndarray:
    """Inverse of `euler_to_matrix`, y within +-pi/2; at the gimbal z is set to zero. [..., 3, 3] to [..., 3] radians."""
    m = np.asarray(matrices, np.float64)
    length = np.hypot(m[..., 0, 0], m[..., 1, 0])
    locked = length < _GIMBAL
    x = np.where(locked, np.arctan2(-m[..., 1, 2], m[..., 1, 1]), np.arctan2(m[..., 2, 1], m[..., 2, 2]))
    y = np.arctan2(-m[..., 2, 0], length)
    z = np.where(locked, 0.0, np.arctan2(m[..., 1, 0], m[..., 0, 0]))
    return np.stack([x, y, z], -1)


def unwrap_euler(angles: np.ndarray) -> np.ndarray:
    """Make a track of Euler angles continuous, [T, 3]: between two frames no angle jumps by a full turn."""
    return np.unwrap(angles, axis=0)


def axis_angle_to_euler(vectors: np.ndarray) -> np.ndarray:
    """A track of axis-angle vectors [T, 3] to continuous XYZ Euler angles [T, 3], radians."""
    return unwrap_euler(matrix_to_euler(axis_angle_to_matrix(vectors)))


def euler_to_axis_angle(angles: np.ndarray) -> np.ndarray:
    """XYZ Euler angles [T, 3] to axis-angle vectors [T, 3], radians."""
    return matrix_to_axis_angle(euler_to_matrix(np.asarray(angles, np.float64)))
