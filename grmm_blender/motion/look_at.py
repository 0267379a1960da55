"""Look At: eyes and, for its part, the neck follow an object within natural ranges, by constraints alone.

Mechanism bones aim at the target and are held within the ranges; the eyes and the neck copy them on top of what turns them
otherwise, so keys of their own still count. The upper lids go with the eyes as they do where a shape turns these.
"""

from __future__ import annotations

import math
from dataclasses import replace

import bpy
from mathutils import Matrix, Vector

from ...grmm_core.controls.control import Control, Limits
from ...grmm_core.session import HEAD_TO_BLENDER
from ..linking import link_beside
from ..rig.armature import EXTRA, MECHANISM_COLLECTION, SHIFT_PREFIX, rest_joints
from ..rig.avatar import Avatar, avatar_of, is_avatar
from ..rig.custom_properties import add_property, property_path
from ..rig.drivers import drive_sum
from ..rig.layers import add_hidden, layer_name, remove_properties
from ..rig.left_rigs import remove_unused
from . import lids, parts

LAYER = "look"
_NAME = "Look At"
FACE, GAZE = f"{SHIFT_PREFIX}face", f"{SHIFT_PREFIX}gaze"
_EYES = ("left_eye", "right_eye")
_RANGES = {  # degrees about x (down is positive) and to either side
    GAZE: ((-40.0, 40.0), 70.0),
    **{f"{SHIFT_PREFIX}gaze_{eye}": ((-25.0, 30.0), 35.0) for eye in _EYES},
}
_LIDS = ((-25.0, -0.2), (0.0, 0.0), (30.0, 0.55))  # degrees of the eye, weight of its blink: as eyeLookUp and eyeLookDown do
_AHEAD = 0.7  # metres from the eyes to a new target
_LENGTH = 0.02  # metres, of the mechanism bones

INFLUENCE = Control(
    "look_at", "Influence", "How much eyes and neck follow the Look At target", "POSE", Limits(0.0, 1.0, 0.0, 1.0), "share",
    rest=1.0,
)  # fmt: skip
NECK = replace(INFLUENCE, name="look_at_neck", label="Neck", description="Share of the turn that the neck takes", rest=0.4)


def is_present(avatar: Avatar) -> bool:
    """Whether a head can follow a target."""
    rig = avatar.armature
    return rig is not None and GAZE in rig.pose.bones


def add(context: bpy.types.Context, avatar: Avatar) -> None:
    """Let a head follow the other selected object, or a new empty in front of it. Raises `GrmmError`."""
    rig, obj, head = parts.rig_of(avatar), avatar.object, parts.head_of(avatar)
    others = [found for found in context.selected_objects if may_be_target(avatar, found)]
    joints = [Vector(joint) for joint in rest_joints(rig).tolist()]
    eyes = dict(zip(_EYES, joints[3:], strict=True))
    middle = (joints[3] + joints[4]) / 2
    bones = [(FACE, f"{SHIFT_PREFIX}neck", middle), (GAZE, FACE, middle)]
    bones += [(f"{GAZE}_{eye}", SHIFT_PREFIX + eye, place) for eye, place in eyes.items()]
    parts.add_bones(
        context, rig, LAYER, [parts.NewBone(name, parent, at, _LENGTH, MECHANISM_COLLECTION) for name, parent, at in bones]
    )
    for control in (INFLUENCE, NECK):
        add_property(obj, control)
    for name, (pitch, yaw) in _RANGES.items():
        _aim(rig, obj, name, pitch, yaw)
    turned = parts.add_constraint(rig, "neck", "COPY_ROTATION", _NAME, GAZE)
    drive_sum(turned, "influence", -1, obj, [property_path(NECK.name)])
    for eye in _EYES:
        parts.add_constraint(rig, eye, "COPY_ROTATION", _NAME, f"{GAZE}_{eye}")
        share = layer_name(lids.BLINKS[eye], LAYER)
        add_hidden(obj, (share, lids.asked(share)))
        points = [(math.radians(angle), weight) for angle, weight in _LIDS]
        parts.bend(parts.drive_by_bone(obj, lids.asked(share), rig, f"{GAZE}_{eye}", "ROT_X"), points)
    lids.layers_changed(avatar, head)
    obj.grmm_motion.look_at = others[0] if len(others) == 1 else _new_target(avatar)
    _followers_look_again(avatar)


def remove(context: bpy.types.Context, avatar: Avatar) -> None:
    """Take everything away; also the target where it was made for this head and nothing else uses it. Raises `GrmmError`."""
    rig, obj = parts.rig_of(avatar), avatar.object
    parts.remove_constraints(rig, _NAME)
    parts.remove_bones(context, rig, LAYER)
    remove_properties(obj, (INFLUENCE.name, NECK.name))
    lids.remove_layer(avatar, LAYER)
    obj.grmm_motion.look_at = None
    _followers_look_again(avatar)
    remove_unused()


def may_be_target(avatar: Avatar, obj: bpy.types.Object) -> bool:
    """Whether a head can follow an object: not itself, its rig, or what hangs on them."""
    while obj is not None:
        if obj in (avatar.object, avatar.armature):
            return False
        obj = obj.parent
    return True


def follow(avatar: Avatar, target: bpy.types.Object | None) -> None:
    """Aim at an object; at the face of a head, where it is one."""
    other = avatar_of(target)
    bone = ""
    if other is not None and other.armature is not None:
        target = other.armature
        bone = FACE if FACE in target.pose.bones else "left_eye"
    for name in _RANGES if is_present(avatar) else ():
        constraint = avatar.bones[name].constraints[_NAME]
        constraint.target, constraint.subtarget = target, bone


def _followers_look_again(avatar: Avatar) -> None:
    """Aim the heads that look at this one at what is its face now.

    It is a bone that nothing of Look At moves, so that two heads can look at each other without a loop.
    """
    for obj in bpy.data.objects:
        if is_avatar(obj) and obj.grmm_motion.look_at in (avatar.object, avatar.armature):
            follow(Avatar(obj), obj.grmm_motion.look_at)


def _aim(rig: bpy.types.Object, obj: bpy.types.Object, name: str, pitch: tuple[float, float], yaw: float) -> None:
    """Have a mechanism bone look at the target, as far as its range goes."""
    track = parts.add_constraint(rig, name, "DAMPED_TRACK", _NAME)
    track.track_axis = "TRACK_Z"
    drive_sum(track, "influence", -1, obj, [property_path(INFLUENCE.name)])
    limit = parts.add_constraint(rig, name, "LIMIT_ROTATION", f"{_NAME} Range")
    for axis, (low, high) in zip("xyz", (pitch, (-yaw, yaw), (-15.0, 15.0)), strict=True):
        setattr(limit, f"use_limit_{axis}", True)
        setattr(limit, f"min_{axis}", math.radians(low))
        setattr(limit, f"max_{axis}", math.radians(high))


def _new_target(avatar: Avatar) -> bpy.types.Object:
    """Return a new empty before the eyes, beside the rig in its collections."""
    rig = parts.rig_of(avatar)
    target = bpy.data.objects.new(f"{avatar.object.name} Look At", None)
    target.empty_display_type, target.empty_display_size = "SPHERE", 0.03
    target[EXTRA] = LAYER
    link_beside(target, rig)
    middle = sum((Vector(joint) for joint in rest_joints(rig)[3:].tolist()), Vector()) / 2
    target.location = rig.matrix_world @ Matrix(HEAD_TO_BLENDER.tolist()) @ (middle + Vector((0.0, 0.0, _AHEAD)))
    return target
