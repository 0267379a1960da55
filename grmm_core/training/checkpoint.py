"""Checkpoints: everything that a run needs to continue as if it had not stopped, in one tensor file.

Written whole or not at all, without pickle. The random choices of a run depend on the step alone (`views.choose`), so that
only torch's own generator is stored beside parameters, optimiser moments and the moving average. Used by `trainer`.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from ..errors import FileFormatError
from ..files.access import TEMPORARY_PATTERN, atomic_write_bytes, read_bytes
from ..files.tensorfile import read_tensors, write_tensors

FORMAT = "grmm-checkpoint"
VERSION = 1
_KEY = "grmm"
_RNG = "rng/torch"


def save_checkpoint(
    path: str | os.PathLike[str],
    parameters: Mapping[str, Tensor],
    optimiser: torch.optim.Optimizer,
    averages: dict[str, Tensor],
    state: dict[str, Any],
) -> None:
    """Write a checkpoint.

    Args:
        path: Target file; replaced only when the new one is complete.
        parameters: By name.
        optimiser: Adam over (some of) these parameters.
        averages: Moving averages by parameter name; may be empty.
        state: JSON values: step, seconds, configuration.

    Raises:
        FileAccessError: The disk is full or the folder not writable; the earlier checkpoint is intact.
    """
    tensors = {f"parameter/{name}": value.detach().cpu().numpy() for name, value in parameters.items()}
    tensors |= {f"average/{name}": value.cpu().numpy() for name, value in averages.items()}
    for name, parameter in parameters.items():
        for key, value in optimiser.state.get(parameter, {}).items():
            tensors[f"adam/{key}/{name}"] = torch.as_tensor(value).detach().cpu().numpy()
    tensors[_RNG] = torch.get_rng_state().numpy()
    header = {"format": FORMAT, "version": VERSION, **state}
    write_tensors(path, tensors, {_KEY: json.dumps(header, sort_keys=True)})


def read_state(metadata: Mapping[str, str]) -> dict[str, Any] | None:
    """Return the state in a tensor file's metadata; None where the file is no checkpoint that this version reads."""
    try:
        state = json.loads(metadata.get(_KEY, ""))
    except ValueError:
        return None
    known = isinstance(state, dict) and state.get("format") == FORMAT and state.get("version") == VERSION
    return state if known else None


def load_checkpoint(
    path: str | os.PathLike[str],
    parameters: Mapping[str, Tensor],
    optimiser: torch.optim.Optimizer,
    averages: dict[str, Tensor],
    check: Callable[[dict[str, Any]], None] | None = None,
) -> dict[str, Any]:
    """Restore parameters, optimiser, averages and random state in place.

    Args:
        path: Checkpoint.
        parameters: By name.
        optimiser: Adam over (some of) these parameters.
        averages: Moving averages by parameter name; may be empty.
        check: Called with the state before anything is changed; may raise.

    Returns:
        The state given to `save_checkpoint`.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Damaged, of another format or version, or of a model of other sizes.
    """
    tensors, metadata = read_tensors(path)
    state = read_state(metadata)
    if state is None:
        raise FileFormatError(f"{path} is not a checkpoint that this version reads; start the training anew in another folder.")
    if check is not None:
        check(state)

    def array(name: str, like: Tensor | None) -> Tensor:
        value = tensors.get(name)
        if value is None or (like is not None and value.shape != tuple(like.shape)):
            raise FileFormatError(f"{path} does not fit this model at {name}; use the run's configuration or another folder.")
        return torch.from_numpy(np.array(value))

    # read everything before changing anything
    restored = {name: array(f"parameter/{name}", p) for name, p in parameters.items()}
    averaged = {name: array(f"average/{name}", p) for name, p in averages.items()}
    moments: dict[str, dict[str, Tensor]] = {name: {} for name in parameters}
    for full in tensors:
        kind, _, rest = full.partition("/")
        key, _, name = rest.partition("/")
        if kind == "adam" and name in parameters:
            moments[name][key] = array(full, None if key == "step" else parameters[name])
    rng = array(_RNG, None)
    with torch.no_grad():
        for name, parameter in parameters.items():
            parameter.copy_(restored[name])
        for name, average in averages.items():
            average.copy_(averaged[name])
    for name, values in moments.items():
        if values:
            device = parameters[name].device
            # a fused Adam counts steps where the parameter is, another one on the CPU
            optimiser.state[parameters[name]] = {
                k: v if k == "step" and not optimiser.defaults.get("fused") else v.to(device) for k, v in values.items()
            }
    torch.set_rng_state(rng)
    return state


def tidy(folder: Path, metrics: str, step: int) -> None:
    """Remove what a killed run left after its last checkpoint: half-written files, and numbers of steps that are done again.

    Args:
        folder: Of the run; no other process writes to it.
        metrics: Name of its file of one JSON object a line.
        step: Steps that the checkpoint holds.

    Raises:
        FileAccessError: The folder is not writable.
    """
    for leftover in folder.glob(TEMPORARY_PATTERN):
        leftover.unlink(missing_ok=True)
    path = folder / metrics
    if not path.exists():
        return
    lines = read_bytes(path).decode("utf-8", "replace").splitlines(keepends=True)
    kept = [line for line in lines if _step_of(line) <= step]
    if len(kept) < len(lines):
        atomic_write_bytes(path, "".join(kept).encode())


def _step_of(line: str) -> float:
    """Step of a line of numbers; infinite for one that was not written to its end."""
    try:
        return float(json.loads(line)["step"]) if line.endswith("\n") else float("inf")
    except (ValueError, KeyError, TypeError):
        return float("inf")
