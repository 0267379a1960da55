"""The armature of an avatar (the package says what the four bones of a joint are for).

All bones rest upright with their local axes along the head's: x to the subject's left, y up, z forward. So a bone's Euler
angles are the pose controls of `grmm_core.controls`, unchanged. Used by `build`, `live` and `avatar`.
"""

from __future__ import annotations

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...grmm_core.controls.names import JOINT_NAMES
from ...grmm_core.head import HeadModel
from .mesh import DEFORM_PREFIX, to_blender

SHIFT_PREFIX = "MCH-"
DRIVEN_PREFIX = "DRV-"
CONSTRAINT_NAME = "Expression"
ROOT = JOINT_NAMES[0]
EXTRA = "grmm_motion"
"""Custom property of bones and other data that `motion` added to a head; its value says for which of its features."""
CONTROLS_COLLECTION, MECHANISM_COLLECTION = "Controls", "Mechanism"
REST_AXES = Matrix(((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)))
"""A bone's rest orientation in the armature: its columns are the head's axes in Blender's."""
_FORWARD = Vector((0.0, -1.0, 0.0))
_LENGTHS = {"root": 0.06, "neck": 0.09, "jaw": 0.06, "left_eye": 0.02, "right_eye": 0.02}  # metres, for display
_COLORS = {"root": "THEME09", "neck": "THEME04", "jaw": "THEME03", "left_eye": "THEME01", "right_eye": "THEME01"}


def joint_parents(head: HeadModel) -> list[int]:
    """Index of each joint's parent, -1 for the root."""
    return [int(parent) for parent in head.parents]


def driven_joints(head: HeadModel) -> list[int]:
    """Joints that expressions rotate."""
    return [j for j in range(len(JOINT_NAMES)) if head.expression_pose[:, j].any() or head.arkit_pose[:, j].any()]


def make_armature(context: bpy.types.Context, name: str, head: HeadModel, joints: np.ndarray) -> bpy.types.Object:
    """Return a new armature object at the origin of the active collection.

    Args:
        context: In object mode.
        name: Name of the object and its data.
        head: Hierarchy and which joints expressions move.
        joints: Rest joints, head space, metres, [5, 3].
    """
    data = bpy.data.armatures.new(name)
    obj = bpy.data.objects.new(name, data)
    _collection(context).objects.link(obj)
    context.view_layer.objects.active = obj
    bpy.ops.object.mode_set(mode="EDIT")
    try:
        _add_bones(data, head, to_blender(joints))
    finally:
        bpy.ops.object.mode_set(mode="OBJECT")
    _add_collections(data)
    for bone in obj.pose.bones:
        bone.rotation_mode = "XYZ"
        bone.lock_scale = (True, True, True)
        bone.lock_location = (bone.name != ROOT,) * 3
    for joint in driven_joints(head):
        _add_expression(obj.pose.bones[JOINT_NAMES[joint]], obj)
    data.use_mirror_x = False
    data.display_type = "STICK"
    obj.show_in_front = False  # in a face that is only looked at; `viewport.bones` shows bones that are being posed
    return obj


def is_head_rig(obj: bpy.types.Object) -> bool:
    """Whether an object is an armature with the bones of `make_armature` and of `motion`, and no others."""
    prefixes = ("", SHIFT_PREFIX, DRIVEN_PREFIX, DEFORM_PREFIX)
    ours = {prefix + name for prefix in prefixes for name in JOINT_NAMES}
    return obj.type == "ARMATURE" and {bone.name for bone in obj.data.bones if EXTRA not in bone} <= ours


def rest_joints(obj: bpy.types.Object, place_of_head: Matrix | None = None) -> np.ndarray:
    """Joints that an armature was built with, head axes, metres, [5, 3]; zero where a bone was removed.

    Args:
        obj: Armature object.
        place_of_head: `Avatar.place_in_rig`, for joints in the head's axes whatever was applied; else as the bones are.
    """
    joints = np.zeros((len(JOINT_NAMES), 3), np.float32)
    to_head = REST_AXES.inverted().to_4x4() @ (Matrix() if place_of_head is None else place_of_head).inverted_safe()
    for joint, name in enumerate(JOINT_NAMES):
        bone = obj.data.bones.get(name)
        if bone is not None:
            joints[joint] = to_head @ bone.head_local
    return joints


