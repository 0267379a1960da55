"""Edit an avatar's controls: reset, mirror, random expression, random identity; repair linked duplicates.

With automatic keying on, what an operator changes is keyed, as it is for a transform in the viewport.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import ClassVar

import bpy
import numpy as np

from ..grmm_blender import session_host
from ..grmm_blender.rig import live
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.rig.build import make_independent
from ..grmm_blender.rig.codes import code_properties
from ..grmm_blender.rig.definitions import (
    ALIGNED_NAMES,
    ARRAY_NAMES,
    ARRAY_RANGES,
    CODES,
    CONTROL_JOINTS,
    EXPRESSION,
    REGIONS,
    SHAPE,
    STRENGTH,
    Z_EXP,
    Z_ID,
    mirrored,
    property_path,
)
from ..grmm_blender.rig.identity import load_head, read_identity
from ..grmm_core.avatar import AssetReference
from ..grmm_core.errors import GrmmError, RuntimeMissingError
from ..grmm_core.session import AvatarInfo
from .common import Result, active_avatar, needs_avatar, reports_errors

ALL = "ALL"
_DIRECTIONS = ("jawLeft", "jawRight", "mouthLeft", "mouthRight")
"""Movements to a side, not of a side: swapping swaps them, copying one side to the other leaves them."""
_REGION_ITEMS = ((ALL, "All", "Every region"), *((name, name, f"The region {name.lower()}") for name in REGIONS))
_AT_REST = {STRENGTH: 1.0}
_TOGETHER = 0.8  # chance that both sides of a random expression move alike
_RANDOM_SHAPE_COUNT = 60  # leading components: the others are too small to tell people apart


def _names_in(region: str) -> tuple[str, ...]:
    return ALIGNED_NAMES if region == ALL else REGIONS.get(region, ())


class Edit:
    """What operators that change an avatar's controls share."""

    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}
    poll = classmethod(needs_avatar)

    def finish(self, context: bpy.types.Context, avatar: Avatar, names: Iterable[str], bones: Iterable[str] = ()) -> Result:
        """Evaluate again, and key what changed where automatic keying is on."""
        avatar.tag_edited()
        if context.scene.tool_settings.use_keyframe_insert_auto:
            for name in names:
                avatar.object.keyframe_insert(property_path(name))
            for bone in bones if avatar.armature is not None else ():
                avatar.armature.pose.bones[bone].keyframe_insert("rotation_euler")
        return {"FINISHED"}


class GRMM_OT_reset(Edit, bpy.types.Operator):
    """Set controls of the active avatar back to rest."""

    bl_idname = "grmm.reset"
    bl_label = "Reset Controls"
    bl_description = "Set controls of the active avatar back to rest"

    what: bpy.props.EnumProperty(
        name="Controls",
        description="Which controls to reset",
        items=(
            (ALL, "All", "Every control"),
            ("EXPRESSION", "Expression", "Named expressions and expression coefficients"),
            ("POSE", "Pose", "Neck, jaw, eyes and root"),
            ("IDENTITY", "Identity", "Shape and residual identity"),
            ("DETAIL", "Learned Detail", "Residual expression, its saved codes, and strength"),
        ),
        default=ALL,
    )
    region: bpy.props.EnumProperty(
        name="Region", description="Reset the named expressions of one region only", items=_REGION_ITEMS, default=ALL
    )

    def execute(self, context: bpy.types.Context) -> Result:
        """Reset."""
        avatar = active_avatar(context)
        names: list[str] = []
        bones: list[str] = []
        if self.what in (ALL, "EXPRESSION"):
            names += _names_in(self.region)
            names += [EXPRESSION] if self.region == ALL else []
        if self.what in (ALL, "IDENTITY"):
            names += [SHAPE, Z_ID]
        if self.what in (ALL, "DETAIL"):
            names += [Z_EXP, STRENGTH]
        names = [name for name in names if name in avatar.object]
        for code in (name for name in names if name in CODES):
            for saved in list(code_properties(avatar.object, code)):
                del avatar.object[saved]
        for name in names:
            value = avatar.object[name]
            avatar.object[name] = [0.0] * len(value) if name in ARRAY_NAMES else _AT_REST.get(name, 0.0)
        if self.what in (ALL, "POSE") and avatar.armature is not None:
            bones = [name for name in (*CONTROL_JOINTS, "root") if name in avatar.armature.pose.bones]
            for bone in bones:
                avatar.armature.pose.bones[bone].rotation_euler = (0.0, 0.0, 0.0)
        return self.finish(context, avatar, names, bones)


