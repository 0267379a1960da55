"""Long work one step at a time: modal with progress and cancel for somebody who pressed a button, straight through in scripts.

An operator makes a `Steps` generator. Between yields it runs on Blender's main thread and may touch its data. What it yields
says how far it is, and may carry work that must not touch them: that runs on a thread of its own, so that Blender stays
responsive.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Generator, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
from bpy_extras.io_utils import ExportHelper

from ..grmm_core.errors import GrmmError
from ..grmm_core.jobs.progress import Progress, Reporter, duration
from ..grmm_core.jobs.stages import EXPORT
from .common import OperatorMixin, Result

CancelCheck = Callable[[], bool]
_INTERVAL = 0.02  # seconds between looks at the work
_TURN = 0.1  # seconds for which a walk through frames keeps Blender: each time that it lets go, viewports draw a frame
_SHORT = 5.0  # seconds; nobody needs to be told that less is left


@dataclass(frozen=True)
class Step:
    """One piece of work.

    Attributes:
        fraction: Share of the whole that is done by now, 0..1.
        text: What comes next; empty where the progress says enough.
        work: Called with a function that says whether to stop; its result is what the generator's `yield` returns. None where
            the generator does everything itself.
        walks: The generator is on a walk through the scene, which nobody may edit meanwhile, whatever runs on the thread.
    """

    fraction: float
    text: str = ""
    work: Callable[[CancelCheck], Any] | None = None
    walks: bool = False


Steps = Generator[Step, Any, str]
"""Returns the sentence that is reported at the end. It cleans up after itself when it is closed early."""


class Turn:
    """How long a walk through frames goes on at a time: viewports would draw after every frame of it otherwise."""

    def __init__(self, seconds: float = _TURN) -> None:
        self._seconds, self._begin = seconds, time.monotonic()

    def over(self) -> bool:
        """Whether Blender shall draw and listen now; then the next turn begins with this call."""
        now = time.monotonic()
        if now - self._begin < self._seconds:
            return False
        self._begin = now
        return True


class _Work:
    """A step's work on a thread, or nothing."""

    def __init__(self, step: Step) -> None:
        self.value: Any = None
        self.error: BaseException | None = None
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None
        self.walks = step.walks or step.work is None
        if step.work is not None:
            self._thread = threading.Thread(target=self._run, args=(step.work,), daemon=True, name="grmm-step")
            self._thread.start()

    def _run(self, work: Callable[[CancelCheck], Any]) -> None:
        try:
            self.value = work(self._stop.is_set)
        except BaseException as error:  # noqa: BLE001 - raised again on the main thread
            self.error = error

    @property
    def done(self) -> bool:
        return self._thread is None or not self._thread.is_alive()

    def cancel(self) -> None:
        self._stop.set()
        if self._thread is not None:
            self._thread.join()


@dataclass
class _Run:
    """What is kept of a run that somebody watches; `work` is that of the present step."""

    steps: Steps
    timer: bpy.types.Timer
    report: Reporter
    work: _Work | None = None


