"""The worker as an operating-system process: start it, exchange messages, notice its death, end it.

`client.WorkerSession` builds the session interface on top. Needs numpy only; the child is `worker`, started by its module
name with this package's parent folder on its path, so that it works under whatever name this package was imported
(inside Blender it is part of an extension).
"""

from __future__ import annotations

import contextlib
import importlib.util
import logging
import os
import queue
import subprocess
import sys
import threading
import time
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any, BinaryIO, cast

from ..errors import CancelledError, SessionError
from ..files.access import describe_os_error
from .api import CancelCheck
from .arena import SharedArena
from .codec import receive, send, unpack

START_TIMEOUT = 60.0  # seconds until the interpreter answers; torch is loaded later
CANCEL_GRACE = 0.5  # seconds that a cancelled call may take to confirm before the caller gets control back
EXIT_GRACE = 1.0  # seconds to end by itself before it is killed
CANCEL_POLL = 0.03  # seconds between two questions to `should_cancel`
LOG_LINES = 200
PROTOCOL = 2
WORKER_MODULE = "grmm_core.session.worker"
NO_WINDOW: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)  # `creationflags` that keep Windows from opening a console
LIBRARIES = ("numpy", "numba", "onnxruntime")
# Threads of numpy's matrix products wait by spinning, for a third of what a frame of playback takes; the model's are small.
_ONE_THREAD = {"OPENBLAS_NUM_THREADS": "1"}
_PARENTS_PYTHON = ("PYTHONHOME", "PYTHONSTARTUP", "PYTHONEXECUTABLE", "__PYVENV_LAUNCHER__")

_log = logging.getLogger(__name__)


class WorkerDiedError(SessionError):
    """The worker process ended, or was ended because it hung; another one may do better.

    Attributes:
        how: How it ended, in the words of a sentence about the worker.
        killed: By another process or the system, and not by itself.
    """

    def __init__(self, how: str, killed: bool = True) -> None:
        super().__init__(f"The model worker {how}; try again.")
        self.how, self.killed = how, killed


