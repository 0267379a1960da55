"""`Scene.grmm_viewport`: how splats are shown in solid and material preview viewports."""

from __future__ import annotations

import bpy
from bpy.props import PointerProperty

from ..declare import choice, flag
from ..engine.settings import DETAIL_ITEMS
from ..windows import redraw_viewports
from .changes import CHANGES

SHADINGS = ("SOLID", "MATERIAL")  # kinds of shading in which splats are drawn

HOLD_RATE, FULL, MESH = "HOLD_RATE", "FULL", "MESH"
PLAYBACK_ITEMS = (
    (HOLD_RATE, "Hold Frame Rate", "Use the finest level of detail that keeps up with the frame rate, else the mesh"),
    (FULL, "Full", "Keep the chosen level of detail even where splats come late"),
    (MESH, "Mesh", "Show the mesh alone"),
)


def _redraw(_settings: GRMM_ViewportSettings, context: bpy.types.Context) -> None:
    CHANGES.settings += 1
    redraw_viewports(*SHADINGS)


class GRMM_ViewportSettings(bpy.types.PropertyGroup):
    """How splats are shown in the 3D viewports of a scene."""

    use_splats: flag(
        "Splats",
        "Draw avatars and splat clouds as Gaussians in solid and material preview viewports, not refined",
        default=True,
        update=_redraw,
    )
    detail: choice(
        "Detail", "How many of the Gaussians are drawn when nothing moves", *DETAIL_ITEMS, default="0", update=_redraw
    )
    playback: choice("Playback", "What is shown while an animation plays", *PLAYBACK_ITEMS, default=HOLD_RATE)
    use_handles: flag(
        "Face Handles",
        "Show points on the active avatar's face to drag: brows, lids, cheeks, nose, lips, corners, jaw, gaze",
        update=_redraw,
    )
    use_status: flag(
        "Status Text",
        "Say in the viewport's corner when something else than the full detail is shown, and why",
        default=True,
        update=_redraw,
    )


CLASSES = (GRMM_ViewportSettings,)


def register() -> None:
    """Attach the settings to scenes."""
    bpy.types.Scene.grmm_viewport = PointerProperty(type=GRMM_ViewportSettings)


def unregister() -> None:
    """Detach the settings."""
    del bpy.types.Scene.grmm_viewport
