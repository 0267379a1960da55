"""Import a recorded performance as keyframes: ARKit JSON, Live Link Face CSV."""

from __future__ import annotations

from pathlib import Path
from typing import ClassVar

import bpy

from ..grmm_blender.performance import ImportOptions, apply_performance
from ..grmm_core.errors import FileAccessError
from ..grmm_core.performance import read_performance
from .common import Result, active_performer, needs_performer, reports_errors

_MAX_WARNINGS = 5


class GRMM_OT_import_performance(bpy.types.Operator):
    """Read a performance and key the active avatar with it."""

    bl_idname = "grmm.import_performance"
    bl_label = "Import Performance"
    bl_description = "Key the active avatar with a recorded performance (ARKit JSON, Live Link Face CSV)"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    filepath: bpy.props.StringProperty(name="File", description="Performance file", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.json;*.csv;*.txt;*.npz", options={"HIDDEN"})
    start: bpy.props.FloatProperty(name="Start Frame", description="Scene frame on which the recording starts", default=1.0)
    keys: bpy.props.EnumProperty(
        name="Keys",
        description="Where keys are set",
        items=(
            ("FRAMES", "Every Frame", "One key on each scene frame; peaks between two frames move to the nearer one"),
            ("REDUCED", "Reduced", "As few keys as the largest error allows, with handles: easy to edit"),
            ("SAMPLES", "Every Sample", "One key for each recorded sample, also between frames"),
        ),
        default="FRAMES",
    )
    max_error: bpy.props.FloatProperty(
        name="Largest Error",
        description="How far reduced keys may deviate from the recording",
        default=0.01,
        min=0.0005,
        max=0.2,
    )
    fps: bpy.props.FloatProperty(
        name="Recorded Rate",
        description="Frames per second of the recording; 0 takes what the file says",
        default=0.0,
        min=0.0,
        max=1000.0,
    )
    gain: bpy.props.FloatProperty(
        name="Gain", description="Factor of the expression weights", default=1.0, min=0.0, max=4.0, soft_max=2.0
    )
    rotation_gain: bpy.props.FloatProperty(
        name="Rotation Gain", description="Factor of head and eye rotations", default=1.0, min=-4.0, max=4.0, soft_min=0.0
    )
    neutral: bpy.props.BoolProperty(
        name="Calibrate Neutral Face",
        description="Find the actor's resting face in the recording and make it the neutral one",
        default=False,
    )
    smoothing: bpy.props.FloatProperty(
        name="Smoothing", description="Remove tracking noise", default=0.0, min=0.0, max=1.0, subtype="FACTOR"
    )
    limit: bpy.props.BoolProperty(name="Limit", description="Keep expression weights within 0 and 1", default=True)
    head: bpy.props.EnumProperty(
        name="Head Rotation",
        description="Which bone takes the recorded rotation of the head",
        items=(
            ("neck", "Neck", "The neck bone: the shoulders stay"),
            ("root", "Root", "The root bone: everything turns"),
            ("NONE", "None", "Leave the head where it is"),
        ),
        default="neck",
    )
    eyes: bpy.props.EnumProperty(
        name="Eyes",
        description="What turns the eyes; recordings often say the same thing twice",
        items=(
            ("AUTO", "Automatic", "The eyeLook shapes where the file has them, else the recorded rotations"),
            ("SHAPES", "eyeLook Shapes", "The eyeLook shapes; lids follow"),
            ("ROTATIONS", "Rotations", "The recorded rotations on the eye bones"),
        ),
        default="AUTO",
    )
    landscape: bpy.props.BoolProperty(
        name="Held in Landscape",
        description="The phone was held sideways while Live Link Face recorded",
        default=False,
    )
    set_range: bpy.props.BoolProperty(
        name="Set Scene Range", description="Let the scene start and end with the performance", default=True
    )

    poll = classmethod(needs_performer)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("start", "set_range", "fps", "keys"):
            layout.prop(self, name)
        row = layout.row()
        row.active = self.keys == "REDUCED"
        row.prop(self, "max_error")
        for name in ("gain", "limit", "neutral", "smoothing", "head", "eyes", "rotation_gain", "landscape"):
            layout.prop(self, name)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Open the file browser, unless a file was dropped."""
        if self.filepath:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Read the file and write the keys."""
        if not self.filepath:
            raise FileAccessError("No performance file is chosen; choose a file.")
        scene = context.scene
        path = bpy.path.abspath(self.filepath)
        performance = read_performance(
            path, fps=self.fps or None, orientation="landscape" if self.landscape else "portrait"
        )
        options = ImportOptions(
            start=self.start,
            fps=scene.render.fps / scene.render.fps_base,
            keys=self.keys,
            max_error=self.max_error,
            gain=self.gain,
            rotation_gain=self.rotation_gain,
            neutral=self.neutral,
            smoothing=self.smoothing,
            limit=self.limit,
            head_joint="" if self.head == "NONE" else self.head,
            eyes=self.eyes,
        )
        written = apply_performance(active_performer(context), performance, options, Path(path).stem)
        if self.set_range:
            scene.frame_start, scene.frame_end = max(round(written.first), 0), max(round(written.last), 0)
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        for sentence in written.warnings[:_MAX_WARNINGS]:
            self.report({"WARNING"}, sentence)
        self.report(
            {"INFO"}, f"Imported frames {written.first:g} to {written.last:g}: {written.curves} curves, {written.keys} keys"
        )
        return {"FINISHED"}


class GRMM_FH_performance(bpy.types.FileHandler):
    """Take performance files that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_performance"
    bl_label = "GRMM Performance"
    bl_import_operator = GRMM_OT_import_performance.bl_idname
    bl_file_extensions = ".json;.csv"

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only where an avatar is active."""
        return context.area is not None and context.area.type == "VIEW_3D" and active_performer(context) is not None


def _menu(self: bpy.types.Menu, context: bpy.types.Context) -> None:
    self.layout.operator(GRMM_OT_import_performance.bl_idname, text="GRMM Performance (.json, .csv)")


CLASSES = (GRMM_OT_import_performance, GRMM_FH_performance)


def register() -> None:
    """Add the menu entry."""
    bpy.types.TOPBAR_MT_file_import.append(_menu)


def unregister() -> None:
    """Remove the menu entry."""
    bpy.types.TOPBAR_MT_file_import.remove(_menu)
