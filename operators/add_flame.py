"""Add the user's own FLAME head with the rig of our heads: an animatable mesh, not drawn by a network.

FLAME is licence-gated and nothing of it is in the extension: the user names a file, here or once in the preferences.
"""

from __future__ import annotations

from pathlib import Path

import bpy

from ..grmm_blender import preferences
from ..grmm_blender.declare import Operator, text
from ..grmm_blender.rig.identity import FLAME_PREFIX
from ..grmm_core.errors import FileAccessError
from .add_head import PlacesHead
from .common import Result, reports_errors


class GRMM_OT_add_flame_head(PlacesHead, Operator):
    """Add the head of your own FLAME file with an ARKit rig."""

    bl_label = "Add FLAME Head"
    bl_description = (
        "Add the head of your own FLAME file with bones, ARKit sliders and FLAME's coefficients; the file can be named once in "
        "the extension's preferences"
    )

    filepath: text(
        "FLAME File",
        "generic_model.pkl, flame2023.pkl, or an npz with the same arrays; empty for the one of the preferences",
        subtype="FILE_PATH",
        options={"SKIP_SAVE"},
    )
    filter_glob: bpy.props.StringProperty(default="*.pkl;*.npz", options={"HIDDEN"})

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Ask for the file where the preferences do not name one."""
        self.watch(context)
        if self.filepath or preferences.get().flame:
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Build the head."""
        named = self.filepath or preferences.get().flame
        if not named:
            raise FileAccessError("No FLAME file is chosen; choose generic_model.pkl or flame2023.pkl.")
        path = Path(bpy.path.abspath(named))
        if not path.is_file():
            raise FileAccessError(f"{path} does not exist; choose your FLAME file again.")
        source = f"{FLAME_PREFIX}{path}"
        self.add(context, source, source)
        return {"FINISHED"}


CLASSES = (GRMM_OT_add_flame_head,)
