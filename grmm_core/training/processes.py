"""Several processes that share the views of a step, started by ``torchrun``. Used by `trainer`.

Every process calls these in the same order; with one process they return what they are given.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Mapping, Sequence

import torch
from torch import Tensor


def join(device: str) -> tuple[int, int]:
    """Rank and number of processes; starts torch's process group under ``torchrun``."""
    if "WORLD_SIZE" not in os.environ or int(os.environ["WORLD_SIZE"]) == 1:
        return 0, 1
    if not torch.distributed.is_initialized():
        torch.distributed.init_process_group("nccl" if str(device).startswith("cuda") else "gloo")
    return torch.distributed.get_rank(), torch.distributed.get_world_size()


def add_gradients(parameters: Iterable[Tensor]) -> None:
    """Replace the gradients by their sums over the processes (each is divided by the views of the whole step already)."""
    if not _several():
        return
    parameters = list(parameters)
    gradients = [p.grad if p.grad is not None else torch.zeros_like(p) for p in parameters]
    flat = torch.cat([g.reshape(-1) for g in gradients])
    torch.distributed.all_reduce(flat)
    for parameter, part in zip(parameters, flat.split([g.numel() for g in gradients]), strict=True):
        parameter.grad = part.view_as(parameter).clone()


def mean_terms(views: Sequence[Mapping[str, float]], names: Sequence[str], device: torch.device) -> dict[str, float]:
    """Means of numbers over the views of all processes.

    Args:
        views: Numbers by name of each view of this process; some views may lack some (a picture without depth).
        names: All names that there can be, the same in every process.
        device: That the processes talk through.

    Returns:
        The mean of each name over the views that have it; names that no view has are left out.
    """
    sums = [sum(view[name] for view in views if name in view) for name in names]
    counts = [sum(name in view for view in views) for name in names]
    if _several():
        both = torch.tensor([sums, counts], dtype=torch.float64, device=device)
        torch.distributed.all_reduce(both)
        sums, counts = both.tolist()
    return {name: total / count for name, total, count in zip(names, sums, counts, strict=True) if count}


def anybody(flag: bool, device: torch.device) -> bool:
    """Whether the flag is set in any of the processes."""
    if not _several():
        return flag
    shared = torch.tensor(float(flag), device=device)
    torch.distributed.all_reduce(shared, torch.distributed.ReduceOp.MAX)
    return bool(shared)


def _several() -> bool:
    return torch.distributed.is_available() and torch.distributed.is_initialized() and torch.distributed.get_world_size() > 1
