"""Run the photo networks (face detector, landmarks, blendshapes, person mask) with torch.

The asset `photo_networks.safetensors` holds each network as a program: operators of TensorFlow Lite over numbered tensors,
and half-precision weights (`tools/photo_networks` makes it and names source and licence). Tensors are kept in the source's
channels-last order; a permuted view of one is torch's channels_last layout, so convolutions copy nothing.

Called by `photo.faces` and `photo.person`. Inference only.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..errors import FileFormatError
from ..files.tensorfile import read_tensors

ASSET = Path(__file__).resolve().parent.parent / "assets" / "photo_networks.safetensors"
NetworkName = Literal["face_detector", "face_landmarks_detector", "face_blendshapes", "selfie_segmentation"]


class ProgramNetwork:
    """One network of the asset.

    Attributes:
        input_shape: Shape of its input, channels last, batch first.
        operators: Its steps in their order, as the asset has them: "op", numbers of tensors "in" and "out", and options.
        weights: Its constants by the tensors' numbers.
        outputs: Numbers of the tensors that it returns.
    """

    def __init__(self, program: dict[str, Any], weights: dict[int, Tensor]) -> None:
        self.input_shape: tuple[int, ...] = tuple(program["shapes"][0])
        self.operators: list[dict[str, Any]] = program["operators"]
        self.weights = weights
        self._input: int = program["inputs"][0]
        self.outputs: list[int] = program["outputs"]

    @torch.no_grad()
    def __call__(self, value: Tensor) -> list[Tensor]:
        """Run the network on `value`, shape `input_shape` float32; returns its outputs in the source's order."""
        return self._run(value, self.weights, self.outputs)

    def first_output(self, value: Tensor, weights: Mapping[int, Tensor]) -> Tensor:
        """Its first output for any number of inputs at once, by other weights, through which gradients go back."""
        return self._run(value, {**self.weights, **weights}, self.outputs[:1])[0]

    def _run(self, value: Tensor, weights: Mapping[int, Tensor], outputs: list[int]) -> list[Tensor]:
        tensors: dict[int, Tensor] = {**weights, self._input: value}
        for step in self.operators:
            tensors[step["out"]] = _OPERATORS[step["op"]](step, *(tensors[i] if i >= 0 else None for i in step["in"]))
            if all(output in tensors for output in outputs):
                break
        return [tensors[i] for i in outputs]


@lru_cache(maxsize=1)
def load_networks() -> dict[str, ProgramNetwork]:
    """Load all networks of the asset.

    Raises:
        FileAccessError, FileFormatError: The asset is missing or damaged.
    """
    tensors, metadata = _asset()
    return {name: ProgramNetwork(json.loads(metadata[name]), _weights(tensors, name)) for name in NetworkName.__args__}  # type: ignore[attr-defined]


def load_program(name: NetworkName, weights: dict[int, Tensor]) -> ProgramNetwork:
    """A network of the asset with other weights.

    Args:
        name: Which.
        weights: By the tensors' numbers; those that are not given are the asset's (sizes and the like).

    Raises:
        FileAccessError, FileFormatError: The asset is missing or damaged.
    """
    tensors, metadata = _asset()
    return ProgramNetwork(json.loads(metadata[name]), {**_weights(tensors, name), **weights})


def _asset() -> tuple[dict[str, np.ndarray], dict[str, str]]:
    tensors, metadata = read_tensors(ASSET)
    if metadata.get("format") != "grmm-photo-networks" or metadata.get("version") != "1":
        raise FileFormatError(f"{ASSET} does not hold this version's photo networks; install the project again.")
    return tensors, metadata


def _weights(tensors: dict[str, np.ndarray], name: str) -> dict[int, Tensor]:
    """Of one network, by the tensors' numbers."""
    return {
        int(key.rpartition("/")[2]): torch.from_numpy(array).float() if array.dtype.kind == "f" else torch.from_numpy(array)
        for key, array in tensors.items()
        if key.startswith(f"{name}/")
    }


def _activate(step: dict[str, Any], value: Tensor) -> Tensor:
    activation = step.get("activation", "none")
    if activation == "relu":
        return functional.relu(value)
    return functional.relu6(value) if activation == "relu6" else value


