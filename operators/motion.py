"""Face bones, Look At, blinking and breathing: add, remove, bake to keys."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import bpy

from ..grmm_blender.declare import Operator, choice
from ..grmm_blender.motion.bake import bake
from ..grmm_blender.motion.features import FEATURES
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_core.errors import GrmmError
from .common import OperatorMixin, Result, active_avatar, polls, reports_errors


class _Change(OperatorMixin):
    """What the three operators share."""

    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}
    bl_description: str
    adds: bool
    change: Callable[[bpy.types.Context, Avatar], None]
    poll = polls(active_avatar)

    feature: choice(
        "Feature",
        "What the avatar gets or loses",
        *((key, feature.label, feature.description) for key, feature in FEATURES.items()),
    )

    @classmethod
    def description(cls, _context: bpy.types.Context, properties: bpy.types.OperatorProperties) -> str:
        """Say what the button is about."""
        return f"{cls.bl_description}. {FEATURES[properties.feature].description}"

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Change the active avatar."""
        avatar, feature = active_avatar(context), FEATURES[self.feature]
        if feature.is_present(avatar) == self.adds:
            raise GrmmError(f"{avatar.object.name} has {'already' if self.adds else 'no'} {feature.label}.")
        self.change(context, avatar)
        avatar.tag_edited()
        return {"FINISHED"}


class GRMM_OT_add_motion(_Change, Operator):
    """Give it to the active avatar; sliders and keys stay as they are."""

    bl_label = "Add to Rig"
    adds = True

    def change(self, context: bpy.types.Context, avatar: Avatar) -> None:
        """Add it."""
        FEATURES[self.feature].add(context, avatar)


class GRMM_OT_remove_motion(_Change, Operator):
    """Take it from the active avatar; sliders and keys stay as they are."""

    bl_label = "Remove from Rig"
    adds = False

    def change(self, context: bpy.types.Context, avatar: Avatar) -> None:
        """Remove it."""
        FEATURES[self.feature].remove(context, avatar)


class GRMM_OT_bake_motion(_Change, Operator):
    """Key what it does in the frames of the scene on sliders and bones, and take it away."""

    bl_label = "Bake to Keys"
    adds = False

    def change(self, context: bpy.types.Context, avatar: Avatar) -> None:
        """Bake and remove."""
        count = bake(context, avatar, self.feature)
        FEATURES[self.feature].remove(context, avatar)
        self.report({"INFO"}, f"{FEATURES[self.feature].label} is keyed on {count} curves")


CLASSES = (GRMM_OT_add_motion, GRMM_OT_remove_motion, GRMM_OT_bake_motion)
