"""Performances from voices: a recording of speech lets the active avatar speak."""

from __future__ import annotations

from typing import ClassVar

import bpy

from ..grmm_blender.declare import Operator, choice, number, text, whole
from ..grmm_blender.recordings.job import SpeakJob
from ..grmm_core.voice.request import ENGLISH, MOST_STRENGTH, OTHER, OUTPUT_SUFFIX, SUFFIXES, SpeakRequest
from .common import Result, menu_entries, reports_errors
from .recordings import ImportsRecordings, TakesRecordings

_OPTIONS = (
    "start", "first", "last", "language", "said", "strength", "liveliness", "seed", "keys", "present", "head",
    "sound", "set_range",
)  # fmt: skip


class GRMM_OT_import_voice(ImportsRecordings, Operator):
    """Let the active avatar speak with a recorded voice of somebody who has agreed."""

    bl_label = "Import Voice"
    bl_options: ClassVar[set[str]] = {"REGISTER"}  # what it writes comes later, as a step of its own

    filepath: text("File", "Recording of one voice", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=";".join(f"*{suffix}" for suffix in SUFFIXES), options={"HIDDEN"})
    language: choice(
        "Language",
        "What is listened for",
        (ENGLISH.upper(), "English", "Words: lips are most exact"),
        (OTHER.upper(), "Other", "Single sounds, the nearest that English has"),
    )
    said: text("Text", "What is said, in English, if you have it: lips get more exact")
    strength: number("Strength", "How far lips and jaw move", default=1.0, min=0.0, max=MOST_STRENGTH)
    liveliness: number("Liveliness", "How far brows, eyes and head move", default=1.0, min=0.0, max=MOST_STRENGTH)
    seed: whole("Seed", "Draws other looks and blinks", min=0)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel."""
        self.layout.use_property_split = True
        for name in _OPTIONS:
            if name != "said" or self.language == ENGLISH.upper():
                self.layout.prop(self, name)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Start to listen; in background wait for it."""
        voice = self.recording()
        language = self.language.lower()
        request = SpeakRequest(
            voice, self.output(voice, OUTPUT_SUFFIX), self.said if language == ENGLISH else "", language, self.strength,
            self.liveliness, self.seed, self.first, self.last or None,
        )  # fmt: skip
        return self.begin(context, SpeakJob, request, None, 0.0)


class GRMM_FH_voice(TakesRecordings, bpy.types.FileHandler):
    """Take sound files that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_voice"
    bl_label = "GRMM Voice"
    bl_import_operator = GRMM_OT_import_voice.bl_idname
    bl_file_extensions = ";".join(SUFFIXES)


CLASSES = (GRMM_OT_import_voice, GRMM_FH_voice)
register, unregister = menu_entries(bpy.types.TOPBAR_MT_file_import, (GRMM_OT_import_voice, "GRMM Performance from Voice"))
