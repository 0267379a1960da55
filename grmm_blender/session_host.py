"""The one model session of this Blender process.

Everything in Blender that needs the model asks here: the render engine, the viewport, the frame handler and operators, on
whatever thread Blender runs them. The session is made on first use, by `choose_runtime`: a Python of the user's with torch,
torch in this process, or what the extension's own wheels can do in a process of Blender's own Python. Threads never read
preferences from here: `preferences` hands its values over by `configure`.

Imports neither torch nor bpy's data; `grmm_core.session` is light.
"""

from __future__ import annotations

import contextlib
import logging
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from ..grmm_core.controls.frame import Controls
from ..grmm_core.errors import GrmmError, RuntimeMissingError, SessionError
from ..grmm_core.hair import Groom
from ..grmm_core.session import (
    WORKER_PYTHON_VARIABLE,
    AvatarInfo,
    CloudArrays,
    Session,
    SessionStatus,
    create_session,
    has_plain_engine,
    has_torch,
)
from ..grmm_core.session.sources import SAMPLE_PREFIX

_log = logging.getLogger(__name__)

NO_RUNTIME = (
    "This zip of GRMM carries no libraries for drawing; install the one for this platform and Blender, or choose a Python with "
    "torch in the preferences of the extension."
)
NO_TORCH = (
    "Photos, videos and voices need torch, which this Blender does not have; install the runtime, or choose a Python that has "
    "torch, in the preferences of the GRMM extension."
)
_WAIT_SECONDS = 0.5  # that the main thread waits for another one's picture once there is nothing left to compile
FIRST_TIME = "the first time after installing can take a minute"
CLASSES = ()

Mode = Literal["auto", "local", "worker"]


@dataclass(frozen=True)
class RuntimeSettings:
    """How to make the session.

    Attributes:
        mode: "auto" chooses by `choose_runtime`.
        python: Interpreter of the worker, or "" for the environment variable GRMM_WORKER_PYTHON.
        device: "auto", "cpu", "cuda" or "mps".
        threads: CPU threads, 0 leaves it to the libraries.
        weights: File of trained weights for "default" and samples, or "" for the embedded ones.
    """

    mode: Mode = "auto"
    python: str = ""
    device: str = "auto"
    threads: int = 0
    weights: str = ""


@dataclass(frozen=True)
class RuntimeStatus:
    """What can run the model.

    Attributes:
        available: A session exists or could be made.
        message: One sentence for the user: what runs the model, or what is missing and what to do.
        session: Details of the session, None before it was made.
    """

    available: bool
    message: str
    session: SessionStatus | None = None


_lock = threading.Lock()
_settings = RuntimeSettings()
_session: Session | None = None
_last_error = ""
_has_drawn = False
_opened: dict[str, int] = {}  # ids of avatars in the session, by what was opened
_opener: threading.Thread | None = None  # opens an avatar for the main thread
_not_opened: dict[str, GrmmError] = {}  # why it could not, by what was to be opened, until the main thread hears of it
_disabled = False  # between `unregister` and `register`
_giving_clouds = threading.RLock()  # of calls about splat clouds: what one file lets go of is not what the next one takes
_clouds: set[int] = set()  # ids of splat clouds in the session
_KEPT_GROOMS = 4  # of each Curves object: a thread that began with one draws it to the end
_grooms: dict[str, dict[str, int]] = {}  # in the session: by object, the places of its versions, the newest last
changed: list[Callable[..., object]] = []
"""Called on the main thread when sessions are made otherwise from now on: what met an error then tries again."""


def configure(settings: RuntimeSettings, renewed: bool = False) -> None:
    """Use these settings from now on; a session made with others is closed. On the main thread.

    Args:
        settings: How to make the session.
        renewed: What they name is another by now, such as a runtime that was installed again.
    """
    global _settings, _last_error
    with _lock:
        if settings == _settings and not renewed:
            return
        _settings, _last_error = settings, ""
    shutdown()
    for function in changed:
        function()


