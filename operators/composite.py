"""Set up a composite of a Cycles or EEVEE scene with its avatars in one click, and take it away again."""

from __future__ import annotations

import bpy

from ..grmm_blender.composite import scenes
from ..grmm_blender.declare import Operator
from ..grmm_blender.engine.settings import ENGINE
from ..grmm_blender.properties import SCENE_LIGHT
from .common import Result, polls, reports_errors, require


def _check_scene(context: bpy.types.Context) -> None:
    """There are avatars, and another engine than GRMM."""
    already = context.scene.render.engine == ENGINE
    require(not already, "The GRMM engine renders this scene already; choose Cycles or EEVEE")
    require(scenes.drawn_objects(context.scene), "The scene has no GRMM avatar")


class GRMM_OT_composite_set_up(Operator):
    """Render the avatars with GRMM and everything else with the scene's engine, put together by the compositor."""

    bl_label = "Composite Avatars"
    bl_description = (
        "Render the avatars with GRMM in a scene of their own and everything else with this scene's engine, "
        "put together by the compositor; again: put it right"
    )

    poll = polls(_check_scene)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Set it up."""
        partner = scenes.set_up(context.scene)
        self.report({"INFO"}, f"The scene {partner.name} renders the avatars")
        return {"FINISHED"}


class GRMM_OT_composite_light(Operator):
    """Let the lamps and the world of the scene light its avatars."""

    bl_label = "Light by Scene"
    bl_description = (
        "Light the avatars by the lamps and the world of the scene, as all else in it, instead of the studio's light"
    )

    poll = polls(lambda context: require(scenes.studio_lit(context.scene), "No avatar of the scene has the studio's light"))

    def execute(self, context: bpy.types.Context) -> Result:
        """Change them."""
        for head in scenes.studio_lit(context.scene):
            head.grmm.lighting = SCENE_LIGHT
        return {"FINISHED"}


class GRMM_OT_composite_remove(Operator):
    """Remove the compositing nodes and the scene that renders the avatars; your own nodes stay."""

    bl_label = "Remove Composite"

    poll = polls(lambda context: require(scenes.partner_of(context.scene), "This scene has no composite"))

    def execute(self, context: bpy.types.Context) -> Result:
        """Remove it."""
        scenes.remove(context.scene)
        return {"FINISHED"}


CLASSES = (GRMM_OT_composite_set_up, GRMM_OT_composite_light, GRMM_OT_composite_remove)
