"""Save an avatar as a `.grmm` file, with the hair that it wears."""

from __future__ import annotations

from typing import ClassVar

import bpy
from bpy_extras.io_utils import ExportHelper

from ..grmm_blender import exporting, session_host
from ..grmm_blender.declare import Operator
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_core.avatar import EXTENSION
from .common import Result, active_avatar, menu_entries, output_path, polls, require
from .steps import CancelCheck, Step, SteppedOperator, Steps


def _savable(context: bpy.types.Context) -> Avatar:
    """The active avatar, if the model draws it. Raises `UnavailableError`."""
    avatar = active_avatar(context, linked=True)
    require(avatar.has_network, "No network draws this head")
    return avatar


class GRMM_OT_save_avatar(SteppedOperator, Operator, ExportHelper):
    """Write the active avatar as an avatar file of its own, with the strands that it wears, combed ones as well."""

    bl_label = "Save Avatar"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filename_ext = EXTENSION
    filter_glob: bpy.props.StringProperty(default=f"*{EXTENSION}", options={"HIDDEN"})

    poll = polls(_savable)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Choose a file, or start the steps."""
        return self.begin(context, event) if self.running else self.ask(context, event)

    def steps(self, context: bpy.types.Context) -> Steps:
        """Have the session write it, on a thread: it may be busy, and a picture of the avatar goes into the file."""
        path, avatar = output_path(self.filepath, (EXTENSION,), EXTENSION), _savable(context)
        hair, source = exporting.hair_kept(avatar, context.evaluated_depsgraph_get()), avatar.source

        def save(stopped: CancelCheck) -> None:
            session_host.get_session().save(session_host.open_avatar(source).id, path, hair())

        yield Step(0.1, "Writing", save)
        return f"Wrote {path.name}"


CLASSES = (GRMM_OT_save_avatar,)
register, unregister = menu_entries(bpy.types.TOPBAR_MT_file_export, (GRMM_OT_save_avatar, f"GRMM Avatar ({EXTENSION})"))
