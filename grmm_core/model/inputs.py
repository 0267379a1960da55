"""`ModelInputs`: what the model needs to draw one frame, and how a person and controls give it.

One convention for batches in the whole room: every argument is [..., K] with any leading dimensions, the same for all; a
single frame has none. A picture is of one scene, so batches end at the rasteriser.

Numpy only: a session without torch makes the same inputs and the same cache keys. Used by every part that draws.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Generic, TypeAlias, TypeVar

import numpy as np

from ..controls.frame import Controls, ResolvedControls, resolve
from ..controls.names import ALIGNED_NAMES
from ..errors import ConfigError, ShapeError
from ..geometry.libraries import Array
from ..head import arkit_gain

if TYPE_CHECKING:
    import torch

    from ..avatar import Avatar
    from ..head import HeadModel

    Other = TypeVar("Other", np.ndarray, torch.Tensor)
    AnyPerson: TypeAlias = "Person | Avatar"

_NOTHING = np.zeros(0, np.float32)


@dataclass(frozen=True)
class ModelInputs(Generic[Array]):
    """Everything that a picture depends on besides weights and camera: numpy arrays or tensors, all of one kind.

    Attributes:
        z_id: Identity code, [..., Z]; without residuals the shape (eq. 21).
        z_exp: Expression code, strength included, [..., Y]; without residuals the expression.
        shape: Shape coefficients alpha_id, [..., <=S].
        expression: Expression coefficients alpha_exp, [..., <=E]; missing ones are zero.
        pose: XYZ Euler angles of the five joints, all parts included, radians, [..., 5, 3].
        strength: Factor of the learned displacement, one for the whole batch.
    """

    z_id: Array
    z_exp: Array
    shape: Array
    expression: Array
    pose: Array
    strength: float = 1.0

    def mapped(self, function: Callable[[Array], Other]) -> ModelInputs[Other]:
        """The same inputs with every array replaced by what a function makes of it."""
        arrays = (self.z_id, self.z_exp, self.shape, self.expression, self.pose)
        z_id, z_exp, shape, expression, pose = (function(array) for array in arrays)
        return ModelInputs(z_id, z_exp, shape, expression, pose, self.strength)

    # What each step of the chain depends on, for caches.

    @functools.cached_property
    def identity_key(self) -> tuple[bytes, ...]:
        """What opacity depends on, and with the view direction the appearance."""
        return _keys(self.z_id)

    @functools.cached_property
    def code_key(self) -> tuple[bytes, ...]:
        """What offsets and expression colors depend on."""
        return _keys(self.z_id, self.z_exp)

    @functools.cached_property
    def shape_key(self) -> tuple[bytes, ...]:
        """What the head at rest depends on."""
        return _keys(self.shape)

    @functools.cached_property
    def mesh_key(self) -> tuple[bytes | float, ...]:
        """What the mesh depends on, and with it the Gaussians' places."""
        return (*_keys(self.z_id, self.z_exp, self.shape, self.expression, self.pose), self.strength)


@dataclass(frozen=True)
class Person:
    """What a person brings to every frame. An `avatar.Avatar` has the same attributes and can stand in its place.

    Attributes:
        z_id: Identity code, [Z].
        shape: Shape coefficients, [S] or longer, filled up with zeros.
        z_exp: Added to the code of every expression, [<=Y].
        expression: Added to every expression, [<=E].
    """

    z_id: np.ndarray
    shape: np.ndarray
    z_exp: np.ndarray = field(default_factory=lambda: _NOTHING)
    expression: np.ndarray = field(default_factory=lambda: _NOTHING)


