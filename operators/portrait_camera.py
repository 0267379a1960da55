"""A camera before the active avatar's face, and the engine that draws it."""

from __future__ import annotations

import bpy

from ..grmm_blender import staging
from ..grmm_blender.declare import Operator
from .common import Result, active_avatar, polls


class GRMM_OT_portrait_camera(Operator):
    """Put a camera before the active avatar, and render through it with GRMM; again: put it there again."""

    bl_label = "Portrait Camera"
    poll = polls(active_avatar)

    def execute(self, context: bpy.types.Context) -> Result:
        """Place the camera."""
        staging.set_up(context, active_avatar(context), fresh=False)
        return {"FINISHED"}


CLASSES = (GRMM_OT_portrait_camera,)
