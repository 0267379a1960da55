"""Export avatars and splat clouds: splat files (one, or one a frame), meshes with morph targets, GaussianAvatars' folders."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper

from ..grmm_blender import exporting
from ..grmm_blender.declare import Operator, choice, flag, text, whole
from ..grmm_blender.exporting import SplatOptions, splat_target
from ..grmm_blender.rig.avatar import Avatar, active_object
from ..grmm_blender.splats.cloud import Cloud
from ..grmm_core.errors import FileAccessError
from ..grmm_core.files.format import Format
from ..grmm_core.formats import SplatCloud, format_to_write, formats
from ..grmm_core.formats.avatars.gaussian_avatars import PLY_NAME, TRACK_NAME
from ..grmm_core.formats.sequence import frame_path
from ..grmm_core.session.harmonics import DEFAULT_DEGREE, MAX_DEGREE
from .common import (
    FrameRange,
    Result,
    UnavailableError,
    active_avatar,
    add_suffix,
    flame_path,
    menu_entries,
    output_path,
    polls,
    reports_errors,
)
from .file_formats import draw_options, has_options, listed, menu_items, option_values, write_filter, written_suffixes
from .steps import CancelCheck, Step, SteppedOperator, Steps, Turn

SPLATS = (*formats("splats", written=True), *(one for one in formats("avatar", written=True) if not one.folder))
MESHES = formats("mesh", written=True)
_DEGREE = {
    "name": "View Dependence",
    "description": "Degree of the spherical harmonics that follow how the avatar's colors change with the view; 0 for none",
    "default": DEFAULT_DEGREE, "min": 0, "max": MAX_DEGREE,
}  # fmt: skip


def _target(context: bpy.types.Context) -> Avatar | Cloud:
    """What the active object's splats are exported from. Raises `UnavailableError`."""
    target = splat_target(active_object(context), context.scene)
    if target is None:
        raise UnavailableError("Select an avatar or a splat cloud")
    return target


