"""Adam (Kingma and Ba 2015) without torch's own, whose first use imports torch's compiler: three seconds of a fit.

Steps are those of `torch.optim.Adam`, to the last bit. Training, which takes hours, uses that. Imports torch.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import torch
from torch import Tensor


class Adam:
    """An optimiser.

    Args:
        groups: Of parameters, each with its "params", the rate "lr", and what else its owner keeps there.
        betas: Decay of the mean of gradients and of their squares.
        eps: Added to the root of the latter.

    Attributes:
        param_groups: The groups.
        state: Of each parameter that was moved: "step", "exp_avg" and "exp_avg_sq", as torch names them.
    """

    def __init__(
        self, groups: Iterable[dict[str, Any]], betas: tuple[float, float] = (0.9, 0.999), eps: float = 1e-8
    ) -> None:  # fmt: skip
        self.param_groups = [dict(group) for group in groups]
        self.betas, self.eps = betas, eps
        self.state: dict[Tensor, dict[str, Tensor]] = {}

    def zero_grad(self) -> None:
        """Forget the gradients."""
        for parameter in self._parameters():
            parameter.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """Move each parameter that has a gradient."""
        for group in self.param_groups:
            for parameter in group["params"]:
                if parameter.grad is not None:
                    self._move(parameter, parameter.grad, float(group["lr"]))

    def _move(self, parameter: Tensor, gradient: Tensor, rate: float) -> None:
        if parameter not in self.state:
            zeros = (torch.zeros_like(parameter) for _ in range(2))
            self.state[parameter] = dict(zip(("step", "exp_avg", "exp_avg_sq"), (torch.tensor(0.0), *zeros), strict=True))
        state = self.state[parameter]
        mean, square = state["exp_avg"], state["exp_avg_sq"]
        state["step"] += 1
        step, (first, second) = float(state["step"]), self.betas
        mean.lerp_(gradient, 1.0 - first)
        square.mul_(second).addcmul_(gradient, gradient, value=1.0 - second)
        root = (square.sqrt() / (1.0 - second**step) ** 0.5).add_(self.eps)
        parameter.addcdiv_(mean, root, value=-rate / (1.0 - first**step))

    def _parameters(self) -> Sequence[Tensor]:
        return [parameter for group in self.param_groups for parameter in group["params"]]
