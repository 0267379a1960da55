"""Bones on the face for brows, lids, lips and jaw, beside the sliders.

Each control moves along some of its own axes, within limits, and each direction drives the `control` layer of expressions: the
bone at its limit is the whole expression. What bone, slider and keys of either say adds up.
"""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Vector

from ...grmm_core.controls.frame import Controls, resolve
from ...grmm_core.controls.names import JOINT_NAMES
from ...grmm_core.controls.table import SHAPE
from ...grmm_core.errors import GrmmError
from ...grmm_core.head import HeadModel
from ..rig.armature import EXTRA, SHIFT_PREFIX
from ..rig.avatar import Avatar
from ..rig.layers import add_hidden, layer_name
from ..rig.left_rigs import remove_unused
from ..rig.mesh import BASIS_KEY, read_key
from . import lids, parts

LAYER = "control"
COLLECTION = "Face Controls"
_LIMIT = "Range"
_X, _Y, _Z = 0, 1, 2  # the subject's left, up, forward
_LENGTH = 0.008  # metres
_SIDES = {"LEFT": ".R", "RIGHT": ".L"}  # those that get the other side's place
_MIRRORED = {22: 21, 23: 20, 24: 19, 43: 38, 44: 37, 46: 41, 47: 40, 54: 48, 53: 49, 55: 59}  # iBUG landmarks


@dataclass(frozen=True)
class FaceBone:
    """One control on the face.

    Attributes:
        name: Of the bone.
        landmarks: It stands before the middle of these iBUG landmarks.
        drives: Axis, metres in that direction (with its sign), and expressions that are 1 there.
        shape: Name of its custom shape.
        size: Half the width of the shape, metres.
        ahead: How far it stands before the skin, metres.
    """

    name: str
    landmarks: tuple[int, ...]
    drives: tuple[tuple[int, float, tuple[str, ...]], ...]
    shape: str
    size: float
    ahead: float = 0.006


def _pair(
    name: str, landmarks: tuple[int, ...], drives: dict[tuple[int, float], str], shape: str, size: float
) -> list[FaceBone]:
    """The left control and its mirror image; expressions are named without their side."""
    found = []
    for side, letter, sign in (("Left", "L", 1.0), ("Right", "R", -1.0)):
        places = landmarks if side == "Left" else tuple(_MIRRORED[place] for place in landmarks)
        moves = tuple((axis, way * (sign if axis == _X else 1.0), (f"{what}{side}",)) for (axis, way), what in drives.items())
        found.append(FaceBone(f"{name}.{letter}", places, moves, shape, size))
    return found


FACE_BONES: tuple[FaceBone, ...] = (
    FaceBone("brow_inner", (21, 22), ((_Y, 0.012, ("browInnerUp",)),), "circle", 0.005),
    *_pair("brow", (24,), {(_Y, 0.012): "browOuterUp", (_Y, -0.012): "browDown"}, "arc", 0.012),
    *_pair("lid_upper", (43, 44), {(_Y, -0.012): "eyeBlink", (_Y, 0.006): "eyeWide"}, "arc", 0.009),
    *_pair("lid_lower", (46, 47), {(_Y, 0.006): "eyeSquint"}, "bow", 0.009),
    *_pair(
        "lip_corner",
        (54,),
        {(_Y, 0.015): "mouthSmile", (_Y, -0.012): "mouthFrown", (_X, 0.012): "mouthStretch", (_X, -0.008): "mouthDimple"},
        "diamond",
        0.005,
    ),
    *_pair("lip_upper", (53,), {(_Y, 0.008): "mouthUpperUp"}, "arc", 0.005),
    *_pair("lip_lower", (55,), {(_Y, -0.008): "mouthLowerDown"}, "bow", 0.005),
    FaceBone(
        "mouth",
        (51, 57),
        (
            (_X, 0.015, ("mouthLeft",)),
            (_X, -0.015, ("mouthRight",)),
            (_Y, 0.012, ("mouthShrugLower", "mouthShrugUpper")),
            (_Y, -0.012, ("mouthFunnel",)),
            (_Z, 0.012, ("mouthPucker",)),
            (_Z, -0.008, ("mouthRollLower", "mouthRollUpper")),
        ),
        "circle",
        0.007,
        ahead=0.02,
    ),
    FaceBone(
        "chin",
        (8,),
        (
            (_Y, -0.03, ("jawOpen",)),
            (_X, 0.012, ("jawLeft",)),
            (_X, -0.012, ("jawRight",)),
            (_Z, 0.012, ("jawForward",)),
        ),
        "bow",
        0.016,
    ),
)


def is_present(avatar: Avatar) -> bool:
    """Whether a head has these bones."""
    rig = avatar.armature
    return rig is not None and bool(parts.feature_bones(rig, LAYER))


def add(context: bpy.types.Context, avatar: Avatar) -> None:
    """Give a head the bones, at rest where the face now is. Raises `GrmmError`."""
    rig, obj, head = parts.rig_of(avatar), avatar.object, parts.head_of(avatar)
    if head.landmarks68 is None:
        raise GrmmError(f"The head model {head.name} has no landmarks; bones cannot be placed on its face.")
    places = _landmarks(avatar, head)
    parts.add_bones(context, rig, LAYER, [
        parts.NewBone(
            bone.name, _parent(bone, head),
            Vector(places[list(bone.landmarks)].mean(0)) + Vector((0.0, 0.0, bone.ahead)), _LENGTH, COLLECTION,
        )
        for bone in FACE_BONES
    ])  # fmt: skip
    for bone in FACE_BONES:
        _equip(rig, bone)
        for axis, travel, names in bone.drives:
            for name in names:
                share = layer_name(name, LAYER)
                add_hidden(obj, [share])
                curve = parts.drive_by_bone(obj, share, rig, bone.name, f"LOC_{'XYZ'[axis]}")
                parts.slope(curve, 1.0 / travel, 0.0, 1.0)
    lids.layers_changed(avatar, head)


