"""A model out of a weights file, and back into one (`weights_file`)."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import torch
from torch.overrides import TorchFunctionMode

from ..files.packing import unpack
from .grmm import GRMM
from .weights_file import WeightsInfo, read_weights, write_weights

if TYPE_CHECKING:
    from ..head import HeadModel

_INITIALISERS = frozenset({"normal_", "uniform_", "kaiming_normal_", "kaiming_uniform_", "mul"})


def save_weights(path: str | os.PathLike[str], model: GRMM, info: WeightsInfo) -> None:
    """Write a model and its information; head and configuration are taken from the model. Raises as `write_weights`."""
    parameters = {name: value.detach().cpu().numpy() for name, value in model.state_dict().items()}
    write_weights(path, parameters, model.config, model.head_model, info)


def load_weights(path: str | os.PathLike[str], head: HeadModel | None = None) -> tuple[GRMM, WeightsInfo]:
    """Load a model, in evaluation mode on the CPU in float32; arguments and errors as for `read_weights`."""
    file = read_weights(path, head)
    with torch.device("meta"), _Uninitialised():  # only shapes; memory comes with the tensors of the file
        model = GRMM(file.head, file.info.config, file.layout)
    layout = {"texel": file.layout.texel, "face": file.layout.face, "barycentric": file.layout.barycentric}
    arrays = {**file.arrays, **{f"anchor.{name}": array for name, array in layout.items()}}
    arrays |= {name: unpack(*packed) for name, packed in file.packed.items()}
    model.load_state_dict({name: torch.from_numpy(array) for name, array in arrays.items()}, assign=True)
    for parameter in model.parameters():
        parameter.requires_grad_(True)
    return model.eval(), file.info


class _Uninitialised(TorchFunctionMode):
    """Leaves out the arithmetic of initialisation, whose first use on the meta device loads torch's compiler for seconds."""

    def __torch_function__(
        self, func: Callable[..., Any], types: Any, args: tuple[Any, ...] = (), kwargs: Mapping[str, Any] | None = None
    ) -> Any:
        """Return the tensor that would be filled or scaled as it is, and an empty one for a random one."""
        kwargs = kwargs or {}
        if getattr(func, "__name__", "") in _INITIALISERS:
            tensor = args[0] if args else kwargs["tensor"]
            if tensor.is_meta:
                return tensor
        return (torch.empty if func is torch.randn else func)(*args, **kwargs)
