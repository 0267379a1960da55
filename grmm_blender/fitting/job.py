"""A fit in a process of its own: start it, follow its events, cancel it.

Blender stays responsive, and a crash or lack of memory there is a message here. The process is `grmm fit --events`, run by an
interpreter that has torch. Knows no bpy; safe on any thread.
"""

from __future__ import annotations

import json
import logging
import math
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

from ...grmm_core.errors import RuntimeMissingError
from ...grmm_core.files.access import describe_os_error
from ...grmm_core.session.process import core_environment, core_folder

STAGE_SHARES: dict[str, tuple[float, float]] = {
    "analyse": (0.0, 0.05), "track": (0.05, 0.20), "codes": (0.20, 0.50), "decoders": (0.50, 1.0),
}  # fmt: skip
"""Where each stage begins and ends on the progress bar."""
_LOG_LINES = 100
_SHOWN_CHARACTERS = 200
_KILL_AFTER = 20.0  # seconds that a cancelled fit may take to save its state

_log = logging.getLogger(__name__)

State = Literal["running", "done", "cancelled", "failed"]


@dataclass(frozen=True)
class FitRequest:
    """What to do.

    Attributes:
        photos: Files of one person.
        output: `.grmm` file to write; None only looks at the photos.
        look: Folder for pictures of what was found; used where `output` is None.
        preset: "fast", "standard" or "high".
        face: Which face, from 1.
        masks: Outlines, one for each photo, or none.
        work: Folder that keeps the state for a resume.
        resume: Go on with the state there.
        weights, device, threads: As in the preferences; empty or 0 for the usual.
    """

    photos: tuple[Path, ...]
    output: Path | None = None
    look: Path | None = None
    preset: str = "standard"
    face: int = 1
    masks: tuple[Path, ...] = ()
    work: Path | None = None
    resume: bool = False
    weights: str = ""
    device: str = "auto"
    threads: int = 0

    def arguments(self) -> list[str]:
        """Arguments of ``grmm``."""
        result = ["fit", "--events", "--face", str(self.face), "--preset", self.preset, "--device", self.device]
        for option, value in (("--output", self.output), ("--look", self.look), ("--work", self.work)):
            result += [option, str(value)] if value is not None else []
        for mask in self.masks:
            result += ["--mask", str(mask)]
        result += ["--resume"] if self.resume else []
        result += ["--weights", self.weights] if self.weights else []
        result += ["--threads", str(self.threads)] if self.threads else []
        return [*result, "--", *(str(photo) for photo in self.photos)]


@dataclass(frozen=True)
class FitStatus:
    """Where a fit stands.

    Attributes:
        state: Whether it runs, and how it ended.
        stage: "analyse", "track", "codes" or "decoders"; "" before the first.
        fraction: 0..1, of everything.
        seconds_left: Estimate, None while unknown.
        preview: Path of the latest picture (photo beside fit), or "".
        faces: Faces found in each photo, by its path.
        found: Pictures of what was found, in the order of the photos.
        avatar: Path of the finished avatar.
        message: One sentence for the user once it has ended otherwise than well.
    """

    state: State = "running"
    stage: str = ""
    fraction: float = 0.0
    seconds_left: float | None = None
    preview: str = ""
    faces: tuple[tuple[str, int], ...] = ()
    found: tuple[str, ...] = ()
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
    def start(python: str, request: FitRequest) -> FitJob:
        """Start a fit.

        Args:
            python: Interpreter with torch.
            request: What to do.

        Raises:
            RuntimeMissingError: It cannot be started.
        """
        options: dict[str, Any] = {"creationflags": subprocess.CREATE_NO_WINDOW} if sys.platform == "win32" else {}
        try:
            process = subprocess.Popen(
                [python, "-m", "grmm_core", *request.arguments()],
                stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, encoding="utf-8",
                errors="replace", env=core_environment(), cwd=core_folder(), **options,
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
        with self._process.stdout as stream:
            for line in stream:
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
                self._status = replace(status, state="cancelled", message="The fit was cancelled; it can be resumed.")
            elif status.state == "running":
                self._status = replace(status, **self._ending(status, code))

    def _ending(self, status: FitStatus, code: int) -> dict[str, Any]:
        """What the end of the process means when its last event does not say."""
        if code == 0 and status.found:  # a look at the photos ends without an event of its own
            return {"state": "done", "fraction": 1.0}
        last = next((line.strip() for line in reversed(self._lines) if line.strip()), "")
        if self._lines:
            _log.error("the fit's last words:\n%s", self.log)
        if "No module named" in last:
            return _failed(f"The Python that runs the model lacks a package ({last}); install it.")
        if code == 0:
            return _failed("The fit ended without an avatar and said nothing; check the Python in the preferences.")
        if code < 0 or not last:
            reason = f"ended with code {code}" if code > 0 else "was ended by the system, perhaps for lack of memory"
            return _failed(f"The fit {reason}; choose the preset fast, or see the system console.")
        return _failed(f"The fit ended with code {code} ({last[:_SHOWN_CHARACTERS]}); see the system console.")

    def _apply(self, event: dict[str, Any]) -> None:
        with self._lock:
            try:
                self._status = _after(self._status, event)
            except (TypeError, ValueError, OverflowError):  # not an event of ours; the reader must live on
                _log.warning("the fit wrote an event that makes no sense: %.200r", event)

    def _read_log(self) -> None:
        with self._process.stderr as stream:
            for line in stream:
                self._lines.append(line.rstrip())
                _log.debug("fit %d: %s", self._process.pid, line.rstrip())


def _failed(message: str) -> dict[str, Any]:
    return {"state": "failed", "message": message}


def _after(status: FitStatus, event: dict[str, Any]) -> FitStatus:
    """The status after an event; unknown events change nothing."""
    kind = event.get("event")
    if kind == "progress":
        begin, end = STAGE_SHARES.get(str(event.get("stage")), (status.fraction, status.fraction))
        fraction = begin + (end - begin) * _number(event.get("fraction") or 0.0)
        left = event.get("seconds_left")
        return replace(
            status, stage=str(event.get("stage", "")), fraction=max(status.fraction, fraction),
            seconds_left=None if left is None else _number(left), preview=str(event.get("preview") or status.preview),
        )  # fmt: skip
    if kind == "faces":
        return replace(status, faces=(*status.faces, (str(event.get("photo")), _count(event.get("boxes")))))
    if kind == "found":
        faces = (*status.faces, (str(event.get("photo")), int(event.get("faces") or 0)))
        return replace(status, faces=faces, found=(*status.found, str(event.get("picture"))))
    if kind == "done":
        if not event.get("avatar"):
            raise ValueError("no avatar is named")
        return replace(status, state="done", fraction=1.0, seconds_left=0.0, avatar=str(event.get("avatar")))
    if kind == "error":
        return replace(status, state="failed", message=str(event.get("message")))
    return status


def _number(value: Any) -> float:
    number = float(value)
    if not math.isfinite(number):
        raise ValueError(f"{number} is no share and no time")
    return number


def _count(boxes: Any) -> int:
    return len(boxes) if isinstance(boxes, Sequence) and not isinstance(boxes, str) else 0
