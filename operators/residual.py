"""Operators of the learned detail: random detail, saved codes A and B and the blend between them."""

from __future__ import annotations

import bpy
import numpy as np

from ..grmm_blender.declare import Operator, choice, number
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.rig.components import components
from ..grmm_blender.rig.custom_properties import add_property, read_array, write_array
from ..grmm_blender.rig.saved_codes import SLOTS, blend_control, blend_of, code_properties, saved_slots, slot_control
from ..grmm_core.controls.table import CONTROLS, Z_EXP, Z_ID
from .common import Result, active_avatar, polls, require
from .edit import DrawsAnother, Edit

_CODE_ITEMS = (
    (Z_EXP, CONTROLS[Z_EXP].label, "The code of the expression's learned detail"),
    (Z_ID, CONTROLS[Z_ID].label, "The code of the person's learned detail"),
)
_SLOT_ITEMS = (("A", "A", "What the blend is at 0"), ("B", "B", "What the blend is at 1"))


def present_code(avatar: Avatar, name: str) -> np.ndarray:
    """The code that the avatar has now, with what the blend adds, before it is evaluated again."""
    values = read_array(avatar.object, name)
    return values + blend_of(avatar.object, name, values.size)


def _drawn_avatar(context: bpy.types.Context) -> Avatar:
    """The active avatar, which a network draws. Raises `UnavailableError`."""
    avatar = active_avatar(context)
    require(Z_EXP in avatar.object, "This head has no learned detail: no network draws it")
    return avatar


class _CodeEdit(Edit):
    """Works on one of the two codes."""

    poll = polls(_drawn_avatar)


class GRMM_OT_save_code(_CodeEdit, Operator):
    """Keep the present learned detail of the active avatar as A or B; with both saved, a slider blends them."""

    bl_label = "Save Learned Detail"

    code: choice("Code", "Which code to keep", *_CODE_ITEMS, default=Z_EXP)
    slot: choice("Slot", "Where to keep it", *_SLOT_ITEMS, default="A")

    def execute(self, context: bpy.types.Context) -> Result:
        """Keep it. Once both are there the sliders go to zero: the blend says the same, and sliders add to it."""
        avatar = _drawn_avatar(context)
        head, slot = avatar.object, self.slot.lower()
        present = present_code(avatar, self.code)
        saved = slot_control(self.code, slot)
        add_property(head, saved, present.size)
        head[saved.name] = present.tolist()
        changed: list[str] = []
        if len(saved_slots(head, self.code)) == len(SLOTS):
            blend = blend_control(self.code)
            if blend.name not in head:
                add_property(head, blend)
            head[blend.name] = 0.0 if slot == "a" else 1.0
            write_array(head, self.code, np.zeros_like(present))
            changed = [self.code, blend.name]
        return self.finish(context, avatar, changed)


class GRMM_OT_apply_blend(_CodeEdit, Operator):
    """Put the present blend of A and B into the sliders, so that nothing changes, and forget A and B."""

    bl_label = "Apply Blend"

    code: choice("Code", "Which code's blend to apply", *_CODE_ITEMS, default=Z_EXP)

    def execute(self, context: bpy.types.Context) -> Result:
        """Apply it."""
        avatar = _drawn_avatar(context)
        write_array(avatar.object, self.code, present_code(avatar, self.code))
        for name in list(code_properties(avatar.object, self.code)):
            del avatar.object[name]
        return self.finish(context, avatar, [self.code])


class GRMM_OT_random_detail(DrawsAnother, _CodeEdit, Operator):
    """Draw the active avatar's residual expression at random, spread as in the trained expressions."""

    bl_label = "Random Detail"

    amount: number("Amount", "1 is as strong as trained expressions are", default=1.0, min=0.0, soft_max=2.0, max=4.0)

    def execute(self, context: bpy.types.Context) -> Result:
        """Draw it."""
        avatar = _drawn_avatar(context)
        size = len(avatar.object[Z_EXP])
        spread = np.ones(size, np.float32)
        for component in components(Z_EXP, size):
            spread[component.index] = component.spread
        drawn = np.random.default_rng(self.seed).standard_normal(size).astype(np.float32)
        write_array(avatar.object, Z_EXP, drawn * spread * self.amount)
        return self.finish(context, avatar, [Z_EXP])


CLASSES = (GRMM_OT_save_code, GRMM_OT_apply_blend, GRMM_OT_random_detail)
