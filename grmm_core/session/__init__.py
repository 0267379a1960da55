"""Sessions: open, deform and render avatars, in this process or in a worker process (see `api`).

The map:

``api`` ``values`` ``wearing``  what callers see: the interface, what goes through it, what an avatar wears
``local``  the session in this process; ``opened``: its avatars, ``sources`` ``carrying``: where from
``client`` ``worker``  the session in a process of its own; ``process`` ``codec`` ``arena`` ``holding``: what lies between
``engines``  the library behind the arrays: ``torch_engine`` ``plain_engine``
``evaluator``  from an avatar and controls to mesh and Gaussians, behind ``cache``
``wardrobe``  strands: ``scalp`` ``photo_skin`` ``cap`` lay trained hair flat, ``swinging`` moves them; ``random_hair``
``compose``  one picture: ``stacking`` of channels, ``refining``, ``cover_kernels``, ``passes``
``lit``  a scene's light on skin, ``shading_hair`` on strands, ``mutual_shadows`` of heads; ``furrowed``: wrinkles
``clouds``  splats from elsewhere in the same picture
``exporting`` ``harmonics``  what files of splats and morph targets take
``painter`` ``presenting``  the person on the mesh's UV map, and thumbnails

`create_session` chooses the implementation. Importing this package loads numpy and nothing heavier; torch is loaded by
`TorchEngine` in the process that runs the model, and not at all by `PlainEngine`.
"""

from __future__ import annotations

import importlib.util
import os
import sys
from typing import TYPE_CHECKING, Literal

from ..errors import ConfigError, RuntimeMissingError
from ..splat.types import GaussianArrays
from .api import CancelCheck, Session
from .values import (
    EMPTY_DEPTH,
    FINAL_STRANDS,
    HEAD_TO_BLENDER,
    MAX_LOD,
    PASS_NAMES,
    AvatarInfo,
    CloudArrays,
    Deformation,
    Instance,
    RenderOptions,
    SessionStatus,
)
from .wearing import HairUse

if TYPE_CHECKING:
    from .local import LocalSession

__all__ = [
    "EMPTY_DEPTH",
    "FINAL_STRANDS",
    "HEAD_TO_BLENDER",
    "MAX_LOD",
    "PASS_NAMES",
    "AvatarInfo",
    "CancelCheck",
    "CloudArrays",
    "Deformation",
    "GaussianArrays",
    "HairUse",
    "Instance",
    "RenderOptions",
    "Session",
    "SessionStatus",
    "create_session",
    "has_plain_engine",
    "has_torch",
    "make_local_session",
]

WORKER_PYTHON_VARIABLE = "GRMM_WORKER_PYTHON"
"""Environment variable that names the worker's interpreter where none is given."""


EngineName = Literal["auto", "torch", "plain"]
PLAIN_LIBRARIES = ("numba", "onnxruntime")


def has_torch() -> bool:
    """Return whether this interpreter could import torch; does not import it."""
    return importlib.util.find_spec("torch") is not None


def has_plain_engine() -> bool:
    """Return whether this interpreter could run the model without torch; imports nothing."""
    return all(importlib.util.find_spec(name) is not None for name in PLAIN_LIBRARIES)


def has_engine(engine: EngineName) -> bool:
    """Return whether this interpreter could run an engine."""
    return (engine != "plain" and has_torch()) or (engine != "torch" and has_plain_engine())


def make_local_session(
    weights: str | os.PathLike[str] | None = None,
    device: str = "auto",
    threads: int | None = None,
    head: str | os.PathLike[str] | None = None,
    engine: EngineName = "auto",
) -> LocalSession:
    """Return a session in this process.

    Args:
        weights: As `create_session`.
        device: As `create_session`.
        threads: As `create_session`.
        head: As `create_session`.
        engine: "torch", "plain" (numpy, numba and onnxruntime), or the faster one that is there: torch on graphics cards, which
            only it uses, and plain on the CPU.

    Raises:
        RuntimeMissingError: The engine's libraries are not installed.
        BackendError: The device is not there.
        ConfigError: Unknown engine.
    """
    if engine not in ("auto", "torch", "plain"):
        raise ConfigError(f"There is no engine {engine!r}; use auto, torch or plain.")
    from .local import LocalSession

    if engine == "torch" or (engine == "auto" and _torch_draws(device)):
        if not has_torch():
            raise RuntimeMissingError("Torch is not installed in this Python; install it or use a worker with another Python.")
        from .torch_engine import TorchEngine

        return LocalSession(TorchEngine(weights, device, threads, head))
    missing = [name for name in PLAIN_LIBRARIES if importlib.util.find_spec(name) is None]
    if missing:
        raise RuntimeMissingError(
            f"The model needs torch, or {' and '.join(missing)}, which this Python does not have; install it there or choose "
            "another Python."
        )
    from .plain_engine import PlainEngine

    return LocalSession(PlainEngine(weights, device, threads, head))


def _torch_draws(device: str) -> bool:
    """Whether torch is the engine where nobody chose one: on the CPU it takes half as long again as the plain one."""
    if device not in ("auto", "cpu"):
        return True
    if not has_plain_engine():
        return has_torch()
    from ..compute.devices import has_card

    return device == "auto" and has_torch() and has_card()


def create_session(
    mode: Literal["auto", "local", "worker"] = "auto",
    python: str | os.PathLike[str] | None = None,
    weights: str | os.PathLike[str] | None = None,
    device: str = "auto",
    threads: int | None = None,
    head: str | os.PathLike[str] | None = None,
    engine: EngineName = "auto",
) -> Session:
    """Return a session. It is cheap: the model is loaded by the first call or by `warm_up`.

    Args:
        mode: "local" runs the model in this process, "worker" in another one, "auto" here if that is possible, else there.
        python: Interpreter for the worker; else the environment variable GRMM_WORKER_PYTHON; else this interpreter.
        weights: Name of installed weights or a file, for "default" and `sample`; None for the embedded ones.
        device: "auto", "cpu", "cuda" or "mps"; all but the CPU need torch.
        threads: CPU threads for the model; None leaves it to the libraries.
        head: The user's FLAME file (.pkl, .npz) or another head file, for weights that were trained on that head model.
        engine: As `make_local_session`, of the process that runs the model.

    Raises:
        RuntimeMissingError: The libraries are neither here nor behind `python`.
        ConfigError: Unknown mode or engine.
    """
    if mode not in ("auto", "local", "worker"):
        raise ConfigError(f"There is no session mode {mode!r}; use auto, local or worker.")
    interpreter = os.fspath(python) if python else os.environ.get(WORKER_PYTHON_VARIABLE, "")
    if mode == "local" or (mode == "auto" and has_engine(engine)):
        return make_local_session(weights, device, threads, head, engine)
    if mode == "auto" and not interpreter:
        raise RuntimeMissingError(
            f"Torch is not installed in this Python; choose a Python that has it (or set {WORKER_PYTHON_VARIABLE})."
        )
    from .client import WorkerSession

    return WorkerSession(interpreter or sys.executable, weights, device, threads, head=head, engine=engine)
