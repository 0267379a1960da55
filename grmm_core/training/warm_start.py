"""Starting a run from trained networks with other people.

A weights file or a checkpoint of a model of the same sizes (or with fewer basis maps) gives networks, maps and the table of
expression codes; people's identity codes are new, spread around the mean of the old ones, because the people are others. Used
by `trainer`.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..errors import ConfigError
from ..model.weights import load_weights, weights_path
from ..tensorfile import read_tensors
from .checkpoint import read_state

if TYPE_CHECKING:
    from ..model.grmm import GRMM

_CODES = "codes"


@torch.no_grad()
def warm_start(path: str | os.PathLike[str], model: GRMM, codes: Tensor) -> None:
    """Copy what was trained into a new run.

    Args:
        path: Weights file (or the name of one of the package) or checkpoint, whose moving average is taken where it has one.
        model: Its parameters are overwritten.
        codes: New people's random codes, [P, Z]; the mean of the old people's is added.

    Raises:
        FileAccessError, FileFormatError: The file is missing, damaged, or neither kind.
        ConfigError: The model in it has other sizes.
    """
    parameters, mean = _read(path, model)
    for name, parameter in model.named_parameters():
        value = parameters.get(name)
        if value is None or not _fits(name, value, parameter):
            found = "is missing" if value is None else f"has the shape {tuple(value.shape)}"
            raise ConfigError(
                f"{path} does not fit this model: {name} {found}, not {tuple(parameter.shape)}; use its own configuration."
            )
    for name, parameter in model.named_parameters():
        parameter[: len(parameters[name])].copy_(parameters[name])
    if mean.shape == codes.shape[1:]:  # without residuals the codes are not used, and those of a file are shapes
        codes += mean.to(codes)


def _fits(name: str, value: Tensor, parameter: Tensor) -> bool:
    """Whether a trained parameter can be copied; a new model may have more basis maps, of which the last stay random."""
    if ".basis" in f".{name}":
        return value.shape[1:] == parameter.shape[1:] and len(value) <= len(parameter)
    return value.shape == parameter.shape


def _read(path: str | os.PathLike[str], model: GRMM) -> tuple[dict[str, Tensor], Tensor]:
    """Parameters by name and the people's mean code [Z]."""
    named = weights_path(str(path))
    path = named if not Path(path).exists() and named.exists() else path
    tensors, metadata = read_tensors(path)
    if read_state(metadata) is None:
        trained, info = load_weights(path, model.head_model)
        codes = info.z_id if len(info.z_id) else info.default_z_id[None]
        return {name: value.detach() for name, value in trained.named_parameters()}, torch.from_numpy(codes.mean(0))
    found: dict[str, Tensor] = {}
    for kind in ("parameter/", "average/"):  # the average last: it replaces the parameter
        for name, array in tensors.items():
            if name.startswith(kind):
                found[name[len(kind) :]] = torch.from_numpy(np.array(array))
    codes = found.pop(_CODES, torch.zeros(0, 0))
    return found, codes.mean(0) if codes.ndim == 2 and len(codes) else torch.zeros(0)
