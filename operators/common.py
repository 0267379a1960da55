"""What operators share: which avatar they work on, and how errors reach the user."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import bpy

from ..grmm_blender import preferences
from ..grmm_blender.declare import whole
from ..grmm_blender.exporting import frames_between, performer_of
from ..grmm_blender.rig.avatar import Avatar, active_object
from ..grmm_blender.splats.rigged import Puppet
from ..grmm_core.errors import FileAccessError, GrmmError

Result = set[str]
_Self = TypeVar("_Self", bound=bpy.types.Operator)


class FrameRange:
    """Mixin: first and last frame of an export; zero means the scene's."""

    first: whole("First Frame", "First frame; 0 for the scene's", min=0)
    last: whole("Last Frame", "Last frame; 0 for the scene's", min=0)

    def frames(self, context: bpy.types.Context) -> list[int]:
        """Return the frame numbers. Raises `ConfigError` when there are none."""
        return frames_between(self.first or context.scene.frame_start, self.last or context.scene.frame_end)


class UnavailableError(GrmmError):
    """An operator cannot run here; the sentence says what to select or to do first."""


class OperatorMixin:
    """Base of mixins: what they use of Blender's own class."""

    bl_idname: str
    bl_label: str
    properties: bpy.types.OperatorProperties
    report: Callable[[set[str], str], None]
    execute: Callable[[bpy.types.Context], Result]


def polls(question: Callable[[bpy.types.Context], object]) -> classmethod[Any, [bpy.types.Context], bool]:
    """Return a `poll` that gives an `UnavailableError` of `question` as the reason why an operator is not available."""

    def poll(cls: type[bpy.types.Operator], context: bpy.types.Context) -> bool:
        try:
            question(context)
        except UnavailableError as error:
            cls.poll_message_set(str(error))
            return False
        return True

    return classmethod(poll)


def require(condition: object, sentence: str) -> None:
    """Raise `UnavailableError` unless a condition holds."""
    if not condition:
        raise UnavailableError(sentence)


def active_performer(context: bpy.types.Context, linked: bool = False) -> Avatar | Puppet:
    """Return what can play a performance: the active avatar, or an imported one with ARKit controls.

    Args:
        context: With the head or the armature as its active object.
        linked: Also one that a library holds and that cannot be changed.

    Raises:
        UnavailableError: There is none.
    """
    performer = performer_of(active_object(context))
    if performer is None:
        raise UnavailableError("Select the head or the armature of an avatar")
    require(linked or performer.object.is_editable, "The avatar is linked; make a library override of it first")
    return performer


def active_avatar(context: bpy.types.Context, linked: bool = False) -> Avatar:
    """Return the active avatar, as `active_performer` does."""
    performer = active_performer(context, linked)
    if not isinstance(performer, Avatar):
        raise UnavailableError("Select the head or the armature of a GRMM avatar")
    return performer


def check_object_mode(context: bpy.types.Context) -> None:
    """Raise `UnavailableError` where no objects can be made or selected: outside of object mode."""
    require(context.mode == "OBJECT", "Go to object mode first")


def reports_errors(execute: Callable[[_Self, bpy.types.Context], Result]) -> Callable[[_Self, bpy.types.Context], Result]:
    """Decorate `execute` so that the core's errors become a report and a cancelled operator; defects of ours stay visible."""

    @functools.wraps(execute)
    def guarded(self: _Self, context: bpy.types.Context) -> Result:
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
    if not filepath or filepath.endswith(("/", "\\")):
        raise FileAccessError("No file is chosen; choose a file name.")
    path = Path(bpy.path.abspath(filepath))
    if path.suffix.lower() not in extensions:
        path = path.with_name(path.name + default)
    if not path.parent.is_dir():
        raise FileAccessError(f"{path.parent} is not a folder; create it or choose another.")
    return path


def add_suffix(operator: Any, extensions: tuple[str, ...], default: str) -> bool:
    """For `check` of a file browser: add `default` as `output_path` does, so that Blender marks the name where it exists."""
    path = Path(operator.filepath)
    if not path.name or path.suffix.lower() in extensions:
        return False
    operator.filepath = str(path.with_name(path.name + default))
    return True


def flame_path(option: str) -> str:
    """Return the FLAME file that an operator's option names, else that of the preferences, absolute, or ""."""
    named = option or preferences.get().flame
    return bpy.path.abspath(named) if named else ""


def menu_entries(menu: Any, *entries: tuple[type[bpy.types.Operator], str]) -> tuple[Callable[[], None], Callable[[], None]]:
    """Return what adds operators, each with its text, to a menu of Blender's, and what removes them."""

    def draw(self: bpy.types.Menu, context: bpy.types.Context) -> None:
        for operator, text in entries:
            self.layout.operator(operator.bl_idname, text=text)

    return lambda: menu.append(draw), lambda: menu.remove(draw)
