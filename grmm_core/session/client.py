"""`WorkerSession`: the session interface, carried out by a process of its own.

Chosen by `create_session` where this interpreter has no torch (Blender), or where a crash of the model must not end the
program. A worker that dies costs time: another is started, opens the avatars again under their old ids, and does the same
work anew, so that an animation rendered over night goes on. Work over which `TRIES` workers end in a row is given up with a
sentence. Needs numpy only.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging
import os
import threading
import weakref
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

import numpy as np

from .. import errors
from ..compute.memory import resident_memory
from ..controls.frame import Controls
from ..errors import CancelledError, GrmmError, SessionError
from ..geometry.camera import Camera
from ..hair.groom import Groom
from ..splat.types import GaussianArrays
from .api import CancelCheck
from .codec import digest
from .holding import held
from .process import CANCEL_POLL, WorkerDiedError, WorkerProcess
from .sources import SourceKey, source_key
from .values import AvatarInfo, CloudArrays, Deformation, Instance, RenderOptions, SessionStatus, check_render_size
from .wearing import PUT_PREFIX, HairUse

CLOSE_GRACE = 0.5  # seconds that closing waits for another thread's call
CALL_TIMEOUT = 600.0  # seconds; a picture of a film's size on an old machine stays below
PREPARED_BYTES = 1 << 18  # of arrays in a message that announces a picture
TRIES = 3  # workers that may end over the same work before it is given up

Result = TypeVar("Result")

_log = logging.getLogger(__name__)


class WorkerSession:
    """Opens and draws avatars in a worker process. See `api.Session` for the methods."""

    def __init__(
        self,
        python: str,
        weights: str | os.PathLike[str] | None = None,
        device: str = "auto",
        threads: int | None = None,
        timeout: float = CALL_TIMEOUT,
        head: str | os.PathLike[str] | None = None,
        engine: str = "auto",
    ) -> None:
        """Prepare a session; the process starts with the first call or `warm_up`.

        Args:
            python: Executable of an interpreter that has the engine's libraries.
            weights: As `make_local_session`.
            device: As `make_local_session`.
            threads: As `make_local_session`.
            timeout: Seconds that one call may take before the worker counts as hung and is ended.
            head: As `make_local_session`.
            engine: As `make_local_session`.
        """
        self._python = python
        self._settings = {
            "weights": None if weights is None else os.fspath(weights), "device": device, "threads": threads,
            "head": None if head is None else os.fspath(Path(head).absolute()), "engine": engine,
        }  # fmt: skip
        self._timeout = timeout
        self._lock = threading.RLock()
        self._worker: WorkerProcess | None = None
        self._facts: SessionStatus | None = None
        self._starts = 0
        self._closed = False
        self._next_id = 0
        self._sources: dict[int, SourceKey] = {}  # every avatar ever opened here, for a restart
        self._infos: dict[int, AvatarInfo] = {}
        self._clouds: dict[int, tuple[str, str, CloudArrays]] = {}  # name, version, Gaussians; kept for a restart too
        self._stale: set[int] = set()  # clouds that the running worker has in an older version
        self._grooms: dict[str, tuple[str, Groom]] = {}  # by name: version and strands, likewise
        self._worn: dict[str, str] = {}  # by name: the version that the running worker has
        self._remote: dict[int, int] = {}  # our ids to those of the running worker
        self._finalizer: weakref.finalize | None = None
        self._announced: deque[str] = deque(maxlen=2)  # what `prepare` was told of, by its digest

    def open(self, source: str | os.PathLike[str]) -> AvatarInfo:
        """See `Session.open`."""
        return self._open(source_key(source))

    def sample(self, seed: int) -> AvatarInfo:
        """See `Session.sample`."""
        return self._open(SourceKey("sample", str(int(seed))))

    def save(self, avatar_id: int, path: str | os.PathLike[str], hair: HairUse | None = None) -> None:
        """See `Session.save`."""
        absolute = os.path.abspath(path)  # noqa: PTH100 - bytes and str alike
        self._call_for(avatar_id, "save", {"path": absolute, "hair": hair})

    def release(self, avatar_id: int) -> None:
        """See `Session.release`."""
        with self._lock:
            self._sources.pop(avatar_id, None)
            self._infos.pop(avatar_id, None)
            self._clouds.pop(avatar_id, None)
            remote = self._remote.pop(avatar_id, None)
            if remote is not None and self._worker is not None and self._worker.alive:
                with contextlib.suppress(WorkerDiedError):  # the avatar went with it
                    self._call("release", {"avatar_id": remote})

    def put_cloud(self, name: str, version: str, cloud: CloudArrays) -> int:
        """See `Session.put_cloud`. Sent with the first picture that shows it."""
        with self._lock:
            self._check_open()
            number = next((number for number, known in self._clouds.items() if known[0] == name), None)
            if number is None:
                self._next_id += 1
                number = self._next_id
            if number not in self._clouds or self._clouds[number][1] != version:
                self._clouds[number] = (name, version, cloud)
                self._stale.add(number)
            return number

    def put_groom(self, name: str, version: str, groom: Groom) -> str:
        """See `Session.put_groom`. Sent with the first picture that shows it."""
        with self._lock:
            self._check_open()
            if name not in self._grooms or self._grooms[name][0] != version:
                self._grooms[name] = (version, groom)
            return PUT_PREFIX + name

    def deform(self, avatar_id: int, controls: Controls) -> Deformation:
        """See `Session.deform`."""
        return self._call_for(avatar_id, "deform", {"controls": controls.validate()})

    def gaussians(
        self,
        avatar_id: int,
        controls: Controls,
        view_direction: np.ndarray | None = None,
        lod: int = 0,
        features: bool = False,
        hair: HairUse = HairUse(),  # noqa: B008 - frozen
    ) -> GaussianArrays:
        """See `Session.gaussians`."""
        direction = None if view_direction is None else np.asarray(view_direction, np.float64)
        arguments = {
            "controls": controls.validate(),
            "view_direction": direction,
            "lod": lod,
            "features": features,
            "hair": hair,
        }
        return self._call_for(avatar_id, "gaussians", arguments)

    def render(
        self,
        instances: Sequence[Instance],
        camera: Camera,
        options: RenderOptions = RenderOptions(),  # noqa: B008 - frozen
        should_cancel: CancelCheck | None = None,
    ) -> dict[str, np.ndarray]:
        """See `Session.render`."""
        check_render_size(camera)
        valid = [dataclasses.replace(item, controls=item.controls.validate()) for item in instances]

        def draw() -> dict[str, np.ndarray]:
            remote = [dataclasses.replace(item, avatar_id=self._remote_id(item.avatar_id)) for item in valid]
            for item in valid:
                self._send_groom(item.hair)
            asked = {"instances": remote, "camera": camera, "options": options}
            name = digest(asked)[0] if self._announced else ""
            return self._call("render", asked | ({"begun": name} if name in self._announced else {}), should_cancel)

        return self._tried(draw, should_cancel)

    def prepare(self, instances: Sequence[Instance], camera: Camera, options: RenderOptions) -> None:
        """See `Session.prepare`. Without a lock, which another thread's call may hold; what the worker lacks is left to it."""
        worker, valid = self._worker, []
        for item in instances:
            number, groom = self._remote.get(item.avatar_id), item.hair.groom
            if groom.startswith(PUT_PREFIX):
                name = groom.removeprefix(PUT_PREFIX)
                if name not in self._grooms or self._worn.get(name) != self._grooms[name][0]:
                    return
            if number is None or item.avatar_id in self._stale:
                return
            try:
                valid.append(dataclasses.replace(item, avatar_id=number, controls=item.controls.validate()))
            except GrmmError:
                return
        asked = {"instances": valid, "camera": camera, "options": options}
        name, size = digest(asked)
        if worker is not None and size <= PREPARED_BYTES:
            self._announced.append(name)
            worker.tell({"begin": name, "arguments": asked})

    @contextlib.contextmanager
    def at_once(self, seconds: float) -> Iterator[bool]:
        """See `Session.at_once`."""
        with held(self._lock, seconds) as free:
            yield free and self._worker is not None and self._worker.alive and self._facts is not None

    def warm_up(self) -> None:
        """See `Session.warm_up`."""
        if not self._closed:
            threading.Thread(target=self._warm_up, name="grmm-warm-up", daemon=True).start()

    def _warm_up(self) -> None:
        try:
            self._tried(lambda: self._call("warm_up", {}))
        except GrmmError as error:
            # The next call meets the same difficulty and has somebody to tell.
            _log.info("the model worker could not be warmed up: %s", error)

    def status(self) -> SessionStatus:
        """See `Session.status`."""
        worker = self._worker
        restarts = max(self._starts - 1, 0)
        if worker is None or not worker.alive:
            return SessionStatus("worker", alive=False, restarts=restarts, log="" if worker is None else worker.log())
        facts = self._facts or SessionStatus("worker", alive=False, python=worker.hello["python"])
        return dataclasses.replace(
            facts, kind="worker", pid=worker.pid, memory_bytes=resident_memory(worker.pid), restarts=restarts, log=worker.log()
        )

    def close(self) -> None:
        """See `Session.close`. A call that is under way in another thread ends with `SessionError`."""
        self._closed = True
        free = self._lock.acquire(timeout=CLOSE_GRACE)
        try:
            worker = self._worker
            if worker is None:
                return
            if free:
                worker.stop()
                self._worker = None
            else:
                worker.terminate()  # the thread that waits for it notices and cleans up
        finally:
            if free:
                self._lock.release()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None) -> None:
        self.close()

    def _open(self, key: SourceKey) -> AvatarInfo:
        with self._lock:
            self._check_open()
            for avatar_id, known in self._sources.items():
                if known == key:
                    return self._infos[avatar_id]
            info = self._tried(lambda: self._open_remote(key))
            self._next_id += 1
            avatar_id = self._next_id
            self._remote[avatar_id] = info.id
            self._sources[avatar_id] = key
            self._infos[avatar_id] = dataclasses.replace(info, id=avatar_id)
            return self._infos[avatar_id]

    def _open_remote(self, key: SourceKey) -> AvatarInfo:
        return self._call("open", {"source": key.label})

    def _remote_id(self, avatar_id: int) -> int:
        """Return the worker's id of an avatar or a cloud, bringing it there if this worker does not have it."""
        if avatar_id in self._clouds:
            if avatar_id not in self._remote or avatar_id in self._stale:
                name, version, cloud = self._clouds[avatar_id]
                sent = self._call("put_cloud", {"name": name, "version": version, "cloud": cloud})
                self._remote[avatar_id] = sent
                self._stale.discard(avatar_id)
            return self._remote[avatar_id]
        if avatar_id not in self._sources:
            raise SessionError(f"There is no avatar {avatar_id} in this session; open it first.")
        if avatar_id not in self._remote:
            self._remote[avatar_id] = self._open_remote(self._sources[avatar_id]).id
        return self._remote[avatar_id]

    def _send_groom(self, use: HairUse | None) -> None:
        """Bring a groom that was put here to the worker, if this worker does not have it."""
        name = None if use is None or not use.groom.startswith(PUT_PREFIX) else use.groom.removeprefix(PUT_PREFIX)
        if name is not None and name in self._grooms and self._worn.get(name) != self._grooms[name][0]:
            version, groom = self._grooms[name]
            self._call("put_groom", {"name": name, "version": version, "groom": groom})
            self._worn[name] = version

    def _call_for(self, avatar_id: int, operation: str, arguments: dict[str, Any]) -> Any:
        def work() -> Any:
            self._send_groom(arguments.get("hair"))
            return self._call(operation, {"avatar_id": self._remote_id(avatar_id), **arguments})

        return self._tried(work)

    @contextlib.contextmanager
    def _turn(self, should_cancel: CancelCheck | None) -> Iterator[None]:
        """Hold the session once other threads' calls are done; raises `CancelledError` where nobody waits that long."""
        while not self._lock.acquire(timeout=-1.0 if should_cancel is None else CANCEL_POLL):
            if should_cancel is not None and should_cancel():
                raise CancelledError("The picture was cancelled.")
        try:
            yield
        finally:
            self._lock.release()

    def _tried(self, work: Callable[[], Result], should_cancel: CancelCheck | None = None) -> Result:
        """Do one piece of work, again with a fresh worker where one ends over it. It must look up remote ids itself.

        Raises:
            CancelledError: `should_cancel` said so before it was this call's turn.
            SessionError: `TRIES` workers ended.
        """
        with self._turn(should_cancel):
            tries = 1
            while True:
                try:
                    self._ensure_worker()
                    return work()
                except WorkerDiedError as error:
                    if tries == TRIES:
                        raise SessionError(
                            f"The model worker {error.how}, {TRIES} times in a row over the same work; choose a smaller "
                            "picture or close other programs, and try again."
                        ) from error
                    tries += 1

    def _call(self, operation: str, arguments: dict[str, Any], should_cancel: CancelCheck | None = None) -> Any:
        """Ask the worker that `_ensure_worker` gave. None is started here: the ids in `arguments` are those of that worker."""
        with self._lock:
            worker = self._worker
            if worker is None:
                raise SessionError("The session is closed; open a new one.")
            try:
                reply = worker.call(operation, arguments, self._timeout, should_cancel)
                if "error" in reply:
                    raise _as_exception(reply["error"])
                if self._facts is None and operation not in ("status", "release"):
                    self._facts = worker.call("status", {}, self._timeout)["result"]
            except WorkerDiedError:
                _log.warning("the model worker %d ended during %s: %s", worker.pid, operation, worker.last_line())
                raise
            return reply["result"]

    def _ensure_worker(self) -> WorkerProcess:
        """Return a running worker, starting one if there is none or the last one ended."""
        self._check_open()
        if self._worker is not None and self._worker.alive:
            return self._worker
        if self._worker is not None:
            _log.warning("the model worker %d has ended; starting another", self._worker.pid)
            self._worker.kill()
        if self._finalizer is not None:
            self._finalizer.detach()
        self._remote.clear()
        self._worn.clear()
        self._facts = None
        self._starts += 1
        worker = WorkerProcess(self._python, self._settings)
        # A session that is simply dropped must not leave its process behind.
        self._finalizer = weakref.finalize(self, worker.kill)
        self._worker = worker
        return worker

    def _check_open(self) -> None:
        if self._closed:
            raise SessionError("The session is closed; open a new one.")


def _as_exception(description: dict[str, str]) -> GrmmError:
    """Return the typed error that the worker raised."""
    kind = getattr(errors, description["type"], SessionError)
    if not (isinstance(kind, type) and issubclass(kind, GrmmError)):
        kind = SessionError
    return kind(description["message"])
