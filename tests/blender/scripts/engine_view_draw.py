"""The rendered viewport drawn into an offscreen buffer, against F12: engine_view_draw.py WEIGHTS FOLDER.

Blender does not call `view_draw` headless, so the script does, with a region that looks through the scene's camera.
"""

from __future__ import annotations

import sys
from pathlib import Path
from types import SimpleNamespace

import bpy
import gpu
import numpy as np
from mathutils import Matrix
from render_support import heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
gpu.init()
SIZE = 160, 120
scene = new_scene(weights, size=SIZE)
scene.camera.location.x = 0.0
scene.camera.rotation_euler.z = 0.0
scene.grmm_render.occlusion_samples = 2  # as in the viewport
bpy.context.view_layer.update()
color = module("grmm_core.pictures.color")
view = module("grmm_blender.engine.view")
view_jobs = module("grmm_blender.engine.view_jobs")


class Engine:
    """Stands in for the RenderEngine: the viewport's picture is scene-linear."""

    status = ""

    def bind_display_space_shader(self, scene: bpy.types.Scene) -> None: ...

    def unbind_display_space_shader(self) -> None: ...

    def update_stats(self, first: str, second: str) -> None:
        self.status = second


def context() -> SimpleNamespace:
    depsgraph = bpy.context.evaluated_depsgraph_get()
    camera = scene.camera.evaluated_get(depsgraph)
    space = SimpleNamespace(
        view_matrix=camera.matrix_world.inverted(), window_matrix=camera.calc_matrix_camera(depsgraph, x=SIZE[0], y=SIZE[1])
    )
    region = SimpleNamespace(width=SIZE[0], height=SIZE[1], as_pointer=lambda: 1)
    space_data, screen = SimpleNamespace(clip_start=0.01, clip_end=100.0), SimpleNamespace(is_animation_playing=False)
    return SimpleNamespace(region=region, region_data=space, space_data=space_data, screen=screen)


rested = False
jobs = view_jobs.ViewJobs(lambda is_outdated: None)
renderer = view.ViewRenderer(jobs)
engine = Engine()
target = gpu.types.GPUOffScreen(*SIZE, format="RGBA16F")


def draw() -> np.ndarray:
    """Draw as Blender would; returns scene-linear premultiplied RGBA, [H, W, 4], top row first."""
    with target.bind():
        buffer = gpu.state.active_framebuffer_get()
        buffer.clear(color=(0.0, 0.0, 0.0, 0.0))
        gpu.matrix.load_matrix(Matrix.Identity(4))
        projection = Matrix.Diagonal((2 / SIZE[0], 2 / SIZE[1], 1.0, 1.0))
        projection.translation = (-1.0, -1.0, 0.0)
        gpu.matrix.load_projection_matrix(projection)
        renderer.draw(engine, context(), bpy.context.evaluated_depsgraph_get())
        values = np.array(buffer.read_color(0, 0, *SIZE, 4, 0, "FLOAT").to_list(), np.float32)
    return values.reshape(SIZE[1], SIZE[0], 4)[::-1]


def settled() -> np.ndarray:
    draw()
    if not jobs.wait(120):
        raise RuntimeError("the viewport's picture does not come")
    return draw()


def f12(name: str) -> np.ndarray:
    """Scene-linear premultiplied RGBA of a render."""
    straight = load_png(render(folder / f"{name}.png")) / 255
    linear = color.srgb_to_linear(straight[..., :3]) * straight[..., 3:]
    return np.concatenate([linear, straight[..., 3:]], -1).astype(np.float32)


def error(one: np.ndarray, other: np.ndarray) -> float:
    return float(np.abs(one - other).mean())


# First nothing, then the preview, then the good picture. The session is held so that each state can be looked at.
original = jobs._publish
pictures = []
jobs._publish = lambda request, level, *rest: (original(request, level, *rest), pictures.append((level, jobs.take())))
draw()
statuses = [engine.status]
jobs.wait(120)
shown = {}
for level, picture in pictures:
    jobs._put(picture)
    shown[level] = draw()
    statuses.append(engine.status)
jobs._publish = original
wanted = f12("alone")
report(
    statuses=statuses,
    covered=float((wanted[..., 3] > 0.5).mean()),
    preview_error=error(shown["preview"], wanted),
    final_error=error(shown["final"], wanted),
)

draw()
report(redrawn_for_nothing=jobs.busy)


def with_overlay(distance: float) -> np.ndarray:
    """What is left of an overlay that fills the view at a distance, after the avatar has hidden it; [H, W], top row first."""
    eye = context()
    with target.bind():
        buffer = gpu.state.active_framebuffer_get()
        terms = np.array(eye.region_data.window_matrix)
        depth = 0.5 * (terms[2, 2] * -distance + terms[2, 3]) / (terms[3, 2] * -distance) + 0.5
        gpu.state.depth_mask_set(True)
        buffer.clear(color=(1.0, 0.0, 0.0, 1.0), depth=float(depth))
        renderer.hide_overlays(eye.region, eye.region_data)
        values = np.array(buffer.read_color(0, 0, *SIZE, 4, 0, "FLOAT").to_list(), np.float32)
    return values.reshape(SIZE[1], SIZE[0], 4)[::-1, :, 0]


solid, beside = wanted[..., 3] > 0.9, wanted[..., 3] < 0.05
far, near = with_overlay(3.0), with_overlay(0.5)
report(overlays=[float(far[solid].mean()), float(far[beside].mean()), float(near.mean())])
head = heads(scene)[0]
head["jawOpen"] = 1.0
head.update_tag()
bpy.context.view_layer.update()
renderer.update(bpy.context.evaluated_depsgraph_get())
report(pose_changed=error(settled(), shown["final"]))
head["jawOpen"] = 0.0
head.update_tag()

mesh = bpy.data.meshes.new("Wall")
mesh.from_pydata([(-5, -0.4, -2), (0, -0.4, -2), (0, -0.4, 2), (-5, -0.4, 2)], [], [(0, 1, 2, 3)])
wall = bpy.data.objects.new("Wall", mesh)
scene.collection.objects.link(wall)
bpy.context.view_layer.update()
renderer.update(bpy.context.evaluated_depsgraph_get())
found, half = settled(), SIZE[0] // 2
report(wall_left=float(found[:, : half - 1].max()), wall_right_error=error(found[:, half + 1 :], wanted[:, half + 1 :]))

scene.render.film_transparent = False
scene.world = bpy.data.worlds.new("World")
scene.world.use_nodes = True
node = next(node for node in scene.world.node_tree.nodes if node.type == "BACKGROUND")
node.inputs["Color"].default_value, node.inputs["Strength"].default_value = (0.2, 0.4, 0.1, 1.0), 0.5
bpy.context.view_layer.update()
renderer.update(bpy.context.evaluated_depsgraph_get())
report(world=[float(value) for value in settled()[2, 2]])

# The viewport looks with its own camera: one that F12 refuses is no concern of it.
scene.camera.data.type = "PANO"
renderer.update(bpy.context.evaluated_depsgraph_get())
report(panoramic=renderer.status())
scene.camera.data.type = "PERSP"

head.grmm.source = str(folder / "missing.grmm")
bpy.context.view_layer.update()
renderer.update(bpy.context.evaluated_depsgraph_get())
settled()
report(error=engine.status)
renderer.close()
