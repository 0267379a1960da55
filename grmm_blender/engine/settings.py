"""Settings of the engine: `Scene.grmm_render` and `ViewLayer.grmm_passes`."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, PointerProperty

from ..declare import choice, flag, whole
from ..scene.walk import drawn_objects

ENGINE = "GRMM"
MESH_ALONE = "This engine renders the painted mesh; for splats choose the engine GRMM, or Composite Avatars in the GRMM tab"
DETAIL_ITEMS = (
    ("0", "Full", "Every Gaussian"),
    ("1", "Quarter", "A quarter of the Gaussians, larger ones"),
    ("2", "Sixteenth", "A sixteenth of the Gaussians"),
    ("3", "Lowest", "A sixty-fourth of the Gaussians"),
)


def _draws_curves(settings: GRMM_RenderSettings) -> bool:
    """Whether a scene's engine is another one."""
    return bool(settings.id_data.render.engine != ENGINE)


class GRMM_RenderSettings(bpy.types.PropertyGroup):
    """How the GRMM engine makes pictures of a scene."""

    use_refine: flag("Refine", "Run the refinement network over the splatted picture", default=True)
    detail: choice("Detail", "How many of the avatars' Gaussians are drawn in final renders", *DETAIL_ITEMS, default="0")
    use_occlusion: flag("Scene Occludes", "Meshes of the scene hide the avatars behind them", default=True)
    occlusion_samples: whole(
        "Edge Samples",
        "Samples per pixel and direction along the edges of occluding meshes",
        default=3,
        min=1,
        max=8,
        soft_max=4,
    )
    motion_steps: whole(
        "Motion Steps", "Pictures averaged over the shutter time when Motion Blur is on", default=8, min=2, max=128, soft_max=32
    )
    use_viewport_refine: flag("Refine", "Run the refinement network in the rendered viewport once the view rests", default=True)
    viewport_detail: choice(
        "Detail",
        "How many of the avatars' Gaussians are drawn in the viewport while the view or the pose changes",
        *DETAIL_ITEMS,
        default="1",
    )
    draws_curves: BoolProperty(
        name="Draws Curves",
        description="Whether the scene's engine draws hair as curves; GRMM draws splats",
        get=_draws_curves,
    )


def _update_passes(_settings: GRMM_PassSettings, context: bpy.types.Context) -> None:
    """Tell Blender that the list of passes changed, so that render layer nodes get new sockets."""
    context.view_layer.update_render_passes()


class GRMM_PassSettings(bpy.types.PropertyGroup):
    """Passes of one view layer beyond Blender's own."""

    use_mask: flag("Mask", "Coverage of all avatars together, and of each avatar in a pass of its own", update=_update_passes)
    use_hair: flag("Hair", "Share of each pixel that strands of hair cover", update=_update_passes)
    use_light: flag(
        "Light",
        "What light inside the skin gives and what surfaces mirror, which add up to the avatars' picture, and the share of the "
        "lamps' light that no shadow keeps off",
        update=_update_passes,
    )
    use_raw: flag("Raw", "The splatted picture before the refinement network", update=_update_passes)
    use_normal: flag("Normal", "Normals of the head meshes in world space", update=_update_passes)
    use_features: flag(
        "Features", "The feature channels that the refinement network reads, four in a pass", update=_update_passes
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
