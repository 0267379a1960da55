"""What drives shape keys and bones: SUM drivers over single properties, with a slope where a weight is needed.

Such drivers run in Blender's own code: no auto-run trust, no add-on, on all threads. A weighted sum is a SUM over hidden
properties, each of which is one control times its weight (the weight is the slope of the driver's curve). Used by `build`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import bpy
import numpy as np

from ...grmm_core.controls.frame import EXPRESSIONS_TO_ARKIT
from ...grmm_core.controls.names import EXPRESSION_NAMES, JOINT_NAMES
from ...grmm_core.controls.table import EXPRESSION, SHAPE
from ...grmm_core.head import HeadModel
from .armature import DRIVEN_PREFIX, driven_joints
from .custom_properties import property_path
from .layers import input_paths
from .mesh import component_of, expression_rows, leading_shapes, recipe_key_name, shape_key_name

_AXES = "xyz"
_MIN_ANGLE = 1e-7  # radians per unit; smaller ones do not move a vertex by 1e-7 m


def expression_inputs(head: HeadModel, obj: bpy.types.Object) -> tuple[list[list[str]], dict[str, np.ndarray]]:
    """Sort the named expressions into those that are one component of the head and those with a key of their own.

    Args:
        head: Its model.
        obj: Head object, whose layers count.

    Returns:
        For each component the data paths that add up to it, [E]; and name to coefficients [E] of all others.
    """
    inputs = [[property_path(EXPRESSION, k)] for k in range(head.expression_count)]
    others: dict[str, np.ndarray] = {}
    for name, row in zip(EXPRESSION_NAMES, expression_rows(head), strict=True):
        component = component_of(name, row)
        if component is None:
            others[name] = row
        else:
            inputs[component] += input_paths(obj, name)
    return inputs, others


def drive_shape_keys(obj: bpy.types.Object, head: HeadModel) -> None:
    """Drive all keys of a head object by its own properties."""
    keys = obj.data.shape_keys.key_blocks
    inputs, others = expression_inputs(head, obj)
    for k in range(leading_shapes(head)):
        drive_sum(keys[shape_key_name(k)], "value", -1, obj, [property_path(SHAPE, k)])
    for name, paths in zip(head.expression_names, inputs, strict=True):
        drive_sum(keys[name], "value", -1, obj, paths)
    for name in others:
        drive_sum(keys[recipe_key_name(name, head)], "value", -1, obj, input_paths(obj, name))


def drive_bones(armature: bpy.types.Object, obj: bpy.types.Object, head: HeadModel, resting: np.ndarray) -> None:
    """Rotate the DRV bones by what the expressions on the head object say.

    Args:
        armature: Armature object.
        obj: Head object with the properties.
        head: Says how far each component turns each joint.
        resting: Euler angles in radians that the avatar's own expression adds, [5, 3].
    """
    inputs, others = expression_inputs(head, obj)
    poses = np.asarray(head.expression_pose)  # [E, 5, 3]
    sources = [(name, inputs[k], poses[k]) for k, name in enumerate(head.expression_names)]
    sources += [(f"{name}.recipe", input_paths(obj, name), np.einsum("e,ejk->jk", row, poses)) for name, row in others.items()]
    own = np.einsum("ma,ajk->mjk", EXPRESSIONS_TO_ARKIT, head.arkit_pose)  # [K, 5, 3]; FLAME's shapes turn joints themselves
    sources += [(f"{name}.own", input_paths(obj, name), own[k]) for k, name in enumerate(EXPRESSION_NAMES)]
    for joint in driven_joints(head):
        bone = armature.pose.bones[DRIVEN_PREFIX + JOINT_NAMES[joint]]
        for axis in range(3):
            terms: list[str] = []
            for name, paths, pose in sources:
                if abs(pose[joint, axis]) < _MIN_ANGLE:
                    continue
                term = f"{name}.{_AXES[axis]}"
                bone[term] = 0.0
                terms.append(bone.path_from_id() + property_path(term))
                drive_sum(bone, property_path(term), -1, obj, paths, slope=float(pose[joint, axis]))
            rest = resting_term(axis)
            bone[rest] = float(resting[joint, axis])
            terms.append(bone.path_from_id() + property_path(rest))
            drive_sum(bone, "rotation_euler", axis, armature, terms)


def resting_term(axis: int) -> str:
    """Name of the DRV bones' property that holds the rotation of the avatar's own expression."""
    return f"rest.{_AXES[axis]}"


def set_resting_pose(bones: Mapping[str, bpy.types.PoseBone], resting: np.ndarray) -> None:
    """Change what `drive_bones` was given as `resting`, [5, 3]."""
    for joint, name in enumerate(JOINT_NAMES):
        bone = bones.get(DRIVEN_PREFIX + name)
        if bone is not None:
            for axis in range(3):
                bone[resting_term(axis)] = float(resting[joint, axis])


def resting_pose(bones: Mapping[str, bpy.types.PoseBone]) -> np.ndarray:
    """Return what `set_resting_pose` stored, radians, [5, 3]."""
    pose = np.zeros((len(JOINT_NAMES), 3), np.float32)
    for joint, name in enumerate(JOINT_NAMES):
        bone = bones.get(DRIVEN_PREFIX + name)
        if bone is not None:
            pose[joint] = [bone.get(resting_term(axis), 0.0) for axis in range(3)]
    return pose


def drive_sum(
    owner: bpy.types.bpy_struct,
    path: str,
    index: int,
    target: bpy.types.Object,
    paths: Sequence[str],
    slope: float = 1.0,
) -> None:
    """Make a channel the sum of properties of one object, times `slope`, whatever drove it before."""
    curve = owner.driver_add(path, index) if index >= 0 else owner.driver_add(path)
    driver = curve.driver
    driver.type = "SUM"
    for variable in list(driver.variables):
        driver.variables.remove(variable)
    for number, source in enumerate(paths):
        variable = driver.variables.new()
        variable.name = f"v{number}"
        variable.targets[0].id = target
        variable.targets[0].data_path = source
    for modifier in list(curve.modifiers):
        curve.modifiers.remove(modifier)
    if slope != 1.0:
        generator = curve.modifiers.new("GENERATOR")
        generator.poly_order = 1
        generator.coefficients = (0.0, slope)