def shift_joints(obj: bpy.types.Object, shifts: np.ndarray, parents: list[int]) -> bool:
    """Move the joints with the person's shape.

    A joint j at rest J_j + d_j instead of J_j turns about another point. MCH-j moves by d_j - d_parent before the rotation, and
    DEF-j goes back by d_j after it, so that DEF-j's skinning transform is the rotation about J_j + d_j.

    Args:
        obj: Armature object.
        shifts: d, head axes, metres, [5, 3].
        parents: Parent of each joint.

    Returns:
        Whether anything changed.
    """
    bones, changed = obj.pose.bones, False
    for joint, name in enumerate(JOINT_NAMES):
        relative = shifts[joint] - (shifts[parents[joint]] if parents[joint] >= 0 else 0.0)
        for bone_name, value in ((SHIFT_PREFIX + name, relative), (DEFORM_PREFIX + name, -shifts[joint])):
            bone = bones.get(bone_name)
            location = Vector(value)
            if bone is not None and bone.location != location:
                bone.location, changed = location, True
    return changed


def local_rotation(bone: bpy.types.PoseBone) -> Matrix:
    """Rotation of a posed control bone relative to its parent joint, in head axes, with everything that moves it.

    Args:
        bone: Of an evaluated armature.
    """
    return bone.parent.matrix.to_3x3().normalized().inverted() @ bone.matrix.to_3x3().normalized()


def root_offset(bone: bpy.types.PoseBone) -> Vector:
    """Translation of the posed root bone, head axes, metres. Takes it from an evaluated armature."""
    return (bone.parent.matrix.inverted() @ bone.matrix).to_translation()


def _collection(context: bpy.types.Context) -> bpy.types.Collection:
    """The active collection, or the scene's own where the active one is hidden (edit mode would fail), linked or overridden."""
    layer = context.view_layer.active_layer_collection
    own = layer.collection.library is None and layer.collection.override_library is None
    usable = not layer.exclude and layer.is_visible and own
    return layer.collection if usable else context.scene.collection


def _add_bones(data: bpy.types.Armature, head: HeadModel, joints: np.ndarray) -> None:
    parents = joint_parents(head)
    driven = set(driven_joints(head))

    def add(name: str, joint: int, parent: str | None, scale: float = 0.5) -> None:
        bone = data.edit_bones.new(name)
        bone.head = joints[joint].tolist()
        bone.tail = (joints[joint] + [0.0, 0.0, _LENGTHS[JOINT_NAMES[joint]] * scale]).tolist()
        bone.align_roll(_FORWARD)
        bone.use_deform = name.startswith(DEFORM_PREFIX)
        bone.use_connect = False
        if parent is not None:
            bone.parent = data.edit_bones[parent]

    for joint, name in enumerate(JOINT_NAMES):
        parent = JOINT_NAMES[parents[joint]] if parents[joint] >= 0 else None
        add(SHIFT_PREFIX + name, joint, parent)
        add(name, joint, SHIFT_PREFIX + name, scale=1.0)
        add(DEFORM_PREFIX + name, joint, name)
        if joint in driven:
            add(DRIVEN_PREFIX + name, joint, SHIFT_PREFIX + name)


def _add_collections(data: bpy.types.Armature) -> None:
    controls = data.collections.new(CONTROLS_COLLECTION)
    mechanism = data.collections.new(MECHANISM_COLLECTION)
    mechanism.is_visible = False
    for bone in data.bones:
        if bone.name in JOINT_NAMES:
            controls.assign(bone)
            bone.color.palette = _COLORS[bone.name]
        else:
            mechanism.assign(bone)


def _add_expression(bone: bpy.types.PoseBone, obj: bpy.types.Object) -> None:
    """Let a bone turn by its DRV bone's Euler angles on top of its own."""
    constraint = bone.constraints.new("COPY_ROTATION")
    constraint.name = CONSTRAINT_NAME
    constraint.target, constraint.subtarget = obj, DRIVEN_PREFIX + bone.name
    constraint.mix_mode = "ADD"
    constraint.euler_order = "XYZ"
    constraint.owner_space = constraint.target_space = "LOCAL"
