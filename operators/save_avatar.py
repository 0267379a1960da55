"""Save an avatar as a `.grmm` file, with the hair that it wears."""

from __future__ import annotations

from typing import ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper

from ..grmm_blender import exporting, session_host
from ..grmm_blender.declare import Operator
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_core.avatar import EXTENSION
from .common import Result, active_avatar, menu_entries, output_path, polls, reports_errors, require


def _savable(context: bpy.types.Context) -> Avatar:
    """The active avatar, if the model draws it. Raises `UnavailableError`."""
    avatar = active_avatar(context, linked=True)
    require(avatar.has_network, "No network draws this head")
    return avatar


class GRMM_OT_save_avatar(Operator, ExportHelper):
    """Write the active avatar as an avatar file of its own, with the strands that it wears, combed ones as well."""

    bl_label = "Save Avatar"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = EXTENSION
    filter_glob: bpy.props.StringProperty(default=f"*{EXTENSION}", options={"HIDDEN"})

    poll = polls(_savable)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Have the session write it."""
        path, avatar = output_path(self.filepath, (EXTENSION,), EXTENSION), _savable(context)
        hair = exporting.hair_kept(avatar, context.evaluated_depsgraph_get())
        session_host.get_session().save(session_host.open_avatar(avatar.source).id, path, hair)
        self.report({"INFO"}, f"Wrote {path.name}")
        return {"FINISHED"}


CLASSES = (GRMM_OT_save_avatar,)
register, unregister = menu_entries(bpy.types.TOPBAR_MT_file_export, (GRMM_OT_save_avatar, f"GRMM Avatar ({EXTENSION})"))
