"""From a recorded performance to curves on an avatar's rig. Called by the import operator.

Weights become curves of the head object's properties, rotations curves of the armature's bones; both live in one action with
a slot each, so that a performance is one thing in the action editor and can be put on another avatar.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import bpy
import numpy as np

from ..grmm_core.errors import ConfigError, FileFormatError
from ..grmm_core.expressions import ARKIT_NAMES
from ..grmm_core.performance import Performance
from .avatar import Avatar
from .rig.actions import ensure_bag, set_keys
from .rig.definitions import ALIGNED_RANGE, ARRAY_RANGES, EXPRESSION, REGIONS, property_path

EyeSource = Literal["AUTO", "SHAPES", "ROTATIONS"]
_EYE_SHAPES = "eyeLook"
_EYES = {"left_eye": "left_eye_rotation", "right_eye": "right_eye_rotation"}
_REGION_OF = {name: region for region, names in REGIONS.items() for name in names}
MAX_FRAME = 1_048_574  # Blender's last frame


@dataclass(frozen=True)
class ImportOptions:
    """How a performance becomes keys.

    Attributes:
        start: Scene frame of the recording's start.
        fps: Scene frames per second.
        whole_frames: One key on each scene frame, interpolated between samples; else one key for each sample.
        gain: Factor of the weights.
        rotation_gain: Factor of head and joint rotations.
        head_joint: Bone that takes the rotation of the head; "" for none.
        eyes: Take the eyes from the eyeLook shapes, from the recorded rotations, or from whichever the file has.
    """

    start: float = 1.0
    fps: float = 24.0
    whole_frames: bool = True
    gain: float = 1.0
    rotation_gain: float = 1.0
    head_joint: str = "neck"
    eyes: EyeSource = "AUTO"


@dataclass(frozen=True)
class Channel:
    """One curve: values at the samples' times.

    Attributes:
        bone: Bone whose rotation it is, or "" for a property of the head object.
        path: Data path on the armature or head object.
        index: Index in the property.
        group: Channel group.
        values: [T].
    """

    bone: str
    path: str
    index: int
    group: str
    values: np.ndarray


def channels_of(performance: Performance, options: ImportOptions, flame_head: bool = False) -> list[Channel]:
    """Return the curves that a performance gives.

    Args:
        performance: What was read.
        options: What to take, and gains.
        flame_head: The avatar's head model understands FLAME's expression coefficients.

    Raises:
        FileFormatError: The performance is for another head model, or holds nothing that can be used.
    """
    if performance.expression is not None and not flame_head:
        raise FileFormatError(
            "The performance has FLAME expression coefficients, which the open head does not have; choose ARKit weights."
        )
    has_shapes = any(name.startswith(_EYE_SHAPES) for name in performance.found)
    has_rotations = performance.left_eye_rotation is not None or performance.right_eye_rotation is not None
    rotate_eyes = has_rotations and (options.eyes == "ROTATIONS" or (options.eyes == "AUTO" and not has_shapes))
    result: list[Channel] = []
    for k, name in enumerate(ARKIT_NAMES):
        if name in performance.found and not (rotate_eyes and name.startswith(_EYE_SHAPES)):
            values = (performance.weights[:, k] * options.gain).clip(ALIGNED_RANGE.low, ALIGNED_RANGE.high)
            result.append(Channel("", property_path(name), 0, _REGION_OF[name], values))
    if performance.expression is not None:
        limits = ARRAY_RANGES[EXPRESSION]
        for k, values in enumerate(performance.expression.T):
            clipped = (values * options.gain).clip(limits.low, limits.high)
            result.append(Channel("", property_path(EXPRESSION), k, "Expression", clipped))
    for bone, angles in _rotations(performance, options, rotate_eyes).items():
        path = f'pose.bones["{bone}"].rotation_euler'
        result += [Channel(bone, path, axis, bone, angles[:, axis] * options.rotation_gain) for axis in range(3)]
    if not result:
        raise FileFormatError("The performance holds nothing that this head can play; choose a file with ARKit weights.")
    return result


def sample_frames(performance: Performance, options: ImportOptions) -> tuple[np.ndarray, np.ndarray]:
    """Return the scene frames of the samples [T], and those that get keys [K].

    Raises:
        ConfigError: The performance would end behind Blender's last frame.
    """
    frames = options.start + (performance.times - performance.times[0]) * options.fps
    if abs(frames).max() > MAX_FRAME:
        raise ConfigError(f"The performance would end at frame {frames[-1]:.0f}, beyond Blender's last; start it earlier.")
    if not options.whole_frames:
        return frames, frames
    # a recording that ends within a rounding error of a frame still has that frame
    keys = np.arange(np.ceil(frames[0] - 1e-4), np.floor(frames[-1] + 1e-4) + 1.0)
    return frames, keys if keys.size else frames[:1]


def apply_performance(avatar: Avatar, performance: Performance, options: ImportOptions, name: str) -> tuple[float, float]:
    """Write a performance as keys; keys of the same curves at other times stay.

    Args:
        avatar: Whose rig plays it.
        performance: What was read.
        options: How.
        name: Name of a new action.

    Returns:
        First and last frame with a key.

    Raises:
        FileFormatError, ConfigError: See `channels_of` and `sample_frames`.
    """
    channels = channels_of(performance, options, flame_head=avatar.object.grmm.head_name.startswith("flame"))
    frames, keys = sample_frames(performance, options)
    head_bag = ensure_bag(avatar.object, name)
    rig = avatar.armature
    rig_bag = None
    if rig is not None and any(channel.bone for channel in channels):
        has_own = rig.animation_data is not None and rig.animation_data.action is not None
        rig_bag = ensure_bag(rig, name, None if has_own else avatar.object.animation_data.action)
    for channel, bag in _placed(channels, head_bag, rig_bag):
        values = channel.values if keys is frames else np.interp(keys, frames, channel.values)
        set_keys(bag, channel.path, channel.index, keys, values, channel.group)
    return float(keys[0]), float(keys[-1])


def _placed(
    channels: list[Channel], head: bpy.types.ActionChannelbag, rig: bpy.types.ActionChannelbag | None
) -> Iterator[tuple[Channel, bpy.types.ActionChannelbag]]:
    for channel in channels:
        bag = rig if channel.bone else head
        if bag is not None:
            yield channel, bag


def _rotations(performance: Performance, options: ImportOptions, rotate_eyes: bool) -> dict[str, np.ndarray]:
    """Bone to Euler angles in radians, [T, 3]; a head rotation is added to one of the neck."""
    found: dict[str, np.ndarray] = {}
    sources = {"neck": performance.neck_rotation, "jaw": performance.jaw_rotation}
    if rotate_eyes:
        sources |= {bone: getattr(performance, name) for bone, name in _EYES.items()}
    for bone, angles in sources.items():
        if angles is not None:
            found[bone] = np.asarray(angles, np.float64)
    if performance.head_rotation is not None and options.head_joint:
        found[options.head_joint] = found.get(options.head_joint, 0.0) + np.asarray(performance.head_rotation, np.float64)
    return found
