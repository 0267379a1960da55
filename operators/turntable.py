"""A camera that walks around the active avatar."""

from __future__ import annotations

import math

import bpy
from mathutils import Matrix

from ..grmm_blender.declare import Operator, flag, number, whole
from ..grmm_blender.rig.actions import action_curves
from ..grmm_blender.rig.avatar import Avatar
from ..grmm_blender.scene.avatars import place_of
from ..grmm_blender.scene.cameras import fit_shorter_side
from ..grmm_blender.staging import LENS
from .common import Result, active_avatar, polls

PIVOT_TAG = "grmm_turntable"  # custom property of the objects: a second run uses them again


class GRMM_OT_turntable(Operator):
    """Add a camera that walks around the active avatar, keyed over a number of frames; again: change it."""

    bl_label = "Turntable"

    frames: whole("Frames", "Length of one turn", default=96, min=2, max=10000)
    start: whole("Start Frame", "First frame of the turn", default=1, min=0)
    angle: number(
        "Angle",
        "How far the camera walks; a full turn ends one step before its start, so that it loops",
        default=2 * math.pi,
        min=-20 * math.pi,
        max=20 * math.pi,
        subtype="ANGLE",
    )
    first: number("First Angle", "Where it starts; 0 looks at the face", subtype="ANGLE", min=-2 * math.pi, max=2 * math.pi)
    elevation: number(
        "Elevation",
        "Angle from which the camera looks down",
        default=math.radians(4.0),
        subtype="ANGLE",
        min=-math.radians(85.0),
        max=math.radians(85.0),
    )
    lens: number("Focal Length", "Millimetres", default=LENS, min=10.0, max=500.0, subtype="DISTANCE_CAMERA")
    margin: number("Margin", "Room around the head", default=0.1, min=0.0, max=2.0)
    set_range: flag("Set Scene Range", "Let the scene play the turn; off at first where the avatar is animated", default=True)
    set_camera: flag("Set Scene Camera", "Render the turn; off at first where the avatar is animated", default=True)

    poll = polls(active_avatar)

    def execute(self, context: bpy.types.Context) -> Result:
        """Make the camera, or change the one of an earlier run."""
        scene, avatar = context.scene, active_avatar(context)
        self._respect(scene, avatar)
        pivot, camera = self._objects(scene)
        place = place_of(avatar, context.evaluated_depsgraph_get())
        pivot.location = place.centre
        pivot.rotation_mode = "XYZ"
        camera.parent = pivot
        camera.matrix_parent_inverse = Matrix()
        distance = fit_shorter_side(camera.data, self.lens, place.radius * (1 + self.margin))
        camera.location = (0.0, -distance * math.cos(self.elevation), distance * math.sin(self.elevation))
        camera.rotation_euler = (math.pi / 2 - self.elevation, 0.0, 0.0)
        camera.data.clip_start = min(0.1, distance / 10)
        pivot.animation_data_clear()
        for frame, angle in ((self.start, 0.0), (self.start + self.frames, self.angle)):
            pivot.rotation_euler = (0.0, 0.0, place.facing + self.first + angle)
            pivot.keyframe_insert("rotation_euler", index=2, frame=frame)
        for curve in action_curves(pivot):  # at constant speed, on and on
            curve.extrapolation = "LINEAR"
            for key in curve.keyframe_points:
                key.interpolation = "LINEAR"
        if self.set_camera:
            scene.camera = camera
        if self.set_range:
            scene.frame_start, scene.frame_end = self.start, self.start + self.frames - 1
        scene.frame_set(scene.frame_current)
        return {"FINISHED"}

    def _respect(self, scene: bpy.types.Scene, avatar: Avatar) -> None:
        """Leave a performance its range and its camera, and walk as long as it plays, unless something else is asked for."""
        if not is_animated(avatar):
            return
        length = scene.frame_end - scene.frame_start + 1
        kept = scene.camera is None or PIVOT_TAG in scene.camera
        for name, value in (("start", scene.frame_start), ("frames", length), ("set_range", False), ("set_camera", kept)):
            if not self.properties.is_property_set(name):
                setattr(self, name, value)
        if not self.set_camera:
            self.report({"INFO"}, "The scene keeps its camera and its range; Set Scene Camera renders the turn")

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


def is_animated(avatar: Avatar) -> bool:
    """Whether an avatar plays anything: an action or a strip on its head or its rig."""
    owners = (obj.animation_data for obj in (avatar.object, avatar.armature) if obj is not None)
    return any(data is not None and (data.action is not None or len(data.nla_tracks) > 0) for data in owners)


CLASSES = (GRMM_OT_turntable,)
