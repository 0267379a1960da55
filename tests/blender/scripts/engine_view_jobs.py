"""The rendered viewport's thread, with a pipeline and a clock that the script holds in its hands: engine_view_jobs.py

Every line of the log is an event that the test judges. Nothing here waits for time to pass.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
from support import module, report

camera_module = module("grmm_core.geometry.camera")
errors = module("grmm_core.errors")
pipeline = module("grmm_blender.engine.pipeline")
shot = module("grmm_blender.scene.shot")
view_jobs = module("grmm_blender.engine.view_jobs")
PATIENCE = 20.0  # seconds until a thread counts as stuck

log: list[str] = []
rested = threading.Event()  # set: the view has rested
started = threading.Semaphore(0)  # a picture has begun
proceed = threading.Semaphore(0)  # lets a picture go on
plan = SimpleNamespace(error=None)


def wait_for_rest(is_outdated: Callable[[], bool]) -> None:
    waiting = threading.Event()
    while not rested.is_set() and not is_outdated():
        waiting.wait(0.002)


def frame_values(frame, settings, items, region, should_cancel, depths):
    """Stands in for the pipeline: begins, waits to be let go on, and looks whether it was cancelled."""
    kind = "final" if settings.refine and settings.strands == 1.0 else "playing" if settings.refine else "preview"
    name = f"{kind} {frame.scene.avatars[0]} {region.width}x{region.height}"
    log.append(f"begin {name}")
    started.release()
    if not proceed.acquire(timeout=PATIENCE):
        raise RuntimeError("stuck")
    if plan.error is not None:
        raise plan.error
    if should_cancel():
        log.append(f"cancelled {name}")
        raise errors.CancelledError("cancelled")
    values = np.zeros((region.height, region.width, 4), np.float32)
    values[0] = 1.0  # the top row
    return {"Combined": values, "Mask": values[..., :1], "Depth": values[..., :1]}


pipeline.frame_values = frame_values
pipeline.announce = lambda frame, settings, items: log.append(f"announce {frame.scene.avatars[0]}")


def request(name: str, width: int = 640, height: int = 480, seconds: float | None = None):
    frame = shot.Frame(shot.SceneShot((name,)), camera_module.Camera.orbit(width, height), (0.1, 100.0))
    ways = pipeline.DrawSettings(refine=False, lod=1), pipeline.DrawSettings()
    return view_jobs.ViewRequest(frame, *ways, playing=pipeline.DrawSettings(strands=0.5), seconds=seconds)


def begun() -> None:
    if not started.acquire(timeout=PATIENCE):
        raise RuntimeError(f"nothing has begun: {log}")


def step() -> None:
    """Let the picture that has begun go on."""
    proceed.release()


def until(condition: Callable[[], bool]) -> None:
    event = threading.Event()
    for _ in range(int(PATIENCE / 0.002)):
        if condition():
            return
        event.wait(0.002)
    raise RuntimeError(f"did not come: {log}")


def take() -> str:
    until(lambda: jobs.has_news)
    picture = jobs.take()
    if picture is None:
        return f"error {jobs.error}"
    turned = "turned" if picture.values[-1].min() == 1 and picture.values[0].max() == 0 else "upright"
    return f"{picture.level} {picture.request.frame.scene.avatars[0]} {turned}"


def section() -> list[str]:
    found = list(log)
    log.clear()
    return found


# At rest: the cheap picture in a quarter of the size, then the good one; then the thread ends.
jobs = view_jobs.ViewJobs(wait_for_rest)
rested.set()
jobs.request(request("a"))
begun(), step()
first = take()
begun(), step()
second = take()
report(rest=section(), pictures=[first, second], ended=jobs.wait(PATIENCE) and not jobs.busy)

# The view moves on before it rests: cheap pictures only, and those in between are left out.
rested.clear()
jobs.request(request("a"))
begun()
jobs.request(request("b"))
jobs.request(request("c"))
step()
shown = [take()]
begun(), step()
shown.append(take())
report(moving=section(), shown=shown)

# The good picture of "c" is given up for "d".
rested.set()
begun()
rested.clear()
jobs.request(request("d"))
step()
begun(), step()
until(lambda: len(log) == 3)
report(superseded=section())

# The good picture gives way to Blender's main thread, and is begun again afterwards.
rested.set()
begun()
view_jobs.give_way()
step()
begun(), step()
until(lambda: not jobs.busy or jobs.has_news)
jobs.wait(PATIENCE)
report(gave_way=section(), afterwards=take())

# A frame of playback is one refined picture of 512 x 512 pixels at most; where that takes longer than a frame may, one of
# 384 x 384, where that does, cheap ones follow. A still picture follows when it is stopped.
levels = []
frames = (
    [(name, 1e3) for name in "pqr"] + [(name, 1e-9) for name in "so"] + [("stop", None)] + [(name, 1e-9) for name in "tuvi"]
)
for name, seconds in frames:
    jobs.request(request(name, 1024, 1024, seconds))
    for _ in range(1 if seconds else 2):
        begun(), step()
        levels.append(take())
    jobs.wait(PATIENCE)
report(playing=section(), playing_levels=levels)

# What is asked for while a frame of playback is drawn is announced, one frame at a time, and drawn next, then the newest.
jobs.request(request("w", 512, 512, 1e3))
begun()
for name in ("x", "y", "z"):
    jobs.request(request(name, 512, 512, 1e3))
drawn = []
for _ in range(3):
    step()
    drawn.append(take())
    if len(drawn) < 3:
        begun()
jobs.wait(PATIENCE)
report(ahead=section(), ahead_drawn=drawn)

# Errors are for the user: ours as they are, defects with their name; the next request starts afresh.
plan.error = errors.SessionError("The model worker ended.")
jobs.request(request("e"))
begun(), step()
jobs.wait(PATIENCE)
messages = [jobs.error]
plan.error = ZeroDivisionError("oops")
jobs.request(request("f"))
messages.append(jobs.error)  # the old one is gone as soon as something new is wanted
begun(), step()
jobs.wait(PATIENCE)
messages.append(jobs.error)
plan.error = None
section()
report(errors=messages)

# Closed in the middle: the picture is dropped, nothing starts any more.
jobs.request(request("g"))
begun()
view_jobs.close_all()
step()
ended = jobs.wait(PATIENCE)
jobs.request(request("h"))
report(closed=section(), closed_ended=ended, closed_picture=jobs.take() is None, closed_busy=jobs.busy)
