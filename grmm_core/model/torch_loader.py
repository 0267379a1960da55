"""Trained models as torch modules on a device, for `store.ModelStore`."""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..compute.graphs import Replayed
from ..errors import BackendError
from .grmm import GRMM
from .parameters import mean_map_shapes
from .store import LoadedModel, checked_deltas
from .weights import load_weights
from .weights_file import WeightsInfo

if TYPE_CHECKING:
    from ..head import HeadModel


class TorchLoader:
    """Loads models on a device."""

    def __init__(self, device: torch.device) -> None:
        self._device = device

    def load(self, path: Path, head: HeadModel | None) -> LoadedModel[GRMM]:
        """See `Loader.load`."""
        model, info = load_weights(path, head)
        model.requires_grad_(False)
        try:
            model.to(self._device)
        except RuntimeError as error:  # torch's only type for a device that is broken or full
            reason = first_line(error)
            raise BackendError(f"The device {self._device} cannot hold the model ({reason}); use cpu.") from error
        # For the convolutions of a card that has bfloat16 units; not measured on CPUs, whose path stays in float32.
        model.half_refinement = self._device.type == "cuda" and torch.cuda.is_bf16_supported()
        return _loaded(model, info)

    def with_deltas(self, loaded: LoadedModel[GRMM], deltas: Mapping[str, np.ndarray], path: Path) -> LoadedModel[GRMM]:
        """See `Loader.with_deltas`."""
        return _loaded(with_deltas(loaded.model, deltas, path), loaded.info, loaded)


def _loaded(model: GRMM, info: WeightsInfo, shared: LoadedModel[GRMM] | None = None) -> LoadedModel[GRMM]:
    """A model whose decoders are replayed on a graphics card."""
    decoders = {
        "opacity": Replayed(lambda z_id: (model.opacity(z_id),)),
        "appearance": Replayed(lambda z_id, view: model.appearance(z_id, view)),
        "offsets": Replayed(lambda z_id, z_exp: (model.offsets(z_id, z_exp),)),
        "expression_colors": Replayed(lambda z_id, z_exp: (model.expression_colors(z_id, z_exp),)),
    }
    return LoadedModel(model, info, decoders, shared)


def with_deltas(model: GRMM, deltas: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> GRMM:
    """Return a copy of a model with an avatar's changes added; everything unchanged is shared (eq. 20's result).

    Args:
        model: Of the weights that the avatar was made with; it is returned itself where there are no changes.
        deltas: `Avatar.deltas`.
        path: The avatar's file, for messages.

    Raises:
        FileFormatError: A parameter is unknown or of another shape.
    """
    if not deltas:
        return model
    parameters = dict(model.named_parameters())
    maps = {} if model.config.mean_maps else mean_map_shapes(model.config, model.gaussian_count)
    deltas = checked_deltas(deltas, maps | {name: tuple(value.shape) for name, value in parameters.items()}, path)
    memo: dict[int, object] = {id(value): value for name, value in parameters.items() if name not in deltas}
    memo |= {id(value): value for value in model.buffers()}
    memo[id(model.head_model)] = model.head_model
    changed = copy.deepcopy(model, memo)
    for name in deltas:
        if name in maps:  # the paper's form has no mean maps; an avatar may still bring its own
            empty = torch.zeros(maps[name], dtype=model.dtype, device=model.device)
            setattr(changed.decoders, name.rpartition(".")[2], torch.nn.Parameter(empty, requires_grad=False))
    with torch.no_grad():
        for name, value in changed.named_parameters():
            if name in deltas:
                value.add_(torch.tensor(deltas[name], dtype=value.dtype, device=value.device))
    return changed


def first_line(error: BaseException) -> str:
    """Return the first line of a library's message, without its final full stop."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(".")