class WorkerProcess:
    """A running worker. Not thread-safe: the session's lock lets one call through at a time.

    Attributes:
        pid: Process id.
        hello: What the worker said about itself at the start (its Python version).
    """

    def __init__(self, python: str, settings: dict[str, Any]) -> None:
        """Start an interpreter and wait until it answers.

        Args:
            python: Its executable.
            settings: Arguments of `make_local_session` there, as JSON values.

        Raises:
            WorkerDiedError: It was killed meanwhile.
            SessionError: It cannot be started or does not answer; the message says which Python and why.
        """
        self._arena = SharedArena()
        self._replies: queue.Queue[dict[str, Any] | SessionError | None] = queue.Queue()
        self._lines: deque[str] = deque(maxlen=LOG_LINES)
        self._next_id = 0
        self._abandoned: int | None = None
        self._sending = threading.Lock()
        try:
            self._process = _launch(python, self._arena)
        except OSError as error:
            self._arena.close()
            raise SessionError(
                f"The model worker's Python {python} cannot be started ({describe_os_error(error)}); choose another one."
            ) from error
        self.pid = self._process.pid
        # All three are pipes, see `_launch`.
        self._input, self._output = cast(BinaryIO, self._process.stdin), cast(BinaryIO, self._process.stdout)
        self._errors = cast(BinaryIO, self._process.stderr)
        threading.Thread(target=self._read_replies, name="grmm-worker-replies", daemon=True).start()
        self._log_reader = threading.Thread(target=self._read_log, name="grmm-worker-log", daemon=True)
        self._log_reader.start()
        try:
            self.hello = self._start(python, settings)
        except BaseException:
            self.kill()
            raise

    def _start(self, python: str, settings: dict[str, Any]) -> dict[str, Any]:
        try:
            self._send({"start": settings, "arena": self._arena.spec()}, with_arena=False)
            hello = self._wait(time.monotonic() + START_TIMEOUT)
        except WorkerDiedError as error:
            if error.killed:
                raise
            reason = self.last_line() or "no message"
            raise SessionError(f"The model worker did not start with {python}: {reason}; choose another Python.") from error
        if hello is None:
            raise SessionError(f"The model worker did not answer within {START_TIMEOUT:.0f} seconds; choose another Python.")
        if hello.get("protocol") != PROTOCOL:
            raise SessionError(f"{python} runs another version of the model worker; install this version there.")
        return hello

    @property
    def alive(self) -> bool:
        """Whether the process still runs."""
        return self._process.poll() is None

    def log(self) -> str:
        """Return the last lines that the worker wrote to stderr."""
        return "\n".join(self._lines)

    def last_line(self) -> str:
        """Return the last line with text that the worker wrote to stderr."""
        self._log_reader.join(0.5 if not self.alive else 0.0)
        return next((line.strip() for line in reversed(self._lines) if line.strip()), "")

    def call(self, operation: str, arguments: dict[str, Any], timeout: float, should_cancel: CancelCheck | None = None) -> Any:
        """Carry out one operation and return its result, arrays and dataclasses included.

        Returns:
            The reply: {"result": ...} or {"error": {...}}.

        Raises:
            WorkerDiedError: The process ended, or the time ran out and it has been killed.
            CancelledError: `should_cancel` returned True.
        """
        deadline = time.monotonic() + timeout
        self._finish_abandoned(deadline, should_cancel)
        self._next_id += 1
        request = self._next_id
        self._send({"id": request, "call": operation, "arguments": arguments})
        while True:
            if should_cancel is not None and should_cancel():
                self._cancel(request)
            pause = deadline if should_cancel is None else min(deadline, time.monotonic() + CANCEL_POLL)
            reply = self._wait(pause)
            if reply is not None and reply.get("id") == request:
                return unpack(reply, self._arena)
            if time.monotonic() >= deadline:
                self.kill()
                raise WorkerDiedError(f"took longer than {timeout:.0f} seconds and was stopped")

    def _cancel(self, request: int) -> None:
        """Ask the worker to stop, give it a moment, and return to the caller by `CancelledError` in any case."""
        self._send({"cancel": request}, with_arena=False)
        reply = self._wait(time.monotonic() + CANCEL_GRACE)
        if reply is None:
            self._abandoned = request
        raise CancelledError("The picture was cancelled.")

    def _finish_abandoned(self, deadline: float, should_cancel: CancelCheck | None) -> None:
        """Wait for the late end of a cancelled call, because the arena is in its hands until then."""
        while self._abandoned is not None:
            if should_cancel is not None and should_cancel():
                raise CancelledError("The picture was cancelled.")
            reply = self._wait(deadline if should_cancel is None else min(deadline, time.monotonic() + CANCEL_POLL))
            if reply is None:
                if time.monotonic() < deadline:
                    continue
                self.kill()
                raise WorkerDiedError("did not stop its cancelled work and was ended")
            if reply.get("id") == self._abandoned:
                self._abandoned = None

    def tell(self, message: dict[str, Any]) -> None:
        """Send what has no reply, from any thread, also during a call; that the process has ended shows at the next call."""
        with contextlib.suppress(OSError, ValueError), self._sending:
            send(self._input, message)

    def _send(self, message: dict[str, Any], with_arena: bool = True) -> None:
        try:
            with self._sending:
                send(self._input, message, self._arena if with_arena else None)
        except (OSError, ValueError) as error:
            raise self._death() from error

    def _wait(self, until: float) -> dict[str, Any] | None:
        """Return the next message, or None when the time is over."""
        try:
            reply = self._replies.get(timeout=max(until - time.monotonic(), 0.0))
        except queue.Empty:
            return None
        if reply is None:
            raise self._death()
        if isinstance(reply, SessionError):
            self.kill()
            raise reply
        return reply

    def _death(self) -> WorkerDiedError:
        """Describe how the process ended."""
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(EXIT_GRACE)
        code = self._process.returncode
        self.kill()
        if code is not None and code < 0:
            return WorkerDiedError(f"was ended by signal {-code} (out of memory is the usual reason)")
        return WorkerDiedError(f"ended with code {code}", killed=False)

    def stop(self) -> None:
        """End the process: it leaves when its input closes, and is killed if it does not."""
        with contextlib.suppress(OSError, ValueError):
            self._input.close()
        with contextlib.suppress(subprocess.TimeoutExpired):
            self._process.wait(EXIT_GRACE)
        self.kill()

    def terminate(self) -> None:
        """End the process at once and leave the rest to the thread that waits for its reply."""
        if self._process.poll() is None:
            self._process.kill()

    def kill(self) -> None:
        """End the process at once and free what it used; harmless when done twice."""
        if self._process.poll() is None:
            self._process.kill()
            self._process.wait()
        with contextlib.suppress(OSError, ValueError):
            self._input.close()
        self._arena.close()

    def _read_replies(self) -> None:
        with self._output as stream:
            while True:
                try:
                    message = receive(stream)
                except SessionError as error:
                    self._replies.put(error)
                    return
                except (OSError, ValueError):
                    message = None
                self._replies.put(message)
                if message is None:
                    return

    def _read_log(self) -> None:
        with self._errors as stream:
            for line in stream:
                text = line.decode("utf-8", "replace").rstrip()
                self._lines.append(text)
                _log.debug("worker %d: %s", self.pid, text)


def core_environment(python: str) -> dict[str, str]:
    """Environment in which a Python imports this very package; start it in `core_folder`.

    A parent of another Python version must not lend the child its libraries. Its own Python gets them: Blender keeps those
    of extensions in a folder that only a running Blender has on its path.
    """
    environment = {k: v for k, v in os.environ.items() if k not in _PARENTS_PYTHON}
    folders = [str(core_folder()), *(_library_folders() if Path(python).resolve() == Path(sys.executable).resolve() else [])]
    return environment | {
        "PYTHONPATH": os.pathsep.join(folders), "PYTHONUTF8": "1", "PYTHONUNBUFFERED": "1", "PYTHONNOUSERSITE": "1",
    }  # fmt: skip


def _library_folders() -> list[str]:
    """Folders from which this Python takes the libraries of inference."""
    folders = []
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):  # a finder may refuse a name
            spec = importlib.util.find_spec(name)
            if spec is not None and spec.origin is not None:
                folders.append(str(Path(spec.origin).parents[1]))
    return list(dict.fromkeys(folders))


def lines_of(pipe: IO[str] | None) -> Iterator[str]:
    """Yield what a process writes into a pipe, line by line, and close it at its end."""
    with pipe or contextlib.nullcontext(()) as lines:
        yield from lines


def core_folder() -> Path:
    """Folder from which `python -m grmm_core` works."""
    return Path(__file__).resolve().parents[2]


def _launch(python: str, arena: SharedArena) -> subprocess.Popen[bytes]:
    options: dict[str, Any] = {}
    if sys.platform == "win32":
        options["creationflags"] = NO_WINDOW
    else:
        options["pass_fds"] = (arena.descriptor,)
    return subprocess.Popen(
        [python, "-m", WORKER_MODULE],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        env=_ONE_THREAD | core_environment(python),
        cwd=core_folder(),
        **options,
    )