def remove(context: bpy.types.Context, avatar: Avatar) -> None:
    """Take the bones away; sliders and their keys stay. Raises `GrmmError`."""
    parts.remove_bones(context, parts.rig_of(avatar), LAYER)
    lids.remove_layer(avatar, LAYER)
    remove_unused()


def controls(avatar: Avatar, expressions: set[str]) -> list[bpy.types.PoseBone]:
    """Posed bones that drive any of some expressions; none where the head has no such bones."""
    bones = avatar.bones
    return [bones[b.name] for b in FACE_BONES if b.name in bones and any(expressions & set(names) for *_, names in b.drives)]


def mirror(avatar: Avatar, expressions: set[str], direction: str) -> list[bpy.types.PoseBone]:
    """Mirror the bones that drive some expressions as the operator does these; returns those that moved.

    Args:
        avatar: The avatar.
        expressions: Names.
        direction: "SWAP", or the side that is copied: "LEFT" or "RIGHT".
    """
    taken = [bone for bone in controls(avatar, expressions) if direction == "SWAP" or bone.name.endswith(_SIDES[direction])]
    places = {bone.name: avatar.bones[_partner(bone.name)].location.copy() for bone in taken}
    for bone in taken:
        x, y, z = places[bone.name]
        bone.location = (-x, y, z)
    return taken


def _partner(name: str) -> str:
    """Name of the bone on the other side, its own for one in the middle."""
    stem, _, side = name.rpartition(".")
    return f"{stem}.{'R' if side == 'L' else 'L'}" if stem else name


def _landmarks(avatar: Avatar, head: HeadModel) -> np.ndarray:
    """Landmarks (iBUG) of the face at rest, head axes, less what the neck's mechanism bone adds to its children, [68, 3]."""
    x, y, z = read_key(avatar.object.data.shape_keys.key_blocks[BASIS_KEY]).reshape(-1, 3).T
    shape = avatar.array(SHAPE)[: head.shape_count]
    vertices = np.stack([x, z, -y], 1) + head.shape_dirs[:, :, : shape.size] @ shape
    neck = avatar.bones.get(f"{SHIFT_PREFIX}neck")
    return head.landmark_positions(vertices) - np.array(neck.location if neck is not None else (0.0, 0.0, 0.0))


def _parent(bone: FaceBone, head: HeadModel) -> str:
    """The jaw for controls below it, unless they turn it themselves, which Blender could not evaluate."""
    if not bone.name.startswith("lip_lower"):
        return "neck"
    weights = Controls().set_named({name: 1.0 for *_, names in bone.drives for name in names})
    return "neck" if resolve(weights, head).pose[JOINT_NAMES.index("jaw")].any() else "jaw"


def _equip(rig: bpy.types.Object, bone: FaceBone) -> None:
    """Limit, lock and draw a control."""
    posed = rig.pose.bones[bone.name]
    ways = [[0.0, *(way for axis, way, _ in bone.drives if axis == k)] for k in range(3)]
    posed.lock_location = tuple(len(found) == 1 for found in ways)
    posed.lock_rotation = posed.lock_scale = (True, True, True)
    limit = parts.add_constraint(rig, bone.name, "LIMIT_LOCATION", _LIMIT)
    limit.use_transform_limit = True
    for axis, found in zip("xyz", ways, strict=True):
        for end, value in (("min", min(found)), ("max", max(found))):
            setattr(limit, f"use_{end}_{axis}", True)
            setattr(limit, f"{end}_{axis}", value)
    posed.custom_shape = _widget(bone.shape)
    posed.use_custom_shape_bone_size = False
    posed.custom_shape_scale_xyz = (bone.size,) * 3
    palette = {"L": "THEME01", "R": "THEME04"}.get(bone.name.rpartition(".")[2], "THEME09")
    rig.data.bones[bone.name].color.palette = palette


def _outline(shape: str) -> tuple[np.ndarray, bool]:
    """Points of a custom shape about the origin, half a unit wide or more, [P, 2], and whether it is closed."""
    if shape in ("arc", "bow"):
        x = np.linspace(-1.0, 1.0, 9)
        return np.stack([x, (0.35 if shape == "arc" else -0.35) * (1.0 - x * x)], 1), False
    corners = 4 if shape == "diamond" else 24
    angles = np.arange(corners) * (2.0 * np.pi / corners)
    return np.stack([np.cos(angles), np.sin(angles)], 1), True


def _widget(shape: str) -> bpy.types.Object:
    """Return the object that draws a custom shape, in no scene, shared by all heads of the file."""
    name = f"GRMM {shape}"
    for found in bpy.data.objects:
        if found.get(EXTRA) == name and found.library is None:
            return found
    points, closed = _outline(shape)
    mesh = bpy.data.meshes.new(name)
    edges = [(k, k + 1) for k in range(len(points) - 1)] + ([(len(points) - 1, 0)] if closed else [])
    mesh.from_pydata([(x, y, 0.0) for x, y in points.tolist()], edges, [])
    widget = bpy.data.objects.new(name, mesh)
    mesh[EXTRA] = widget[EXTRA] = name
    return widget
