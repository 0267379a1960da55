"""Long operators as a window runs them, with a window that the script plays: operator_steps.py.

Headless Blender runs such operators straight through, so `begin` and `modal` are called here as its event loop would.
"""

from __future__ import annotations

import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
from support import module, report

steps = module("operators.steps")


class GRMM_OT_asks_for_a_file(steps.SteppedOperator, bpy.types.Operator):
    """A registered one, which goes through Blender's own call of operators after the file browser."""

    bl_idname = "grmm.asks_for_a_file"
    bl_label = "Asks"

    filepath: bpy.props.StringProperty()
    calls: list = []  # noqa: RUF012 - of the class: every call is another instance

    def execute(self, context):
        self._asked = not self.running  # a background Blender has no file browser, and executes where it is to invoke
        return super().execute(context)

    def steps(self, _context):
        self.calls.append([self.running, self.filepath])
        if not self.filepath:
            raise errors.FileAccessError("No file is chosen.")
        yield steps.Step(0.5)
        return "done"


def after_the_file_browser() -> dict:
    bpy.utils.register_class(GRMM_OT_asks_for_a_file)
    result = bpy.ops.grmm.asks_for_a_file(filepath="chosen.txt")
    try:
        bpy.ops.grmm.asks_for_a_file()
    except RuntimeError as error:
        said = str(error)
    bpy.utils.unregister_class(GRMM_OT_asks_for_a_file)
    calls = GRMM_OT_asks_for_a_file.calls
    return {"window": bpy.context.window is not None, "result": sorted(result), "calls": calls, "refused": said.strip()}


errors = module("grmm_core.errors")
report(asked=after_the_file_browser())
steps.bpy = SimpleNamespace(app=SimpleNamespace(background=False), types=steps.bpy.types, props=steps.bpy.props)
PATIENCE = 20.0  # seconds until a thread counts as stuck
TIMER, ESCAPE, CLICK = (
    SimpleNamespace(type=kind, value=value) for kind, value in (("TIMER", ""), ("ESC", "PRESS"), ("LEFTMOUSE", "PRESS"))
)


class Window:
    """Stands in for the context: notes what is shown."""

    def __init__(self) -> None:
        self.window, self.window_manager, self.workspace = object(), self, self
        self.shown: list[float | str | None] = []
        self.open = self.handlers = 0

    def event_timer_add(self, _interval: float, window: object) -> object:
        self.open += 1
        return self

    def event_timer_remove(self, _timer: object) -> None:
        self.open -= 1

    def progress_begin(self, *_: float) -> None: ...

    def progress_end(self) -> None:
        self.shown.append("end")

    def progress_update(self, done: float) -> None:
        self.shown.append(done)

    def status_text_set(self, text: str | None) -> None:
        self.shown.append(text)

    def modal_handler_add(self, _operator: object) -> None:
        self.handlers += 1

    def invoke_confirm(self, _operator: object, _event: object, *, message: str, **_options: str) -> set[str]:
        self.shown.append(message)
        return {"INTERFACE"}


class Job(steps.SteppedOperator):
    """Three steps: one here, one on a thread, one here; `fails` says in which there is an error."""

    bl_label = "Job"
    running = replaces = False

    def __init__(self, fails: str = "") -> None:
        self.fails, self.said, self.log = fails, [], []
        self.started, self.stopped = threading.Event(), threading.Event()
        self.go_on = threading.Event()

    def report(self, kind: set[str], text: str) -> None:
        self.said.append([*kind, text])

    def steps(self, _context: object):
        try:
            if self.fails == "at once":
                raise errors.FileAccessError("No folder.")
            yield steps.Step(0.25, "first")
            if self.fails == "here":
                raise errors.FileAccessError("No room.")
            value = yield steps.Step(0.5, "second", self.work)
            self.log.append(value)
            yield steps.Step(0.75)
            return f"done {value}"
        finally:
            self.log.append("closed")

    def work(self, should_stop) -> str:
        self.log.append(threading.current_thread() is threading.main_thread())
        self.started.set()
        while not should_stop() and not self.go_on.wait(0.002):
            pass
        if should_stop():
            self.stopped.set()
        if self.fails == "thread":
            raise errors.SessionError("The model worker ended.")
        return "value"

    def until_done(self, window: Window) -> set[str]:
        """Let timer events come until the operator ends."""
        for _ in range(10_000):
            result = self.modal(window, TIMER)
            if result & {"FINISHED", "CANCELLED"}:
                return result
            threading.Event().wait(0.002)
        raise RuntimeError(f"did not end: {self.log}")


def finished() -> dict:
    job, window = Job(), Window()
    first = job.begin(window, CLICK)
    swallowed = job.modal(window, CLICK)  # nothing may be edited while a step on this thread waits for its turn
    job.modal(window, TIMER)
    job.started.wait(PATIENCE)
    passed = job.modal(window, CLICK)  # work on a thread leaves Blender to the user
    waiting = job.modal(window, TIMER)
    job.go_on.set()
    last = job.until_done(window)
    return {
        "results": [sorted(r)[0] for r in (first, swallowed, passed, waiting, last)], "said": job.said, "log": job.log,
        "shown": window.shown, "timers": window.open,
    }  # fmt: skip


class Walk(Job):
    """Work on a thread in the middle of a walk through the scene's frames."""

    def steps(self, _context: object):
        yield steps.Step(0.5, work=self.work, walks=True)
        return "walked"


def walking() -> dict:
    job, window = Walk(), Window()
    job.begin(window, CLICK)
    job.started.wait(PATIENCE)
    swallowed = job.modal(window, CLICK)  # nothing may be edited, although Blender goes on drawing
    job.go_on.set()
    return {"swallowed": sorted(swallowed), "last": sorted(job.until_done(window)), "log": job.log}


def cancelled() -> dict:
    job, window = Job(), Window()
    job.begin(window, CLICK)
    job.modal(window, TIMER)
    job.started.wait(PATIENCE)
    result = job.modal(window, ESCAPE)
    return {"result": sorted(result), "said": job.said, "log": job.log, "stopped": job.stopped.is_set(), "timers": window.open}


def failed(where: str) -> dict:
    job, window = Job(where), Window()
    job.go_on.set()
    job.begin(window, CLICK)
    result = job.until_done(window)
    return {"result": sorted(result), "said": job.said, "log": job.log[-1], "timers": window.open}


def failed_at_once() -> dict:
    job, window = Job("at once"), Window()
    return {"result": sorted(job.begin(window, CLICK)), "said": job.said, "handlers": window.handlers, "timers": window.open}


def replaces() -> dict:
    """Files that the file browser did not mark: asked about first, then written; `execute` is what a popup calls."""
    job, window = Job(), Window()
    there = Path(__file__)
    job.written = lambda _context: [there.with_name("not there"), there, there.with_name("support.py")]
    asked = job.begin(window, CLICK)
    waits = window.open, window.handlers
    job.replaces = True
    return {"asked": sorted(asked), "shown": window.shown[:1], "waits": waits, "then": sorted(job.begin(window, CLICK))}


def in_a_script(where: str = "") -> dict:
    job = Job(where)
    job.go_on.set()
    return {"result": sorted(job.execute(Window())), "said": job.said, "log": job.log}


report(finished=finished(), cancelled=cancelled(), here=failed("here"), thread=failed("thread"), at_once=failed_at_once())
report(walking=walking(), replaces=replaces(), script=in_a_script(), script_fails=in_a_script("thread"))
