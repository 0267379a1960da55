"""Keying all controls of an avatar at once: a keying set, and the operator that selects what it keys."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..grmm_blender import compat
from ..grmm_blender.declare import Operator
from ..grmm_blender.rig.avatar import Avatar, active_object, avatar_of
from ..grmm_blender.rig.custom_properties import controls_of, property_path
from .common import Result, active_avatar, polls

KEYING_SET = "GRMM Controls"


def visible_bones(avatar: Avatar) -> list[bpy.types.PoseBone]:
    """Return the bones that an animator sees, among them those on the face where the avatar has them."""
    bones = avatar.bones.values()
    return [bone for bone in bones if any(collection.is_visible_effectively for collection in bone.bone.collections)]


def keyed_paths(avatar: Avatar) -> Iterator[tuple[bpy.types.Object, str, str]]:
    """Yield what an animator keys: object, data path, channel group. Who the avatar is, its arrays, is no animation."""
    for control in controls_of(avatar.object):
        if not control.size and control.section != "IDENTITY":
            yield avatar.object, property_path(control.name), control.group
    for bone in visible_bones(avatar):
        for channel, locks in (("location", bone.lock_location), ("rotation_euler", bone.lock_rotation)):
            if not all(locks):
                yield avatar.armature, f'pose.bones["{bone.name}"].{channel}', bone.name


class GRMM_KSI_controls(bpy.types.KeyingSetInfo):
    """Key every expression, the learned detail's strength, and the bones of the selected avatars."""

    bl_idname = "GRMM_KSI_controls"
    bl_label = KEYING_SET

    def poll(self, context: bpy.types.Context) -> bool:
        """With an avatar selected."""
        return avatar_of(active_object(context)) is not None

    def iterator(self, context: bpy.types.Context, keying_set: bpy.types.KeyingSet) -> None:
        """Add the paths of each avatar that is selected, or active."""
        found = {avatar.key: avatar for avatar in map(avatar_of, {*context.selected_objects, context.object}) if avatar}
        for avatar in found.values():
            self.generate(context, keying_set, avatar)

    def generate(self, _context: bpy.types.Context, keying_set: bpy.types.KeyingSet, avatar: Avatar) -> None:
        """Add the paths of one avatar, grouped by region."""
        for owner, path, group in keyed_paths(avatar):
            keying_set.paths.add(owner, path, group_method="NAMED", group_name=group)


class GRMM_OT_select_controls(Operator):
    """Select the head, its rig and its bones, and choose the keying set of all controls."""

    bl_label = "Select All Controls"
    bl_description = (
        "Select the rig and its bones and choose the keying set GRMM Controls: I then keys every expression and bone at once"
    )
    poll = polls(active_avatar)

    def execute(self, context: bpy.types.Context) -> Result:
        """Select, and choose."""
        avatar = active_avatar(context)
        for obj in (avatar.object, avatar.armature):
            if obj is not None and not obj.hide_select:
                obj.select_set(True)
        for bone in visible_bones(avatar):
            compat.select_bone(bone)
        sets = context.scene.keying_sets_all
        sets.active = sets[KEYING_SET]
        return {"FINISHED"}


CLASSES = (GRMM_KSI_controls, GRMM_OT_select_controls)
