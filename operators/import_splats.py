"""Import splat files and other projects' avatars."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..grmm_blender.declare import Operator, flag, text
from ..grmm_blender.performance import ImportOptions, apply_performance
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.splats.rigged import import_file
from ..grmm_core.errors import FileAccessError
from ..grmm_core.formats import formats
from ..grmm_core.performance import Performance
from .common import Result, check_object_mode, flame_path, menu_entries, polls, reports_errors
from .file_formats import dropped_suffixes, listed, read_filter
from .importing import ImportsFiles, TakesDrops, pointer_progress

READ = formats(("splats", "avatar", "sequence"), read=True)


class GRMM_OT_import_splats(ImportsFiles, Operator):
    """Add the Gaussians of splat files, or avatars of other projects, to the scene."""

    bl_label = "Import Splats"
    bl_description = (
        "Add the Gaussians of splat files (3DGS, .splat, SPZ, SOG, glTF) "
        "or avatars of other projects (GaussianAvatars, LAM, CAP4D)"
    )

    filepath: text("File", "Splat file", subtype="FILE_PATH", options={"SKIP_SAVE"})
    directory: bpy.props.StringProperty(subtype="DIR_PATH", options={"SKIP_SAVE", "HIDDEN"})
    files: bpy.props.CollectionProperty(type=bpy.types.OperatorFileListElement, options={"SKIP_SAVE", "HIDDEN"})
    filter_glob: bpy.props.StringProperty(default=read_filter(READ), options={"HIDDEN"})
    turned: flag("Turn Upside Down", "Turn plain splats by half a turn: for files that were written with the other axis up")
    flame_file: text(
        "FLAME File",
        "Your own FLAME model (generic_model.pkl or flame2023.pkl), which carries GaussianAvatars' splats",
        subtype="FILE_PATH",
    )
    animation: flag("Animation", "Key the performance that lies beside a GaussianAvatars file", default=True)

    poll = polls(check_object_mode)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Import every chosen file."""
        names = [Path(bpy.path.abspath(self.directory)) / item.name for item in self.files if item.name]
        paths = names or ([Path(bpy.path.abspath(self.filepath))] if self.filepath else [])
        if not paths:
            raise FileAccessError("No splat file is chosen; choose a file.")
        with pointer_progress(context, len(paths)) as show:
            for number, path in enumerate(paths):
                show(number)
                self._import(context, path)
        return {"FINISHED"}

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the options in the file browser's side panel."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "turned")
        box = layout.column(heading="GaussianAvatars")
        box.prop(self, "flame_file")
        box.prop(self, "animation")

    def _import(self, context: bpy.types.Context, path: Path) -> None:
        made = import_file(context, path, flame=flame_path(self.flame_file), turned=self.turned)
        warnings = list(made.warnings)
        if made.avatar is not None and made.track is not None and self.animation:
            warnings += self._animate(context, made.avatar, made.track, path)
        self.warn(warnings)
        frames = f", {made.frames} frames" if made.frames else ""
        self.report({"INFO"}, f"Imported {made.objects[0].name}: {made.splats} splats{frames}")

    def _animate(self, context: bpy.types.Context, avatar: Avatar, track: Performance, path: Path) -> list[str]:
        scene = context.scene
        rate = scene.render.fps / scene.render.fps_base
        options = ImportOptions(start=scene.frame_start, fps=rate, head_joint="root", limit=False)
        name = path.name if path.is_dir() else path.parent.name
        written = apply_performance(avatar, track, options, f"{name} track")
        moved = track.translation is not None and bool(track.translation.any())
        return [*written.warnings, *(["The track's movement of the whole head through space was left out."] if moved else [])]


class GRMM_FH_splats(TakesDrops, bpy.types.FileHandler):
    """Take splat files that are dropped into the 3D viewport."""

    bl_idname = "GRMM_FH_splats"
    bl_label = "GRMM Splats"
    bl_import_operator = GRMM_OT_import_splats.bl_idname
    bl_file_extensions = dropped_suffixes(READ)


CLASSES = (GRMM_OT_import_splats, GRMM_FH_splats)
register, unregister = menu_entries(
    bpy.types.TOPBAR_MT_file_import, (GRMM_OT_import_splats, f"GRMM Splats and Avatars ({listed(READ)})")
)
