"""Parameter groups, learning-rate schedule and moving average of the weights. Used by `trainer`."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from contextlib import contextmanager

import torch
from torch import Tensor, nn

from ..model.grmm import GRMM
from .config import TrainConfig

_MAP_NAMES = ("_mean", "basis.", "expression.maps")
_OFFSET_NAMES = ("transform_mean", "basis.position", "basis.rotation", "basis.scale")


def parameter_groups(model: GRMM, codes: nn.Parameter, config: TrainConfig) -> list[dict[str, object]]:
    """Split parameters by learning rate: free maps of offsets and of the rest, codes, and all layers."""
    maps: list[nn.Parameter] = []
    offsets: list[nn.Parameter] = []
    networks, code_list = [], [codes]
    for name, parameter in model.named_parameters():
        if name == "aligned_codes":
            code_list.append(parameter)
        elif name.startswith("decoders.") and any(part in name for part in _MAP_NAMES):
            (offsets if any(part in name for part in _OFFSET_NAMES) else maps).append(parameter)
        else:
            networks.append(parameter)
    groups = (
        (networks, config.lr_networks), (maps, config.lr_maps), (code_list, config.lr_codes),
        (offsets, config.lr_offsets or config.lr_maps),
    )  # fmt: skip
    return [{"params": list(group), "lr": rate, "peak": rate} for group, rate in groups if group]


def rate_factor(config: TrainConfig, step: int, progress: float) -> float:
    """Factor of the learning rates: linear growth over `warmup_steps`, times a cosine from 1 to `lr_end`."""
    warm = min(1.0, (step + 1) / max(1, config.warmup_steps))
    cosine = 0.5 * (1.0 + math.cos(math.pi * min(1.0, progress)))
    return warm * (config.lr_end + (1.0 - config.lr_end) * cosine)


class MovingAverage:
    """Exponential moving average of parameters.

    Args:
        parameters: Averaged parameters; the order identifies them.
        decay: Decay a step; the early average follows faster, so that the start is forgotten.
        every: Steps between updates.
    """

    def __init__(self, parameters: Iterable[Tensor], decay: float, every: int) -> None:
        self.parameters = list(parameters)
        self.decay = decay
        self.every = every
        self.values = [p.detach().clone() for p in self.parameters]

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Include the parameters after `step` (counted from 1)."""
        if step % self.every:
            return
        # (1 + n) / (10 + n) keeps the average near the parameters during the first few thousand steps
        decay = min(self.decay**self.every, (1.0 + step / self.every) / (10.0 + step / self.every))
        torch._foreach_lerp_(self.values, self.parameters, 1.0 - decay)

    @contextmanager
    def swapped(self) -> Iterator[None]:
        """Context in which the parameters hold their averages."""
        self._swap()
        try:
            yield
        finally:
            self._swap()

    @torch.no_grad()
    def _swap(self) -> None:
        for parameter, value in zip(self.parameters, self.values, strict=True):
            kept = parameter.detach().clone()
            parameter.copy_(value)
            value.copy_(kept)
