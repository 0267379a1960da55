"""From a recorded performance to curves on an avatar's rig. Called by the import operator.

Weights become curves of the head object's properties, rotations curves of the armature's bones; both live in one action with
a slot each, so that a performance is one thing in the action editor and can be put on another avatar.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Literal

import bpy
import numpy as np

from ..grmm_core.avatar import AssetReference
from ..grmm_core.controls.frame import Controls
from ..grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES
from ..grmm_core.controls.table import CONTROLS, EXPRESSION
from ..grmm_core.errors import ConfigError, FileFormatError, GrmmError
from ..grmm_core.jobs.progress import Share, nobody, within
from ..grmm_core.performance import CleanOptions, Performance, clean, to_arkit
from ..grmm_core.performance.closures import LipModel, keep_lips_closed, lip_model
from ..grmm_core.performance.curves import DEFAULT_ANGLE_ERROR, reduce_curves
from . import session_host
from .rig.actions import ensure_bag, find_curve, linear_keys, put_aside, reduced_keys, replace_keys
from .rig.avatar import Avatar
from .rig.custom_properties import property_path
from .rig.identity import load_head
from .rig.mesh import gain_of
from .splats.cloud import resting_positions

if TYPE_CHECKING:
    from ..grmm_core.head import HeadModel
    from .splats.rigged import Puppet

EyeSource = Literal["AUTO", "SHAPES", "ROTATIONS"]
Keys = Literal["FRAMES", "REDUCED", "SAMPLES"]
Present = Literal["KEEP", "ADD", "PUSH_DOWN", "WRITE_INTO"]
_PUSHED = {"ADD": "ADD", "PUSH_DOWN": "REPLACE"}  # how the new action blends with what is pushed down
_EYE_SHAPES = "eyeLook"
_EYES = {"left_eye": "left_eye_rotation", "right_eye": "right_eye_rotation"}
MAX_FRAME = 1_048_574  # Blender's last frame
NEEDS_FLAME = (
    "The performance has FLAME expression coefficients, which this head does not have; "
    "choose your own FLAME file in the import options to turn them into ARKit weights."
)
_FRAMES = re.compile(r"([0-9]{1,7})(?:\s*-\s*([0-9]{1,7}))?")
_MAX_NEUTRAL = 100_000
_PREPARED, _REDUCED = 0.4, 0.8  # of the progress


@dataclass(frozen=True)
class ImportOptions:
    """How a performance becomes keys.

    Attributes:
        start: Scene frame of the recording's start.
        fps: Scene frames per second.
        keys: One on each scene frame, as few as `max_error` allows, or one for each recorded sample.
        max_error: Largest deviation of a weight for reduced keys.
        gain: Factor of the weights.
        region_gains: Further factors by region of `grmm_core.performance.REGIONS`.
        rotation_gain: Factor of all rotations.
        neutral: Frames of the recording in which the actor rests, counted from 0; "auto" finds them; None takes nothing off.
        smoothing: 0..1.
        limit: Keep weights within 0..1.
        close_lips: Close the lips where the recording, without calibration, gain and smoothing, closes them.
        offset: Seconds by which everything is moved against `start`.
        first, last: Seconds of the recording to use; no `last` for all.
        angle_error: Largest deviation of an angle for reduced keys, radians.
        head_joint: Bone that takes the rotation of the head; "" for none.
        eyes: Take the eyes from the eyeLook shapes, from the recorded rotations, or from whichever the file has.
        present: What becomes of the action that is there: kept unused, pushed down to a track and added to, pushed down and
            replaced where both say something, or written into.
    """

    start: float = 1.0
    fps: float = 24.0
    keys: Keys = "FRAMES"
    max_error: float = 0.01
    gain: float = 1.0
    region_gains: Mapping[str, float] = field(default_factory=dict)
    rotation_gain: float = 1.0
    neutral: Sequence[int] | Literal["auto"] | None = None
    smoothing: float = 0.0
    limit: bool = True
    close_lips: bool = True
    offset: float = 0.0
    first: float = 0.0
    last: float | None = None
    angle_error: float = DEFAULT_ANGLE_ERROR
    head_joint: str = "neck"
    eyes: EyeSource = "AUTO"
    present: Present = "KEEP"


@dataclass(frozen=True)
class Channel:
    """One curve.

    Attributes:
        bone: Bone whose rotation it is, or "" for a property of the head object.
        path: Data path on the armature or head object.
        index: Index in the property.
        group: Channel group.
        limits: Range of the property.
        values: Values at the performance's times, [T].
    """

    bone: str
    path: str
    index: int
    group: str
    limits: tuple[float, float]
    values: np.ndarray

    @property
    def property_name(self) -> str:
        """Name of the head object's property, "" for a bone."""
        return "" if self.bone else self.path.split('"')[1]


