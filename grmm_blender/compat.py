"""Differences between Blender versions, found by feature and never by version number."""

from __future__ import annotations

import bpy

ROOT_PACKAGE = __package__.rpartition(".")[0]
"""The extension's module, such as `bl_ext.user_default.grmm`: what preferences and user folders are named after."""


def bone_state(bone: bpy.types.PoseBone) -> tuple[bool, bool]:
    """Return whether a posed bone is hidden, and whether it is selected; 5.x keeps both with the pose."""
    hidden, selected = (getattr(bone if hasattr(bone, name) else bone.bone, name) for name in ("hide", "select"))
    return hidden, selected


def select_bone(bone: bpy.types.PoseBone) -> None:
    """Select a posed bone."""
    (bone if hasattr(bone, "select") else bone.bone).select = True


def user_folder(name: str, create: bool = False) -> str:
    """Return a folder of the extension's own under Blender's user files.

    Args:
        name: Sub-folder.
        create: Make it when missing.
    """
    return bpy.utils.extension_path_user(ROOT_PACKAGE, path=name, create=create)