def settings() -> RuntimeSettings:
    """Return the settings in use."""
    with _lock:
        return _settings


def get_session() -> Session:
    """Return the session, made on the first call. Safe on any thread; never close the result.

    Raises:
        RuntimeMissingError: There is no torch, neither here nor in a worker; the message says what to do.
        GrmmError: The session cannot be made.
    """
    global _session, _last_error
    with _lock:
        if _disabled:
            raise SessionError("The GRMM extension is switched off.")
        if _session is None:
            try:
                mode, python = choose_runtime(_settings)
                _session = create_session(
                    mode,
                    python=python or None,
                    device=_settings.device,
                    threads=_settings.threads or None,
                    weights=_settings.weights or None,
                )
            except RuntimeMissingError as error:
                _last_error = NO_RUNTIME
                raise RuntimeMissingError(NO_RUNTIME) from error
            except GrmmError as error:
                _last_error = str(error)
                raise
            _last_error = ""
        return _session


def choose_runtime(current: RuntimeSettings) -> tuple[Mode, str]:
    """Return where the model runs, and with which interpreter if in a process of its own.

    The user's Python comes first. Torch in this process is a developer's Blender. What the extension carries runs in a process
    of Blender's Python, so that a crash of the model never takes Blender down.
    """
    named = current.python or os.environ.get(WORKER_PYTHON_VARIABLE, "")
    if current.mode == "local" or (current.mode == "auto" and has_torch() and not current.python):
        return "local", ""
    if named:
        return "worker", named
    if not has_plain_engine():
        return current.mode, ""
    return ("worker", sys.executable) if Path(sys.executable).stem.lower().startswith("python") else ("local", "")


def job_python() -> str:
    """Return the interpreter for work on photos, videos and voices, in a process of its own.

    Raises:
        RuntimeMissingError: Torch is neither here nor behind another interpreter.
    """
    current = settings()
    named = current.python or os.environ.get(WORKER_PYTHON_VARIABLE, "")
    if named and (current.mode != "local" or not has_torch()):
        return named
    if not has_torch():
        raise RuntimeMissingError(NO_TORCH)
    return sys.executable


def open_avatar(source: str) -> AvatarInfo:
    """Open what an avatar in a scene names as its source.

    Args:
        source: "default", "sample:SEED", or the absolute path of a `.grmm` file.

    Raises:
        GrmmError: The file or the runtime is missing or unusable.
    """
    session = get_session()
    seed = source.removeprefix(SAMPLE_PREFIX)
    info = session.sample(int(seed)) if source.startswith(SAMPLE_PREFIX) and seed.isdigit() else session.open(source)
    with _lock:
        _opened[source] = info.id
    return info


@contextlib.contextmanager
def answering(source: str, patient: bool = True) -> Iterator[bool]:
    """Tell whether the model answers what the main thread asks about an avatar within the block, without a wait worth noticing.

    Where it does not, because it is being loaded or compiled for another thread's picture, the avatar is opened on a thread
    meanwhile: ask again in a moment. An impatient one does not wait for another thread's picture at all.

    Raises:
        GrmmError: The session cannot be made, or the avatar could not be opened since the last time that this was asked.
    """
    session = get_session()
    problem = _not_opened.pop(source, None)
    if problem is not None:
        raise problem
    worth = patient and _has_drawn and source in _opened  # who is not open yet does not answer, however long the wait
    with session.at_once(_WAIT_SECONDS if worth else 0.0) as free:
        ready = free and source in _opened
        yield ready
    if not ready:
        _open_soon(source)


def _open_soon(source: str) -> None:
    global _opener

    def work() -> None:
        session: Session | None = None
        try:
            session = get_session()
            session.deform(open_avatar(source).id, Controls())  # an avatar that was open before may need a new worker
        except Exception as error:  # noqa: BLE001 - a thread has no caller that would hear of it
            if not isinstance(error, GrmmError):
                _log.error("%s could not be opened.", source, exc_info=error)
            if session is _session:  # else nobody wants it any more
                text = f"The avatar could not be opened ({type(error).__name__}: {error})."
                _not_opened[source] = error if isinstance(error, GrmmError) else SessionError(text)

    with _lock:
        if _opener is None or not _opener.is_alive():
            _opener = threading.Thread(target=work, name="GRMM opening", daemon=True)
            _opener.start()