def prepare(performance: Performance, options: ImportOptions, progress: Share | None = None) -> Performance:
    """Clean a recording as the options say; at the scene's rate, unless every sample gets a key. Raises `ShapeError`."""
    gains = {name: gain for name, gain in {"all": options.gain, **options.region_gains}.items() if gain != 1.0}
    wanted = CleanOptions(
        start=options.first,
        end=options.last,
        neutral=options.neutral,
        gains=gains,
        smoothing=options.smoothing,
        fps=None if options.keys == "SAMPLES" else options.fps,
        limit=options.limit,
    )
    return clean(performance, wanted, progress)


def closed_lips(avatar: Avatar, prepared: Performance, performance: Performance, options: ImportOptions) -> Performance:
    """Return prepared frames whose lips touch wherever the recording lets this avatar's lips touch."""
    as_recorded = replace(options, neutral=None, gain=1.0, region_gains={}, smoothing=0.0)
    if not performance.recorded_shapes or as_recorded == options:
        return prepared
    try:
        head = load_head(AssetReference(avatar.object.grmm.head_name))
    except GrmmError:
        return prepared  # the rig says so itself
    lips = _learned_lips(avatar, head)
    if lips is None:
        resting = resting_positions(avatar.object.data)
        gain = gain_of(avatar.object, head)
        lips = lip_model(head, gain, np.stack([resting[:, 0], resting[:, 2], -resting[:, 1]], -1))
    return keep_lips_closed(prepared, prepare(performance, as_recorded), lips)


def _learned_lips(avatar: Avatar, head: HeadModel) -> LipModel | None:
    """Lips of the avatar with the learned displacement, where the mesh shows it; it moves lips with every expression."""
    if not (avatar.has_network and avatar.object.grmm.live_detail):
        return None
    aligned = np.zeros(len(ALIGNED_NAMES), np.float32)
    try:
        session, number = session_host.get_session(), session_host.open_avatar(avatar.source).id

        def posed(weights: np.ndarray) -> np.ndarray:
            aligned[: len(ARKIT_NAMES)] = weights
            return session.deform(number, Controls(aligned=aligned)).vertices

        return lip_model(head, gain_of(avatar.object, head), posed=posed)
    except GrmmError:
        return None  # there is nothing to run the model: the mesh is the head model alone


def parse_frames(text: str) -> tuple[int, ...]:
    """Return the frame numbers of a list such as "0, 12-15". Raises `ConfigError` for anything else."""
    frames: list[int] = []
    for part in filter(None, (part.strip() for part in text.split(","))):
        match = _FRAMES.fullmatch(part)
        low, high = (int(match[1]), int(match[2] or match[1])) if match else (1, 0)
        if high < low or high - low > _MAX_NEUTRAL:
            raise ConfigError(f"{part[:40]!r} is no frame number and no range of frames; write something like 0, 12-15.")
        frames.extend(range(low, high + 1))
    if not frames:
        raise ConfigError("No neutral frames are named; write something like 0, 12-15.")
    return tuple(frames)


def for_head(performance: Performance, flame_head: bool, flame: HeadModel | None, progress: Share | None) -> Performance:
    """Return a performance that a head can play: FLAME's coefficients become ARKit weights for any other head.

    Args:
        performance: As read.
        flame_head: The head understands FLAME's coefficients.
        flame: The user's FLAME head, which says what they mean; None where none was named.
        progress: Called with the fraction done.

    Raises:
        FileFormatError: FLAME's coefficients, and no FLAME head to understand them by.
    """
    if performance.expression is None or flame_head:
        return performance
    if flame is None:
        raise FileFormatError(NEEDS_FLAME)
    return to_arkit(performance, flame, progress)


def channels_of(performance: Performance, options: ImportOptions, flame_head: bool = False) -> list[Channel]:
    """Return the curves that a prepared performance gives.

    Args:
        performance: Of `prepare`.
        options: What to take.
        flame_head: The avatar's head model understands FLAME's expression coefficients.

    Raises:
        FileFormatError: The performance is for another head model, or holds nothing that can be used.
    """
    if performance.expression is not None and not flame_head:
        raise FileFormatError(NEEDS_FLAME)
    has_shapes = any(name.startswith(_EYE_SHAPES) for name in performance.recorded_shapes)
    has_rotations = performance.left_eye_rotation is not None or performance.right_eye_rotation is not None
    rotate_eyes = has_rotations and (options.eyes == "ROTATIONS" or (options.eyes == "AUTO" and not has_shapes))
    result: list[Channel] = []
    for k, name in enumerate(ARKIT_NAMES):
        if name in performance.recorded_shapes and not (rotate_eyes and name.startswith(_EYE_SHAPES)):
            result.append(_property_channel(name, 0, performance.weights[:, k]))
    if performance.expression is not None:
        for k, values in enumerate(performance.expression.T):
            result.append(_property_channel(EXPRESSION, k, values * options.gain))
    for bone, angles in _rotations(performance, options, rotate_eyes).items():
        path = f'pose.bones["{bone}"].rotation_euler'
        for axis in range(3):
            result.append(Channel(bone, path, axis, bone, (-np.inf, np.inf), angles[:, axis] * options.rotation_gain))
    if not result:
        raise FileFormatError("The performance holds nothing that this head can play; choose a file with ARKit weights.")
    return [replace(channel, values=np.clip(channel.values, *channel.limits)) for channel in result]


