"""Export an avatar's animation: performance files (CSV, JSON, npz), and caches through Blender's Alembic and USD exporters."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper

from ..grmm_blender import exporting
from ..grmm_blender.declare import Operator, choice, text
from ..grmm_blender.hair.build import selected_curves
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_core.errors import FileAccessError
from ..grmm_core.formats import formats, write_performance
from .common import (
    FrameRange,
    Result,
    active_avatar,
    active_performer,
    add_suffix,
    flame_path,
    menu_entries,
    output_path,
    polls,
    reports_errors,
    require,
)
from .file_formats import menu_items, write_filter, written_suffixes
from .steps import Step, SteppedOperator, Steps, Turn

PERFORMANCES = formats("performance", written=True)
CACHES = (
    (".abc", "Alembic (.abc)", "Moving mesh, through Blender's Alembic exporter"),
    (".usdc", "USD (.usdc)", "Moving mesh, through Blender's USD exporter"),
)
_CACHE_SUFFIXES = (".abc", ".usd", ".usdc", ".usda")


class GRMM_OT_export_performance(SteppedOperator, FrameRange, Operator, ExportHelper):
    """Write the animation of the active avatar, as the scene plays it, as a performance file."""

    bl_label = "Export Performance"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = PERFORMANCES[0].suffix
    check_extension = None
    filter_glob: bpy.props.StringProperty(default=write_filter(PERFORMANCES), options={"HIDDEN"})
    format: choice(
        "Format", "File format, where the name does not say", *menu_items(PERFORMANCES), default=PERFORMANCES[0].suffix
    )
    flame_file: text("FLAME File", "Your own FLAME model, for .npz files of an avatar of the open head", subtype="FILE_PATH")

    poll = polls(partial(active_performer, linked=True))

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Choose a file, or start the steps."""
        return self.begin(context, event) if self.running else self.ask(context, event)

    def check(self, context: bpy.types.Context) -> bool:
        """Show the whole name."""
        return add_suffix(self, written_suffixes(PERFORMANCES), self.format)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel."""
        layout = self.layout
        layout.use_property_split = True
        for name in ("format", "first", "last"):
            layout.prop(self, name)
        if self.format == ".npz":
            layout.prop(self, "flame_file")

    def steps(self, context: bpy.types.Context) -> Steps:
        """Walk through the frames, then write."""
        path = output_path(self.filepath, written_suffixes(PERFORMANCES), self.format)
        scene, performer = context.scene, active_performer(context, linked=True)
        head = exporting.check_flame(performer, flame_path(self.flame_file)) if path.suffix.lower() == ".npz" else None
        frames = self.frames(context)
        rate = scene.render.fps / scene.render.fps_base
        controls, turn = [], Turn()
        with exporting.kept_frame(scene):
            for found in exporting.sample_controls(performer, scene, frames):
                controls.append(found)
                if turn.over():
                    yield Step(0.95 * len(controls) / len(frames), "Playing the frames")
        if head is not None:
            performance = exporting.recorded_flame(head, controls, frames, rate, flame_path(self.flame_file))
        else:
            performance = exporting.recorded(performer, controls, frames, rate)
        if path.suffix.lower() == ".csv" and performance.jaw_rotation is not None:
            performance.warnings.append("The jaw bone is animated; Live Link Face files cannot hold it and it was left out.")
        write_performance(path, performance)
        for sentence in performance.warnings:
            self.report({"WARNING"}, sentence)
        return f"Wrote {len(frames)} frames to {path.name}"


def _selectable(context: bpy.types.Context) -> Avatar:
    """The active avatar, in object mode. Raises `UnavailableError`."""
    require(context.mode == "OBJECT", "Go to object mode first")
    return active_avatar(context, linked=True)


class GRMM_OT_export_cache(FrameRange, Operator, ExportHelper):
    """Write the active avatar's moving mesh with its learned displacement, and its strands as curves, as Alembic or USD."""

    bl_label = "Export Mesh Cache"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = ".abc"
    check_extension = None
    filter_glob: bpy.props.StringProperty(default="*.abc;*.usd;*.usdc;*.usda", options={"HIDDEN"})
    format: choice("Format", "File format, where the name does not say", *CACHES, default=".abc")

    poll = polls(_selectable)

    def check(self, context: bpy.types.Context) -> bool:
        """Show the whole name."""
        return add_suffix(self, _CACHE_SUFFIXES, self.format)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Select head and hair, and let Blender export them."""
        path = output_path(self.filepath, _CACHE_SUFFIXES, self.format)
        frames = self.frames(context)
        first, last = frames[0], frames[-1]
        scene, avatar = context.scene, _selectable(context)
        selected, active = list(context.selected_objects), context.view_layer.objects.active
        kept = scene.frame_start, scene.frame_end
        try:
            for obj in selected:
                obj.select_set(False)
            avatar.object.select_set(True)
            context.view_layer.objects.active = avatar.object
            scene.frame_start, scene.frame_end = first, last  # all that the USD exporter looks at
            with exporting.kept_frame(scene), selected_curves(avatar):
                self._export(path, first, last)
        except RuntimeError as error:  # how Blender's exporters say that they could not write
            reason = str(error).strip().rstrip(".")
            raise FileAccessError(f"Blender could not write {path} ({reason}); check the folder.") from error
        finally:
            scene.frame_start, scene.frame_end = kept
            for obj in context.selected_objects:
                obj.select_set(False)
            for obj in selected:
                obj.select_set(True)
            context.view_layer.objects.active = active
        self.report({"INFO"}, f"Wrote {len(frames)} frames to {path.name}")
        return {"FINISHED"}

    @staticmethod
    def _export(path: Path, first: int, last: int) -> None:
        if path.suffix.lower() == ".abc":
            bpy.ops.wm.alembic_export(
                "EXEC_DEFAULT", filepath=str(path), start=first, end=last, selected=True, as_background_job=False,
                uvs=True, normals=True, face_sets=True, flatten=False, export_hair=False, export_particles=False,
            )  # fmt: skip
        else:
            bpy.ops.wm.usd_export(
                "EXEC_DEFAULT", filepath=str(path), selected_objects_only=True, export_animation=True,
                export_uvmaps=True, export_normals=True, export_armatures=False, export_shapekeys=False,
                export_custom_properties=False,
            )  # fmt: skip


CLASSES = (GRMM_OT_export_performance, GRMM_OT_export_cache)
register, unregister = menu_entries(
    bpy.types.TOPBAR_MT_file_export,
    (GRMM_OT_export_performance, f"GRMM Performance ({', '.join(written_suffixes(PERFORMANCES))})"),
    (GRMM_OT_export_cache, "GRMM Mesh Cache (.abc, .usdc)"),
)
