"""Gradients for cameras: a small motion of the scene in the camera's axes, as a differentiable function of six numbers.

Moving the camera is moving the scene the other way, and all backends differentiate the scene. So `api.rasterize` applies a
motion to the Gaussians first and then draws them with a camera at the origin. Imports torch.
"""

from __future__ import annotations

import dataclasses

import numpy as np
import torch
from torch import Tensor

from ..errors import ShapeError
from ..geometry.camera import Camera
from .types import Gaussians

_SMALL = 1e-8  # squared radians below which sin(x / 2) / x is 1/2 to the last digit


def moved(gaussians: Gaussians, camera: Camera, motion: Tensor) -> tuple[Gaussians, Camera]:
    """Return the scene in the camera's axes after a motion, and the camera of that scene.

    Drawing the result is drawing `gaussians` with world_to_camera = [R(motion[:3]) | motion[3:]] @ camera.world_to_camera.

    Args:
        gaussians: In the world.
        camera: Where the motion starts; its matrix is a rotation, a translation and one uniform scale.
        motion: [6] rotation vector, radians, and translation, metres, in the camera's axes (x right, y down, z forward).

    Raises:
        ShapeError: `motion` has another shape.
    """
    if tuple(motion.shape) != (6,):
        raise ShapeError(f"The camera's motion has the shape {list(motion.shape)}; [6] is needed.")
    like = gaussians.means
    linear = camera.world_to_camera[:3, :3]
    size = float(np.cbrt(np.abs(np.linalg.det(linear))))
    fixed = like.new_tensor(_quaternion(linear / size))
    turn = _quaternion_of(motion[:3].to(like))
    means = like @ like.new_tensor(linear).T + like.new_tensor(camera.world_to_camera[:3, 3])
    means = _rotate(turn, means) + motion[3:].to(like)
    scene = dataclasses.replace(
        gaussians, means=means, quats=_multiply(_multiply(turn, fixed), gaussians.quats), scales=gaussians.scales * size
    )
    return scene, dataclasses.replace(camera, world_to_camera=np.eye(4))


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """Unit quaternion [4] of a rotation matrix [3, 3]: the largest eigenvector of Bar-Itzhack's symmetric matrix."""
    (a, b, c), (d, e, f), (g, h, i) = rotation
    matrix = np.array(
        [
            [a + e + i, h - f, c - g, d - b],
            [h - f, a - e - i, b + d, c + g],
            [c - g, b + d, e - a - i, f + h],
            [d - b, c + g, f + h, i - a - e],
        ]
    )
    return np.linalg.eigh(matrix)[1][:, -1]


def _quaternion_of(rotation_vector: Tensor) -> Tensor:
    """Unit quaternion [4] of a rotation vector [3]; smooth at zero."""
    square = rotation_vector.square().sum()
    small = square < _SMALL
    angle = torch.where(small, torch.ones_like(square), square).sqrt()  # no square root of zero in the gradient
    factor = torch.where(small, 0.5 - square / 48, torch.sin(angle / 2) / angle)
    real = torch.where(small, 1 - square / 8, torch.cos(angle / 2))
    return torch.cat([real[None], rotation_vector * factor])


def _multiply(left: Tensor, right: Tensor) -> Tensor:
    """Product of quaternions, [4] times [..., 4]."""
    a, b, c, d = left.unbind(-1)
    w, x, y, z = right.unbind(-1)
    real = a * w - b * x - c * y - d * z
    return torch.stack([real, a * x + b * w + c * z - d * y, a * y - b * z + c * w + d * x, a * z + b * y - c * x + d * w], -1)


def _rotate(quaternion: Tensor, points: Tensor) -> Tensor:
    """Points [N, 3] turned by a unit quaternion [4]."""
    axis = quaternion[1:].expand_as(points)
    once = 2 * torch.linalg.cross(axis, points)
    return points + quaternion[0] * once + torch.linalg.cross(axis, once)