def _pad_same(value: Tensor, kernel: tuple[int, int], stride: list[int], fill: float) -> Tensor:
    """Pad NCHW as TensorFlow's SAME does: the odd pixel goes to the bottom and right."""
    pads: list[int] = []
    for size, k, s in ((value.shape[3], kernel[1], stride[1]), (value.shape[2], kernel[0], stride[0])):
        total = max((-(-size // s) - 1) * s + k - size, 0)
        pads += [total // 2, total - total // 2]
    return functional.pad(value, pads, value=fill) if any(pads) else value


def _convolution(step: dict[str, Any], value: Tensor, weight: Tensor, bias: Tensor | None = None) -> Tensor:
    groups = 1
    if step["op"] == "DEPTHWISE_CONV_2D":  # weight [1, kh, kw, C]
        kernel = weight.permute(3, 0, 1, 2)
        groups = value.shape[3]
    else:  # weight [out, kh, kw, in]
        kernel = weight.permute(0, 3, 1, 2)
    planes = value.permute(0, 3, 1, 2)
    if step["padding"] == "same":
        planes = _pad_same(planes, (kernel.shape[2], kernel.shape[3]), step["stride"], 0.0)
    result = functional.conv2d(planes, kernel, bias, stride=step["stride"], groups=groups)
    return _activate(step, result.permute(0, 2, 3, 1))


def _transposed_convolution(step: dict[str, Any], value: Tensor, weight: Tensor, bias: Tensor) -> Tensor:
    """MediaPipe's Convolution2DTransposeBias: 2x2 kernel, stride 2; weight [out, kh, kw, in]."""
    result = functional.conv_transpose2d(value.permute(0, 3, 1, 2), weight.permute(3, 0, 1, 2), bias, stride=2)
    return result.permute(0, 2, 3, 1)


def _max_pool(step: dict[str, Any], value: Tensor) -> Tensor:
    planes = value.permute(0, 3, 1, 2)
    if step["padding"] == "same":
        planes = _pad_same(planes, tuple(step["size"]), step["stride"], float("-inf"))
    return functional.max_pool2d(planes, step["size"], step["stride"]).permute(0, 2, 3, 1)


def _average_pool(step: dict[str, Any], value: Tensor) -> Tensor:
    return functional.avg_pool2d(value.permute(0, 3, 1, 2), step["size"], step["stride"]).permute(0, 2, 3, 1)


def _pad(_: dict[str, Any], value: Tensor, amounts: Tensor) -> Tensor:
    return functional.pad(value, [int(n) for pair in amounts.flip(0) for n in pair])


def _resize(step: dict[str, Any], value: Tensor, size: Tensor) -> Tensor:
    """Bilinear; only the two conventions that torch shares with TensorFlow are accepted."""
    if not (step["align_corners"] or step["half_pixel"]):
        raise FileFormatError("The photo networks ask for an unknown resize convention; install the project again.")
    planes = functional.interpolate(
        value.permute(0, 3, 1, 2), size=size.tolist(), mode="bilinear", align_corners=step["align_corners"]
    )
    return planes.permute(0, 2, 3, 1)


def _prelu(_: dict[str, Any], value: Tensor, slope: Tensor) -> Tensor:
    return functional.prelu(value.permute(0, 3, 1, 2), slope.reshape(-1)).permute(0, 2, 3, 1)


def _slice(step: dict[str, Any], value: Tensor, begin: Tensor, end: Tensor, stride: Tensor) -> Tensor:
    index: list[slice | int] = []
    for axis in range(begin.numel()):
        first, last = int(begin[axis]), int(end[axis])
        if step["shrink_mask"] >> axis & 1:
            index.append(first)
            continue
        start = None if step["begin_mask"] >> axis & 1 else first
        stop = None if step["end_mask"] >> axis & 1 else last
        index.append(slice(start, stop, int(stride[axis])))
    return value[tuple(index)]


def _reduced(function: Callable[..., Tensor]) -> Callable[..., Tensor]:
    return lambda step, value, axes: function(value, dim=axes.reshape(-1).tolist(), keepdim=step["keep"])


_OPERATORS: dict[str, Callable[..., Tensor]] = {
    "CONV_2D": _convolution,
    "DEPTHWISE_CONV_2D": _convolution,
    "Convolution2DTransposeBias": _transposed_convolution,
    "MAX_POOL_2D": _max_pool,
    "AVERAGE_POOL_2D": _average_pool,
    "RESIZE_BILINEAR": _resize,
    "PAD": _pad,
    "PRELU": _prelu,
    "STRIDED_SLICE": _slice,
    "MEAN": _reduced(torch.mean),
    "SUM": _reduced(torch.sum),
    "RELU": lambda _, value: functional.relu(value),
    "HARD_SWISH": lambda _, value: functional.hardswish(value),
    "LOGISTIC": lambda _, value: torch.sigmoid(value),
    "SQRT": lambda _, value: torch.sqrt(value),
    "RSQRT": lambda _, value: torch.rsqrt(value),
    "NEG": lambda _, value: -value,
    "ADD": lambda step, a, b: _activate(step, a + b),
    "SUB": lambda step, a, b: _activate(step, a - b),
    "MUL": lambda step, a, b: _activate(step, a * b),
    "DIV": lambda step, a, b: _activate(step, a / b),
    "SQUARED_DIFFERENCE": lambda _, a, b: (a - b) ** 2,
    "RESHAPE": lambda step, value: value.reshape(step["shape"]),
    "TRANSPOSE": lambda _, value, order: value.permute(order.tolist()),
    "CONCATENATION": lambda step, *values: torch.cat(values, step["axis"]),
}
