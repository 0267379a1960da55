"""Import a recorded performance as keyframes: ARKit JSON, Live Link Face CSV, FLAME parameters."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

import bpy

from ..grmm_blender.declare import Operator, choice, flag, number, text
from ..grmm_blender.exporting import performer_of
from ..grmm_blender.performance import MAX_FRAME, ImportedRange, ImportOptions, apply_performance, for_head, parse_frames
from ..grmm_blender.rig.avatar import active_object
from ..grmm_core.errors import FileAccessError
from ..grmm_core.files.format import options_of_formats
from ..grmm_core.formats import format_to_read, formats
from ..grmm_core.head import load_flame
from ..grmm_core.jobs.progress import within
from ..grmm_core.performance import REGIONS
from ..grmm_core.performance.curves import DEFAULT_ANGLE_ERROR
from .common import Result, active_performer, flame_path, menu_entries, polls, reports_errors
from .file_formats import dropped_suffixes, has_options, listed, option_values, read_filter
from .importing import ImportsFiles, KeysHead, over_viewport, pointer_progress

READ = formats("performance", read=True)
_HUNDRED = 100
_READ, _RETARGETED = 0.3, 0.4  # of the progress
_PANELS = {
    "Time": ("start", "offset", "first", "last", "fps", "set_range"),
    "Keys": ("keys", "max_error", "angle_error", "present"),
    "Cleaning": ("neutral", "neutral_frames", "smoothing", "limit", "close_lips"),
    "Strength": ("gain", *(f"gain_{region}" for region in REGIONS), "rotation_gain"),
    "Head and Eyes": ("head", "eyes"),
    "Recording": tuple(option.identifier for option in options_of_formats(READ, "reading")),
    "FLAME": ("flame_file",),
}
_OPEN = ("Time", "Keys", "Cleaning")
_ONLY_FOR = {  # shown where another option has a value
    "max_error": ("keys", "REDUCED"), "angle_error": ("keys", "REDUCED"), "neutral_frames": ("neutral", "FRAMES"),
}  # fmt: skip


def _gain(name: str, description: str) -> Any:
    return number(name, description, default=1.0, min=0.0, max=4.0, soft_max=2.0)


@has_options(READ, "reading")
class GRMM_OT_import_performance(KeysHead, ImportsFiles, Operator):
    """Key the active avatar with a recorded performance (ARKit JSON, Live Link Face CSV, FLAME npz)."""

    bl_label = "Import Performance"

    filepath: text("File", "Performance file", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=read_filter(READ), options={"HIDDEN"})
    start: number("Start Frame", "Scene frame on which the recording starts", default=1.0, min=-MAX_FRAME, max=MAX_FRAME)
    keys: choice(
        "Keys",
        "Where keys are set",
        ("FRAMES", "Every Frame", "One key on each scene frame; peaks between two frames move to the nearer one"),
        ("REDUCED", "Reduced", "As few keys as the largest error allows, with handles: easy to edit"),
        ("SAMPLES", "Every Sample", "One key for each recorded sample, also between frames"),
    )
    max_error: number("Max Error", "How far reduced keys may deviate from the recording", default=0.01, min=0.0005, max=0.2)
    fps: number("Rate (0: File's)", "Frames per second of the recording; 0 takes what the file says", min=0.0, max=1000.0)
    angle_error: number(
        "Angle Error",
        "How far reduced keys of rotations may deviate from the recording",
        default=DEFAULT_ANGLE_ERROR,
        min=0.0005,
        max=0.2,
        subtype="ANGLE",
    )
    offset: number(
        "Time Offset",
        "Seconds by which the recording is moved against the start frame, to bring it in step with sound",
        min=-86_400.0,
        max=86_400.0,
        soft_min=-2.0,
        soft_max=2.0,
        subtype="TIME_ABSOLUTE",
        unit="TIME_ABSOLUTE",
    )
    first: number("From", "First second of the recording that is used", min=0.0, unit="TIME_ABSOLUTE")
    last: number("To (0: End)", "Last second that is used; 0 for all", min=0.0, unit="TIME_ABSOLUTE")
    gain: _gain("Gain", "Factor of all expression weights")
    gain_brows: _gain("Brows", "Further factor of the brows")
    gain_eyelids: _gain("Eyelids", "Further factor of blinks, squints and wide eyes")
    gain_gaze: _gain("Gaze", "Further factor of the eyeLook shapes")
    gain_cheeks: _gain("Cheeks", "Further factor of the cheeks")
    gain_nose: _gain("Nose", "Further factor of the nose")
    gain_jaw: _gain("Jaw", "Further factor of the jaw")
    gain_mouth: _gain("Mouth", "Further factor of the mouth")
    gain_tongue: _gain("Tongue", "Further factor of the tongue")
    rotation_gain: number("Rotation Gain", "Factor of head and eye rotations", default=1.0, min=-4.0, max=4.0, soft_min=0.0)
    neutral: choice(
        "Neutral Face",
        "The actor's resting face, which becomes the avatar's neutral one",
        ("NONE", "As Recorded", "Take nothing off"),
        ("AUTO", "Find It", "Find the calmest frames of the recording"),
        ("FRAMES", "From Frames", "Frames of the recording that you name"),
    )
    neutral_frames: text(
        "Frames", "Frames of the recording in which the actor rests, counted from 0, such as 0, 12-15", default="0"
    )
    smoothing: number("Smoothing", "Remove tracking noise and keep blinks and closed lips", min=0.0, max=1.0, subtype="FACTOR")
    limit: flag("Limit", "Keep expression weights within 0 and 1", default=True)
    close_lips: flag(
        "Keep Lips Closed",
        "Close the avatar's lips wherever the recording closes them, also after calibration, gain and smoothing",
        default=True,
    )
    eyes: choice(
        "Eyes",
        "What turns the eyes; recordings often say the same thing twice",
        ("AUTO", "Automatic", "The eyeLook shapes where the file has them, else the recorded rotations"),
        ("SHAPES", "eyeLook Shapes", "The eyeLook shapes; lids follow"),
        ("ROTATIONS", "Rotations", "The recorded rotations on the eye bones"),
    )
    flame_file: text(
        "FLAME File",
        "Your own FLAME model, which says what the coefficients of a FLAME performance mean on another head",
        subtype="FILE_PATH",
    )

    poll = polls(active_performer)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel, in the groups that Blender's own importers have."""
        self.layout.use_property_split = True
        for title, names in _PANELS.items():
            self._panel(title, names)

    def _panel(self, title: str, names: tuple[str, ...]) -> None:
        header, body = self.layout.panel(f"GRMM_PT_performance_{title}", default_closed=title not in _OPEN)
        header.label(text=title)
        if body is None:
            return
        column = body.column()
        for name in names:
            needed = _ONLY_FOR.get(name)
            if needed is None or getattr(self, needed[0]) == needed[1]:
                column.prop(self, name)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Read the file and write the keys."""
        if not self.filepath:
            raise FileAccessError("No performance file is chosen; choose a file.")
        with pointer_progress(context, _HUNDRED) as show:
            written = self._import(context, Path(bpy.path.abspath(self.filepath)), show)
        scene = context.scene
        if self.set_range:
            written.set_range(scene)
        scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
        self.warn(written.warnings)
        self.report(
            {"INFO"}, f"Imported frames {written.first:g} to {written.last:g}: {written.curves} curves, {written.keys} keys"
        )
        return {"FINISHED"}

    def _import(self, context: bpy.types.Context, path: Path, show: Callable[[int], None]) -> ImportedRange:
        """Read, retarget, clean and key; `show` is told how many hundredths are done."""
        performer = active_performer(context)

        def whole(share: float, message: str = "") -> None:
            show(int(_HUNDRED * share))

        found = format_to_read(path, "performance")
        chosen = option_values(self, found, "reading")
        performance = found.read(path, fps=self.fps or None, progress=within(whole, 0.0, _READ), **chosen)
        on_flame = performer.object.grmm.head_name.startswith("flame")
        flame = None
        if performance.expression is not None and not on_flame:
            named = flame_path(self.flame_file)
            flame = load_flame(named) if named else None
        performance = for_head(performance, on_flame, flame, within(whole, _READ, _RETARGETED))
        return apply_performance(performer, performance, self._options(context), path.stem, within(whole, _RETARGETED, 1.0))

    def _options(self, context: bpy.types.Context) -> ImportOptions:
        render = context.scene.render
        neutral: tuple[int, ...] | Literal["auto"] | None = None
        if self.neutral != "NONE":
            neutral = "auto" if self.neutral == "AUTO" else parse_frames(self.neutral_frames)
        return ImportOptions(
            start=self.start,
            fps=render.fps / render.fps_base,
            keys=self.keys,
            max_error=self.max_error,
            angle_error=self.angle_error,
            gain=self.gain,
            region_gains={region: getattr(self, f"gain_{region}") for region in REGIONS},
            rotation_gain=self.rotation_gain,
            neutral=neutral,
            smoothing=self.smoothing,
            limit=self.limit,
            close_lips=self.close_lips,
            offset=self.offset,
            first=self.first,
            last=self.last or None,
            head_joint=self.head_joint,
            eyes=self.eyes,
            present=self.present,
        )


class GRMM_FH_performance(bpy.types.FileHandler):
    """Take performance files that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_performance"
    bl_label = "GRMM Performance"
    bl_import_operator = GRMM_OT_import_performance.bl_idname
    bl_file_extensions = dropped_suffixes(READ)

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only where an avatar is active."""
        return over_viewport(context) and performer_of(active_object(context)) is not None


CLASSES = (GRMM_OT_import_performance, GRMM_FH_performance)
register, unregister = menu_entries(
    bpy.types.TOPBAR_MT_file_import, (GRMM_OT_import_performance, f"GRMM Performance ({listed(READ)})")
)
