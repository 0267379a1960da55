"""Puts an avatar into a scene. Called by the add-head operator."""

from __future__ import annotations

import bpy

from ...grmm_core.expressions import ALIGNED_NAMES
from ..avatar import Avatar
from . import armature, drivers, mesh
from .definitions import (
    ALIGNED_RANGE,
    ARRAY_DESCRIPTIONS,
    ARRAY_RANGES,
    EXPRESSION,
    SHAPE,
    STRENGTH,
    STRENGTH_DESCRIPTION,
    STRENGTH_RANGE,
    Z_EXP,
    Z_ID,
    Range,
    describe_aligned,
)
from .identity import Identity

MODIFIER_NAME = "Armature"


def build_avatar(context: bpy.types.Context, source: str, identity: Identity) -> Avatar:
    """Add a head with its rig at the scene's cursor and make it active.

    Args:
        context: In object mode.
        source: What to store as the avatar's source ("default", "sample:SEED" or a file, also relative to the .blend).
        identity: What `identity.read_identity` returned for it.
    """
    head = identity.head
    rig = armature.make_armature(context, f"{identity.name} rig", head, identity.joints)
    obj = bpy.data.objects.new(identity.name, mesh.make_mesh(identity.name, identity))
    for collection in rig.users_collection:
        collection.objects.link(obj)
    add_properties(obj, identity)
    mesh.add_vertex_groups(obj, head)
    mesh.add_shape_keys(obj, identity)
    drivers.drive_shape_keys(obj, head)
    drivers.drive_bones(rig, obj, head, identity.resting_pose)
    _bind(obj, rig)
    obj.grmm.is_avatar = True
    obj.grmm.source = source
    obj.grmm.head_name = head.name
    rig.location = context.scene.cursor.location
    for other in context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    context.view_layer.objects.active = obj
    return Avatar(obj)


def add_properties(obj: bpy.types.Object, identity: Identity) -> None:
    """Create the custom properties that are the avatar's controls, at rest."""
    for name in ALIGNED_NAMES:
        _add_property(obj, name, 0.0, ALIGNED_RANGE, describe_aligned(name))
    sizes = {
        SHAPE: identity.head.shape_count,
        EXPRESSION: identity.head.expression_count,
        Z_ID: identity.z_id_size,
        Z_EXP: identity.z_exp_size,
    }
    for name, size in sizes.items():
        _add_property(obj, name, [0.0] * size, ARRAY_RANGES[name], ARRAY_DESCRIPTIONS[name])
    _add_property(obj, STRENGTH, 1.0, STRENGTH_RANGE, STRENGTH_DESCRIPTION)


def _add_property(obj: bpy.types.Object, name: str, value: float | list[float], limits: Range, description: str) -> None:
    obj[name] = value
    obj.id_properties_ui(name).update(
        min=limits.low,
        max=limits.high,
        soft_min=limits.soft_low,
        soft_max=limits.soft_high,
        default=value,
        description=description,
        step=1.0,
        precision=3,
    )
    obj.property_overridable_library_set(f'["{name}"]', True)


def _bind(obj: bpy.types.Object, rig: bpy.types.Object) -> None:
    """Deform the head by the armature. The head itself does not move: the armature object and its root bone do."""
    obj.parent = rig
    modifier = obj.modifiers.new(MODIFIER_NAME, "ARMATURE")
    modifier.object = rig
    modifier.use_deform_preserve_volume = False  # linear blend skinning, as in the core
    modifier.use_bone_envelopes = False
    obj.lock_location = obj.lock_rotation = obj.lock_scale = (True, True, True)
