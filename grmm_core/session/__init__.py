"""Sessions: open, deform and render avatars, in this process or in a worker process (see `api`).

`create_session` chooses the implementation. Importing this package loads numpy and nothing heavier; torch is loaded by
`LocalSession` in the process that runs the model.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from typing import Literal

from ..errors import ConfigError, RuntimeMissingError
from .api import (
    EMPTY_DEPTH,
    HEAD_TO_BLENDER,
    MAX_LOD,
    PASS_NAMES,
    AvatarInfo,
    CancelCheck,
    CloudArrays,
    Deformation,
    GaussianArrays,
    Instance,
    RenderOptions,
    Session,
    SessionStatus,
)

__all__ = [
    "EMPTY_DEPTH",
    "HEAD_TO_BLENDER",
    "MAX_LOD",
    "PASS_NAMES",
    "AvatarInfo",
    "CancelCheck",
    "CloudArrays",
    "Deformation",
    "GaussianArrays",
    "Instance",
    "RenderOptions",
    "Session",
    "SessionStatus",
    "create_session",
    "has_torch",
]

WORKER_PYTHON_VARIABLE = "GRMM_WORKER_PYTHON"
"""Environment variable that names the worker's interpreter where none is given."""


def has_torch() -> bool:
    """Return whether this interpreter could import torch; does not import it."""
    return importlib.util.find_spec("torch") is not None


def create_session(
    mode: Literal["auto", "local", "worker"] = "auto",
    python: str | os.PathLike[str] | None = None,
    weights: str | os.PathLike[str] | None = None,
    device: str = "auto",
    threads: int | None = None,
    head: str | os.PathLike[str] | None = None,
) -> Session:
    """Return a session. It is cheap: the model is loaded by the first call or by `warm_up`.

    Args:
        mode: "local" runs the model in this process, "worker" in another one, "auto" here if there is torch, else there.
        python: Interpreter for the worker; else the environment variable GRMM_WORKER_PYTHON; else this interpreter.
        weights: Name of installed weights or a file, for "default" and `sample`; None for the embedded ones.
        device: "auto", "cpu", "cuda" or "mps".
        threads: CPU threads for the model; None leaves it to the libraries.
        head: The user's FLAME file (.pkl, .npz) or another head file, for weights that were trained on that head model.

    Raises:
        RuntimeMissingError: Torch is neither here nor behind `python`.
        ConfigError: Unknown mode.
    """
    if mode not in ("auto", "local", "worker"):
        raise ConfigError(f"There is no session mode {mode!r}; use auto, local or worker.")
    interpreter = os.fspath(python) if python else os.environ.get(WORKER_PYTHON_VARIABLE, "")
    if mode == "local" or (mode == "auto" and has_torch()):
        if not has_torch():
            raise RuntimeMissingError("Torch is not installed in this Python; install it or use a worker with another Python.")
        from .local import LocalSession

        return LocalSession(weights=weights, device=device, threads=threads, head=head)
    if mode == "auto" and not interpreter:
        raise RuntimeMissingError(
            f"Torch is not installed in this Python; choose a Python that has it (or set {WORKER_PYTHON_VARIABLE})."
        )
    from .client import WorkerSession

    return WorkerSession(interpreter or sys.executable, weights=weights, device=device, threads=threads, head=head)
