"""An animation whose worker is killed again and again: engine_killed.py WEIGHTS FOLDER ENGINE FRAMES KILLS.

The worker runs in Blender's own Python, or in that of GRMM_WORKER_PYTHON.
"""

from __future__ import annotations

import functools
import sys
import time
from pathlib import Path

import bpy
import numpy as np
from render_support import heads, load_png, new_scene
from support import module, report

sys.path.append(str(Path(__file__).resolve().parents[2] / "support"))
from worker_killer import WorkerKiller

weights, folder, engine, frames, kills = sys.argv[1], Path(sys.argv[2]), sys.argv[3], int(sys.argv[4]), int(sys.argv[5])
host, process = module("grmm_blender.session_host"), module("grmm_core.session.process")
host.create_session = functools.partial(host.create_session, engine=engine)
scene = new_scene(weights, size=(64, 64))
host.configure(host.RuntimeSettings(mode="worker", weights=weights, device="cpu", threads=1))
head = heads(scene)[0]
for frame, value in ((1, 0.0), (frames, 0.8)):
    head["jawOpen"] = value
    head.keyframe_insert('["jawOpen"]', frame=frame)
scene.frame_start, scene.frame_end = 1, frames


def animation(name: str) -> float:
    """Render into a folder; returns the seconds."""
    scene.render.filepath = str(folder / name / "frame_")
    begin = time.monotonic()
    bpy.ops.render.render(animation=True)
    return time.monotonic() - begin


bpy.ops.render.render()  # kernels are compiled
seconds = animation("whole")
host.shutdown()
begin = time.monotonic()
bpy.ops.render.render()
killer = WorkerKiller(process, frames, kills, seed=frames, draw=seconds / frames, start=time.monotonic() - begin)
host.shutdown()  # the next worker is one that the killer knows
bpy.app.handlers.render_pre.append(lambda scene, _: killer.picture(scene.frame_current - 1))
animation("killed")
pictures = [[folder / name / f"frame_{number:04d}.png" for number in range(1, frames + 1)] for name in ("whole", "killed")]
same = [bool(np.array_equal(load_png(one), load_png(other))) for one, other in zip(*pictures, strict=True)]
status = host.get_session().status()
report(
    same=sum(same), kills=killer.done, restarts=status.restarts, engine=status.engine, kind=status.kind,
    files=len(list((folder / "killed").iterdir())),
)  # fmt: skip
