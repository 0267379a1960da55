"""The other end of a `WorkerSession`: a process that holds a `LocalSession` and answers messages.

Started by `process` as ``python -m grmm_core.session.worker``; not for use by hand. Messages come on stdin and go to what was
stdout; whatever libraries print goes to stderr instead. A thread of its own reads stdin, so that a cancel is heard during a
call and the process ends as soon as its parent closes the pipe or dies.
"""

from __future__ import annotations

import gc
import logging
import os
import platform
import queue
import signal
import sys
import threading
import traceback
from typing import Any, BinaryIO

from ..compute.memory import give_back
from ..errors import GrmmError, RuntimeMissingError, SessionError
from . import make_local_session
from .arena import SharedArena
from .codec import receive, send, unpack
from .process import PROTOCOL

OPERATIONS = frozenset(
    {"open", "sample", "save", "release", "put_cloud", "put_groom", "deform", "gaussians", "render", "warm_up", "status"}
)
_AHEAD: dict[str, Any] = {"id": -1, "call": "draw_ahead", "arguments": {}}  # of our own: the picture that was begun with
_CANCELLABLE = frozenset({"render"})
_SWITCH_SECONDS = 5e-4  # that a thread waits for another one's Python: a frame's threads meet hundreds of times

IDLE_SECONDS = 5.0  # without a call, until freed memory goes back to the system
_SETTLED = 3  # pictures after which whatever is loaded for them is there

_log = logging.getLogger(__name__)


class _Requests:
    """Messages from the parent, read by a thread of their own."""

    def __init__(self, stream: BinaryIO) -> None:
        self._stream = stream
        self.begun: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()  # what is announced
        self._queue: queue.Queue[dict[str, Any]] = queue.Queue()
        self._cancelled = -1
        threading.Thread(target=self._read, name="grmm-requests", daemon=True).start()

    def next(self) -> dict[str, Any]:
        """Wait for the next call; after a while without one, what was freed meanwhile goes back to the system."""
        try:
            return self._queue.get(timeout=IDLE_SECONDS)
        except queue.Empty:
            give_back()
            return self._queue.get()

    @property
    def idle(self) -> bool:
        """Whether no call waits."""
        return self._queue.empty()

    def is_cancelled(self, request: int) -> bool:
        """Whether the parent wants the call `request` to end."""
        return self._cancelled == request

    def _read(self) -> None:
        while True:
            try:
                message = receive(self._stream)
            except (SessionError, OSError, ValueError):
                message = None
            if message is None:
                # The parent is gone, so nobody waits for an orderly end, and a long computation must not outlive it.
                os._exit(0)
            if "cancel" in message:
                self._cancelled = int(message["cancel"])
            elif "begin" in message:
                self.begun.put(message)
            else:
                self._queue.put(message)


def main() -> None:
    """Serve until the parent closes the pipe."""
    logging.basicConfig(level=logging.INFO, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr)
    # Ctrl-C in a terminal reaches the whole group; the parent decides what it means.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    replies = _take_stdout()
    requests = _Requests(sys.stdin.buffer)
    start = requests.next()
    arena = SharedArena.attach(start["arena"])
    send(replies, {"protocol": PROTOCOL, "python": platform.python_version(), "pid": os.getpid()})

    session, failure = _make_session(start["start"])
    sys.setswitchinterval(_SWITCH_SECONDS)
    threading.Thread(target=_begin, args=(session, requests.begun), name="grmm-begin", daemon=True).start()
    pictures = 0
    while True:
        message = unpack(requests.next(), arena)
        if failure is not None:
            reply = {"id": message["id"], "error": _describe(failure)}
        else:
            reply = _answer(session, message, requests)
        try:
            send(replies, reply, arena, turned=message["call"] == "render")
        except SessionError as error:  # no shared memory for this result
            send(replies, {"id": message["id"], "error": _describe(error)}, arena)
        if message["call"] == "render" and failure is None and requests.idle:
            _answer(session, _AHEAD, requests)  # while the parent is busy with this one; what fails, its own call will meet too
        if message["call"] == "render" and pictures < _SETTLED:
            # Libraries and models stay. Looking through all of them for garbage would cost a frame of playback now and then.
            pictures += 1
            gc.collect()
            gc.freeze()


def _begin(session: Any, announced: queue.SimpleQueue[dict[str, Any]]) -> None:
    """Begin with what is announced, on a thread beside the one that answers; of several the last one.

    A defect of ours ends the thread with a traceback in the worker's log, and pictures are made one after the other again.
    """
    while True:
        message = announced.get()
        while not announced.empty():
            message = announced.get()
        try:
            message = unpack(message, None)
            session.begin(message["begin"], **message["arguments"])
        except (GrmmError, MemoryError) as error:
            _log.debug("The next picture could not be begun: %s", error)  # the call itself meets the same error


def _make_session(settings: dict[str, Any]) -> tuple[Any, GrmmError | None]:
    """Return the session, or why there is none: that is the answer to every call."""
    try:
        return make_local_session(**settings), None
    except ModuleNotFoundError as error:
        missing = (error.name or "a module").partition(".")[0]
        return None, RuntimeMissingError(
            f"The Python {sys.executable} has no {missing}; install it there or choose another Python for the model."
        )
    except GrmmError as error:
        return None, error


def _answer(session: Any, message: dict[str, Any], requests: _Requests) -> dict[str, Any]:
    request, operation, arguments = message["id"], message["call"], message["arguments"]
    try:
        if operation not in OPERATIONS and message is not _AHEAD:
            raise SessionError(f"The model worker has no operation {operation!r}; install the same version on both sides.")
        if operation in _CANCELLABLE:
            arguments["should_cancel"] = lambda: requests.is_cancelled(request)
        return {"id": request, "result": getattr(session, operation)(**arguments)}
    except GrmmError as error:
        return {"id": request, "error": _describe(error)}
    except MemoryError:
        return {"id": request, "error": _describe(SessionError("The model ran out of memory; choose a smaller size."))}
    except Exception as error:  # noqa: BLE001 - a defect of ours must reach the caller as a message and not end the worker
        traceback.print_exc()
        text = f"The model worker failed ({type(error).__name__}: {error}); its log has the details."
        return {"id": request, "error": {"type": "SessionError", "message": " ".join(text.split())}}


def _describe(error: GrmmError) -> dict[str, str]:
    return {"type": type(error).__name__, "message": str(error)}


def _take_stdout() -> BinaryIO:
    """Keep stdout for messages and let everybody else's prints go to stderr."""
    private = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    return private


if __name__ == "__main__":
    main()
