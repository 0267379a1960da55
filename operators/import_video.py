"""Performances from videos: a face before a camera keys the active avatar."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import bpy

from ..grmm_blender import session_host
from ..grmm_blender.declare import Operator, choice, flag, number, text
from ..grmm_blender.exporting import performer_of
from ..grmm_blender.fitting.provenance import provenance_sentence
from ..grmm_blender.recordings.job import TrackJob
from ..grmm_blender.rig.avatar import Avatar, active_object
from ..grmm_blender.splats.rigged import Puppet
from ..grmm_core.video.request import OUTPUT_SUFFIX, SUFFIXES, TrackRequest
from .common import Result, active_performer, menu_entries, reports_errors
from .recordings import ImportsRecordings, TakesRecordings

_OPTIONS = (
    "start", "first", "last", "keys", "present", "smoothing", "neutral", "head", "own_shape", "sound", "set_range",
)  # fmt: skip


def _file_from_photos(performer: Avatar | Puppet | None) -> Path | None:
    """File of an avatar that was made from photos; None of others."""
    if not (isinstance(performer, Avatar) and provenance_sentence(performer.source)):
        return None
    return Path(performer.source)


class GRMM_OT_import_video(ImportsRecordings, Operator):
    """Key the active avatar with the performance of a face in a video of somebody who has agreed."""

    bl_label = "Import Video"
    bl_options: ClassVar[set[str]] = {"REGISTER"}  # what it writes comes later, as a step of its own

    filepath: text("File", "Video of one face from the front", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
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
        video = self.recording()
        request = TrackRequest(
            video, self.output(video, OUTPUT_SUFFIX),
            _file_from_photos(active_performer(context)) if self.own_shape else None,
            self.first, self.last or None, threads=session_host.settings().threads,
        )  # fmt: skip
        return self.begin(context, TrackJob, request, "auto" if self.neutral == "AUTO" else None, self.smoothing)


class GRMM_FH_video(TakesRecordings, bpy.types.FileHandler):
    """Take videos that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_video"
    bl_label = "GRMM Video"
    bl_import_operator = GRMM_OT_import_video.bl_idname
    bl_file_extensions = ";".join(SUFFIXES)


CLASSES = (GRMM_OT_import_video, GRMM_FH_video)
register, unregister = menu_entries(bpy.types.TOPBAR_MT_file_import, (GRMM_OT_import_video, "GRMM Performance from Video"))
