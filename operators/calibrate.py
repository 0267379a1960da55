"""Neutral calibration of an avatar: the face of chosen frames becomes the resting one, in a pose or a whole animation.

The same arithmetic as `grmm_core.performance.calibrate_neutral` has for recordings, applied to the keys in Blender: with n the
mean of a control over the chosen frames, a named expression w becomes (w - n) / (1 - n), so that rest is 0 and a full
expression stays 1; coefficients and angles lose n.
"""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ..grmm_blender.declare import Operator, choice, flag, text
from ..grmm_blender.performance import parse_frames
from ..grmm_blender.rig.actions import action_curves
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.rig.custom_properties import property_path
from ..grmm_core.controls.table import EXPRESSION, EXPRESSIONS, JOINTS
from ..grmm_core.errors import ControlError
from .common import Result, active_avatar, reports_errors
from .edit import Edit

_MOST = 0.9  # a weight beyond this is no resting face
_MAX_FRAMES = 10_000
_COORDINATES = ("co", "handle_left", "handle_right")


class GRMM_OT_calibrate_neutral(Edit, Operator):
    """Make the face of the present or of chosen frames the neutral one."""

    bl_label = "Calibrate Neutral"
    bl_description = (
        "Make the face of the present frame, or the mean of chosen frames, the neutral one: expressions and rotations become "
        "relative to it, in the whole animation"
    )

    source: choice(
        "Neutral",
        "Which face becomes the neutral one",
        ("PRESENT", "Present Pose", "The avatar as it is now"),
        ("FRAMES", "Frames", "The mean of frames of the animation in which the actor rests"),
    )
    frames: text("Frames", "Scene frames in which the actor rests, such as 1, 12-20", default="1")
    expression: flag("Expression", "Calibrate expressions", default=True)
    rotation: flag("Rotation", "Calibrate neck, jaw and eyes", default=True)

    def draw(self, context: bpy.types.Context) -> None:
        """Show the frames only where they matter."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "source")
        if self.source == "FRAMES":
            layout.prop(self, "frames")
        layout.prop(self, "expression")
        layout.prop(self, "rotation")

    @reports_errors
    def execute(self, context: bpy.types.Context) -> Result:
        """Calibrate."""
        avatar = active_avatar(context)
        frames = [context.scene.frame_current_final]
        if self.source == "FRAMES":
            frames = list(parse_frames(self.frames))
            if len(frames) > _MAX_FRAMES:
                raise ControlError(f"{len(frames)} frames are too many to take the mean of; name at most {_MAX_FRAMES}.")
        names = self._calibrate_expressions(avatar, frames) if self.expression else []
        bones = self._calibrate_bones(avatar, frames) if self.rotation else []
        return self.finish(context, avatar, names, bones)

    def _calibrate_expressions(self, avatar: Avatar, frames: list[float]) -> list[str]:
        """Named expressions and coefficients; returns those whose present value was changed, which are not animated."""
        head = avatar.object
        curves = {(curve.data_path, curve.array_index): curve for curve in action_curves(head)}
        changed = []
        for name in (control.name for control in EXPRESSIONS if control.name in head):
            curve = curves.get((property_path(name), 0))
            if curve is None:
                if head[name] != 0.0:
                    head[name] = 0.0
                    changed.append(name)
                continue
            rest = min(max(_mean(curve, frames), 0.0), _MOST)
            _change(curve, -rest, 1.0 / (1.0 - rest), 0.0)
            head[name] = max((head[name] - rest) / (1.0 - rest), 0.0)
        values = head[EXPRESSION].to_list()
        for index, value in enumerate(values):
            curve = curves.get((property_path(EXPRESSION), index))
            rest = value if curve is None else _mean(curve, frames)
            if curve is not None:
                _change(curve, -rest)
            values[index] = value - rest
        head[EXPRESSION] = values
        return changed

    def _calibrate_bones(self, avatar: Avatar, frames: list[float]) -> list[str]:
        if avatar.armature is None:
            return []
        curves = {(curve.data_path, curve.array_index): curve for curve in action_curves(avatar.armature)}
        changed = []
        for bone in (avatar.bones[joint.name] for joint in JOINTS if joint.axes and joint.name in avatar.bones):
            angles = list(bone.rotation_euler)
            animated = False
            for axis, curve in _rotation_curves(bone, curves):
                animated = animated or curve is not None
                rest = angles[axis] if curve is None else _mean(curve, frames)
                if curve is not None:
                    _change(curve, -rest)
                angles[axis] -= rest
            bone.rotation_euler = angles
            if not animated:
                changed.append(bone.name)
        return changed


def _rotation_curves(
    bone: bpy.types.PoseBone, curves: dict[tuple[str, int], bpy.types.FCurve]
) -> Iterator[tuple[int, bpy.types.FCurve | None]]:
    path = bone.path_from_id("rotation_euler")
    for axis in range(3):
        yield axis, curves.get((path, axis))


def _mean(curve: bpy.types.FCurve, frames: list[float]) -> float:
    return float(np.mean([curve.evaluate(frame) for frame in frames]))


def _change(curve: bpy.types.FCurve, offset: float, factor: float = 1.0, least: float | None = None) -> None:
    """Make a curve's value (value + offset) * factor, with its handles, and no key smaller than `least`."""
    points = curve.keyframe_points
    for name in _COORDINATES:
        values = np.empty(2 * len(points), np.float32)
        points.foreach_get(name, values)
        values[1::2] = (values[1::2] + offset) * factor
        if least is not None:
            values[1::2] = np.maximum(values[1::2], least)
        points.foreach_set(name, values)
    curve.update()


CLASSES = (GRMM_OT_calibrate_neutral,)
