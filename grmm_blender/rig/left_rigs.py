"""Rigs whose heads were deleted: Blender deletes the object that is selected, and the rig of a head is another one."""

from __future__ import annotations

import bpy

from .armature import is_head_rig
from .avatar import Avatar, is_avatar


class LeftRigs:
    """Notices heads that are deleted, and removes the rigs that they leave behind. `handlers` asks after edits."""

    def __init__(self) -> None:
        """Know of nothing."""
        self._count = -1  # of objects: looking is only worth it after it has changed
        self._rig_of: dict[int, int] = {}  # by head; both by `session_uid`
        self._left: set[int] = set()

    def look(self) -> bool:
        """Compare with what there was at the last look; returns whether there are rigs to remove."""
        if len(bpy.data.objects) != self._count:
            self._count = len(bpy.data.objects)
            present, known, self._rig_of = {obj.session_uid for obj in bpy.data.objects}, self._rig_of, {}
            for obj in bpy.data.objects:
                rig = Avatar(obj).armature if is_avatar(obj) else None
                if rig is not None:
                    self._rig_of[obj.session_uid] = rig.session_uid
            self._left |= {rig for head, rig in known.items() if head not in present} - set(self._rig_of.values())
        return bool(self._left)

    def remove(self) -> None:
        """Remove the rigs; linked ones stay, and those that something else hangs on, or that have other bones than ours."""
        for obj in list(bpy.data.objects):
            if obj.session_uid in self._left and obj.library is None and not obj.children and is_head_rig(obj):
                armature = obj.data
                bpy.data.objects.remove(obj)
                if not armature.users:
                    bpy.data.armatures.remove(armature)
        self._left.clear()
        self._count = len(bpy.data.objects)

    def forget(self) -> None:
        """Begin anew: another file, or another point of the undo history, is there now."""
        self._count, self._rig_of, self._left = -1, {}, set()
