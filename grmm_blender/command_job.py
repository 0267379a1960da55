"""A command of `grmm` in a process of its own: start it, follow its events, cancel it.

Blender stays responsive, and a crash or lack of memory there is a message here. The process is `grmm COMMAND --events`, run by
an interpreter that has torch. Knows no bpy; safe on any thread.
"""

from __future__ import annotations

import json
import logging
import subprocess
import threading
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Generic, Literal, Self, TypeVar

from ..grmm_core.errors import RuntimeMissingError
from ..grmm_core.files.access import describe_os_error
from ..grmm_core.jobs.progress import Progress
from ..grmm_core.session.process import NO_WINDOW, core_environment, core_folder, lines_of

_LOG_LINES = 100
_SHOWN_CHARACTERS = 200
_KILL_AFTER = 20.0  # seconds that a cancelled job may take to save its state

_log = logging.getLogger(__name__)

State = Literal["running", "done", "cancelled", "failed"]


@dataclass(frozen=True)
class JobStatus:
    """Where a job stands.

    Attributes:
        state: Whether it runs, and how it ended.
        progress: The newest.
        message: For the user once it has ended: one sentence why otherwise than well, or what was left out.
    """

    state: State = "running"
    progress: Progress = field(default_factory=Progress)
    message: str = ""


Status = TypeVar("Status", bound=JobStatus)


class CommandJob(ABC, Generic[Status]):
    """A running command. Make it with `launch`.

    Attributes:
        COMMAND: Of `grmm`.
        LABEL: What it is, for people: "fit".
        RESULT: What it ends with, with its article: "an avatar".
        LESSER: What to do where it was too much for the machine: "choose the preset fast".
    """

    COMMAND: ClassVar[str]
    LABEL: ClassVar[str]
    RESULT: ClassVar[str]
    LESSER: ClassVar[str]

    def __init__(self, process: subprocess.Popen[str], status: Status) -> None:
        """Follow a process, from a status on."""
        self._process = process
        self._status = status
        self._lock = threading.Lock()
        self._cancelled = False
        self._lines: deque[str] = deque(maxlen=_LOG_LINES)
        self._errors = threading.Thread(target=self._read_log, name=f"grmm-{self.COMMAND}-log", daemon=True)
        self._reader = threading.Thread(target=self._read, name=f"grmm-{self.COMMAND}", daemon=True)
        self._errors.start()
        self._reader.start()

    @classmethod
    def launch(cls, python: str, arguments: Sequence[str], *status: Status) -> Self:
        """Start the command.

        Args:
            python: Interpreter with torch.
            arguments: Of the command.
            status: What else the class is made with.

        Raises:
            RuntimeMissingError: It cannot be started.
        """
        try:
            process = subprocess.Popen(
                [python, "-m", "grmm_core", cls.COMMAND, "--events", *arguments],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8",
                errors="replace", env=core_environment(python), cwd=core_folder(), creationflags=NO_WINDOW,
            )  # fmt: skip
        except OSError as error:
            raise RuntimeMissingError(
                f"The Python {python} cannot be started ({describe_os_error(error)}); choose another in the preferences."
            ) from error
        return cls(process, *status)

    @property
    def status(self) -> Status:
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

    def wait(self, timeout: float | None = None) -> Status:
        """Wait for the end."""
        self._reader.join(timeout)
        return self.status

    def after(self, status: Status, event: dict[str, Any]) -> Status:
        """The status after an event; unknown ones change nothing. An error of Python's for one that makes no sense."""
        kind = event.get("event")
        if kind == "progress":
            progress = Progress.from_json(event)
            return replace(status, progress=replace(progress, fraction=max(status.progress.fraction, progress.fraction)))
        if kind == "done":
            said = event.get("warnings")
            message = " ".join(map(str, said)) if isinstance(said, list) else ""
            progress = replace(status.progress, fraction=1.0, seconds_left=0.0)
            return replace(self.finished(status, event), state="done", progress=progress, message=message)
        if kind == "error":
            return replace(status, state="failed", message=str(event["message"]))
        return status

    @abstractmethod
    def finished(self, status: Status, event: dict[str, Any]) -> Status:
        """The status with what the last event of a job that ended well names. Raises `ValueError` where it names nothing."""

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
                said = status.message or f"The {self.LABEL} was cancelled."
                self._status = replace(status, state="cancelled", message=said)
            elif status.state == "running":
                self._status = replace(status, state="failed", message=self._ending(code))

    def _ending(self, code: int) -> str:
        """What the end of the process means when its last event does not say."""
        last = next((line.strip() for line in reversed(self._lines) if line.strip()), "")
        if self._lines:
            _log.error("the last words of the %s:\n%s", self.LABEL, self.log)
        if "No module named" in last:
            return f"The Python that runs the model lacks a package ({last}); install it."
        if code == 0:
            return f"The {self.LABEL} ended without {self.RESULT} and said nothing; check the Python in the preferences."
        if code < 0 or not last:
            reason = f"ended with code {code}" if code > 0 else "was ended by the system, perhaps for lack of memory"
            return f"The {self.LABEL} {reason}; {self.LESSER}, or see the system console."
        return f"The {self.LABEL} ended with code {code} ({last[:_SHOWN_CHARACTERS]}); see the system console."

    def _apply(self, event: dict[str, Any]) -> None:
        with self._lock:
            try:
                self._status = self.after(self._status, event)
            except (KeyError, TypeError, ValueError):  # not an event of ours; the reader must live on
                _log.warning("the %s wrote an event that makes no sense: %.200r", self.LABEL, event)

    def _read_log(self) -> None:
        for line in lines_of(self._process.stderr):
            self._lines.append(line.rstrip())
            _log.debug("%s %d: %s", self.LABEL, self._process.pid, line.rstrip())
