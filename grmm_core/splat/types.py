"""What goes into the rasteriser and what comes out, and the checks at its boundary.

`Gaussians` and `RasterOutput` hold tensors, `GaussianArrays` and `PictureArrays` the same as arrays, for those without torch.
Imports torch only for annotations, so that the package can be imported where torch is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any, Generic, NamedTuple

import numpy as np

from ..errors import ShapeError
from ..geometry.libraries import Array, library_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from torch import Tensor


def _check_shapes(gaussians: Any) -> None:
    """Raise `ShapeError` naming the part of `Gaussians` or `GaussianArrays` whose shape does not fit the means'."""
    count = gaussians.means.shape[0] if gaussians.means.ndim else 0
    expected = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,), "colors": (count, 3)}
    for name, shape in expected.items():
        part = getattr(gaussians, name)
        if tuple(part.shape) != shape:
            raise ShapeError(f"Gaussians.{name} has the shape {list(part.shape)}; {list(shape)} is needed.")
    features = gaussians.features
    if features is not None and (features.ndim != 2 or features.shape[0] != count):
        raise ShapeError(f"Gaussians.features has the shape {list(features.shape)}; [{count}, channels] is needed.")


@dataclass
class Gaussians:
    """N Gaussians of a scene; all tensors on one device and of one floating type.

    A Gaussian with a non-finite number, or with a quaternion of length zero, is not drawn and gets zero gradients.

    Attributes:
        means: [N, 3] centres, metres.
        quats: [N, 4] rotations, w x y z; need not have unit length.
        scales: [N, 3] standard deviations along the rotated axes, metres, linear.
        opacities: [N], 0..1; what is above 1 counts as 1.
        colors: [N, 3], display values; not clamped.
        features: [N, C] further channels blended like the colors, or None.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    features: Tensor | None = None

    def __len__(self) -> int:
        return int(self.means.shape[0])

    def validate(self) -> None:
        """Raise `ShapeError` naming the tensor whose shape, type or device does not fit."""
        _check_shapes(self)
        for field in fields(self):
            tensor = getattr(self, field.name)
            if tensor is None:
                continue
            if not tensor.is_floating_point():
                raise ShapeError(f"Gaussians.{field.name} holds {tensor.dtype}; floating point numbers are needed.")
            if tensor.device != self.means.device:
                raise ShapeError(f"Gaussians.{field.name} is on {tensor.device} and the means are on {self.means.device}.")

    def to(self, target: torch.device | torch.dtype | str) -> Gaussians:
        """Return the Gaussians with every tensor on another device or of another type (differentiable)."""
        moved = {f.name: getattr(self, f.name).to(target) for f in fields(self) if getattr(self, f.name) is not None}
        return replace(self, **moved)

    @staticmethod
    def concatenate(parts: Sequence[Gaussians]) -> Gaussians:
        """Return the Gaussians of several scenes as one; ties in depth follow the order given.

        Raises:
            ShapeError: No parts, or only some of them carry features.
        """
        if not parts:
            raise ShapeError("At least one set of Gaussians is needed to join them.")
        if len({None if part.features is None else part.features.shape[1] for part in parts}) > 1:
            raise ShapeError("Gaussians with different numbers of features cannot be drawn together.")
        join = library_of(parts[0].means).concatenate
        joined = {f.name: join([getattr(p, f.name) for p in parts]) for f in fields(Gaussians) if f.name != "features"}
        if parts[0].features is not None:
            joined["features"] = join([part.features for part in parts if part.features is not None])
        return Gaussians(**joined)


@dataclass
class RasterOutput(Generic[Array]):
    """The picture of a scene, as tensors or arrays.

    Attributes:
        rgb: [H, W, 3] colors, premultiplied, over the background.
        alpha: [H, W] cover, 0..1: one minus the transmittance that is left.
        depth: [H, W] expected depth along the camera's z axis, metres: sum of w z / alpha; 0 where nothing covers the pixel.
        features: [H, W, C] blended features (premultiplied, over zero), or None.
        halves: [ceil(H / 2), ceil(W / 2), D] means over 2 x 2 pixels of the features that follow these, or None.
    """

    rgb: Array
    alpha: Array
    depth: Array
    features: Array | None = None
    halves: Array | None = None


class GaussianArrays(NamedTuple):
    """`Gaussians` as arrays.

    Attributes:
        means: [N, 3] centres, metres.
        quats: [N, 4] rotations, w x y z.
        scales: [N, 3] standard deviations, metres.
        opacities: [N], 0..1.
        colors: [N, 3] display values.
        features: [N, C]; C is 0 where there are none.
    """

    means: np.ndarray
    quats: np.ndarray
    scales: np.ndarray
    opacities: np.ndarray
    colors: np.ndarray
    features: np.ndarray

    def prepared(self) -> GaussianArrays:
        """Return the arrays as the kernels read them, float32 and contiguous.

        Raises:
            ShapeError: An array has another shape.
        """
        _check_shapes(self)
        return GaussianArrays(*(np.require(array, np.float32, ("C", "W")) for array in self))


class PictureArrays(NamedTuple):
    """`RasterOutput` as float32 arrays: rgb [H, W, 3], alpha [H, W], depth [H, W], features [H, W, C], halves or none."""

    rgb: np.ndarray
    alpha: np.ndarray
    depth: np.ndarray
    features: np.ndarray
    halves: np.ndarray = np.zeros((0, 0, 0), np.float32)
