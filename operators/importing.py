"""What operators that import files share: the file browser, progress, warnings, dropped files, the menu entry."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager

import bpy

from ..grmm_blender.declare import choice, flag
from .common import OperatorMixin, Result

_MAX_WARNINGS = 5


class ImportsFiles(OperatorMixin):
    """Mixin of operators with a `filepath`, and perhaps `files`."""

    filepath: str

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Open the file browser, unless something was dropped."""
        if self.filepath or len(getattr(self, "files", ())):
            return self.execute(context)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def warn(self, sentences: Iterable[str]) -> None:
        """Report the first few different sentences as warnings."""
        for sentence in list(dict.fromkeys(sentences))[:_MAX_WARNINGS]:
            self.report({"WARNING"}, sentence)


@contextmanager
def pointer_progress(context: bpy.types.Context, total: int) -> Iterator[Callable[[int], None]]:
    """Show progress at the mouse pointer; yields what sets it, 0..total."""
    manager = context.window_manager
    manager.progress_begin(0, total)
    try:
        yield manager.progress_update
    finally:
        manager.progress_end()


def over_viewport(context: bpy.types.Context) -> bool:
    """Whether something is held over a 3D viewport; `poll_drop` of file handlers asks."""
    return context.area is not None and context.area.type == "VIEW_3D"


class KeysHead:
    """Mixin of operators that key a head with a performance: what they all ask."""

    head: choice(
        "Head Rotation",
        "Which bone takes the recorded rotation of the head",
        ("neck", "Neck", "The neck bone: the shoulders stay"),
        ("root", "Root", "The root bone: everything turns"),
        ("NONE", "None", "Leave the head where it is"),
    )
    present: choice(
        "Old Action",
        "What becomes of an animation that the avatar has; the recording gets an action named after the file",
        ("KEEP", "Keep", "It stays in the file with a fake user, to be chosen again in the action editor"),
        ("ADD", "Add to It", "It plays on in a track of the nonlinear animation, and the recording is added to it"),
        ("PUSH_DOWN", "Push Down", "It plays on in a track of the nonlinear animation, below the recording"),
        ("WRITE_INTO", "Write Into", "No new action: the recording replaces its keys from first to last frame"),
    )
    set_range: flag("Set Scene Range", "Let the scene start and end with the performance", default=True)

    @property
    def head_joint(self) -> str:
        """The bone, "" for none."""
        return "" if self.head == "NONE" else self.head


class TakesDrops:
    """Mixin of file handlers: files that are dropped into a 3D viewport."""

    @classmethod
    def poll_drop(cls, context: bpy.types.Context) -> bool:
        """Only in 3D viewports."""
        return over_viewport(context)
