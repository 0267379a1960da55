"""Renders that end before they are done: engine_stops.py WEIGHTS FOLDER

Interrupted and cancelled animations, a full disk, avatars of another version, a camera at odds with the border.
"""

from __future__ import annotations

import json
import struct
import sys
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
from render_support import difference, expected, expected_png, full_camera, heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights, size=(48, 40))
head = heads(scene)[0]
host = module("grmm_blender.session_host")
pipeline = module("grmm_blender.engine.pipeline")
final = module("grmm_blender.engine.final")
errors = module("grmm_core.errors")
alone = expected_png(expected(scene, full_camera(scene)))
messages: dict[str, str] = {}
left: dict[str, list[str]] = {}
scene.frame_start, scene.frame_end = 1, 4


def attempt(name: str, target: str = "", animation: bool = False) -> None:
    """Render and note the error, and the files that are there afterwards."""
    place = folder / name
    place.mkdir()
    scene.render.filepath = target or str(place / ("frame_" if animation else "picture.png"))
    try:
        bpy.ops.render.render(write_still=not animation, animation=animation)
        messages[name] = ""
    except RuntimeError as error:
        messages[name] = str(error).strip()
    left[name] = sorted(path.name for path in place.iterdir())


def at_third_call(error: BaseException):
    """Let two frames be drawn, then raise."""
    original, count = pipeline.frame_values, [0]

    def frame_values(*arguments: object, **options: object) -> object:
        count[0] += 1
        if count[0] > 2:
            raise error
        return original(*arguments, **options)

    pipeline.frame_values = frame_values
    return original


# As in a window, which shows the frame before until there is a new one.
final._has_window = True
written = []
write = final._Result.write
final._Result.write = lambda result, values, view="": written.append(list(values)) or write(result, values, view)
original = at_third_call(KeyboardInterrupt())
attempt("interrupted", animation=True)
pipeline.frame_values = original
final._Result.write, final._has_window = write, False
pictures = [load_png(folder / "interrupted" / f"frame_000{number}.png") for number in (1, 2)]
report(written=len(written), shown_before=max(difference(found, alone) for found in pictures))
# In another size of the same shape it fills the picture; a border of another shape begins empty.
last = np.arange(8.0 * 4 * 2).reshape(4, 8, 2)
larger, smaller, other = (module("grmm_blender.engine.picture").stretched(last, *size) for size in ((16, 8), (3, 2), (8, 8)))
report(stretched=bool((larger[::2, 1::2] == last).all()), smaller=list(smaller.shape), other=other is None)
original = at_third_call(errors.CancelledError("The picture was cancelled."))
attempt("cancelled", animation=True)
pipeline.frame_values = original

# A session that is told to stop in the middle of drawing does so, and the next picture is whole.
session = host.get_session()
draw, asked = session.render, []


def stopped(*arguments: object, **options: object) -> object:
    return draw(*arguments[:3], lambda: bool(asked.append(1)) or len(asked) > 1)


session.render = stopped
size = scene.render.resolution_x, scene.render.resolution_y
scene.render.resolution_x, scene.render.resolution_y = 1600, 1280  # drawn for longer than a worker takes to be asked again
attempt("stopped_while_drawing")
scene.render.resolution_x, scene.render.resolution_y = size
del session.render
report(asked=len(asked))

# A model that takes long to load keeps nobody: the render ends, and what was begun goes on.
loaded, ended = threading.Event(), threading.Event()
began = time.monotonic()
try:
    pipeline._while_asked(lambda: [loaded.wait(60.0), ended.set()], lambda: time.monotonic() > began + 0.2)
except errors.CancelledError:
    report(waited=time.monotonic() - began)
loaded.set()
report(loaded=ended.wait(60.0))

# What Blender is told meanwhile: how far this is, in words, and the memory that the model takes.
told: dict[str, list] = {"progress": [], "texts": [], "memory": []}


class Told:
    """Stands before the engine and notes what it is told."""

    def __init__(self, engine: bpy.types.RenderEngine) -> None:
        self.engine = engine
        told["progress"].append([])

    def __getattr__(self, name: str) -> object:
        return getattr(self.engine, name)

    def update_progress(self, done: float) -> None:
        told["progress"][-1].append(done)

    def update_stats(self, _first: str, text: str) -> None:
        told["texts"].append(text)

    def update_memory_stats(self, memory_used: float, memory_peak: float) -> None:
        told["memory"].append(min(memory_used, memory_peak))


draw_frame = final.render
final.render = lambda engine, depsgraph: draw_frame(Told(engine), depsgraph)
render(folder / "told.png")
scene.render.use_motion_blur, scene.grmm_render.motion_steps = True, 2
render(folder / "told_blurred.png")
scene.render.use_motion_blur = False
final.render = draw_frame
report(progress=told["progress"], texts=told["texts"], memory=min(told["memory"]))

# A disk without room for the picture.
output = module("grmm_blender.engine.output")
usage = output.shutil.disk_usage
output.shutil.disk_usage = lambda folder: SimpleNamespace(total=1 << 40, used=1 << 40, free=1000)
attempt("disk_full", animation=True)
output.shutil.disk_usage = usage

# An avatar of a newer program, of other weights, and a file that was cut off.
session.save(host.open_avatar(head.grmm.source).id, folder / "person.grmm")
data = (folder / "person.grmm").read_bytes()
(size,) = struct.unpack("<Q", data[:8])
header = json.loads(data[8 : 8 + size])


def variant(name: str, version: str = "1", **changes: object) -> None:
    description = json.dumps({**json.loads(header["__metadata__"]["avatar"]), **changes})
    metadata = {**header["__metadata__"], "avatar": description, "format_version": version}
    changed = json.dumps({**header, "__metadata__": metadata}).encode()
    (folder / f"{name}.grmm").write_bytes(struct.pack("<Q", len(changed)) + changed + data[8 + size :])
    head.grmm.source = str(folder / f"{name}.grmm")
    attempt(name)


variant("same")
variant("newer_version", version="99")
variant("other_weights", weights={"name": "unknown", "sha256": "0" * 64})
variant("other_head", head={"name": "flame", "sha256": "0" * 64})
(folder / "cut.grmm").write_bytes(data[: len(data) // 2])
head.grmm.source = str(folder / "cut.grmm")
attempt("cut")
head.grmm.source = "sample:3"

# Borders: outside of the picture, and so thin that no pixel is left.
scene.render.use_border = True
scene.render.border_min_y, scene.render.border_max_y = 0.5, 0.501
attempt("thin_border")
scene.render.use_border = False
report(messages=messages, left=left, after=difference(load_png(render(folder / "after.png")), alone))
