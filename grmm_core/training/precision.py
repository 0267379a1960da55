"""Mixed precision: the convolutions of decoders and refinement in bfloat16, everything geometric in float32.

Vertices, Gaussians and the rasteriser need the digits; parameters, gradients and the optimiser stay in float32, so that no loss
scaling is needed. Worth it on graphics cards, and on processors with bfloat16 units only. Used by `trainer`.
"""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor, nn

from ..model.grmm import GRMM

FLOAT32 = "float32"


def use_precision(model: GRMM, precision: str) -> None:
    """Let a model's decoders and refinement network compute in a precision; their results stay float32.

    Args:
        model: Changed in place, only this object and its state of now.
        precision: One of `config.PRECISIONS`.
    """
    if precision == FLOAT32:
        return
    modules: list[nn.Module] = [model.decoders.transform, model.decoders.opacity, model.decoders.appearance]
    if model.refinement is not None:
        modules.append(model.refinement)
    for module in modules:
        module.forward = _lowered(module)


def _lowered(module: nn.Module) -> Any:
    plain = module.forward

    def forward(*args: Any) -> Tensor:
        device = next(module.parameters()).device.type
        with torch.autocast(device, dtype=torch.bfloat16):
            result: Tensor = plain(*args)
        return result.float()

    return forward
