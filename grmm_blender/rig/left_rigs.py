"""What deleted heads and rigs leave: Blender deletes the object that is selected, and the rig of a head is another one."""

from __future__ import annotations

import bpy
from mathutils import Matrix

from .armature import EXTRA, is_head_rig
from .avatar import Avatar, is_avatar


class LeftRigs:
    """Notices heads that are deleted, and removes the rigs and the curves of hair that they leave behind.

    `handlers` asks after edits.

    A head whose rig is deleted stays, as a mesh with its sliders, where it stood: Blender would drop it to the world's origin.
    """

    def __init__(self) -> None:
        """Know of nothing."""
        self._count = -1  # of objects: looking is only worth it after it has changed
        self._rig_of: dict[int, int] = {}  # by head; both by `session_uid`
        self._hair_of: dict[int, set[int]] = {}  # curves by head, likewise
        self._left: set[int] = set()
        self._bald: set[int] = set()  # curves whose heads are gone
        self._gone = False  # heads are, whatever became of their rigs
        self._places: dict[int, Matrix] = {}  # in the world, of heads
        self._dropped: set[int] = set()  # heads that have lost their rigs

    def note_place(self, avatar: Avatar) -> None:
        """Remember where a head stands; asked whenever one may have moved. One that has lost its rig lies at the origin."""
        if avatar.armature is not None:
            self._places[avatar.object.session_uid] = avatar.object.matrix_world.copy()

    def notice_deleted(self) -> bool:
        """Compare the objects with those of the last call; returns whether there is something to `remove` or to put back."""
        if len(bpy.data.objects) != self._count:
            self._count = len(bpy.data.objects)
            present, known, self._rig_of = {obj.session_uid for obj in bpy.data.objects}, self._rig_of, {}
            hair, self._hair_of = self._hair_of, {}
            for obj in bpy.data.objects:
                if obj.type == "CURVES" and obj.parent is not None and _is_ours(obj.data):
                    self._hair_of.setdefault(obj.parent.session_uid, set()).add(obj.session_uid)
                rig = Avatar(obj).armature if is_avatar(obj) else None
                if rig is not None:
                    self._rig_of[obj.session_uid] = rig.session_uid
                    self.note_place(Avatar(obj))
            gone = {rig for head, rig in known.items() if head not in present}
            self._left |= gone - set(self._rig_of.values())
            self._bald |= {uid for head in known if head not in present for uid in hair.get(head, ())}
            self._gone = self._gone or bool(gone)
            self._dropped |= {head for head, rig in known.items() if head in present and rig not in present}
        return self._gone or bool(self._dropped)

    def remove(self) -> None:
        """Remove the rigs, what `motion` made for them, and hair; put heads without a rig where they stood, free to be moved.

        Linked rigs stay, and those that something else hangs on, or that have other bones than ours.
        """
        for obj in list(bpy.data.objects):
            if obj.session_uid in self._dropped and obj.session_uid in self._places and obj.library is None and not obj.parent:
                obj.matrix_world = self._places[obj.session_uid]
                obj.lock_location = obj.lock_rotation = obj.lock_scale = (False, False, False)
            if obj.session_uid in self._left and obj.library is None and not obj.children and is_head_rig(obj):
                armature = obj.data
                bpy.data.objects.remove(obj)
                if not armature.users:
                    bpy.data.armatures.remove(armature)
        for obj in [obj for obj in bpy.data.objects if obj.session_uid in self._bald]:
            curves = obj.data
            if obj.library is None and obj.parent is None and not obj.children and _is_ours(curves):
                bpy.data.objects.remove(obj)
                if not curves.users:
                    bpy.data.hair_curves.remove(curves)
        self._left.clear()
        self._bald.clear()
        self._dropped.clear()
        self._gone = False
        remove_unused()
        self._count = len(bpy.data.objects)

    def forget(self) -> None:
        """Begin anew: another file, or another point of the undo history, is there now."""
        self._count, self._rig_of, self._left, self._gone = -1, {}, set(), False
        self._places, self._dropped, self._hair_of, self._bald = {}, set(), {}, set()


def _is_ours(curves: bpy.types.ID) -> bool:
    """Whether curves were made from a groom: `hair.build` says so in properties of theirs."""
    return any(key.startswith("grmm_") for key in curves.keys())  # noqa: SIM118 - a data-block is no mapping


def remove_unused() -> None:
    """Remove actions, custom shapes and Look At targets that `motion` made and nothing uses; a scene is no use."""
    for kind in (bpy.data.actions, bpy.data.objects, bpy.data.meshes):
        made = [found for found in kind if found.get(EXTRA) and found.library is None and not found.use_fake_user]
        users = bpy.data.user_map(subset=made) if made else {}
        for found in made:
            if not any(user.id_type not in ("COLLECTION", "SCENE") for user in users[found]):
                kind.remove(found)
