"""Long exports one step at a time: with progress and Escape where somebody chose them, in one go in scripts."""

from __future__ import annotations

from collections.abc import Iterator

import bpy

from ..grmm_blender.exporting import frames_between
from ..grmm_core.errors import GrmmError
from .common import Result

_TICK_SECONDS = 0.01
_HUNDRED = 100


class FrameRange:
    """Mixin: first and last frame of an export; zero means the scene's."""

    first: bpy.props.IntProperty(name="First Frame", description="First frame; 0 for the scene's", default=0, min=0)
    last: bpy.props.IntProperty(name="Last Frame", description="Last frame; 0 for the scene's", default=0, min=0)

    def frames(self, context: bpy.types.Context) -> list[int]:
        """Return the frame numbers. Raises `ConfigError` when there are none."""
        return frames_between(self.first or context.scene.frame_start, self.last or context.scene.frame_end)


class Stepwise:
    """Mixin of operators whose work is a generator.

    A class gives `steps`, which yields how far it is (0..1) after each step and may raise the core's errors, and `finished`,
    which reports. After `invoke` has set `interactive`, `execute` starts the operator once more as a modal one.
    """

    running: bpy.props.BoolProperty(default=False, options={"HIDDEN", "SKIP_SAVE"})
    interactive = False
    _steps: Iterator[float] | None = None
    _timer: bpy.types.Timer | None = None

    def steps(self, context: bpy.types.Context) -> Iterator[float]:
        """Do the work."""
        raise NotImplementedError

    def finished(self, context: bpy.types.Context) -> None:
        """Report what was done."""

    def is_slow(self, context: bpy.types.Context) -> bool:
        """Whether there is more than one step worth showing."""
        return True

    def run(self, context: bpy.types.Context) -> Result:
        """`execute` of the class."""
        if self.interactive and context.window is not None and self.is_slow(context):
            names = [name for name in self.properties.keys() if name != "running"]  # noqa: SIM118 - no dictionary
            again = getattr(getattr(bpy.ops, self.bl_idname.split(".")[0]), self.bl_idname.split(".")[1])
            return again("INVOKE_DEFAULT", running=True, **{name: getattr(self, name) for name in names})
        try:
            for _ in self.steps(context):
                pass
        except GrmmError as error:
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        self.finished(context)
        return {"FINISHED"}

    def start(self, context: bpy.types.Context) -> Result:
        """`invoke` of the class, when `running` is set."""
        manager = context.window_manager
        self._steps = self.steps(context)
        self._timer = manager.event_timer_add(_TICK_SECONDS, window=context.window)
        manager.progress_begin(0, _HUNDRED)
        manager.modal_handler_add(self)
        return {"RUNNING_MODAL"}

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """One step a tick; Escape ends it, and finished files stay."""
        if event.type == "ESC":
            self._stop(context)
            self.report({"WARNING"}, "Export cancelled; files that were finished before stay")
            return {"CANCELLED"}
        if event.type != "TIMER":
            return {"RUNNING_MODAL"}
        try:
            done = next(self._steps)
        except StopIteration:
            self._stop(context)
            self.finished(context)
            return {"FINISHED"}
        except GrmmError as error:
            self._stop(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        context.window_manager.progress_update(int(done * _HUNDRED))
        context.workspace.status_text_set(f"{self.bl_label}: {done:.0%}   Esc: cancel")
        return {"RUNNING_MODAL"}

    def _stop(self, context: bpy.types.Context) -> None:
        self._steps.close()  # runs its `finally`, which brings the scene's frame back
        context.window_manager.event_timer_remove(self._timer)
        context.window_manager.progress_end()
        context.workspace.status_text_set(None)
