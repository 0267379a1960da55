"""The files that heads name stay the same ones: when the blend file is saved to another folder, and when heads are appended.

Blender renames relative paths of its own there, but not those in properties of extensions.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from . import events
from .hair.swing import hair_key
from .rig.avatar import is_avatar, library_of
from .rig.identity import FLAME_PREFIX

CLASSES = ()
_REUSED = "REUSE_LOCAL"  # what was appended before, and has been renamed then


@dataclass(frozen=True)
class _Names:
    """What a head names of files; `swing_of` has the source in it."""

    source: str
    swing_file: str
    swing_of: str

    @staticmethod
    def of(head: bpy.types.Object) -> _Names:
        hair = head.grmm.hair
        return _Names(head.grmm.source, hair.swing_file, hair.swing_of)

    def give(self, head: bpy.types.Object) -> None:
        """Name these files; who they are is not read again."""
        settings, hair = head.grmm, head.grmm.hair
        settings.is_avatar = False
        try:
            settings.source = self.source
        finally:
            settings.is_avatar = True
        hair.swing_file, hair.swing_of = self.swing_file, self.swing_of
        head.update_tag()


_before: list[tuple[bpy.types.Object, _Names]] = []  # of the heads that were renamed for the file that is being saved


@persistent
def _on_save(path: str, *_: object) -> None:
    """Name files relative to the folder that is saved to; a startup file has none, and a new file no relative names."""
    _before.clear()
    if not (path and bpy.data.filepath):
        return
    start, end = _folder(bpy.data.filepath), _folder(path)
    for obj in bpy.data.objects if start != end else ():
        if _is_own(obj):
            _before.append((obj, _Names.of(obj)))
            _rename(obj, start, end)


@persistent
def _on_saved(path: str, *_: object) -> None:
    """After a copy was saved, the file that is open still is in its old folder."""
    if _folder(bpy.data.filepath) != _folder(path):
        _on_save_failed()
    _before.clear()


@persistent
def _on_save_failed(*_: object) -> None:
    for head, names in _before:
        names.give(head)
    _before.clear()


@persistent
def _on_import(found: bpy.types.BlendImportContext, *_: object) -> None:
    """Name the files of appended heads from here; those that are not there may be found by where they once were."""
    end = _folder(bpy.data.filepath) if bpy.data.filepath else ""
    for item in found.import_items:
        obj, library = item.id, item.source_library
        if isinstance(obj, bpy.types.Object) and library is not None and item.append_action != _REUSED and _is_own(obj):
            _rename(obj, _folder(bpy.path.abspath(library.filepath)), end, only_found=True)


def _is_own(obj: bpy.types.Object) -> bool:
    """Whether an object is a head whose names of files start from this blend file's folder."""
    return is_avatar(obj) and library_of(obj) is None


def _rename(head: bpy.types.Object, start: str, end: str, only_found: bool = False) -> None:
    """Have a head name its files relative to another folder."""
    names, key = _Names.of(head), hair_key(head)
    source, swing_file = (_renamed(name, start, end, only_found) for name in (names.source, names.swing_file))
    if (source, swing_file) == (names.source, names.swing_file):
        return
    _Names(source, swing_file, names.swing_of).give(head)
    if names.swing_of == key:
        head.grmm.hair.swing_of = hair_key(head)


def _renamed(name: str, start: str, end: str, only_found: bool) -> str:
    """A name relative to a folder as one relative to another, or absolute where that is "" or on another drive."""
    if name.startswith(FLAME_PREFIX):
        return FLAME_PREFIX + _renamed(name.removeprefix(FLAME_PREFIX), start, end, only_found)
    path = os.path.normpath(bpy.path.abspath(name, start=start))
    if not name.startswith("//") or (only_found and not Path(path).exists()):
        return name
    try:
        return bpy.path.relpath(path, start=end) if end else path
    except ValueError:
        return path


def _folder(path: str) -> str:
    return str(Path(path).absolute().parent)


_EVENTS = (
    (bpy.app.handlers.save_pre, _on_save),
    (bpy.app.handlers.save_post, _on_saved),
    (bpy.app.handlers.save_post_fail, _on_save_failed),
    (bpy.app.handlers.blend_import_post, _on_import),
)


def register() -> None:
    """Follow Blender's events."""
    events.follow(_EVENTS)


def unregister() -> None:
    """Stop following them."""
    events.stop(_EVENTS)
    _before.clear()
