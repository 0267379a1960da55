"""How many frames a second a window plays with splats and on the bare mesh: `python -m tools.walk ZIP --rate`.

Turn by turn, so that what else the machine does favours neither; the processors' time that Blender, its worker and the screen
take for a frame says more than the clock on a busy machine.
"""

from __future__ import annotations

import time
from pathlib import Path

from tools.demo.performance import write_performance

from .blender import WalkedBlender, WalkError
from .steps import SELECT_RIG, add_head, install, start

TURNS, WARM_SECONDS, TURN_SECONDS = 3, 12.0, 15.0  # kernels of small pictures are compiled once
_COUNT = """
names = bpy.app.driver_namespace
if "walk frames" not in names:
    names["walk frames"] = 0
    def count(*_):
        bpy.app.driver_namespace["walk frames"] += 1
    bpy.app.handlers.frame_change_post.append(count)
result = names["walk frames"]
"""


_MESH_ONLY = """
import sys
overlay = next(module for name, module in sys.modules.items() if name.endswith("viewport.overlay"))
result = [viewport._mesh_only for viewport in overlay._viewports.values()]
"""


def measure(blender: WalkedBlender, extension: Path) -> None:
    """Play a recording in solid view on the bare mesh and with splats, then in rendered view, and print the rates."""
    blender.bring(extension, "grmm.zip")
    start(blender)
    install(blender)
    add_head(blender)
    path = blender.shared / "performance.json"
    write_performance(path)
    blender.run(SELECT_RIG + f"bpy.ops.grmm.import_performance(filepath={blender.inner(path)!r})")
    blender.run("bpy.ops.object.select_all(action='DESELECT')")
    blender.settle()
    for number in range(TURNS):
        for name, splats in (("bare mesh", False), ("splats", True)):
            blender.run(f"bpy.context.scene.grmm_viewport.use_splats = {splats}")
            _play(blender, f"{name}, turn {number + 1}", splats)
    blender.run("area.spaces.active.shading.type = 'RENDERED'")
    _play(blender, "rendered view")


def _play(blender: WalkedBlender, name: str, splats: bool = False) -> None:
    blender.run("bpy.ops.screen.animation_play()")
    time.sleep(WARM_SECONDS)
    frames, begin, spent = blender.run(_COUNT), time.monotonic(), blender.processor_seconds()
    time.sleep(TURN_SECONDS)
    frames, seconds = blender.run(_COUNT) - frames, time.monotonic() - begin
    spent = (blender.processor_seconds() - spent) / max(frames, 1)
    if splats and any(blender.run(_MESH_ONLY)):
        raise WalkError("with splats on, the bare mesh is played")
    blender.picture(name.partition(",")[0].replace(" ", "_"), 0.0, settled=False)
    blender.run("bpy.ops.screen.animation_cancel(restore_frame=False)")
    blender.note(f"{name}: {frames / seconds:.2f} frames a second, {1e3 * spent:.0f} ms of processors' time a frame")
