"""Small networks on a graphics card as CUDA graphs: one launch instead of dozens, whose starts cost more than their arithmetic.

The decoders read a code of a few hundred numbers and always give the same shapes, so that each can be captured once and
replayed. `model.torch_loader` wraps them; on other devices a `Replayed` calls its function as it is. Never run on a graphics
card so far: none was at hand. Where a capture fails, the function is called plainly from then on.
"""

from __future__ import annotations

import logging
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import torch
from torch import Tensor

SHAPES_KEPT = 4  # captured shapes of inputs per function
WARM_UPS = 3  # calls before a capture, in which libraries choose algorithms and make workspaces

_log = logging.getLogger(__name__)

Outputs = tuple[Tensor, ...]
Function = Callable[..., Outputs]
Capture = Callable[[Function, tuple[Tensor, ...]], tuple[Callable[[], None], Outputs]]


def capture_cuda(function: Function, inputs: tuple[Tensor, ...]) -> tuple[Callable[[], None], Outputs]:
    """Capture a function of tensors.

    Args:
        function: Launches work on the current stream; must not read results on the CPU.
        inputs: Tensors that replays will read.

    Returns:
        What replays it, and the tensors that replays write.

    Raises:
        RuntimeError: It does something that cannot be captured.
    """
    side = torch.cuda.Stream()
    side.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(side):
        for _ in range(WARM_UPS):
            function(*inputs)
    torch.cuda.current_stream().wait_stream(side)
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph):
        outputs = function(*inputs)
    return graph.replay, outputs


class Replayed:
    """A function of tensors that is captured when it is first called on a graphics card.

    Args:
        function: Tensors to a tuple of tensors; depends on nothing else that changes.
        capture: How to capture; tests give another one.
        devices: Kinds of device on which to capture.
    """

    def __init__(self, function: Function, capture: Capture = capture_cuda, devices: tuple[str, ...] = ("cuda",)) -> None:
        self._function = function
        self._capture = capture
        self._devices = devices
        self._captured: OrderedDict[Any, tuple[tuple[Tensor, ...], Callable[[], None], Outputs]] = OrderedDict()
        self._refused = False

    def __call__(self, *inputs: Tensor) -> Outputs:
        """Return fresh tensors, as the function itself would."""
        if self._refused or inputs[0].device.type not in self._devices or torch.is_grad_enabled():
            return self._function(*inputs)
        key = tuple((tuple(tensor.shape), tensor.dtype, tensor.device) for tensor in inputs)
        if key not in self._captured:
            own = tuple(tensor.clone() for tensor in inputs)
            try:
                self._captured[key] = (own, *self._capture(self._function, own))
            except RuntimeError as error:  # torch's only type for what cannot be captured
                _log.info("a CUDA graph could not be captured, going on without: %s", error)
                self._refused = True
                return self._function(*inputs)
            while len(self._captured) > SHAPES_KEPT:
                self._captured.popitem(last=False)
        self._captured.move_to_end(key)
        own, replay, outputs = self._captured[key]
        for mine, given in zip(own, inputs, strict=True):
            mine.copy_(given)
        replay()
        return tuple(tensor.clone() for tensor in outputs)