class GRMM_OT_mirror(Edit, bpy.types.Operator):
    """Mirror the expression, jaw, neck and eyes of the active avatar."""

    bl_idname = "grmm.mirror"
    bl_label = "Mirror Expression"
    bl_description = "Swap the sides of the active avatar's expression, or copy one side to the other"

    direction: bpy.props.EnumProperty(
        name="Direction",
        description="What to mirror; left and right are the subject's",
        items=(
            ("SWAP", "Swap", "Exchange both sides; sideways movements turn round"),
            ("LEFT", "Left to Right", "Copy the subject's left side to the right"),
            ("RIGHT", "Right to Left", "Copy the subject's right side to the left"),
        ),
        default="SWAP",
    )
    region: bpy.props.EnumProperty(name="Region", description="Mirror one region only", items=_REGION_ITEMS, default=ALL)

    def execute(self, context: bpy.types.Context) -> Result:
        """Mirror."""
        avatar = active_avatar(context)
        head = avatar.object
        names = [name for name in _names_in(self.region) if self._takes(name) and name in head]
        values = {name: head[mirrored(name)] for name in names}
        for name, value in values.items():
            head[name] = value
        bones: list[str] = []
        if self.region == ALL:
            self._mirror_coefficients(avatar)
            names.append(EXPRESSION)
            bones = self._mirror_bones(avatar)
        return self.finish(context, avatar, names, bones)

    def _takes(self, name: str) -> bool:
        """Whether a control gets its partner's value."""
        if self.direction == "SWAP":
            return mirrored(name) != name
        if name in _DIRECTIONS:
            return False
        return ("Right" if self.direction == "LEFT" else "Left") in name or (
            name.startswith("right_" if self.direction == "LEFT" else "left_")
        )

    def _mirror_coefficients(self, avatar: Avatar) -> None:
        names = load_head(AssetReference(avatar.object.grmm.head_name)).expression_names
        values = avatar.object[EXPRESSION].to_list()
        index = {name: k for k, name in enumerate(names)}
        avatar.object[EXPRESSION] = [
            values[index.get(mirrored(name), k)] if self._takes(name) else values[k] for k, name in enumerate(names)
        ]

    def _mirror_bones(self, avatar: Avatar) -> list[str]:
        """A rotation seen in a mirror keeps its pitch and turns its yaw and roll round."""
        if avatar.armature is None:
            return []
        bones = avatar.armature.pose.bones
        taken = [name for name in CONTROL_JOINTS if name in bones and (self.direction == "SWAP" or self._takes(name))]
        angles = {name: bones[mirrored(name)].rotation_euler.copy() for name in taken}
        for name, (x, y, z) in angles.items():
            bones[name].rotation_euler = (x, -y, -z)
        return taken


