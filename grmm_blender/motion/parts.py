"""What the features of this package have in common: bones, drivers and constraints that a head gets and loses again."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import bpy
from mathutils import Vector

from ...grmm_core.avatar import AssetReference
from ...grmm_core.errors import GrmmError
from ...grmm_core.head import HeadModel
from ..rig.actions import action_fcurves
from ..rig.armature import CONSTRAINT_NAME, EXTRA, REST_AXES, ROOT
from ..rig.avatar import Avatar
from ..rig.custom_properties import property_path
from ..rig.identity import load_head
from ..rig.live import limitation

_TURNED = 1e-3  # radians by which applied rotations count


@dataclass(frozen=True)
class NewBone:
    """A bone to add.

    Attributes:
        name: Of the bone.
        parent: Name of its parent.
        head: Where it rests, head axes, metres.
        length: Metres; it points up, as all bones of a head do.
        collection: Bone collection that it belongs to, made where it is missing.
    """

    name: str
    parent: str
    head: Vector
    length: float
    collection: str


def rig_of(avatar: Avatar) -> bpy.types.Object:
    """Return the armature of an avatar whose bones can be changed.

    Raises:
        GrmmError: They cannot.
    """
    problem = limitation(avatar)
    if problem:
        raise GrmmError(problem)
    rig = avatar.armature
    if rig is None:
        raise GrmmError("The armature is missing; add the head again.")
    if rig.data.library is not None or rig.data.override_library is not None:
        raise GrmmError("The armature is linked; append the avatar to add bones to it.")
    if rig.data.users > 1:
        raise GrmmError("The armature is shared with another head; make it a single user first.")
    return rig


def head_of(avatar: Avatar) -> HeadModel:
    """Return the head model of an avatar. Raises `GrmmError`."""
    return load_head(AssetReference(avatar.object.grmm.head_name))


@contextmanager
def _editing(context: bpy.types.Context, rig: bpy.types.Object) -> Iterator[bpy.types.ArmatureEditBones]:
    """Edit mode of an armature; before and after it is whatever was active and its mode.

    Raises:
        GrmmError: The armature is hidden.
    """
    active = context.view_layer.objects.active
    mode = active.mode if active is not None else "OBJECT"
    if not rig.visible_get():
        raise GrmmError(f"{rig.name} is hidden; show it to change its bones.")
    if mode != "OBJECT":
        bpy.ops.object.mode_set(mode="OBJECT")
    context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        yield rig.data.edit_bones
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
        context.view_layer.objects.active = active
        if mode != "OBJECT":
            bpy.ops.object.mode_set(mode=mode)


def add_bones(context: bpy.types.Context, rig: bpy.types.Object, feature: str, bones: Sequence[NewBone]) -> None:
    """Add bones at rest to an armature, marked as a feature's, which do not deform. Raises `GrmmError`."""
    if (rig.data.bones[ROOT].matrix_local.to_3x3().inverted() @ REST_AXES).to_quaternion().angle > _TURNED:
        raise GrmmError("A rotation was applied to the rig, whose bones are turned; undo Apply to add bones to it.")
    with _editing(context, rig) as edit_bones:
        for new in bones:
            bone = edit_bones.new(new.name)
            bone.head = REST_AXES @ new.head
            bone.tail = bone.head + Vector((0.0, 0.0, new.length))
            bone.align_roll(Vector((0.0, -1.0, 0.0)))
            bone.use_deform = False
            bone.parent = edit_bones[new.parent]
            bone[EXTRA] = feature
    collections = rig.data.collections
    for new in bones:
        collection = collections.get(new.collection) or collections.new(new.collection)
        collection.assign(rig.data.bones[new.name])
        rig.pose.bones[new.name].rotation_mode = "XYZ"


def feature_bones(rig: bpy.types.Object, feature: str) -> list[str]:
    """Names of the bones that `add_bones` gave an armature for a feature."""
    return [bone.name for bone in rig.data.bones if bone.get(EXTRA) == feature]


