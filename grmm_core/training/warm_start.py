"""Starting a run from trained networks.

A weights file or a checkpoint of a model of the same sizes (or with fewer basis or expression maps, or none) gives
networks, maps and the table of expression codes. People of the same names keep their identity codes; those of others are new,
spread around the mean of the old ones. Used by `trainer`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor

from ..errors import ConfigError
from ..files.tensorfile import read_metadata, read_tensors
from ..model.weights import load_weights
from ..model.weights_file import read_weights, weights_path
from .checkpoint import read_state

if TYPE_CHECKING:
    from ..head import HeadModel
    from ..model.config import GRMMConfig
    from ..model.grmm import GRMM
    from ..model.layout import TexelLayout

_CODES = "codes"
_DEFAULT = ""  # name of nobody
_EXPRESSION = "decoders.expression."
_MAPS = ("decoders.basis.", "decoders.basis_weights.", _EXPRESSION)


def layout_to_start(path: str | os.PathLike[str], head: HeadModel, config: GRMMConfig) -> TexelLayout | None:
    """The texels of the weights that a new run starts from.

    Where texels are dense depends on the head's form: weights of an earlier form (`HeadModel.continues`) have others than a
    model that is laid out on this one, and their maps mean these.

    Returns:
        None where a model is to be laid out anew: of a checkpoint, another grid or another choice of dense regions.

    Raises:
        FileAccessError, FileFormatError: The file is missing, damaged, or neither kind.
    """
    path = _found(path)
    if read_state(read_metadata(path)) is not None:
        return None
    known = read_weights(path, head)
    same = (known.info.config.grid, known.info.config.focus) == (config.grid, config.focus)
    return known.layout if same else None


@torch.no_grad()
def warm_start(path: str | os.PathLike[str], model: GRMM, people: Sequence[str], codes: Tensor) -> frozenset[str]:
    """Copy what was trained into a new run.

    Args:
        path: Weights file (or the name of one of the package) or checkpoint, whose moving average is taken where it has one.
        model: Its parameters are overwritten.
        people: Names of the run's people.
        codes: Their random codes, [P, Z], overwritten; to those of new people the mean of the old ones is added.

    Returns:
        Names of the people whom the file knows.

    Raises:
        FileAccessError, FileFormatError: The file is missing, damaged, or neither kind.
        ConfigError: The model in it has other sizes.
    """
    parameters, known = _read(path, model)
    for name, parameter in model.named_parameters():
        value = parameters.get(name)
        if not _fits(name, value, parameter):
            found = "is missing" if value is None else f"has the shape {tuple(value.shape)}"
            raise ConfigError(
                f"{path} does not fit this model: {name} {found}, not {tuple(parameter.shape)}; use its own configuration."
            )
    for name, parameter in model.named_parameters():
        if name in parameters:
            parameter[: len(parameters[name])].copy_(parameters[name])
    # without residuals the codes are not used, and those of a file are shapes
    known = {name: code.to(codes) for name, code in known.items() if code.shape == codes.shape[1:]}
    if known:
        mean = torch.stack([*known.values()]).mean(0)
        for row, name in zip(codes, people, strict=True):
            row.copy_(known.get(name, row + mean))
    return frozenset(known) - {_DEFAULT}


def _fits(name: str, value: Tensor | None, parameter: Tensor) -> bool:
    """Whether a parameter can be started: a model may have more maps than the old one."""
    if value is None:
        return name.startswith(_EXPRESSION)
    if name.startswith(_MAPS):
        return value.shape[1:] == parameter.shape[1:] and len(value) <= len(parameter)
    return value.shape == parameter.shape


def _read(path: str | os.PathLike[str], model: GRMM) -> tuple[dict[str, Tensor], dict[str, Tensor]]:
    """Parameters by name, and people's codes [Z] by name."""
    path = _found(path)
    tensors, metadata = read_tensors(path)
    state = read_state(metadata)
    if state is None:
        trained, info = load_weights(path, model.head_model)
        names, codes = (info.people, info.z_id) if len(info.z_id) else ((_DEFAULT,), info.default_z_id[None])
        return {name: value.detach() for name, value in trained.named_parameters()}, _by_name(names, torch.from_numpy(codes))
    found: dict[str, Tensor] = {}
    for kind in ("parameter/", "average/"):  # the average last: it replaces the parameter
        for name, array in tensors.items():
            if name.startswith(kind):
                found[name[len(kind) :]] = torch.from_numpy(np.array(array))
    return found, _by_name(state.get("people", ()), found.pop(_CODES, torch.zeros(0, 0)))


def _found(path: str | os.PathLike[str]) -> str | os.PathLike[str]:
    """The file, or the weights of the package of that name."""
    named = weights_path(str(path))
    return named if not Path(path).exists() and named.exists() else path


def _by_name(names: Sequence[str], codes: Tensor) -> dict[str, Tensor]:
    return dict(zip(names, codes, strict=False))  # a damaged file may name fewer people
