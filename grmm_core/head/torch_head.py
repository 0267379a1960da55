"""The head model as a batched, differentiable torch module, for training and fitting.

The twin of `head_model.HeadModel`: same arrays, same functions of `skinning`, any leading batch. Imported only where torch is
installed; used by `model.grmm`, training and fitting.
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import ShapeError
from ..geometry.rotations import euler_to_matrix
from .head_model import JOINT_COUNT, HeadModel
from .skinning import posed_vertices


class TorchHead(nn.Module):
    """Head model with its arrays as non-persistent buffers: they move with `.to()` and stay out of checkpoints.

    Attributes:
        model: The numpy model that the buffers were copied from.
    """

    v_template: Tensor  # [V, 3]
    shape_dirs: Tensor  # [V, 3, S]
    expression_dirs: Tensor  # [V, 3, E]
    posedirs: Tensor | None  # [V, 3, 36]
    weights: Tensor  # [V, 5]
    expression_pose: Tensor  # [E, 5, 3]
    joint_template: Tensor  # [5, 3]
    joint_dirs: Tensor  # [5, 3, S]
    faces: Tensor  # [F, 3] int64

    def __init__(self, model: HeadModel, dtype: torch.dtype = torch.float32) -> None:
        super().__init__()
        self.model = model
        self.parents = tuple(int(parent) for parent in model.parents)
        arrays = {
            "v_template": model.v_template, "shape_dirs": model.shape_dirs, "expression_dirs": model.expression_dirs,
            "weights": model.weights, "expression_pose": model.expression_pose,
            "joint_template": model.joint_template, "joint_dirs": model.joint_dirs,
        }  # fmt: skip
        for name, array in arrays.items():
            self.register_buffer(name, torch.tensor(array, dtype=dtype), persistent=False)
        posedirs = None if model.posedirs is None else torch.tensor(model.posedirs, dtype=dtype)
        self.register_buffer("posedirs", posedirs, persistent=False)
        self.register_buffer("faces", torch.tensor(model.faces.astype(np.int64)), persistent=False)

    def shaped(self, shape: Tensor, expression: Tensor | None = None) -> Tensor:
        """Template plus shape and expression directions.

        Args:
            shape: [..., <=S].
            expression: [..., <=E] or None.

        Returns:
            Unposed vertices in metres, [..., V, 3].
        """
        result = self.v_template + _offsets(self.shape_dirs, shape, "shape")
        if expression is not None:
            result = result + self.expression_offsets(expression)
        return result

    def expression_offsets(self, expression: Tensor) -> Tensor:
        """What expression coefficients [..., <=E] add to the unposed vertices, metres, [..., V, 3]."""
        return _offsets(self.expression_dirs, expression, "expression")

    def joints(self, shape: Tensor) -> Tensor:
        """Rest joints in metres for coefficients [..., <=S]: [..., 5, 3]."""
        return self.joint_template + _offsets(self.joint_dirs, shape, "shape")

    def pose_of(self, expression: Tensor, pose_euler: Tensor | None = None) -> Tensor:
        """Euler angles [..., 5, 3] in radians that expression coefficients [..., <=E] give, on top of `pose_euler`."""
        pose = torch.einsum("...e,ejk->...jk", expression, self.expression_pose[: expression.shape[-1]])
        return pose if pose_euler is None else pose + pose_euler

    def forward(
        self, shape: Tensor, expression: Tensor, pose: Tensor, displacement: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Posed vertices and rest joints.

        Args:
            shape: [..., <=S].
            expression: Vertex part only; add `pose_of(expression)` to the pose as the animation does, [..., <=E].
            pose: XYZ Euler angles in radians, [..., 5, 3], or rotation matrices, [..., 5, 3, 3].
            displacement: Learned residual before skinning (paper, equation 11), metres, [..., V, 3] or None.

        Returns:
            Vertices [..., V, 3] and rest joints [..., 5, 3], metres.

        Raises:
            ShapeError: An argument has the wrong shape.
        """
        unposed = self.shaped(shape, expression)
        if displacement is not None:
            unposed = unposed + displacement
        joints = self.joints(shape)
        return self.posed(unposed, pose, joints), joints

    def posed(self, unposed: Tensor, pose: Tensor, joints: Tensor) -> Tensor:
        """Pose vertices [..., V, 3] of a head with rest joints [..., 5, 3]; `pose` and errors as in `forward`."""
        if pose.shape[-2:] == (JOINT_COUNT, 3) and pose.ndim == joints.ndim:
            rotations = euler_to_matrix(pose)
        elif pose.shape[-3:] == (JOINT_COUNT, 3, 3):
            rotations = pose
        else:
            raise ShapeError(
                f"The pose has shape {tuple(pose.shape)}; it must be [..., 5, 3] angles or [..., 5, 3, 3] rotations."
            )
        return posed_vertices(unposed, rotations, joints, self.weights, self.parents, self.posedirs)


def _offsets(directions: Tensor, coefficients: Tensor, what: str) -> Tensor:
    """Directions [N, 3, K] times coefficients [..., <=K]: [..., N, 3]."""
    count = coefficients.shape[-1]
    if count > directions.shape[2]:
        raise ShapeError(f"{count} {what} coefficients were given; the head model has {directions.shape[2]}.")
    flat = coefficients @ directions[:, :, :count].flatten(0, 1).T
    return flat.reshape((*coefficients.shape[:-1], directions.shape[0], 3))
