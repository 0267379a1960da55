"""From moving features to keys: what they do in the scene's frames becomes keys of sliders and bones, and they go."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.controls.control import Control
from ...grmm_core.controls.names import JOINT_NAMES
from ...grmm_core.controls.table import CONTROLS
from ...grmm_core.performance.curves import DEFAULT_ANGLE_ERROR, DEFAULT_DISTANCE_ERROR, DEFAULT_ERROR, reduce_curves
from ..rig.actions import ensure_bag, find_curve, reduced_keys, replace_keys
from ..rig.armature import ROOT, root_offset
from ..rig.avatar import Avatar
from ..rig.custom_properties import property_path
from ..rig.layers import layer_name, layer_properties
from . import parts

_FINER = 0.1  # of the errors that recordings are reduced with: a blink is short, and breathing small


@dataclass(frozen=True)
class _Channel:
    """A curve to write: of an object, for a property or a bone's channel, with the largest error."""

    owner: bpy.types.Object
    path: str
    index: int
    group: str
    error: float


def bake(context: bpy.types.Context, avatar: Avatar, feature: str) -> int:
    """Key what a feature does in the frames of the scene, on top of what is keyed; it still does it, so remove it then.

    Returns:
        Number of curves.
    """
    scene, shown, rig = context.scene, context.scene.frame_current_final, parts.rig_of(avatar)
    names = [name for name, layer in layer_properties(avatar.object) if layer == feature]
    joints = {"look": ("neck", "left_eye", "right_eye"), "breath": ("neck",)}.get(feature, ())
    channels = [_expression(avatar, CONTROLS[name]) for name in names]
    for joint in joints:
        path = rig.pose.bones[joint].path_from_id("rotation_euler")
        channels += [_Channel(rig, path, axis, CONTROLS[joint].group, DEFAULT_ANGLE_ERROR) for axis in range(3)]
    if feature == "breath":
        path = rig.pose.bones[ROOT].path_from_id("location")
        channels += [_Channel(rig, path, axis, CONTROLS[ROOT].group, DEFAULT_DISTANCE_ERROR) for axis in range(3)]
    frames = np.arange(scene.frame_start, scene.frame_end + 1)
    rows = []
    for frame in frames.tolist():
        scene.frame_set(frame)
        rows.append(_values(context.evaluated_depsgraph_get(), avatar, feature, names, joints))
    scene.frame_set(int(shown), subframe=shown % 1.0)
    values = np.array(rows)
    errors = np.array([channel.error for channel in channels]) * _FINER
    fps = scene.render.fps / scene.render.fps_base
    curves = reduce_curves((frames - frames[0]) / fps, values, errors)
    for channel, curve in zip(channels, curves, strict=True):
        bag = ensure_bag(channel.owner, f"{avatar.object.name} action")
        keys = reduced_keys(curve, float(frames[0]), fps)
        replace_keys(find_curve(bag, channel.path, channel.index, channel.group), keys, (float(frames[0]), float(frames[-1])))
    return len(channels)


def _expression(avatar: Avatar, control: Control) -> _Channel:
    return _Channel(avatar.object, property_path(control.name), 0, control.group, DEFAULT_ERROR)


def _values(
    depsgraph: bpy.types.Depsgraph, avatar: Avatar, feature: str, names: list[str], joints: tuple[str, ...]
) -> list[float]:
    """Present values of the channels with the feature's part, without that of others."""
    head, rig = avatar.object.evaluated_get(depsgraph), parts.rig_of(avatar).evaluated_get(depsgraph)
    found = [float(head[name]) + float(head[layer_name(name, feature)]) for name in names]
    chest = rig.pose.bones.get("MCH-breath")
    breath = np.zeros((2, 3)) if chest is None else np.array([chest.rotation_euler, chest.location])
    pose = avatar.controls(depsgraph).pose
    for joint in joints:
        own = np.array(rig.pose.bones[joint].rotation_euler)
        turned = pose[JOINT_NAMES.index(joint)] - (breath[0] if joint == "neck" else 0.0)
        found += (turned if feature == "look" else own + breath[0]).tolist()
    if feature == "breath":
        found += root_offset(rig.pose.bones[ROOT]).to_tuple()
    return found