def known_avatar(source: str) -> int | None:
    """Return the id of an avatar that was opened before, without a call of the session; None where it was not."""
    return _opened.get(source)


def open_cloud(key: str, version: str, arrays: CloudArrays) -> int:
    """Hand a splat cloud to the session, where this version of it is not there already; returns its id for `Instance`."""
    session = get_session()
    with _giving_clouds:
        number = session.put_cloud(key, version, arrays)
        with _lock:
            _clouds.add(number)
    return number


def put_groom(key: str, version: str, groom: Groom) -> str:
    """Hand strands to the session, where this version of them is not there already; returns what `HairUse` names.

    The session replaces what has the same name; so that no thread's strands are replaced while it draws, versions take turns.
    """
    session = get_session()
    with _lock:
        places = _grooms.setdefault(key, {})
        place = places.pop(version, None)
        if place is None:
            place = len(places) if len(places) < _KEPT_GROOMS else places.pop(next(iter(places)))
        places[version] = place
    return session.put_groom(f"{key}.{place}", version, groom)


def release_clouds() -> None:
    """Forget all splat clouds; called when another file is opened, which does not wait for a session that is busy."""
    with _lock:
        current, numbers = _session, set(_clouds)
        _clouds.clear()
    if current is None or not numbers:
        return
    session = current

    def release() -> None:
        with _giving_clouds, contextlib.suppress(GrmmError):  # a session that has ended holds nothing
            for number in numbers:
                if number not in _clouds:  # the new file has another one of that name
                    session.release(number)

    threading.Thread(target=release, name="GRMM clouds", daemon=True).start()


def runtime_status() -> RuntimeStatus:
    """Return what runs the model, for panels; cheap, starts nothing."""
    with _lock:
        session, current, error = _session, _settings, _last_error
    mode, python = choose_runtime(current)
    if python and shutil.which(python) is None:
        return RuntimeStatus(False, f"There is no Python at {python}; choose another in the preferences of the GRMM extension.")
    if session is not None:
        details = session.status()
        where = "in Blender" if details.kind == "local" else "in a worker process"
        return RuntimeStatus(True, f"The model runs {where}.", details)
    if error:
        return RuntimeStatus(False, error)
    if mode == "local" and (has_torch() or has_plain_engine()):
        return RuntimeStatus(True, "The model will run in Blender.")
    if mode != "local" and (python or has_torch()):
        return RuntimeStatus(True, "The model will run in a worker process.")
    return RuntimeStatus(False, NO_RUNTIME)


def loading(text: str) -> str:
    """Return what is being waited for, and until the model has drawn once in this Blender how long it may take."""
    return text if _has_drawn else f"{text}; {FIRST_TIME}"


def has_drawn() -> bool:
    """Whether the model has drawn once in this Blender."""
    return _has_drawn


def note_drawn() -> None:
    """The model has drawn: libraries are loaded, kernels compiled."""
    global _has_drawn
    _has_drawn = True


def memory_megabytes() -> float:
    """Return the resident memory of the process that runs the model, 0 when unknown or not running."""
    with _lock:
        session = _session
    return 0.0 if session is None else session.status().memory_bytes / 2**20


def shutdown() -> None:
    """Close the session; the next use makes a new one."""
    global _session
    with _lock:
        session, _session = _session, None
        _opened.clear()
        _not_opened.clear()
        _clouds.clear()
        _grooms.clear()
    if session is not None:
        session.close()


def register() -> None:
    """Let sessions be made."""
    global _disabled
    _disabled = False


def unregister() -> None:
    """Close the session, and have threads that are still at work make no other: Blender takes their libraries away."""
    global _disabled
    with _lock:
        _disabled = True
    shutdown()