def _property_channel(name: str, index: int, values: np.ndarray) -> Channel:
    control = CONTROLS[name]
    return Channel("", property_path(name), index, control.group, (control.limits.low, control.limits.high), values)


def apply_performance(
    avatar: Avatar | Puppet, performance: Performance, options: ImportOptions, name: str, progress: Share | None = None
) -> ImportedRange:
    """Write a performance as keys of a new action, or of the present one, whose keys at other times stay.

    Args:
        avatar: Whose rig plays it; channels that it does not have are left out.
        performance: As read.
        options: How.
        name: Name of a new action.
        progress: Called with the fraction done.

    Raises:
        FileFormatError, ShapeError: See `channels_of` and `prepare`.
        ConfigError: The performance would end behind Blender's last frame.
    """
    report = progress or nobody
    prepared = prepare(performance, options, within(report, 0.0, _PREPARED))
    if options.close_lips and isinstance(avatar, Avatar):
        prepared = closed_lips(avatar, prepared, performance, options)
    channels = channels_of(prepared, options, flame_head=avatar.object.grmm.head_name.startswith("flame"))
    channels = [channel for channel in channels if channel.bone or channel.property_name in avatar.object]
    if not channels:
        raise FileFormatError(f"{avatar.object.name} has none of the controls that the performance moves; choose another file.")
    seconds = prepared.times - prepared.times[0]
    start = options.start + options.offset * options.fps
    frames = start + seconds * options.fps
    if abs(frames).max() > MAX_FRAME:
        raise ConfigError(f"The performance would end at frame {frames[-1]:.0f}, beyond Blender's last; start it earlier.")
    placed = _placed(avatar, channels, options.present, name)
    if options.keys == "REDUCED":
        errors = np.array([options.angle_error if channel.bone else options.max_error for channel, _ in placed])
        values = np.stack([channel.values for channel, _ in placed], 1)
        curves = reduce_curves(seconds, values, errors, progress=within(report, _PREPARED, _REDUCED))
    count = 0
    for k, (channel, bag) in enumerate(placed):
        curve = find_curve(bag, channel.path, channel.index, channel.group)
        if options.keys == "REDUCED":
            keys = reduced_keys(curves[k], start, options.fps)
        else:
            keys = linear_keys(frames, channel.values)
        count += len(keys.points)
        replace_keys(curve, keys, (frames[0], frames[-1]))
        report(_REDUCED + (1.0 - _REDUCED) * (k + 1) / len(placed))
    first, last = float(frames[0]), float(frames[-1])
    played = _played(avatar, first, last) if options.present == "WRITE_INTO" else (first, last)
    return ImportedRange(first, last, played, len(placed), count, tuple(prepared.warnings))


def _played(avatar: Avatar | Puppet, first: float, last: float) -> tuple[float, float]:
    """First and last frame that have keys in the actions that a performance was written into."""
    owners = [obj.animation_data for obj in (avatar.object, avatar.armature) if obj is not None]
    spans = [data.action.curve_frame_range for data in owners if data is not None and data.action is not None]
    return min([first, *(span[0] for span in spans)]), max([last, *(span[1] for span in spans)])


@dataclass(frozen=True)
class ImportedRange:
    """What `apply_performance` wrote.

    Attributes:
        first, last: Scene frames.
        played: The same of all that the avatar plays now: more where the performance was written into an action.
        curves, keys: How many.
        warnings: Sentences about what was repaired, missing or limited.
    """

    first: float
    last: float
    played: tuple[float, float]
    curves: int
    keys: int
    warnings: tuple[str, ...]

    def set_range(self, scene: bpy.types.Scene) -> None:
        """Let the scene start and end with it, and with what it was written into."""
        scene.frame_start, scene.frame_end = (max(round(frame), 0) for frame in self.played)


def _placed(
    avatar: Avatar | Puppet, channels: list[Channel], present: Present, name: str
) -> list[tuple[Channel, bpy.types.ActionChannelbag]]:
    """Each channel with where its curve is kept: head and rig share a new action; bones without a rig are left out."""
    placed: list[tuple[Channel, bpy.types.ActionChannelbag]] = []
    shared = None
    for obj, on_bones in ((avatar.object, False), (avatar.armature, True)):
        own = [channel for channel in channels if bool(channel.bone) == on_bones]
        if obj is None or not own:
            continue
        if present != "WRITE_INTO":
            put_aside(obj, push_down=present in _PUSHED)
        has_own = obj.animation_data is not None and obj.animation_data.action is not None
        bag = ensure_bag(obj, name, None if has_own else shared)
        shared = obj.animation_data.action
        if present in _PUSHED:
            obj.animation_data.action_blend_type = _PUSHED[present]
        placed += [(channel, bag) for channel in own]
    return placed


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