@dataclass(frozen=True)
class InputSpace:
    """What a person and controls are added up in.

    Attributes:
        head: Mesh model.
        z_id, z_exp: Lengths of the codes; without residuals those of shape and expression.
        codes: Table Z of aligned expression codes, [60, z_exp]; None without residuals.
    """

    head: HeadModel
    z_id: int
    z_exp: int
    codes: np.ndarray | None

    @property
    def code_norms(self) -> np.ndarray:
        """Length of each aligned expression's code, [60] float32; zeros without residuals."""
        codes = np.zeros((len(ALIGNED_NAMES), 1)) if self.codes is None else self.codes
        return np.linalg.norm(codes, axis=1).astype(np.float32)

    def inputs(self, person: AnyPerson, controls: Controls) -> ModelInputs[np.ndarray]:
        """Add a person and the controls of one frame.

        Raises:
            ControlError, ShapeError: A control is not finite, or has more components than this model.
        """
        clean = controls.validate()
        performed = resolve(clean, self.head, arkit_gain(self.head, person.shape))
        return self.frame(person, performed, clean.shape, clean.z_id, clean.z_exp, clean.residual_strength)

    def frame(
        self, person: AnyPerson, performed: ResolvedControls, shape: np.ndarray = _NOTHING, z_id: np.ndarray = _NOTHING,
        z_exp: np.ndarray = _NOTHING, strength: float = 1.0,
    ) -> ModelInputs[np.ndarray]:  # fmt: skip
        """Add a person and what is performed: coefficients and pose as a capture or `controls.resolve` has them.

        Args:
            person: Who performs.
            performed: Expression, pose and aligned weights, all parts included.
            shape: Added to the person's, [<=S].
            z_id: Likewise, [<=Z].
            z_exp: Likewise, [<=Y].
            strength: Factor of the learned displacement and of z_exp.

        Raises:
            ShapeError: An array has more components than this model.
        """
        head = self.head
        count = head.expression_dirs.shape[-1]
        # The person's resting expression turns joints as the same coefficients in the controls would.
        resting = _sum("expression", count, person.expression)
        expression = _sum("expression", count, performed.expression, resting)
        turned = np.einsum("e,ejk->jk", resting, np.asarray(head.expression_pose, np.float32))
        own_shape = person.shape[: head.shape_dirs.shape[-1]]  # files hold as many as the largest head model has
        shape = _sum("shape", head.shape_dirs.shape[-1], own_shape, shape)
        offset = _sum("z_exp", self.z_exp, person.z_exp, z_exp) if self.codes is not None else None
        code = expression_code(self.codes, performed.aligned, offset, expression)
        if self.codes is not None:
            z_id, code = _sum("z_id", self.z_id, person.z_id, z_id), code * np.float32(strength)
        pose = (performed.pose + turned).astype(np.float32)
        return ModelInputs(identity_code(self.codes, z_id, shape), code, shape, expression, pose, strength)


def identity_code(codes: Array | None, z_id: Array, shape: Array) -> Array:
    """The code that the decoders read: z_id [..., Z], or of a model without residual codes the shape (eq. 21)."""
    return shape if codes is None else z_id


def expression_code(codes: Array | None, aligned: Array, offset: Array | None, expression: Array | None) -> Array:
    """The expression code of weighted aligned expressions.

    Args:
        codes: Table Z, [60, Y], or None of a model without residual codes.
        aligned: Weights, [..., 60].
        offset: Added to the code, [..., Y], or None.
        expression: Head-model coefficients, [..., E]; read, and then needed, without residual codes only.

    Returns:
        z_exp = sum_k aligned_k Z_k + offset, [..., Y]; without residual codes the coefficients (eq. 21).
    """
    if codes is None:
        if expression is None:
            raise ConfigError("This model has no residual codes; give the expression coefficients.")
        return expression
    code = aligned @ codes
    return code if offset is None else code + offset


def _keys(*arrays: Array) -> tuple[bytes, ...]:
    return tuple(np.asarray(array).tobytes() for array in arrays)


def _sum(name: str, size: int, *parts: np.ndarray) -> np.ndarray:
    """Add rows of up to `size` values. Raises `ShapeError` for a longer one."""
    total = np.zeros(size, np.float32)
    for part in parts:
        if part.size > size:
            raise ShapeError(f"{name} has {part.size} values; this model takes {size}.")
        total[: part.size] += part
    return total
