"""Gradients for cameras: a small motion of the scene in the camera's axes, as a differentiable function of six numbers.

Moving the camera is moving the scene the other way, and all backends differentiate the scene. So `api.rasterize` applies a
motion to the Gaussians first and then draws them with a camera at the origin. Imports torch.
"""

from __future__ import annotations

import dataclasses

import numpy as np
from torch import Tensor

from ..errors import ShapeError
from ..geometry.camera import Camera
from ..geometry.rotations import matrix_to_quaternion, multiply_quaternions
from ..geometry.tensor_rotations import rotate, rotvec_to_quaternion
from .types import Gaussians


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
    fixed = like.new_tensor(matrix_to_quaternion(linear / size))
    turn = rotvec_to_quaternion(motion[:3].to(like))
    means = like @ like.new_tensor(linear).T + like.new_tensor(camera.world_to_camera[:3, 3])
    means = rotate(turn.expand(len(means), 4), means) + motion[3:].to(like)
    quats = multiply_quaternions(multiply_quaternions(turn, fixed), gaussians.quats)
    scene = dataclasses.replace(gaussians, means=means, quats=quats, scales=gaussians.scales * size)
    return scene, dataclasses.replace(camera, world_to_camera=np.eye(4))
