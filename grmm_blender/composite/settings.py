"""What a composite keeps in the file: `Scene.grmm_composite` and `Object.grmm_handed_over`."""

from __future__ import annotations

import bpy
from bpy.props import BoolProperty, PointerProperty

from ..declare import flag


class GRMM_CompositeSettings(bpy.types.PropertyGroup):
    """How two scenes make one picture."""

    partner: PointerProperty(
        type=bpy.types.Scene,
        name="Avatars' Scene",
        description="Scene that renders this scene's avatars with the GRMM engine",
    )
    main: PointerProperty(
        type=bpy.types.Scene,
        name="Main Scene",
        description="Scene whose avatars this scene renders",
    )
    made_tree: flag("Made Compositing Tree", "The main scene had no compositing nodes before", options={"HIDDEN"})


CLASSES = (GRMM_CompositeSettings,)


def register() -> None:
    """Attach the settings to scenes and objects."""
    bpy.types.Scene.grmm_composite = PointerProperty(type=GRMM_CompositeSettings)
    bpy.types.Object.grmm_handed_over = BoolProperty(
        name="Composited",
        description="Hidden from the camera of other engines because a GRMM scene renders this head",
        override={"LIBRARY_OVERRIDABLE"},
        options={"HIDDEN"},
    )


def unregister() -> None:
    """Detach the settings; the values stay in the files."""
    del bpy.types.Object.grmm_handed_over
    del bpy.types.Scene.grmm_composite
