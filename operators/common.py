"""What operators share: which avatar they work on, and how errors reach the user."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TypeVar

import bpy

from ..grmm_blender import preferences
from ..grmm_blender.exporting import frames_between, performer_of
from ..grmm_blender.rig.avatar import Avatar, active_object, avatar_of
from ..grmm_blender.splats.rigged import Puppet
from ..grmm_core.errors import FileAccessError, GrmmError

Result = set[str]
_Execute = TypeVar("_Execute", bound=Callable[..., Result])


class FrameRange:
    """Mixin: first and last frame of an export; zero means the scene's."""

    first: bpy.props.IntProperty(name="First Frame", description="First frame; 0 for the scene's", default=0, min=0)
    last: bpy.props.IntProperty(name="Last Frame", description="Last frame; 0 for the scene's", default=0, min=0)

    def frames(self, context: bpy.types.Context) -> list[int]:
        """Return the frame numbers. Raises `ConfigError` when there are none."""
        return frames_between(self.first or context.scene.frame_start, self.last or context.scene.frame_end)


def active_avatar(context: bpy.types.Context) -> Avatar | None:
    """Return the avatar of the active object (its head or its armature)."""
    return avatar_of(active_object(context))


def active_performer(context: bpy.types.Context) -> Avatar | Puppet | None:
    """Return what can play a performance: the active avatar, or an imported one with ARKit controls."""
    return performer_of(active_object(context))


def needs_performer(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """`poll` of operators that key the active avatar, or an imported one."""
    performer = active_performer(context)
    if performer is None:
        cls.poll_message_set("Select the head or the armature of an avatar")
        return False
    if not performer.object.is_editable:
        cls.poll_message_set("The avatar is linked; make a library override of it first")
        return False
    return True


def needs_avatar(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """`poll` of operators that work on the active avatar."""
    avatar = active_avatar(context)
    if avatar is None:
        cls.poll_message_set("Select the head or the armature of a GRMM avatar")
        return False
    if not avatar.object.is_editable:
        cls.poll_message_set("The avatar is linked; make a library override of it first")
        return False
    return True


def needs_object_mode(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
    """`poll` of operators that make new objects."""
    if context.mode != "OBJECT":
        cls.poll_message_set("Go to object mode first")
        return False
    return True


def reports_errors(execute: _Execute) -> _Execute:
    """Decorate `execute` so that the core's errors become a report and a cancelled operator; defects of ours stay visible."""

    @functools.wraps(execute)
    def guarded(self: bpy.types.Operator, context: bpy.types.Context) -> Result:
        try:
            return execute(self, context)
        except GrmmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    return guarded


def output_path(filepath: str, extensions: tuple[str, ...], default: str) -> Path:
    """Return the absolute path of a file to write, with `default` added where it has none of the extensions.

    Raises:
        FileAccessError: No file is chosen, or its folder does not exist.
    """
    if not filepath:
        raise FileAccessError("No file is chosen; choose a file name.")
    path = Path(bpy.path.abspath(filepath))
    if path.suffix.lower() not in extensions:
        path = path.with_name(path.name + default)
    if not path.parent.is_dir():
        raise FileAccessError(f"{path.parent} is not a folder; create it or choose another.")
    return path


def flame_path(chosen: str) -> str:
    """Return the FLAME file that an operator's option names, else that of the preferences, absolute, or ""."""
    named = chosen or preferences.get().flame
    return bpy.path.abspath(named) if named else ""
