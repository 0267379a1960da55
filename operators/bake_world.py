"""Bake a world's light for avatars, where its nodes are more than a color or an environment texture."""

from __future__ import annotations

import bpy

from ..grmm_blender.declare import Operator
from ..grmm_blender.scene import baked_world
from .common import Result, polls, reports_errors, require


class GRMM_OT_bake_world(Operator):
    """Render the world once with Cycles, as a small picture that avatars are lit by; again after its nodes have changed."""

    bl_label = "Bake World"
    bl_options = {"REGISTER", "UNDO"}  # noqa: RUF012 - Blender reads it

    poll = polls(lambda context: require(context.scene.world, "The scene has no world"))

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Bake it."""
        image = baked_world.bake(context.scene.world)
        self.report({"INFO"}, f"Avatars are lit by the picture {image.name}; bake it again when the world changes")
        return {"FINISHED"}


CLASSES = (GRMM_OT_bake_world,)
