"""Puts an avatar into a scene. Called by operators and by the source property."""

from __future__ import annotations

from pathlib import Path

import bpy
import numpy as np

from ...grmm_core.avatar import AssetReference
from ...grmm_core.controls.table import ARRAYS, CONTROLS, EXPRESSIONS, SLIDERS, Z_EXP, Z_ID
from ...grmm_core.errors import FileFormatError, GrmmError
from ...grmm_core.hair import SETTINGS
from ...grmm_core.head import HeadModel, load_open_head
from ..linking import link_beside
from . import armature, drivers, live, mesh, repaint
from .avatar import Avatar
from .custom_properties import add_property
from .identity import OPEN_HEAD, Identity, load_head, read_identity

MODIFIER_NAME = "Armature"


def build_avatar(context: bpy.types.Context, source: str, identity: Identity) -> Avatar:
    """Add a head with its rig at the scene's cursor; both are selected, and the rig is active.

    Args:
        context: In object mode.
        source: What to store as the avatar's source ("default", "sample:SEED" or a file, also relative to the .blend).
        identity: What `identity.read_identity` returned for it.
    """
    head = identity.head
    rig = armature.make_armature(context, f"{identity.name} rig", head, identity.joints)
    obj = bpy.data.objects.new(identity.name, mesh.make_mesh(identity.name, identity))
    link_beside(obj, rig)
    add_properties(obj, identity)
    mesh.add_vertex_groups(obj, head)
    mesh.add_shape_keys(obj, identity)
    drivers.drive_shape_keys(obj, head)
    drivers.drive_bones(rig, obj, head, identity.resting_pose)
    _bind(obj, rig)
    obj.grmm.source = source  # before it is an avatar: nothing has to be brought in step
    obj.grmm.head_name = identity.reference or head.name
    obj.grmm.live_detail = identity.z_exp_size > 0
    if identity.hair is not None:  # the sliders change what is there, and a new curl leaves the color
        for row in SETTINGS:
            setattr(obj.grmm.hair, row.name, getattr(identity.hair, row.name))
    obj.grmm.is_avatar = True
    obj.grmm.known_path = known_path(Avatar(obj))
    rig.location = context.scene.cursor.location
    for other in context.selected_objects:
        other.select_set(False)
    for part in (obj, rig):
        part.select_set(True)
    context.view_layer.objects.active = rig  # what can be moved
    repaint.ask(Avatar(obj))
    return Avatar(obj)


def add_properties(obj: bpy.types.Object, identity: Identity) -> None:
    """Create the custom properties that are the avatar's controls, at rest."""
    for control in EXPRESSIONS:
        add_property(obj, control)
    for control in ARRAYS:
        size = identity.sizes.get(control.name, control.size)
        if size:  # a head that no network draws has no codes
            add_property(obj, control, size)
    for control in SLIDERS:
        add_property(obj, control)


def add_missing_controls(avatar: Avatar) -> None:
    """Give a rig that an earlier version built the controls that have come since; what it has stays as it is."""
    obj = avatar.object
    missing = [control for control in (*EXPRESSIONS, *SLIDERS) if control.name not in obj]
    keyless = obj.grmm.head_name == OPEN_HEAD and not mesh.has_closing_keys(obj, load_open_head())
    if not (missing or keyless) or not obj.is_editable or live.limitation(avatar):
        return
    try:
        head = load_head(AssetReference(obj.grmm.head_name))
    except GrmmError:
        return  # panels say what is wrong with it
    for control in missing:
        add_property(obj, control)
    if keyless or any(control in EXPRESSIONS for control in missing):
        mesh.add_recipe_keys(obj, head, _own_shape(avatar.source))
        drive_again(avatar, head)


def _own_shape(source: str) -> np.ndarray:
    """Shape coefficients of a source, [<=S]; none of one that cannot be read: the mean person's."""
    try:
        return read_identity(source).shape
    except GrmmError:
        return np.zeros(0, np.float32)


def drive_again(avatar: Avatar, head: HeadModel) -> None:
    """Drive mesh and joints of a rig by the controls and layers that its head object has now."""
    drivers.drive_shape_keys(avatar.object, head)
    drivers.drive_bones(avatar.armature, avatar.object, head, drivers.resting_pose(avatar.bones))


def show_source(avatar: Avatar) -> str:
    """Give a rig the resting shape of its source after the source was changed; controls and animation stay.

    Returns:
        One sentence where that is not possible, else an empty string; panels show it too.
    """
    state = live.state_of(avatar)
    try:
        change_identity(avatar, read_identity(avatar.source))
        state.message = ""
    except GrmmError as error:
        state.message = str(error)
    return state.message


def change_identity(avatar: Avatar, identity: Identity) -> None:
    """Make a rig another person's.

    Raises:
        FileFormatError: The person belongs to another head model.
        GrmmError: The head's mesh is linked or shared.
    """
    obj, rig, head = avatar.object, avatar.armature, identity.head
    model = identity.reference or head.name
    if model != obj.grmm.head_name:
        raise FileFormatError(f"{identity.name} belongs to the head model {model!r}; add it as a head of its own.")
    problem = live.limitation(avatar)
    if problem:
        raise FileFormatError(problem)
    mesh.rebase(obj, identity.vertices)
    mesh.fit_recipe_keys(obj, head, identity.shape)
    mesh.add_materials(obj.data, identity)
    drivers.set_resting_pose(avatar.bones, identity.resting_pose)
    obj.grmm.known_path = known_path(avatar)
    offset = identity.joints - armature.rest_joints(rig, avatar.place_in_rig)  # [5, 3]
    obj.grmm.joint_offset = offset.ravel().tolist()
    for name, size in ((Z_ID, identity.z_id_size), (Z_EXP, identity.z_exp_size)):
        values = obj[name].to_list() if name in obj else []
        if len(values) != size:
            kept = (values + [0.0] * size)[:size]
            add_property(obj, CONTROLS[name], size)
            obj[name] = kept
    live.state_of(avatar).shape_for = None
    live.state_of(avatar).detail_for = None
    avatar.tag_edited()
    repaint.ask(avatar)


def known_path(avatar: Avatar) -> str:
    """Absolute file name of a source that is a file, else an empty string."""
    path = Path(avatar.source)
    return str(path) if path.is_absolute() and path.exists() else ""


def make_independent(avatar: Avatar) -> None:
    """Give a linked duplicate a mesh of its own, driven by its own properties, unless it has one."""
    obj, owner = avatar.object, avatar.mesh_owner
    if owner in (None, obj):
        return
    obj.data = obj.data.copy()
    for curve in obj.data.shape_keys.animation_data.drivers:
        for variable in curve.driver.variables:
            for target in variable.targets:
                if target.id == owner:
                    target.id = obj
    live.state_of(avatar).shape_for = None
    live.state_of(avatar).detail_for = None
    obj.update_tag()


def _bind(obj: bpy.types.Object, rig: bpy.types.Object) -> None:
    """Deform the head by the armature. The head itself does not move: the armature object and its root bone do."""
    obj.parent = rig
    modifier = obj.modifiers.new(MODIFIER_NAME, "ARMATURE")
    modifier.object = rig
    modifier.use_deform_preserve_volume = False  # linear blend skinning, as in the core
    modifier.use_bone_envelopes = False
    obj.lock_location = obj.lock_rotation = obj.lock_scale = (True, True, True)