@has_options(SPLATS, "writing")
class GRMM_OT_export_splats(SteppedOperator, FrameRange, Operator, ExportHelper):
    """Write the active avatar or splat cloud as Gaussians for other programs."""

    bl_label = "Export Splats"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".ply"
    if TYPE_CHECKING:  # else it would hide `ExportHelper`'s property
        filepath: str
    check_extension = None  # the format decides; see `check`
    filter_glob: bpy.props.StringProperty(default=write_filter(SPLATS), options={"HIDDEN"})
    format: choice("Format", "File format", *menu_items(SPLATS), default=SPLATS[0].suffix)
    pose: choice(
        "Pose",
        "What is written",
        ("FRAME", "This Frame", "Pose and expression of the scene's frame"),
        ("CANONICAL", "At Rest", "The neutral face, not turned"),
        ("SEQUENCE", "Sequence", "A file for every frame, numbered; #### in the name is where the number goes"),
    )
    degree: bpy.props.IntProperty(**_DEGREE)
    lod: whole("Reduction", "Each step keeps a quarter of an avatar's Gaussians, larger ones", min=0, max=3)

    poll = polls(_target)

    def check(self, context: bpy.types.Context) -> bool:
        """Keep the file's extension that of the format."""
        path = Path(self.filepath)
        wanted = str(
            path.with_suffix(self.format) if path.suffix.lower() in written_suffixes(SPLATS) else f"{path}{self.format}"
        )
        changed = bool(path.name) and wanted != self.filepath
        if changed:
            self.filepath = wanted
        return changed

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Choose a file, or start the steps."""
        if self.running:
            return self.begin(context, event)
        self.filename_ext = self.format
        return self.ask(context, event)

    def written(self, context: bpy.types.Context) -> list[Path]:
        """The files of a sequence."""
        if self.pose != "SEQUENCE":
            return []
        path = output_path(self.filepath, written_suffixes(SPLATS), self.format)
        return [frame_path(path, frame) for frame in self.frames(context)]

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "format")
        draw_options(layout, self, self._format(Path(self.format)), "writing")
        layout.prop(self, "pose")
        if self.pose == "SEQUENCE":
            column = layout.column(align=True)
            column.prop(self, "first")
            column.prop(self, "last")
        if not isinstance(splat_target(context.object, context.scene), Cloud):
            layout.prop(self, "degree")
            layout.prop(self, "lod")

    def steps(self, context: bpy.types.Context) -> Steps:
        """Write one file after the other."""
        path = output_path(self.filepath, written_suffixes(SPLATS), self.format)
        target = _target(context)
        options = SplatOptions(self.degree, self.lod, self.pose == "CANONICAL", self.pose == "SEQUENCE")
        scene = context.scene
        if self._format(path).holds == "avatar":
            made = exporting.lam_of(target, context.evaluated_depsgraph_get(), options)
            avatar = yield Step(0.1, "Reading the model", lambda stopped: made())
            self._say(self._format(path).write(path, avatar))
            return f"Wrote {path.name}"
        if self.pose != "SEQUENCE":
            write = self._writing(path, exporting.splats_of(target, context.evaluated_depsgraph_get(), options))
            self._say((yield Step(0.1, "Writing", write)))
            return f"Wrote {path.name}"
        frames = self.frames(context)
        lost: tuple[str, ...] = ()
        with exporting.kept_frame(scene):
            for number, frame in enumerate(frames):
                scene.frame_set(frame)
                cloud = exporting.splats_of(target, context.evaluated_depsgraph_get(), options)
                write = self._writing(frame_path(path, frame), cloud)
                lost = (yield Step((number + 0.1) / len(frames), work=write, walks=True)) or lost
        self._say(lost)
        return f"Wrote {len(frames)} files to {path.parent}"

    @staticmethod
    def _format(path: Path) -> Format:
        return format_to_write(path if path.suffix else Path(f"a{path}"), ("splats", "avatar"))

    def _writing(self, path: Path, make: Callable[[], SplatCloud]) -> Callable[[CancelCheck], tuple[str, ...]]:
        """What makes and writes a cloud on a thread; it returns what the file cannot hold, in sentences."""
        found = self._format(path)
        values = option_values(self, found, "writing")
        return lambda stopped: found.write(path, make(), **values)

    def _say(self, sentences: tuple[str, ...]) -> None:
        for sentence in sentences:
            self.report({"WARNING"}, sentence)


class GRMM_OT_export_mesh(Operator, ExportHelper):
    """Write the active avatar's mesh with its learned displacement and, in glTF, ARKit morph targets."""

    bl_label = "Export Head Mesh"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = MESHES[0].suffix
    check_extension = None
    filter_glob: bpy.props.StringProperty(default=write_filter(MESHES), options={"HIDDEN"})
    canonical: flag("At Rest", "The neutral face, not turned, instead of the scene's frame", default=True)
    morphs: flag("ARKit Morph Targets", "Add the 52 ARKit shapes (glTF only)", default=True)

    poll = polls(partial(active_avatar, linked=True))

    def check(self, context: bpy.types.Context) -> bool:
        """Show the whole name."""
        return add_suffix(self, written_suffixes(MESHES), self.filename_ext)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Write."""
        path = output_path(self.filepath, written_suffixes(MESHES), self.filename_ext)
        depsgraph = context.evaluated_depsgraph_get()
        count = exporting.write_avatar_mesh(path, active_avatar(context, linked=True), depsgraph, self.canonical, self.morphs)
        self.report({"INFO"}, f"Wrote {path.name}" + (f" with {count} morph targets" if count else ""))
        return {"FINISHED"}


class GRMM_OT_export_gaussian_avatar(SteppedOperator, FrameRange, Operator):
    """Write the active avatar and its animation as GaussianAvatars store them."""

    bl_label = "Export GaussianAvatars Folder"
    bl_description = f"Write {PLY_NAME} (splats bound to FLAME's triangles) and {TRACK_NAME} (the animation) into a folder"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    directory: text("Folder", "Folder for the two files", subtype="DIR_PATH")
    filter_folder: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    flame_file: text(
        "FLAME File",
        "Your own FLAME model (generic_model.pkl or flame2023.pkl), which an avatar of the open head is moved to",
        subtype="FILE_PATH",
    )
    degree: bpy.props.IntProperty(**_DEGREE)

    poll = polls(partial(active_avatar, linked=True))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Choose a folder, or start the steps."""
        return self.begin(context, event) if self.running else self.ask(context, event)

    def written(self, context: bpy.types.Context) -> list[Path]:
        """Both files."""
        folder = Path(bpy.path.abspath(self.directory))
        return [folder / PLY_NAME, folder / TRACK_NAME] if self.directory else []

    def steps(self, context: bpy.types.Context) -> Steps:
        """Sample the animation, then write both files."""
        scene, avatar = context.scene, active_avatar(context, linked=True)
        if not self.directory:
            raise FileAccessError("No folder is chosen; choose a folder.")
        exporting.check_flame(avatar, flame_path(self.flame_file))
        target = splat_target(context.object, scene)
        frames = self.frames(context)
        rate = scene.render.fps / scene.render.fps_base
        controls, turn = [], Turn()
        with exporting.kept_frame(scene):
            for found in exporting.sample_controls(avatar, scene, frames):
                controls.append(found)
                if turn.over():
                    yield Step(0.9 * len(controls) / len(frames), "Playing the frames")
        track = exporting.recorded_flame(avatar, controls, frames, rate, flame_path(self.flame_file))
        cloud = target if isinstance(target, Cloud) else None
        make = exporting.gaussian_avatar(avatar, cloud, track, flame_path(self.flame_file), SplatOptions(self.degree))
        made = yield Step(0.9, "Binding splats", lambda stopped: make())
        folder = Path(bpy.path.abspath(self.directory))
        exporting.save_gaussian_avatar(folder, made)
        return f"Wrote {made.cloud.count} splats and {len(frames)} frames to {folder}"


CLASSES = (GRMM_OT_export_splats, GRMM_OT_export_mesh, GRMM_OT_export_gaussian_avatar)
register, unregister = menu_entries(
    bpy.types.TOPBAR_MT_file_export,
    (GRMM_OT_export_splats, f"GRMM Splats ({listed(SPLATS, False)})"),
    (GRMM_OT_export_mesh, f"GRMM Head Mesh ({listed(MESHES, False)})"),
    (GRMM_OT_export_gaussian_avatar, "GRMM GaussianAvatars Folder"),
)
