"""Operators whose steps run on a thread: modal with progress and cancel in a window, straight through in background.

An operator makes a `Steps` generator. Between yields it runs on Blender's main thread and may touch its data; what it yields
is a function that must not, and runs on a thread of its own in a window, so that Blender stays responsive. (`stepwise` is for
exports, whose steps all need Blender's data.)
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Generator
from dataclasses import dataclass
from typing import Any

import bpy

from ..grmm_core.errors import CancelledError, GrmmError
from .common import Result

CancelCheck = Callable[[], bool]
_INTERVAL = 0.05  # seconds between looks at the thread


@dataclass(frozen=True)
class Step:
    """One piece of work.

    Attributes:
        work: Called with a function that says whether to stop; its result is what the generator's `yield` returns.
        fraction: Share of the whole that is done when this step begins, 0..1.
        text: What is being done.
    """

    work: Callable[[CancelCheck], Any]
    fraction: float
    text: str


Steps = Generator[Step, Any, str]
"""Returns the sentence that is reported at the end."""


class _Work:
    """A step on a thread."""

    def __init__(self, step: Step) -> None:
        self.value: Any = None
        self.error: BaseException | None = None
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, args=(step,), daemon=True, name="grmm-step")
        self._thread.start()

    def _run(self, step: Step) -> None:
        try:
            self.value = step.work(self._stop.is_set)
        except BaseException as error:  # noqa: BLE001 - raised again on the main thread
            self.error = error

    @property
    def done(self) -> bool:
        return not self._thread.is_alive()

    def cancel(self) -> None:
        self._stop.set()
        self._thread.join()


class SteppedOperator:
    """Base of such operators: give it `steps`."""

    _steps: Steps | None = None
    _work: _Work | None = None
    _timer: bpy.types.Timer | None = None

    def steps(self, context: bpy.types.Context) -> Steps:
        """Make the generator. It cleans up after itself when it is closed early."""
        raise TypeError(f"{type(self).__name__} has no steps")

    def execute(self, context: bpy.types.Context) -> Result:
        """Run to the end where nobody is looking, else begin."""
        self._steps, self._work = self.steps(context), None
        if bpy.app.background or context.window is None:
            return self._run_through()
        manager = context.window_manager
        manager.progress_begin(0.0, 1.0)
        self._timer = manager.event_timer_add(_INTERVAL, window=context.window)
        manager.modal_handler_add(self)
        result = self._advance(context, None)
        return {"RUNNING_MODAL"} if result is None else result

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Look after the thread; Escape cancels."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"INFO"}, f"{self.bl_label}: cancelled")
            return {"CANCELLED"}
        if event.type != "TIMER" or self._work is None or not self._work.done:
            return {"PASS_THROUGH"}
        work, self._work = self._work, None
        result = self._advance(context, work)
        return {"RUNNING_MODAL"} if result is None else result

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop the thread and let the generator clean up; Blender calls this too when it quits."""
        if self._work is not None:
            self._work.cancel()
            self._work = None
        if self._steps is not None:
            self._steps.close()
        self._end(context)

    def _run_through(self) -> Result:
        value = None
        try:
            while True:
                value = self._steps.send(value).work(lambda: False)
        except StopIteration as end:
            self.report({"INFO"}, str(end.value))
            return {"FINISHED"}
        except GrmmError as error:
            self._steps.close()
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def _advance(self, context: bpy.types.Context, done: _Work | None) -> Result | None:
        """Hand a result to the generator and start the next step; None while there is more to do."""
        try:
            if done is not None and done.error is not None:
                step = self._steps.throw(done.error)
            else:
                step = self._steps.send(None if done is None else done.value)
        except StopIteration as end:
            self._end(context)
            self.report({"INFO"}, str(end.value))
            return {"FINISHED"}
        except (GrmmError, CancelledError) as error:
            self._end(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except BaseException:
            self._end(context)
            raise
        self._work = _Work(step)
        context.window_manager.progress_update(step.fraction)
        context.workspace.status_text_set(f"{self.bl_label}: {step.text} ({step.fraction:.0%}). Esc cancels")
        return None

    def _end(self, context: bpy.types.Context) -> None:
        if self._timer is not None:
            context.window_manager.event_timer_remove(self._timer)
            self._timer = None
            context.window_manager.progress_end()
            if context.workspace is not None:
                context.workspace.status_text_set(None)
