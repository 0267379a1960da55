"""Blinking and breathing: generated actions on NLA tracks of their own, over whatever is keyed.

The track adds to properties and bones that nothing else animates, and layers carry it to the face; so no key of the animator's
is touched, in whatever action it is, and strips can be moved, muted, scaled and faded like any other. The same seed and rate
give the same keys.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from ...grmm_core.controls.control import Control, Limits
from ...grmm_core.performance.idle import LOOP, blinks, breaths
from ..rig.actions import Keys, find_curve, replace_keys, slot_bag
from ..rig.armature import EXTRA, MECHANISM_COLLECTION, ROOT, SHIFT_PREFIX, rest_joints
from ..rig.avatar import Avatar
from ..rig.custom_properties import add_property, property_path
from ..rig.layers import add_hidden, layer_name, remove_properties
from ..rig.left_rigs import remove_unused
from . import lids, parts

BLINK, BREATH = "blink", "breath"
_TRACKS = {BLINK: "GRMM Blinking", BREATH: "GRMM Breathing"}
_CHEST = f"{SHIFT_PREFIX}breath"
_RISE, _LIFT = 0.002, -0.01  # metres that a full breath lifts the shoulders, radians that it turns the neck up
_BREATHED = {"noseSneerLeft": 0.06, "noseSneerRight": 0.06, "jawOpen": 0.015}  # weights of a full breath
_LEAST_MINUTES = 20.0  # that a track goes on beyond the scene's last frame, so that a longer scene blinks too
_EASE = 0.4  # of a segment: the length of the flat handles
_BLINK_CONTROL = Control(
    lids.BLINK,
    "Blink",
    "Closes both eyes, on top of what closes them otherwise",
    "EXPRESSION",
    Limits(0.0, 1.0, 0.0, 1.0),
    "weight",
)


def strip_of(avatar: Avatar, feature: str) -> bpy.types.NlaStrip | None:
    """The strip of a generated motion, or None."""
    owner = avatar.object if feature == BLINK else avatar.armature
    data = owner.animation_data if owner is not None else None
    track = data.nla_tracks.get(_TRACKS[feature]) if data is not None else None
    return track.strips[0] if track is not None and track.strips else None


def add_blink(context: bpy.types.Context, avatar: Avatar) -> None:
    """Let a head blink. Raises `GrmmError`."""
    parts.rig_of(avatar)
    obj = avatar.object
    add_property(obj, _BLINK_CONTROL)
    add_hidden(obj, [layer_name(name, BLINK) for name in lids.BLINKS.values()])
    lids.layers_changed(avatar, parts.head_of(avatar))
    generate(context.scene, avatar, BLINK)


def add_breath(context: bpy.types.Context, avatar: Avatar) -> None:
    """Let a head breathe. Raises `GrmmError`."""
    rig, obj = parts.rig_of(avatar), avatar.object
    root = Vector(rest_joints(rig)[0].tolist())
    chest = parts.NewBone(_CHEST, SHIFT_PREFIX + ROOT, root, 0.02, MECHANISM_COLLECTION)
    parts.add_bones(context, rig, BREATH, [chest])
    parts.add_constraint(rig, "neck", "COPY_ROTATION", _TRACKS[BREATH], _CHEST)
    parts.add_constraint(rig, ROOT, "COPY_LOCATION", _TRACKS[BREATH], _CHEST).use_offset = True
    for name, weight in _BREATHED.items():
        share = layer_name(name, BREATH)
        add_hidden(obj, [share])
        parts.slope(parts.drive_by_bone(obj, share, rig, _CHEST, "LOC_Y"), weight / _RISE, 0.0, 2.0 * weight)
    lids.layers_changed(avatar, parts.head_of(avatar))
    generate(context.scene, avatar, BREATH)


def remove(context: bpy.types.Context, avatar: Avatar, feature: str) -> None:
    """Take a motion away, with its track and its bone. Raises `GrmmError`."""
    rig, obj = parts.rig_of(avatar), avatar.object
    owner = obj if feature == BLINK else rig
    track = owner.animation_data.nla_tracks.get(_TRACKS[feature]) if owner.animation_data is not None else None
    if track is not None:
        owner.animation_data.nla_tracks.remove(track)
    parts.remove_constraints(rig, _TRACKS[feature])
    parts.remove_bones(context, rig, feature)
    if feature == BLINK:
        remove_properties(obj, [lids.BLINK])
    lids.remove_layer(avatar, feature)
    remove_unused()


def generate(scene: bpy.types.Scene, avatar: Avatar, feature: str) -> None:
    """Make a motion's action as the avatar's settings say, on its track; a strip keeps its place and influence."""
    settings, fps = avatar.object.grmm_motion, scene.render.fps / scene.render.fps_base
    owner = avatar.object if feature == BLINK else parts.rig_of(avatar)
    action = bpy.data.actions.new(f"{avatar.object.name} {_TRACKS[feature].removeprefix('GRMM ')}")
    action[EXTRA] = feature
    slot = action.slots.new(owner.id_type, owner.name)
    bag = slot_bag(action, slot)
    for curve in _curves(settings, feature, owner):
        keys = _eased(curve.values * (fps, curve.scale))
        replace_keys(find_curve(bag, curve.path, curve.index, _TRACKS[feature]), keys, (0.0, 0.0))
    strip = strip_of(avatar, feature) or _new_strip(scene, owner, feature, action)
    strip.action = action
    strip.action_slot = slot
    strip.action_frame_start, strip.action_frame_end = 0.0, LOOP * fps
    wanted = max(scene.frame_end - strip.frame_start, 0.0) + _LEAST_MINUTES * 60.0 * fps
    strip.repeat = max(strip.repeat, math.ceil(wanted / (LOOP * fps)))
    owner.update_tag()
    remove_unused()


@dataclass(frozen=True)
class _Curve:
    path: str
    index: int
    scale: float
    values: np.ndarray  # seconds and shares, [K, 2]


def _curves(settings: bpy.types.PropertyGroup, feature: str, owner: bpy.types.Object) -> list[_Curve]:
    if feature == BLINK:
        return [_Curve(property_path(lids.BLINK), 0, settings.blink_strength, blinks(settings.blink_rate, settings.seed))]
    bone, values = owner.pose.bones[_CHEST].path_from_id(), breaths(settings.breath_rate, settings.seed)
    channels = (("location", 1, _RISE), ("rotation_euler", 0, _LIFT))
    return [_Curve(f"{bone}.{name}", index, full * settings.breath_strength, values) for name, index, full in channels]


def _eased(points: np.ndarray) -> Keys:
    """Keys [K, 2] with flat handles."""
    reach = np.zeros_like(points)
    reach[1:, 0] = np.diff(points[:, 0]) * _EASE
    ahead = np.zeros_like(points)
    ahead[:-1, 0] = reach[1:, 0]
    return Keys(points, points - reach, points + ahead, "BEZIER")


def _new_strip(scene: bpy.types.Scene, owner: bpy.types.Object, feature: str, action: bpy.types.Action) -> bpy.types.NlaStrip:
    track = owner.animation_data_create().nla_tracks.new()
    track.name = _TRACKS[feature]
    strip = track.strips.new(_TRACKS[feature], min(scene.frame_start, 1), action)
    strip.blend_type, strip.extrapolation = "ADD", "HOLD"
    return strip
