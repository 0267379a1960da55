"""The table of rasterisers: what each is called, what it needs, and how it is loaded. A new one is an entry of this table.

Torch, numba and gsplat are imported when a backend is described or loaded, so that this module can be imported without them.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..errors import BackendError

if TYPE_CHECKING:
    from torch import Tensor

    from .rules import View
    from .types import Gaussians, RasterOutput

    Draw = Callable[[Gaussians, View, Tensor | None, bool], RasterOutput[Tensor]]

CUDA_TOLERANCE = 2e-3  # relative, float32 against float32: what `available_backends` accepts of a graphics card


@dataclass(frozen=True)
class BackendInfo:
    """One backend, for `grmm info`.

    Attributes:
        name: "torch", "cpu" ...
        available: Whether it can be used here.
        detail: What it is and how far it was tested, or what is missing.
    """

    name: str
    available: bool
    detail: str


@dataclass(frozen=True)
class Backend:
    """An entry of the table.

    Attributes:
        name: By which callers ask for it.
        load: Import it and return its function: Gaussians (validated), the camera's numbers, background [3], [H, W, 3] or None
            for black, antialiasing -> the picture, differentiable. It obeys `rules.py`.
        describe: Return whether it can be used here, and a line about it; called where torch is installed.
        devices: Kinds of device for whose tensors "auto" takes it, where it is usable.
        needs: Modules besides torch without which it is not usable.
    """

    name: str
    load: Callable[[], Draw]
    describe: Callable[[], tuple[bool, str]]
    devices: tuple[str, ...] = ()
    needs: tuple[str, ...] = ()


_BACKENDS: dict[str, Backend] = {}


def register_backend(backend: Backend) -> None:
    """Put a backend into the table, in the place of one of its name; "auto" prefers those registered earlier."""
    _BACKENDS[backend.name] = backend


def installed(module: str) -> bool:
    """Return whether a module can be imported, without importing it."""
    return importlib.util.find_spec(module) is not None


def find_backend(name: str) -> Backend:
    """Return a backend by name.

    Raises:
        BackendError: There is none of that name.
    """
    if name not in _BACKENDS:
        raise BackendError(f"There is no rasteriser called '{name}'; there are {', '.join(_BACKENDS)} and auto.")
    return _BACKENDS[name]


def choose_backend(device: str) -> str:
    """Return the fastest backend for tensors on a device ("cpu", "cuda", "mps" ...)."""
    for backend in _BACKENDS.values():
        if device in backend.devices and all(map(installed, backend.needs)):
            return backend.name
    return "torch"


def available_backends() -> list[BackendInfo]:
    """Return every backend with its state on this machine.

    Imports no heavy module except torch, for its devices; where there is a CUDA device, it draws a small scene there.
    """
    if not installed("torch"):
        return [BackendInfo(name, False, "torch is not installed") for name in _BACKENDS]
    states = []
    for backend in _BACKENDS.values():
        missing = [module for module in backend.needs if not installed(module)]
        available, detail = (False, f"{' and '.join(missing)} is not installed") if missing else backend.describe()
        states.append(BackendInfo(backend.name, available, detail))
    return states


def _load_torch() -> Draw:
    from .reference import rasterize_reference

    return rasterize_reference


def _load_cpu() -> Draw:
    if not installed("numba"):
        raise BackendError("The CPU rasteriser needs numba: install it, or use the backend 'torch'.")
    from .cpu.engine import rasterize_cpu

    return rasterize_cpu


def _load_cuda() -> Draw:
    from .cuda.adapter import rasterize_cuda

    return rasterize_cuda


def _describe_cuda() -> tuple[bool, str]:
    """Describe the backend "cuda": with a card, what runs and whether it is right here."""
    import torch

    if not torch.cuda.is_available():
        return False, "no CUDA device; gsplat or own kernels, of which only the arithmetic is tested, never the run on a card"
    from .cuda.adapter import check_device, gsplat_usable

    what = "gsplat" if gsplat_usable() else "own kernels, compiled at run time"
    try:
        error = check_device(torch.device("cuda"))
    except BackendError as problem:
        return False, f"{what}: {problem}"
    verdict = "as they should be" if error < CUDA_TOLERANCE else "WRONG: use the device cpu"
    return (
        error < CUDA_TOLERANCE,
        f"{what}; our own tests never ran on a graphics card; checked just now on this one: pictures and gradients within "
        f"{error:.0e} of the reference, {verdict}",
    )


register_backend(Backend("torch", _load_torch, lambda: (True, "readable reference in PyTorch, any device; slow")))
register_backend(
    Backend(
        "cpu", _load_cpu, lambda: (True, "compiled with numba, all cores; tested against the reference"), ("cpu",), ("numba",)
    )
)
register_backend(Backend("cuda", _load_cuda, _describe_cuda, ("cuda",)))
