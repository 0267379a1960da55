"""LPIPS (Zhang et al. 2018) with weights that the user has; none come with this project.

The file is the state dictionary of the authors' VGG16 form: convolutions ``net.sliceN.M``, linear layers ``linN.model.1``.
Used by the command line.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import cast

import torch
from torch import Tensor, nn

from ..errors import FileFormatError
from ..training.perceptual import _read

# widths of the convolutions of each slice with their numbers in VGG16; every slice but the first starts with a pooling
SLICES: tuple[tuple[tuple[int, int], ...], ...] = (
    ((0, 64), (2, 64)),
    ((5, 128), (7, 128)),
    ((10, 256), (12, 256), (14, 256)),
    ((17, 512), (19, 512), (21, 512)),
    ((24, 512), (26, 512), (28, 512)),
)
SHIFT, SCALE = (-0.030, -0.088, -0.188), (0.458, 0.448, 0.450)
_EPSILON = 1e-10


class Lpips(nn.Module):
    """Distance of two pictures [H, W, 3], display sRGB 0..1.

    Args:
        state: Parameters by name.

    Raises:
        FileFormatError: One is missing or of another shape.
    """

    shift: Tensor
    scale: Tensor

    def __init__(self, state: Mapping[str, Tensor]) -> None:
        super().__init__()
        self.slices, self.linear = nn.ModuleList(), nn.ParameterList()
        width = 3
        for number, layers in enumerate(SLICES):
            convolutions = nn.Sequential()
            for index, channels in layers:
                convolution = nn.Conv2d(width, channels, 3, padding=1)
                for part in ("weight", "bias"):
                    value = _take(state, f"net.slice{number + 1}.{index}.{part}", getattr(convolution, part).shape)
                    setattr(convolution, part, nn.Parameter(value))
                convolutions.append(convolution)
                width = channels
            self.slices.append(convolutions)
            self.linear.append(nn.Parameter(_take(state, f"lin{number}.model.1.weight", torch.Size((1, width, 1, 1)))))
        self.register_buffer("shift", torch.tensor(SHIFT).view(1, 3, 1, 1))
        self.register_buffer("scale", torch.tensor(SCALE).view(1, 3, 1, 1))
        self.requires_grad_(False)

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Return the distance, a scalar."""
        x = torch.stack([a, b]).permute(0, 3, 1, 2) * 2.0 - 1.0
        x = (x - self.shift) / self.scale
        total = x.new_zeros(())
        for number, convolutions in enumerate(self.slices):
            if number:
                x = nn.functional.max_pool2d(x, 2)
            for convolution in cast(nn.Sequential, convolutions):
                x = convolution(x).relu()
            unit = x / (x.square().sum(1, keepdim=True).sqrt() + _EPSILON)
            difference = (unit[0] - unit[1]).square()[None]
            total = total + (difference * self.linear[number]).sum(1).mean()
        return total


def load_lpips(path: str | Path) -> Lpips:
    """Read a user's LPIPS weights. Raises `FileAccessError`, `FileFormatError`."""
    return Lpips(_read(Path(path)))


def _take(state: Mapping[str, Tensor], name: str, shape: torch.Size) -> Tensor:
    value = state.get(name)
    if value is None or value.shape != shape:
        raise FileFormatError(f"The LPIPS weights lack {name} of shape {tuple(shape)}; use those of the VGG form.")
    return value.float()
