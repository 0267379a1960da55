"""The making of a performance from a recording in a process of its own. Knows no bpy; safe on any thread."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass, replace
from typing import Any, ClassVar, Self

from ...grmm_core.jobs.stages import SPEAK, TRACK, JobStages
from ...grmm_core.video.request import TrackRequest
from ...grmm_core.voice.request import SpeakRequest
from ..command_job import CommandJob, JobStatus

Request = TrackRequest | SpeakRequest


@dataclass(frozen=True)
class RecordingStatus(JobStatus):
    """Where it stands.

    Attributes:
        performance: Path of the file that it wrote.
        heard: Words that were heard in a voice.
    """

    performance: str = ""
    heard: str = ""


class RecordingJob(CommandJob[RecordingStatus]):
    """A running job of one of the kinds below. Make it with `start`.

    Attributes:
        STAGES: What it goes through.
    """

    RESULT = "a performance"
    STAGES: ClassVar[JobStages]

    def __init__(self, process: subprocess.Popen[str]) -> None:
        """Follow a process."""
        super().__init__(process, RecordingStatus())

    @classmethod
    def start(cls, python: str, request: Request) -> Self:
        """Start.

        Args:
            python: Interpreter with the libraries.
            request: What to do; it travels whole as arguments of the command.

        Raises:
            RuntimeMissingError: It cannot be started.
        """
        return cls.launch(python, request.arguments())

    def finished(self, status: RecordingStatus, event: dict[str, Any]) -> RecordingStatus:
        """With the file."""
        if not event.get("performance"):
            raise ValueError("no performance is named")
        return replace(status, performance=str(event["performance"]), heard=str(event.get("heard", "")))


class TrackJob(RecordingJob):
    """The face in a video is followed."""

    COMMAND, LABEL, LESSER, STAGES = "track", "capture", "choose a shorter part of the video", TRACK


class SpeakJob(RecordingJob):
    """A voice is listened to."""

    COMMAND, LABEL, LESSER, STAGES = "speak", "listening", "choose a shorter part of the recording", SPEAK
