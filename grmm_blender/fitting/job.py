"""A fit, or the search for faces before it, in a process of its own. Knows no bpy; safe on any thread."""

from __future__ import annotations

import subprocess
from dataclasses import dataclass, replace
from typing import Any

from ...grmm_core.fitting.request import FacesRequest, FitRequest
from ..command_job import CommandJob, JobStatus


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
class FitStatus(JobStatus):
    """Where a fit stands; the progress's picture is the photo beside the fit.

    Attributes:
        faces: What was found in each photo so far, in their order.
        avatar: Path of the finished avatar.
    """

    faces: tuple[PhotoFaces, ...] = ()
    avatar: str = ""


class FitJob(CommandJob[FitStatus]):
    """A running fit. Make it with `start`."""

    COMMAND, LABEL, RESULT, LESSER = "fit", "fit", "an avatar", "choose the preset fast"

    def __init__(self, process: subprocess.Popen[str]) -> None:
        """Follow a process."""
        super().__init__(process, FitStatus())

    @classmethod
    def start(cls, python: str, request: FitRequest | FacesRequest) -> FitJob:
        """Start a fit, or the search for faces.

        Args:
            python: Interpreter with torch.
            request: What to do; it travels whole as arguments of the command.

        Raises:
            RuntimeMissingError: It cannot be started.
        """
        return cls.launch(python, request.arguments())

    def after(self, status: FitStatus, event: dict[str, Any]) -> FitStatus:
        """See the base; a photo whose faces were found is one of the fit's own events."""
        if event.get("event") != "faces":
            return super().after(status, event)
        boxes = event.get("boxes")
        count = len(boxes) if isinstance(boxes, list) else 0
        return replace(status, faces=(*status.faces, PhotoFaces(str(event["photo"]), count, str(event.get("picture") or ""))))

    def finished(self, status: FitStatus, event: dict[str, Any]) -> FitStatus:
        """With the avatar, or the pictures of faces."""
        if not (event.get("avatar") or event.get("pictures")):
            raise ValueError("neither an avatar nor pictures are named")
        return replace(status, avatar=str(event.get("avatar") or ""))
