"""Where torch computes and with how many threads. Importing this module is light: the calls import torch."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import BackendError

if TYPE_CHECKING:
    import torch


def choose_device(name: str) -> torch.device:
    """Return a torch device by name; "auto" takes CUDA where it works, else the CPU. Raises `BackendError`."""
    import torch

    if name == "auto":
        return torch.device("cuda" if torch.cuda.is_available() else "cpu")
    available = {"cpu": True, "cuda": torch.cuda.is_available(), "mps": torch.backends.mps.is_available()}
    if not available.get(name, False):
        usable = ", ".join(device for device, there in available.items() if there)
        raise BackendError(f"The device {name!r} is not available here; use auto or one of: {usable}.")
    return torch.device(name)


def has_card() -> bool:
    """Whether torch's device "auto" is a graphics card here; torch is imported only where it was built for one."""
    if "torch" not in sys.modules and not _built_for_cards():
        return False
    return choose_device("auto").type != "cpu"


def _built_for_cards() -> bool:
    """What torch's own record of its build says, without the seconds that importing torch takes."""
    torch = importlib.util.find_spec("torch")
    record = Path(torch.origin).with_name("version.py") if torch is not None and torch.origin else None
    if record is None or not record.is_file():
        return torch is not None
    built = runpy.run_path(str(record))
    return bool(built.get("cuda") or built.get("hip"))


def describe_device(device: torch.device) -> str:
    """Return a device's kind and, for CUDA, its product name."""
    import torch

    return f"cuda ({torch.cuda.get_device_name(device)})" if device.type == "cuda" else device.type


def limit_rasteriser_threads(count: int) -> None:
    """Let the compiled rasteriser use `count` threads, in the whole process; it reads numba's setting."""
    if "numba" in sys.modules:
        sys.modules["numba"].config.NUMBA_NUM_THREADS = count
    else:
        os.environ["NUMBA_NUM_THREADS"] = str(count)


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Run torch on the calling thread alone: a mesh takes less than a millisecond, waking other threads can take many."""
    import torch

    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
