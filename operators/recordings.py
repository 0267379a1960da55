"""What imports of recordings share: the job beside Blender, where its keys go, and how it is cancelled."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar, Literal

import bpy

from ..grmm_blender import session_host
from ..grmm_blender.declare import Operator, choice, flag, number
from ..grmm_blender.exporting import performer_of
from ..grmm_blender.performance import MAX_FRAME, ImportOptions
from ..grmm_blender.recordings import watch
from ..grmm_blender.recordings.job import RecordingJob, Request
from ..grmm_blender.rig.avatar import active_object
from ..grmm_core.errors import FileAccessError
from .common import Result, active_performer, polls, reports_errors, require
from .importing import ImportsFiles, KeysHead, over_viewport

_FOLDER = "grmm_recordings"


def _check(context: bpy.types.Context) -> None:
    """There is somebody to act, and nobody else acts."""
    active_performer(context)
    require(not watch.is_running(), "A recording is being worked on; wait or cancel it")


class ImportsRecordings(KeysHead, ImportsFiles):
    """Mixin of operators that key the active head with what a job makes of a recording."""

    start: number("Start Frame", "Scene frame on which the recording starts", default=1.0, min=-MAX_FRAME, max=MAX_FRAME)
    first: number("From", "First second of the recording that is used", min=0.0, unit="TIME_ABSOLUTE")
    last: number("To (0: End)", "Last second that is used; 0 for all", min=0.0, unit="TIME_ABSOLUTE")
    keys: choice(
        "Keys",
        "Where keys are set",
        ("REDUCED", "Reduced", "As few keys as a small error allows, with handles: easy to edit"),
        ("FRAMES", "Every Frame", "One key on each scene frame"),
    )
    sound: flag("Add Sound", "Put the recording's sound into the sequencer, and keep playing in step with it", default=True)

    poll = polls(_check)

    def recording(self) -> Path:
        """The chosen file. Raises `FileAccessError` where none is chosen."""
        if not self.filepath:
            raise FileAccessError("No recording is chosen; choose a file.")
        return Path(bpy.path.abspath(self.filepath))

    def output(self, recording: Path, suffix: str) -> Path:
        """Where the job writes: beside Blender's other temporary files."""
        folder = Path(bpy.app.tempdir) / _FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        return folder / f"{recording.stem}{suffix}"

    def begin(
        self,
        context: bpy.types.Context,
        kind: type[RecordingJob],
        request: Request,
        neutral: Literal["auto"] | None,
        smoothing: float,
    ) -> Result:
        """Start the job; in background wait for it.

        Args:
            context: Blender's.
            kind: Of the job.
            request: What to do.
            neutral: As in `ImportOptions`.
            smoothing: Likewise.
        """
        render = context.scene.render
        options = ImportOptions(
            start=self.start, fps=render.fps / render.fps_base, keys=self.keys, neutral=neutral, smoothing=smoothing,
            head_joint=self.head_joint, present=self.present,
        )  # fmt: skip
        job = kind.start(session_host.job_python(), request)
        target = active_performer(context).object
        watch.start(job, request, target, options, set_range=self.set_range, sound=self.sound, message=self.bl_label)
        if bpy.app.background:
            job.wait()
            self.report({"INFO"}, watch.finish(context))
        return {"FINISHED"}


class TakesRecordings:
    """Mixin of file handlers: recordings that are dropped into a 3D viewport where an avatar is active."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only there."""
        return over_viewport(context) and performer_of(active_object(context)) is not None


class GRMM_OT_cancel_recording(Operator):
    """Stop working on the recording; nothing is keyed."""

    bl_label = "Cancel"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    poll = polls(lambda _context: require(watch.is_running(), "No recording is being worked on"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Ask it to end."""
        job = watch.current()
        if job is not None:
            job.cancel()
        return {"FINISHED"}


CLASSES = (GRMM_OT_cancel_recording,)
