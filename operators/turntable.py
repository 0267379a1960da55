"""A camera that walks around the active avatar."""

from __future__ import annotations

import math
from typing import ClassVar

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..grmm_blender.rig.avatar import Avatar
from .common import Result, active_avatar, needs_avatar

PIVOT_TAG = "grmm_turntable"  # custom property of the objects: a second run uses them again
_HEAD_RADIUS = 0.19  # metres around the head's origin that hold hair and neck
_CENTRE = Vector((0.0, 0.0, -0.01))  # of the head in the axes of its object, metres
_SENSOR = 36.0  # millimetres


class GRMM_OT_turntable(bpy.types.Operator):
    """Add a camera that walks around the active avatar."""

    bl_idname = "grmm.turntable"
    bl_label = "Turntable"
    bl_description = "Add a camera that walks around the active avatar, keyed over a number of frames; again: change it"
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    frames: bpy.props.IntProperty(name="Frames", description="Length of one turn", default=96, min=2, max=10000)
    start: bpy.props.IntProperty(name="Start Frame", description="First frame of the turn", default=1, min=0)
    angle: bpy.props.FloatProperty(
        name="Angle",
        description="How far the camera walks; a full turn ends one step before its start, so that it loops",
        default=2 * math.pi, min=-20 * math.pi, max=20 * math.pi, subtype="ANGLE",
    )  # fmt: skip
    first: bpy.props.FloatProperty(
        name="First Angle", description="Where it starts; 0 looks at the face", default=0.0, subtype="ANGLE",
        min=-2 * math.pi, max=2 * math.pi,
    )  # fmt: skip
    elevation: bpy.props.FloatProperty(
        name="Elevation", description="Angle from which the camera looks down", default=math.radians(4.0), subtype="ANGLE",
        min=-math.radians(85.0), max=math.radians(85.0),
    )  # fmt: skip
    lens: bpy.props.FloatProperty(
        name="Focal Length", description="Millimetres", default=85.0, min=10.0, max=500.0, subtype="DISTANCE_CAMERA"
    )
    margin: bpy.props.FloatProperty(name="Margin", description="Room around the head", default=0.1, min=0.0, max=2.0)
    set_range: bpy.props.BoolProperty(name="Set Scene Range", description="Let the scene play the turn", default=True)

    poll = classmethod(needs_avatar)

    def execute(self, context: bpy.types.Context) -> Result:
        """Make the camera, or change the one of an earlier run."""
        scene, avatar = context.scene, active_avatar(context)
        pivot, camera = self._objects(scene)
        center, scale = _head_place(avatar, context)
        pivot.location = center
        pivot.rotation_mode = "XYZ"
        camera.parent = pivot
        camera.matrix_parent_inverse = Matrix()
        camera.data.lens, camera.data.sensor_fit, camera.data.sensor_width = self.lens, "AUTO", _SENSOR
        distance = self._distance(scene) * scale
        camera.location = (0.0, -distance * math.cos(self.elevation), distance * math.sin(self.elevation))
        camera.rotation_euler = (math.pi / 2 - self.elevation, 0.0, 0.0)
        camera.data.clip_start = min(0.1, distance / 10)
        facing = _facing(avatar, context)
        pivot.animation_data_clear()
        for frame, angle in ((self.start, 0.0), (self.start + self.frames, self.angle)):
            pivot.rotation_euler = (0.0, 0.0, facing + self.first + angle)
            pivot.keyframe_insert("rotation_euler", index=2, frame=frame)
        _straighten(pivot.animation_data.action)
        scene.camera = camera
        if self.set_range:
            scene.frame_start, scene.frame_end = self.start, self.start + self.frames - 1
        scene.frame_set(scene.frame_current)
        return {"FINISHED"}

    def _objects(self, scene: bpy.types.Scene) -> tuple[bpy.types.Object, bpy.types.Object]:
        found = {obj[PIVOT_TAG]: obj for obj in scene.objects if PIVOT_TAG in obj}
        for role, make in (
            ("pivot", lambda: bpy.data.objects.new("Turntable", None)),
            ("camera", lambda: bpy.data.objects.new("Turntable Camera", bpy.data.cameras.new("Turntable Camera"))),
        ):
            if role not in found:
                found[role] = make()
                found[role][PIVOT_TAG] = role
                scene.collection.objects.link(found[role])
        found["pivot"].empty_display_size = 0.1
        return found["pivot"], found["camera"]

    def _distance(self, scene: bpy.types.Scene) -> float:
        """Distance from which the head fills the shorter side of the picture, but for the margin; metres."""
        render = scene.render
        width, height = render.resolution_x * render.pixel_aspect_x, render.resolution_y * render.pixel_aspect_y
        half = math.atan(_SENSOR * min(width, height) / max(width, height) / (2 * self.lens))
        return _HEAD_RADIUS * (1 + self.margin) / math.sin(half)


def _head_place(avatar: Avatar, context: bpy.types.Context) -> tuple[Vector, float]:
    """Centre of the head in the world, and its scale."""
    matrix = Matrix(avatar.model_to_world(context.evaluated_depsgraph_get()).tolist())
    head = matrix @ Vector((_CENTRE.x, _CENTRE.z, -_CENTRE.y))  # head axes: y up, z forward
    return head, float(np.cbrt(abs(matrix.to_3x3().determinant())))


def _facing(avatar: Avatar, context: bpy.types.Context) -> float:
    """Angle about the world's z axis by which the rig is turned."""
    matrix = Matrix(avatar.model_to_world(context.evaluated_depsgraph_get()).tolist())
    forward = matrix.to_3x3() @ Vector((0.0, 0.0, 1.0))
    return math.atan2(forward.x, -forward.y)


def _straighten(action: bpy.types.Action) -> None:
    """Walk at constant speed, on and on."""
    for layer in action.layers:
        for strip in layer.strips:
            for bag in strip.channelbags:
                for curve in bag.fcurves:
                    curve.extrapolation = "LINEAR"
                    for key in curve.keyframe_points:
                        key.interpolation = "LINEAR"


CLASSES = (GRMM_OT_turntable,)
