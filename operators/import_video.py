"""Performances from videos: a face before a camera keys the active avatar."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import bpy

from ..grmm_blender import session_host
from ..grmm_blender.declare import Operator, choice, flag, number, text
from ..grmm_blender.exporting import performer_of
from ..grmm_blender.fitting.provenance import provenance_sentence
from ..grmm_blender.performance import MAX_FRAME, ImportOptions
from ..grmm_blender.rig.avatar import Avatar, active_object
from ..grmm_blender.splats.rigged import Puppet
from ..grmm_blender.video import watch
from ..grmm_blender.video.job import TrackJob
from ..grmm_core.errors import FileAccessError
from ..grmm_core.video.request import OUTPUT_SUFFIX, SUFFIXES, TrackRequest
from .common import Result, active_performer, menu_entries, polls, reports_errors, require
from .importing import ImportsFiles, KeysHead, over_viewport

_FOLDER = "grmm_videos"
_OPTIONS = ("start", "first", "last", "keys", "smoothing", "neutral", "head", "own_shape", "sound", "set_range")


def _check(context: bpy.types.Context) -> None:
    """There is somebody to act, and nobody else acts."""
    active_performer(context)
    require(not watch.is_running(), "A video is being followed; wait or cancel it")


def _file_from_photos(performer: Avatar | Puppet | None) -> Path | None:
    """File of an avatar that was made from photos; None of others."""
    if not (isinstance(performer, Avatar) and provenance_sentence(performer.source)):
        return None
    return Path(performer.source)


class GRMM_OT_import_video(KeysHead, ImportsFiles, Operator):
    """Key the active avatar with the performance of a face in a video of somebody who has agreed."""

    bl_label = "Import Video"
    bl_options: ClassVar[set[str]] = {"REGISTER"}  # what it writes comes later, as a step of its own

    filepath: text("File", "Video of one face from the front", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
    start: number("Start Frame", "Scene frame on which the video starts", default=1.0, min=-MAX_FRAME, max=MAX_FRAME)
    first: number("From", "First second of the video that is used", min=0.0, unit="TIME_ABSOLUTE")
    last: number("To (0: End)", "Last second that is used; 0 for all", min=0.0, unit="TIME_ABSOLUTE")
    keys: choice(
        "Keys",
        "Where keys are set",
        ("REDUCED", "Reduced", "As few keys as a small error allows, with handles: easy to edit"),
        ("FRAMES", "Every Frame", "One key on each scene frame"),
    )
    smoothing: number(
        "Smoothing", "Remove tracking noise and keep blinks and closed lips", default=0.3, min=0.0, max=1.0, subtype="FACTOR"
    )
    neutral: choice(
        "Neutral Face",
        "What becomes the avatar's neutral face",
        ("AUTO", "Find It", "The actor's face and head in the calmest frames"),
        ("NONE", "As Tracked", "Take nothing off: a head that looks into the camera is straight"),
    )
    own_shape: flag(
        "Same Person", "The avatar was made from photos of the person in the video: its shape is used to follow the face"
    )
    sound: flag("Add Sound", "Put the video's sound into the sequencer", default=True)

    poll = polls(_check)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel; the person's shape only where the avatar has it from photos."""
        self.layout.use_property_split = True
        photographed = _file_from_photos(performer_of(active_object(context))) is not None
        for name in _OPTIONS:
            if photographed or name != "own_shape":
                self.layout.prop(self, name)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Start the capture; in background wait for it."""
        if not self.filepath:
            raise FileAccessError("No video is chosen; choose a file.")
        performer, video = active_performer(context), Path(bpy.path.abspath(self.filepath))
        render, runtime = context.scene.render, session_host.settings()
        folder = Path(bpy.app.tempdir) / _FOLDER
        folder.mkdir(parents=True, exist_ok=True)
        request = TrackRequest(
            video, folder / f"{video.stem}{OUTPUT_SUFFIX}", _file_from_photos(performer) if self.own_shape else None,
            self.first, self.last or None, threads=runtime.threads,
        )  # fmt: skip
        options = ImportOptions(
            start=self.start,
            fps=render.fps / render.fps_base,
            keys=self.keys,
            neutral="auto" if self.neutral == "AUTO" else None,
            smoothing=self.smoothing,
            head_joint=self.head_joint,
        )
        job = TrackJob.start(session_host.job_python(), request)
        watch.start(job, request, performer.object, options, set_range=self.set_range, sound=self.sound)
        if bpy.app.background:
            job.wait()
            self.report({"INFO"}, watch.finish(context))
        return {"FINISHED"}


class GRMM_OT_cancel_video(Operator):
    """Stop following the video; nothing is keyed."""

    bl_label = "Cancel"
    bl_options: ClassVar[set[str]] = {"INTERNAL"}

    poll = polls(lambda _context: require(watch.is_running(), "No video is being followed"))

    def execute(self, context: bpy.types.Context) -> Result:
        """Ask it to end."""
        job = watch.current()
        if job is not None:
            job.cancel()
        return {"FINISHED"}


class GRMM_FH_video(bpy.types.FileHandler):
    """Take videos that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_video"
    bl_label = "GRMM Video"
    bl_import_operator = GRMM_OT_import_video.bl_idname
    bl_file_extensions = ";".join(SUFFIXES)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only where an avatar is active."""
        return over_viewport(context) and performer_of(active_object(context)) is not None


CLASSES = (GRMM_OT_import_video, GRMM_OT_cancel_video, GRMM_FH_video)
register, unregister = menu_entries(bpy.types.TOPBAR_MT_file_import, (GRMM_OT_import_video, "GRMM Performance from Video"))
