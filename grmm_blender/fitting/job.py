"""A fit in a process of its own: start it, follow its events, cancel it.

Blender stays responsive, and a crash or lack of memory there is a message here. The process is `grmm fit --events`, run by an
interpreter that has torch. Knows no bpy; safe on any thread.
"""

from __future__ import annotations

import json
import logging
import subprocess
import threading
from collections import deque
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from ...grmm_core.errors import RuntimeMissingError
from ...grmm_core.files.access import describe_os_error
from ...grmm_core.fitting.request import FacesRequest, FitRequest
from ...grmm_core.jobs.progress import Progress
from ...grmm_core.session.process import NO_WINDOW, core_environment, core_folder, lines_of

_LOG_LINES = 100
_SHOWN_CHARACTERS = 200
_KILL_AFTER = 20.0  # seconds that a cancelled fit may take to save its state

_log = logging.getLogger(__name__)

State = Literal["running", "done", "cancelled", "failed"]


@dataclass(frozen=True)
class PhotoFaces:
    """What was found in one photo.

    Attributes:
        photo: Its path.
        count: Faces in it.
        picture: File of a picture that shows them, or "".
    """

    photo: str
    count: int
    picture: str = ""


@dataclass(frozen=True)
class FitStatus:
    """Where a fit, or the search for faces before it, stands.

    Attributes:
        state: Whether it runs, and how it ended.
        progress: The newest; its picture is the photo beside the fit.
        faces: What was found in each photo so far, in their order.
        avatar: Path of the finished avatar.
        message: For the user once it has ended: one sentence why otherwise than well, or what of the photos was left out.
    """

    state: State = "running"
    progress: Progress = field(default_factory=Progress)
    faces: tuple[PhotoFaces, ...] = ()
    avatar: str = ""
    message: str = ""


class FitJob:
    """A running fit. Make it with `start`."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        """Follow a process."""
        self._process = process
        self._status = FitStatus()
        self._lock = threading.Lock()
        self._cancelled = False
        self._lines: deque[str] = deque(maxlen=_LOG_LINES)
        self._errors = threading.Thread(target=self._read_log, name="grmm-fit-log", daemon=True)
        self._reader = threading.Thread(target=self._read, name="grmm-fit", daemon=True)
        self._errors.start()
        self._reader.start()

    @staticmethod
    def start(python: str, request: FitRequest | FacesRequest) -> FitJob:
        """Start a fit, or the search for faces.

        Args:
            python: Interpreter with torch.
            request: What to do; it travels whole as arguments of the command.

        Raises:
            RuntimeMissingError: It cannot be started.
        """
        try:
            process = subprocess.Popen(
                [python, "-m", "grmm_core", "fit", "--events", *request.arguments()],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8",
                errors="replace", env=core_environment(python), cwd=core_folder(), creationflags=NO_WINDOW,
            )  # fmt: skip
        except OSError as error:
            raise RuntimeMissingError(
                f"The Python {python} cannot be started ({describe_os_error(error)}); choose another in the preferences."
            ) from error
        return FitJob(process)

    @property
    def status(self) -> FitStatus:
        """Where it stands; cheap."""
        with self._lock:
            return self._status

    @property
    def running(self) -> bool:
        """Whether it has not ended yet."""
        return self.status.state == "running"

    @property
    def log(self) -> str:
        """Last lines that the process wrote, for bug reports."""
        return "\n".join(self._lines)

    def cancel(self) -> None:
        """Ask it to save its state and end; it is killed when it does not in time."""
        if not self.running or self._cancelled:
            return
        self._cancelled = True
        self._process.terminate()
        killer = threading.Timer(_KILL_AFTER, self._process.kill)
        killer.daemon = True
        killer.start()

    def wait(self, timeout: float | None = None) -> FitStatus:
        """Wait for the end."""
        self._reader.join(timeout)
        return self.status

    def _read(self) -> None:
        for line in lines_of(self._process.stdout):
            try:
                event = json.loads(line)
            except ValueError:
                continue  # a library wrote to the standard output
            if isinstance(event, dict):
                self._apply(event)
        code = self._process.wait()
        self._errors.join(1.0)
        with self._lock:
            status = self._status
            if self._cancelled and status.state != "done":
                self._status = replace(status, state="cancelled", message=status.message or "The fit was cancelled.")
            elif status.state == "running":
                self._status = replace(status, state="failed", message=self._ending(code))

    def _ending(self, code: int) -> str:
        """What the end of the process means when its last event does not say."""
        last = next((line.strip() for line in reversed(self._lines) if line.strip()), "")
        if self._lines:
            _log.error("the fit's last words:\n%s", self.log)
        if "No module named" in last:
            return f"The Python that runs the model lacks a package ({last}); install it."
        if code == 0:
            return "The fit ended without an avatar and said nothing; check the Python in the preferences."
        if code < 0 or not last:
            reason = f"ended with code {code}" if code > 0 else "was ended by the system, perhaps for lack of memory"
            return f"The fit {reason}; choose the preset fast, or see the system console."
        return f"The fit ended with code {code} ({last[:_SHOWN_CHARACTERS]}); see the system console."

    def _apply(self, event: dict[str, Any]) -> None:
        with self._lock:
            try:
                self._status = _after(self._status, event)
            except (KeyError, TypeError, ValueError):  # not an event of ours; the reader must live on
                _log.warning("the fit wrote an event that makes no sense: %.200r", event)

    def _read_log(self) -> None:
        for line in lines_of(self._process.stderr):
            self._lines.append(line.rstrip())
            _log.debug("fit %d: %s", self._process.pid, line.rstrip())


def _after(status: FitStatus, event: dict[str, Any]) -> FitStatus:
    """The status after an event; unknown events change nothing."""
    kind = event.get("event")
    if kind == "progress":
        progress = Progress.from_json(event)
        return replace(status, progress=replace(progress, fraction=max(status.progress.fraction, progress.fraction)))
    if kind == "faces":
        boxes = event.get("boxes")
        count = len(boxes) if isinstance(boxes, list) else 0
        return replace(status, faces=(*status.faces, PhotoFaces(str(event["photo"]), count, str(event.get("picture") or ""))))
    if kind == "done":
        if not (event.get("avatar") or event.get("pictures")):
            raise ValueError("neither an avatar nor pictures are named")
        progress = replace(status.progress, fraction=1.0, seconds_left=0.0)
        said = event.get("warnings")
        message = " ".join(map(str, said)) if isinstance(said, list) else ""
        return replace(status, state="done", progress=progress, avatar=str(event.get("avatar") or ""), message=message)
    if kind == "error":
        return replace(status, state="failed", message=str(event["message"]))
    return status