def remove_bones(context: bpy.types.Context, rig: bpy.types.Object, feature: str) -> None:
    """Take a feature's bones away, with their keys and the bone collections that have none left."""
    names = feature_bones(rig, feature)
    if not names:
        return
    paths = tuple(rig.pose.bones[name].path_from_id() + "." for name in names)
    collections = {group.name for name in names for group in rig.data.bones[name].collections}
    drivers = rig.animation_data.drivers if rig.animation_data is not None else None
    for curves in filter(None, (action_fcurves(rig), drivers)):
        for curve in [curve for curve in curves if curve.data_path.startswith(paths)]:
            curves.remove(curve)
    with _editing(context, rig) as edit_bones:
        for name in names:
            edit_bones.remove(edit_bones[name])
    for name in collections:
        if not rig.data.collections[name].bones:
            rig.data.collections.remove(rig.data.collections[name])


def add_constraint(rig: bpy.types.Object, bone: str, kind: str, name: str, target: str = "") -> bpy.types.Constraint:
    """Return a new constraint of a posed bone, in local space, before what expressions add.

    Args:
        rig: Armature object.
        bone: Its owner.
        kind: Type of the constraint.
        name: Its name.
        target: Bone of the same armature that it copies, if any.
    """
    constraints = rig.pose.bones[bone].constraints
    constraint = constraints.new(kind)
    constraint.name = name
    if CONSTRAINT_NAME in constraints:
        constraints.move(len(constraints) - 1, constraints.find(CONSTRAINT_NAME))
    if kind != "DAMPED_TRACK":
        constraint.owner_space = "LOCAL"
    if kind in ("COPY_ROTATION", "LIMIT_ROTATION"):
        constraint.euler_order = "XYZ"
    if target:
        constraint.target, constraint.subtarget, constraint.target_space = rig, target, "LOCAL"
        if kind == "COPY_ROTATION":
            constraint.mix_mode = "ADD"
    return constraint


def remove_constraints(rig: bpy.types.Object, name: str) -> None:
    """Take all constraints of a name away from an armature's bones, with their drivers."""
    for bone in rig.pose.bones:
        constraint = bone.constraints.get(name)
        if constraint is not None:
            constraint.driver_remove("influence")
            bone.constraints.remove(constraint)


def drive_by_bone(obj: bpy.types.Object, name: str, rig: bpy.types.Object, bone: str, channel: str) -> bpy.types.FCurve:
    """Have a bone set a property of a head object.

    Args:
        obj: Head object.
        name: Property.
        rig: Armature object.
        bone: Its posed bone, with its constraints.
        channel: "LOC_Y", "ROT_X" and the like, in the bone's own axes.

    Returns:
        The driver's curve, for `slope` or `bend`: from metres or radians to the property.
    """
    curve = obj.driver_add(property_path(name))
    curve.driver.type = "SUM"
    variable = curve.driver.variables.new()
    variable.type = "TRANSFORMS"
    target = variable.targets[0]
    target.id, target.bone_target, target.transform_type, target.transform_space = rig, bone, channel, "LOCAL_SPACE"
    target.rotation_mode = "XYZ"
    return curve


def slope(curve: bpy.types.FCurve, factor: float, low: float, high: float) -> None:
    """Make a driver's value `factor` times its sum, cut off at `low` and `high`."""
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    generator = curve.modifiers.new("GENERATOR")
    generator.poly_order = 1
    generator.coefficients = (0.0, factor)
    limits = curve.modifiers.new("LIMITS")
    limits.use_min_y = limits.use_max_y = True
    limits.min_y, limits.max_y = low, high


def bend(curve: bpy.types.FCurve, points: Sequence[tuple[float, float]]) -> None:
    """Make a driver's value straight from point to point over its sum, and constant beyond them.

    Blender takes places that are nearer than 1e-4 for one.
    """
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    curve.keyframe_points.clear()
    curve.keyframe_points.add(len(points))
    for key, point in zip(curve.keyframe_points, points, strict=True):
        key.co = key.handle_left = key.handle_right = point
        key.interpolation = "LINEAR"
    curve.extrapolation = "CONSTANT"
    curve.update()