class GRMM_OT_random_expression(Edit, bpy.types.Operator):
    """Give the active avatar a random expression."""

    bl_idname = "grmm.random_expression"
    bl_label = "Random Expression"
    bl_description = "Give the active avatar a random expression, or one region of it"

    seed: bpy.props.IntProperty(name="Seed", description="Number of the expression", default=1, min=0)
    amount: bpy.props.FloatProperty(
        name="Amount", description="Largest weight of an expression", default=0.7, min=0.0, max=1.0, subtype="FACTOR"
    )
    share: bpy.props.FloatProperty(
        name="Share", description="Share of the expressions that move", default=0.15, min=0.0, max=1.0, subtype="FACTOR"
    )
    region: bpy.props.EnumProperty(name="Region", description="Change one region only", items=_REGION_ITEMS, default=ALL)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Another expression each time."""
        if not self.properties.is_property_set("seed"):
            self.seed = int(np.random.default_rng().integers(1, 1 << 20))
        return self.execute(context)

    def execute(self, context: bpy.types.Context) -> Result:
        """Draw an expression."""
        avatar = active_avatar(context)
        generator = np.random.default_rng(self.seed)
        drawn: dict[str, float] = {}
        for name in ALIGNED_NAMES:  # all of them, so that a seed means the same in every region
            moves, weight, together = generator.random() < self.share, generator.random() * self.amount, generator.random()
            partner = mirrored(name)
            if partner in drawn and name not in _DIRECTIONS and together < _TOGETHER:
                drawn[name] = drawn[partner]
            else:
                drawn[name] = weight if moves else 0.0
        names = [name for name in _names_in(self.region) if name in avatar.object]
        for name in names:
            avatar.object[name] = drawn[name]
        return self.finish(context, avatar, names)


class GRMM_OT_random_identity(Edit, bpy.types.Operator):
    """Give the active avatar another face by its identity controls."""

    bl_idname = "grmm.random_identity"
    bl_label = "Random Identity"
    bl_description = (
        "Move the active avatar's identity controls towards a random person: shape, and residual identity where there is a "
        "runtime"
    )

    seed: bpy.props.IntProperty(name="Seed", description="Number of the person", default=1, min=0)
    amount: bpy.props.FloatProperty(
        name="Amount",
        description="0 is the avatar itself, 1 the random person",
        default=1.0,
        min=0.0,
        max=1.5,
        subtype="FACTOR",
    )

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Another person each time."""
        if not self.properties.is_property_set("seed"):
            self.seed = int(np.random.default_rng().integers(1, 1 << 20))
        return self.execute(context)

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Draw a person."""
        avatar = active_avatar(context)
        shape = np.zeros(len(avatar.object[SHAPE]), np.float32)
        names = [SHAPE]
        people = self._people(avatar)
        if people is None:
            count = min(_RANDOM_SHAPE_COUNT, shape.size)
            shape[:count] = np.random.default_rng(self.seed).standard_normal(count)
        else:
            person, opened = people
            own = read_identity(avatar.source)
            shape = person.shape[: shape.size] - np.pad(own.shape, (0, shape.size))[: shape.size]
            if person.z_id_size == len(avatar.object[Z_ID]) == opened.z_id_size:
                self._set(avatar, Z_ID, person.z_id - opened.z_id)
                names.append(Z_ID)
        self._set(avatar, SHAPE, shape)
        return self.finish(context, avatar, names)

    def _people(self, avatar: Avatar) -> tuple[AvatarInfo, AvatarInfo] | None:
        """The random person and the avatar itself; None where nothing runs the model, or no network draws the head."""
        if not avatar.has_network:
            return None
        try:
            return session_host.open_avatar(f"{session_host.SAMPLE_PREFIX}{self.seed}"), session_host.open_avatar(avatar.source)
        except RuntimeMissingError:
            return None

    def _set(self, avatar: Avatar, name: str, values: np.ndarray) -> None:
        limits = ARRAY_RANGES[name]
        avatar.object[name] = (values * self.amount).clip(limits.low, limits.high).tolist()


class GRMM_OT_make_independent(bpy.types.Operator):
    """Give a linked duplicate of a head its own mesh."""

    bl_idname = "grmm.make_independent"
    bl_label = "Make Independent"
    bl_description = "Give this head a mesh of its own, so that its sliders move it and not the head it was duplicated from"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Only for heads that follow another one."""
        if not needs_avatar(cls, context):
            return False
        avatar = active_avatar(context)
        if avatar.mesh_owner in (None, avatar.object):
            cls.poll_message_set("This head has a mesh of its own")
            return False
        return True

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Copy the mesh."""
        avatar = active_avatar(context)
        make_independent(avatar)
        problem = live.limitation(avatar)
        if problem:
            raise GrmmError(problem)
        return {"FINISHED"}


CLASSES = (
    GRMM_OT_reset,
    GRMM_OT_mirror,
    GRMM_OT_random_expression,
    GRMM_OT_random_identity,
    GRMM_OT_make_independent,
)
