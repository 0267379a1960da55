"""What goes wrong must be said and must leave no file: engine_errors.py WEIGHTS FOLDER."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

import bpy
from render_support import difference, expected, expected_png, full_camera, heads, load_png, new_scene, render
from support import module, report, set_multilayer_exr

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
head = heads(scene)[0]
host = module("grmm_blender.session_host")
alone = expected_png(expected(scene, full_camera(scene)))
messages: dict[str, str] = {}
left: dict[str, list[str]] = {}


def attempt(name: str, target: Path | None = None, animation: bool = False, **settings: object) -> None:
    """Render and note the error, and the files that are there afterwards."""
    place = folder / name
    place.mkdir()
    scene.render.filepath = str(target or place / "picture.png")
    try:
        bpy.ops.render.render(write_still=not animation, animation=animation, **settings)
        messages[name] = ""
    except RuntimeError as error:
        messages[name] = str(error).strip()
    left[name] = sorted(path.name for path in place.iterdir())


def kill(pid: int) -> None:
    """End the worker as a lack of memory would; 0 would be the whole process group."""
    if pid <= 0:
        raise RuntimeError(f"the worker does not run: {messages}")
    os.kill(pid, signal.SIGKILL)


def replaced(owner: object, name: str, function: Callable) -> Callable[[], None]:
    """Put a function in place of another; returns what takes it back."""
    original = getattr(owner, name)
    setattr(owner, name, function)
    return lambda: setattr(owner, name, original)


head["jawOpen"] = float("nan")
head.update_tag()
attempt("nan")
head["jawOpen"] = 0.0
head.update_tag()

head.grmm.source = str(folder / "größe" / "missing.grmm")
attempt("missing_file")
attempt("animation", animation=True)
(folder / "broken.grmm").write_bytes(b"not an avatar")
head.grmm.source = str(folder / "broken.grmm")
attempt("broken_file")
set_multilayer_exr(scene.render.image_settings)
attempt("broken_file_exr")
if hasattr(scene.render.image_settings, "media_type"):
    scene.render.image_settings.media_type = "IMAGE"
scene.render.image_settings.file_format = "PNG"
head.grmm.source = "sample:3"


def fail(*_: object, **__: object) -> None:
    raise TypeError("a defect")


undo = replaced(module("grmm_blender.engine.picture"), "pass_values", fail)
attempt("defect")
undo()


def no_memory(*_: object, **__: object) -> None:
    raise MemoryError


undo = replaced(module("grmm_blender.engine.picture"), "pass_values", no_memory)
attempt("memory")
undo()

camera = scene.camera
scene.camera = None
attempt("no_camera")
scene.camera = camera
camera.data.type = "PANO"
attempt("panoramic")
camera.data.type = "PERSP"

rig = head.parent
rig.scale = (1.0, 2.0, 1.0)
attempt("uneven_scale")
rig.scale = (1.0, 1.0, 1.0)

scene.render.use_border = True
scene.render.border_min_x, scene.render.border_max_x = 0.5, 0.5
attempt("empty_border")
scene.render.use_border = False

blocker = folder / "file"
blocker.write_text("a file where a folder should be")
attempt("unwritable", target=blocker / "picture.png")

host.configure(host.RuntimeSettings(mode="worker", python=str(folder / "no_python"), weights=weights))
attempt("no_runtime")
host.configure(host.RuntimeSettings(mode="worker", python=os.environ["GRMM_WORKER_PYTHON"], weights=weights, device="cpu"))
attempt("worker")
worker = host.get_session().status()
kill(worker.pid)
while host.get_session().status().alive:
    time.sleep(0.01)
attempt("killed_between")
session = host.get_session()
original = session.render


def killed(*arguments: object, **options: object) -> object:
    kill(session.status().pid)
    return original(*arguments, **options)


session.render = killed
attempt("killed_during")
session.render = original

# Everything works again afterwards.
report(messages=messages, left=left, after=difference(load_png(render(folder / "after.png")), alone), worker=worker.kind)

# A holdout is an avatar. A hidden one is no error, but is said, in blur once.
head.is_holdout = True
render(folder / "cut.png")
head.is_holdout, head.hide_render = False, True
report(hidden=float(load_png(render(folder / "hidden.png"))[..., 3].max()))
scene.render.use_motion_blur = True
render(folder / "blurred.png")
scene.render.use_motion_blur = False

# No avatar: the world is drawn, with a warning.
for item in (head, rig):
    bpy.data.objects.remove(item)
scene.render.film_transparent = False
scene.world = bpy.data.worlds.new("World")
scene.world.use_nodes = True
background = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
background.inputs["Color"].default_value = (1.0, 0.0, 0.0, 1.0)
pixels = load_png(render(folder / "world.png"))
report(world=[float(v) for v in pixels.reshape(-1, 4).mean(0)])
