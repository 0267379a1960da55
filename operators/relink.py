"""Point an avatar whose file has moved, or that is to be another person, to a file."""

from __future__ import annotations

from pathlib import Path

import bpy

from ..grmm_blender.declare import Operator, flag, text
from ..grmm_blender.rig import live
from ..grmm_blender.rig.avatar import Avatar, stored_path
from ..grmm_blender.rig.identity import read_identity
from ..grmm_core.avatar import EXTENSION
from ..grmm_core.errors import FileAccessError, FileFormatError
from .common import Result, active_avatar, polls, reports_errors, require
from .importing import ImportsFiles


def _relinkable(context: bpy.types.Context) -> Avatar:
    """The active avatar, which a network draws. Raises `UnavailableError`."""
    avatar = active_avatar(context)
    require(avatar.has_network, "This head is a FLAME file's")
    return avatar


class GRMM_OT_relink_avatar(ImportsFiles, Operator):
    """Choose the active avatar's file, after a move or to show another person; controls and keys stay."""

    bl_label = "Relink Avatar"

    filepath: text("File", "Avatar file (.grmm)", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default=f"*{EXTENSION}", options={"HIDDEN"})
    relative_path: flag("Relative Path", "Store the file name relative to the .blend file", default=True)

    poll = polls(_relinkable)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Read the file before anything is changed."""
        avatar = _relinkable(context)
        if not self.filepath:
            raise FileAccessError("No avatar file is chosen; choose a .grmm file.")
        path = Path(bpy.path.abspath(self.filepath))
        read_identity(str(path))
        before = avatar.object.grmm.source
        avatar.object.grmm.source = stored_path(str(path), self.relative_path, avatar.object)
        problem = live.state_of(avatar).message
        if problem:
            avatar.object.grmm.source = before
            raise FileFormatError(problem)
        return {"FINISHED"}


CLASSES = (GRMM_OT_relink_avatar,)
