"""The capture of a performance in a process of its own. Knows no bpy; safe on any thread."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass, replace
from typing import Any

from ...grmm_core.video.request import TrackRequest
from ..command_job import CommandJob, JobStatus


@dataclass(frozen=True)
class TrackStatus(JobStatus):
    """Where a capture stands.

    Attributes:
        performance: Path of the file that it wrote.
    """

    performance: str = ""


class TrackJob(CommandJob[TrackStatus]):
    """A running capture. Make it with `start`."""

    COMMAND, LABEL, RESULT, LESSER = "track", "capture", "a performance", "choose a shorter part of the video"

    def __init__(self, process: subprocess.Popen[str]) -> None:
        """Follow a process."""
        super().__init__(process, TrackStatus())

    @classmethod
    def start(cls, python: str, request: TrackRequest) -> TrackJob:
        """Start a capture.

        Args:
            python: Interpreter with torch and PyAV.
            request: What to do; it travels whole as arguments of the command.

        Raises:
            RuntimeMissingError: It cannot be started.
        """
        return cls.launch(python, request.arguments())

    def finished(self, status: TrackStatus, event: dict[str, Any]) -> TrackStatus:
        """With the file."""
        if not event.get("performance"):
            raise ValueError("no performance is named")
        return replace(status, performance=str(event["performance"]))
