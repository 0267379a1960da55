"""An avatar is added while another thread's picture keeps the model, as the first one does while it compiles: busy_model.py."""

from __future__ import annotations

import threading
import time
import types

import bpy
import numpy as np
from render_support import unpainted
from support import empty_scene, enable, module, report

enable()
handlers, host, live = (module(f"grmm_blender.{name}") for name in ("handlers", "session_host", "rig.live"))
avatar_of, errors = module("grmm_blender.rig.avatar").avatar_of, module("grmm_core.errors")
LONG = 120.0  # seconds


def waits_in_render(engine: str = "CYCLES") -> bool:
    """Whether a handler of this thread waits for the model while a window renders."""
    scene = types.SimpleNamespace(render=types.SimpleNamespace(engine=engine))
    app = types.SimpleNamespace(background=False, is_job_running=lambda name: name == "RENDER")
    handlers.bpy, actual = types.SimpleNamespace(app=app), handlers.bpy
    try:
        return handlers._may_wait(types.SimpleNamespace(scene=scene))
    finally:
        handlers.bpy = actual


def renders() -> None:
    rendering.extend([waits_in_render(), waits_in_render("GRMM")])  # the engine waits itself, where Escape is heard
    host._has_drawn = True
    rendering.append(waits_in_render("GRMM"))
    host._has_drawn = False


rendering: list[bool] = []
worker = threading.Thread(target=renders)
worker.start()
worker.join()
report(window_waits=waits_in_render(), render_waits=rendering)
handlers._may_wait = lambda depsgraph: False  # as in a window


def caught_up() -> bool:
    """Run the timer's function, as a window would, until it asks for no further turn."""
    end = time.monotonic() + LONG
    while handlers._catch_up() is not None:
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True


def learned() -> float:
    keys = avatar.object.data.shape_keys.key_blocks
    rest, key = (np.empty(3 * len(avatar.object.data.vertices), np.float32) for _ in range(2))
    keys[0].data.foreach_get("co", rest)
    keys[live.RESIDUAL_KEY].data.foreach_get("co", key)
    return float(np.abs(key - rest).max())


def hold() -> None:
    session = host.get_session()
    with session.at_once(LONG):
        session.open("default")
        holding.set()
        free.wait(LONG)


scene = empty_scene()
holding, free = threading.Event(), threading.Event()
thread = threading.Thread(target=hold)
thread.start()
holding.wait(LONG)
started = time.monotonic()
with unpainted():
    bpy.ops.grmm.add_head()
avatar = avatar_of(bpy.context.object)
avatar.object["jawOpen"] = 0.7
avatar.object.update_tag()
bpy.context.view_layer.update()
turn = handlers._catch_up()
report(
    seconds=time.monotonic() - started, vertices=len(avatar.object.data.vertices), while_busy=learned(), again=turn,
    corner=host.loading("Loading splats"),
)  # fmt: skip
free.set()
thread.join()
report(caught_up=caught_up(), after=learned(), message=live.state_of(avatar).message)


def refuse(source: str) -> None:
    raise errors.FileAccessError(f"There is no {source} today; look elsewhere.")


host._opened.clear()
open_avatar, host.open_avatar = host.open_avatar, refuse
avatar.object["jawOpen"] = 0.2
avatar.object.update_tag()
bpy.context.view_layer.update()
report(refused=caught_up(), why=live.state_of(avatar).message)
host.open_avatar = open_avatar
avatar.object["jawOpen"] = 0.3
avatar.object.update_tag()
bpy.context.view_layer.update()
report(recovered=caught_up(), still=live.state_of(avatar).message)

# While another thread's picture is drawn, who is open is waited for a moment; who has to be opened first is not.
host._has_drawn = True
holding.clear()
free.clear()
thread = threading.Thread(target=hold)
thread.start()
holding.wait(LONG)
waits = []
for source in (avatar.source, "library:bun"):
    started = time.monotonic()
    with host.answering(source):
        waits.append(time.monotonic() - started)
free.set()
thread.join()
report(waits=waits)
