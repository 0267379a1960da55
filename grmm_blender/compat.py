"""Differences between Blender versions, found by feature and never by version number."""

from __future__ import annotations

from typing import Any

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


def node_input(modifier: bpy.types.Modifier, name: str) -> int | float:
    """What a geometry nodes modifier's input of a name is set to."""
    socket = _input_of(modifier, name)
    value: int | float = modifier[socket] if isinstance(socket, str) else socket.value
    return value


def set_node_input(modifier: bpy.types.Modifier, name: str, value: float) -> None:
    """Set a geometry nodes modifier's input of a name."""
    socket = _input_of(modifier, name)
    if isinstance(socket, str):
        modifier[socket] = value
    else:
        socket.value = value


def trim_strip(strip: bpy.types.Strip, first: int, last: int | None) -> None:
    """Leave out frames of a strip of the sequencer; the rest stays where it is.

    Args:
        strip: Of a file.
        first: Of its own frames, counted from 0, the first that is kept.
        last: The first one behind what is kept; None for all.
    """
    new = hasattr(strip, "left_handle_offset")
    length = round(strip.content_duration if new else strip.frame_duration)
    setattr(strip, "left_handle_offset" if new else "frame_offset_start", first)
    behind = 0 if last is None else max(length - last, 0)
    setattr(strip, "right_handle_offset" if new else "frame_offset_end", behind)


def strip_start(strip: bpy.types.Strip) -> int:
    """Frame on which the whole content of a strip of the sequencer begins, what is left out of it included."""
    return round(strip.content_start if hasattr(strip, "content_start") else strip.frame_start)


def heard_from(strip: bpy.types.Strip) -> int:
    """First frame on which a strip of the sequencer is played."""
    return round(strip.left_handle if hasattr(strip, "left_handle") else strip.frame_final_start)


def show_in_sequencers(scene: bpy.types.Scene) -> None:
    """Let sequencers that show no scene show this one: in 5.x each workspace names its own, at first none, and looks empty."""
    for workspace in bpy.data.workspaces:
        if getattr(workspace, "sequencer_scene", scene) is None:
            workspace.sequencer_scene = scene


def _input_of(modifier: bpy.types.Modifier, name: str) -> Any:
    """The modifier's own property, or its key where modifiers have none."""
    items = modifier.node_group.interface.items_tree
    key = next(item.identifier for item in items if item.name == name and item.in_out == "INPUT")
    properties = getattr(modifier, "properties", None)
    return key if properties is None else getattr(properties.inputs, key)
