"""What goes into the rasteriser and what comes out, and the checks at its boundary.

Imports torch only for annotations, so that the package can be imported where torch is missing.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING

from ..errors import ShapeError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import torch
    from torch import Tensor


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
        count = self.means.shape[0] if self.means.ndim else 0
        expected = {"means": (count, 3), "quats": (count, 4), "scales": (count, 3), "opacities": (count,), "colors": (count, 3)}
        for name, shape in expected.items():
            tensor = getattr(self, name)
            if tuple(tensor.shape) != shape:
                raise ShapeError(f"Gaussians.{name} has the shape {list(tensor.shape)}; {list(shape)} is needed.")
        if self.features is not None and (self.features.ndim != 2 or self.features.shape[0] != count):
            raise ShapeError(f"Gaussians.features has the shape {list(self.features.shape)}; [{count}, channels] is needed.")
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
        import torch

        if not parts:
            raise ShapeError("At least one set of Gaussians is needed to join them.")
        if len({None if part.features is None else part.features.shape[1] for part in parts}) > 1:
            raise ShapeError("Gaussians with different numbers of features cannot be drawn together.")
        joined = {f.name: torch.cat([getattr(p, f.name) for p in parts]) for f in fields(Gaussians) if f.name != "features"}
        if parts[0].features is not None:
            joined["features"] = torch.cat([part.features for part in parts])
        return Gaussians(**joined)


@dataclass
class RasterOutput:
    """The picture of a scene.

    Attributes:
        rgb: [H, W, 3] colors, premultiplied, over the background.
        alpha: [H, W] cover, 0..1: one minus the transmittance that is left.
        depth: [H, W] expected depth along the camera's z axis, metres: sum of w z / alpha; 0 where nothing covers the pixel.
        features: [H, W, C] blended features (premultiplied, over zero), or None.
    """

    rgb: Tensor
    alpha: Tensor
    depth: Tensor
    features: Tensor | None = None
