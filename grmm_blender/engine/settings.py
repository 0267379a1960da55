"""Settings of the engine: `Scene.grmm_render` and `ViewLayer.grmm_passes`."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, EnumProperty, IntProperty, PointerProperty

from ..scene.walk import drawn_objects

ENGINE = "GRMM"
MESH_ALONE = "This engine renders the painted mesh; for splats choose the engine GRMM, or Composite Avatars in the GRMM tab"
DETAIL_ITEMS = (
    ("0", "Full", "Every Gaussian"),
    ("1", "Quarter", "A quarter of the Gaussians, larger ones"),
    ("2", "Sixteenth", "A sixteenth of the Gaussians"),
    ("3", "Lowest", "A sixty-fourth of the Gaussians"),
)


class GRMM_RenderSettings(bpy.types.PropertyGroup):
    """How the GRMM engine makes pictures of a scene."""

    use_refine: BoolProperty(
        name="Refine",
        description="Run the refinement network over the splatted picture",
        default=True,
    )
    detail: EnumProperty(
        name="Detail",
        description="How many of the avatars' Gaussians are drawn in final renders",
        items=DETAIL_ITEMS,
        default="0",
    )
    use_occlusion: BoolProperty(
        name="Scene Occludes",
        description="Meshes of the scene hide the avatars behind them",
        default=True,
    )
    occlusion_samples: IntProperty(
        name="Edge Samples",
        description="Samples per pixel and direction along the edges of occluding meshes",
        default=3, min=1, max=8, soft_max=4,
    )  # fmt: skip
    motion_steps: IntProperty(
        name="Motion Steps",
        description="Pictures averaged over the shutter time when Motion Blur is on",
        default=8, min=2, max=128, soft_max=32,
    )  # fmt: skip
    use_viewport_refine: BoolProperty(
        name="Refine",
        description="Run the refinement network in the rendered viewport once the view rests",
        default=True,
    )
    viewport_detail: EnumProperty(
        name="Detail",
        description="How many of the avatars' Gaussians are drawn in the viewport while the view or the pose changes",
        items=DETAIL_ITEMS,
        default="1",
    )


def _update_passes(_settings: GRMM_PassSettings, context: bpy.types.Context) -> None:
    """Tell Blender that the list of passes changed, so that render layer nodes get new sockets."""
    context.view_layer.update_render_passes()


class GRMM_PassSettings(bpy.types.PropertyGroup):
    """Passes of one view layer beyond Blender's own."""

    use_mask: BoolProperty(
        name="Mask",
        description="Coverage of all avatars together, and of each avatar in a pass of its own",
        update=_update_passes,
    )
    use_raw: BoolProperty(
        name="Raw",
        description="The splatted picture before the refinement network",
        update=_update_passes,
    )
    use_normal: BoolProperty(
        name="Normal",
        description="Normals of the head meshes in world space",
        update=_update_passes,
    )
    use_features: BoolProperty(
        name="Features",
        description="The feature channels that the refinement network reads, four in a pass",
        update=_update_passes,
    )


CLASSES = (GRMM_RenderSettings, GRMM_PassSettings)


def shows_mesh_alone(scene: bpy.types.Scene) -> bool:
    """Whether renders of a scene show its avatars as meshes."""
    composited = scene.grmm_composite.partner is not None
    return scene.render.engine != ENGINE and not composited and bool(drawn_objects(scene))


def register() -> None:
    """Attach the settings to scenes and view layers."""
    bpy.types.Scene.grmm_render = PointerProperty(type=GRMM_RenderSettings)
    bpy.types.ViewLayer.grmm_passes = PointerProperty(type=GRMM_PassSettings)


def unregister() -> None:
    """Detach the settings."""
    del bpy.types.ViewLayer.grmm_passes
    del bpy.types.Scene.grmm_render