class SteppedOperator(OperatorMixin):
    """Base of such operators: give it `steps`. One that asks for a file first has an `invoke` of its own, with `ask`."""

    running: bpy.props.BoolProperty(default=False, options={"HIDDEN", "SKIP_SAVE"})
    replaces: bpy.props.BoolProperty(default=False, options={"HIDDEN", "SKIP_SAVE"})
    _asked = False
    _run: _Run | None = None

    def steps(self, context: bpy.types.Context) -> Steps:
        """Make the generator."""
        raise TypeError(f"{type(self).__name__} has no steps")

    def is_slow(self, context: bpy.types.Context) -> bool:
        """Whether there is anything to watch; else `execute` does it all."""
        return True

    def written(self, context: bpy.types.Context) -> Iterable[Path]:
        """Files that it writes and whose names the file browser did not show: it marks a chosen name that exists, only."""
        return ()

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Begin, for somebody who watches."""
        return self.begin(context, event)

    def ask(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Have the file browser ask for a file; `execute` comes afterwards."""
        self._asked = True
        if isinstance(self, ExportHelper):
            return ExportHelper.invoke(self, context, event)
        context.window_manager.fileselect_add(self)
        return {"RUNNING_MODAL"}

    def execute(self, context: bpy.types.Context) -> Result:
        """Run to the end, or begin where a file or whether to replace some was asked for: then somebody watches."""
        confirmed = self.running and not bpy.app.background
        if (self._asked or confirmed) and context.window is not None and (confirmed or self.is_slow(context)):
            # The file browser frees its operator when this returns, so that another one has to go modal.
            names = [name for name in self.properties.keys() if name not in ("running", "replaces")]  # noqa: SIM118
            category, _, name = type(self).bl_idname.partition(".")  # of an instance it is "GRMM_OT_..."
            again = getattr(getattr(bpy.ops, category), name)
            try:
                given = {name: getattr(self, name) for name in names}
                return again("INVOKE_DEFAULT", running=True, replaces=confirmed, **given)
            except RuntimeError as error:  # what the other one reports comes out so
                self.report({"ERROR"}, str(error).removeprefix("Error: ").strip())
                return {"CANCELLED"}
        steps, value = self.steps(context), None
        try:
            while True:
                step = steps.send(value)
                value = None if step.work is None else step.work(lambda: False)
        except StopIteration as end:
            self.report({"INFO"}, str(end.value))
            return {"FINISHED"}
        except GrmmError as error:
            steps.close()
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}

    def begin(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Begin, and look after the work from now on; before files are replaced, ask."""
        if bpy.app.background or context.window is None:
            return self.execute(context)
        there = [] if self.replaces else self._there(context)
        if there:
            others = f" and {len(there) - 1} more" if len(there) > 1 else ""
            return context.window_manager.invoke_confirm(
                self, event, title="Replace Files?", confirm_text="Replace", icon="WARNING",
                message=f"{there[0].name}{others} in {there[0].parent.name} will be replaced.",
            )  # fmt: skip
        manager = context.window_manager
        timer = manager.event_timer_add(_INTERVAL, window=context.window)
        manager.progress_begin(0.0, 1.0)
        self._run = _Run(self.steps(context), timer, Reporter(EXPORT, lambda progress: self._show(context, progress)))
        result = self._advance(context, self._run, None)
        if "RUNNING_MODAL" in result:  # Blender crashes on the handler of an operator that has ended
            manager.modal_handler_add(self)
        return result

    def _there(self, context: bpy.types.Context) -> list[Path]:
        try:
            return [path for path in self.written(context) if path.exists()]
        except GrmmError:  # the steps meet the same
            return []

    def modal(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Look after the work; Escape cancels."""
        if event.type == "ESC" and event.value == "PRESS":
            self.cancel(context)
            self.report({"WARNING"}, f"{self.bl_label}: cancelled; what was finished before stays")
            return {"CANCELLED"}
        run = self._run
        if run is None or run.work is None:
            return {"PASS_THROUGH"}
        if event.type != "TIMER" or not run.work.done:
            return {"RUNNING_MODAL"} if run.work.walks else {"PASS_THROUGH"}
        work, run.work = run.work, None
        return self._advance(context, run, work)

    def cancel(self, context: bpy.types.Context) -> None:
        """Stop the work and let the generator clean up; Blender calls this too when it quits."""
        if self._run is not None and self._run.work is not None:
            self._run.work.cancel()
        self._end(context)

    def _advance(self, context: bpy.types.Context, run: _Run, done: _Work | None) -> Result:
        """Hand a result to the generator and start the next step."""
        try:
            if done is not None and done.error is not None:
                step = run.steps.throw(done.error)
            else:
                step = run.steps.send(None if done is None else done.value)
        except StopIteration as end:
            self._end(context)
            self.report({"INFO"}, str(end.value))
            return {"FINISHED"}
        except GrmmError as error:
            self._end(context)
            self.report({"ERROR"}, str(error))
            return {"CANCELLED"}
        except BaseException:
            self._end(context)
            raise
        run.work = _Work(step)
        run.report("write", step.fraction, step.text)
        return {"RUNNING_MODAL"}

    def _show(self, context: bpy.types.Context, progress: Progress) -> None:
        context.window_manager.progress_update(progress.fraction)
        text = f"{progress.message} " if progress.message else ""
        left = f", about {duration(progress.seconds_left)} left" if progress.seconds_left > _SHORT else ""
        context.workspace.status_text_set(f"{self.bl_label}: {text}({progress.fraction:.0%}{left}). Esc cancels")

    def _end(self, context: bpy.types.Context) -> None:
        run, self._run = self._run, None
        if run is not None:
            run.steps.close()
            context.window_manager.event_timer_remove(run.timer)
            context.window_manager.progress_end()
            if context.workspace is not None:
                context.workspace.status_text_set(None)
