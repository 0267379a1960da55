"""Splats drawn by the gpu module into an offscreen buffer: viewport_draw.py WEIGHTS FOLDER

The test compares what this stores with the CPU rasteriser, which Blender 5.2 does not have.
"""

from __future__ import annotations

import dataclasses
import sys
import threading
from pathlib import Path
from types import SimpleNamespace

import bpy
import gpu
import numpy as np
from gpu_extras.batch import batch_for_shader
from mathutils import Matrix
from render_support import heads, new_scene
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
gpu.init()
SIZE = 200, 160
scene = new_scene(weights, size=SIZE)
camera_class = module("grmm_core.geometry.camera").Camera
arrays = module("grmm_blender.viewport.arrays")
drawing = module("grmm_blender.viewport.drawing")
jobs_module = module("grmm_blender.viewport.jobs")
overlay = module("grmm_blender.viewport.overlay")
target = gpu.types.GPUOffScreen(*SIZE, format="RGBA16F")
stored: dict[str, np.ndarray] = {}


def in_buffer(*calls) -> np.ndarray:
    """Carry out draw calls one after another in an empty buffer; returns [H, W, 4], top row first."""
    with target.bind():
        buffer = gpu.state.active_framebuffer_get()
        buffer.clear(color=(0.0, 0.0, 0.0, 0.0), depth=1.0)
        for call in calls:
            call()
        values = np.array(buffer.read_color(0, 0, *SIZE, 4, 0, "FLOAT").to_list(), np.float32)
    return values.reshape(SIZE[1], SIZE[0], 4)[::-1]


def store_camera(name: str, camera) -> None:
    numbers = (camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height, camera.orthographic)
    stored[f"{name}_camera"] = np.array(numbers, np.float64)
    stored[f"{name}_matrix"] = camera.world_to_camera


# Random Gaussians, near and far, thin and thick, far from the world's origin; both projections, off centre.
rng = np.random.default_rng(5)
count = 3000
quats = rng.normal(size=(count, 4)).astype(np.float32)
scales = np.exp(rng.uniform(np.log(5e-4), np.log(0.03), (count, 3))).astype(np.float32)
local = rng.normal(scale=0.12, size=(count, 3)).astype(np.float32)
opacities = rng.uniform(0.02, 1.0, count).astype(np.float32)
colors = rng.uniform(size=(count, 3)).astype(np.float32)
placement = np.diag([1.5, 1.5, 1.5, 1.0])
placement[:3, 3] = (1000.0, -2000.0, 30.0)
worlds = [arrays.WorldGaussians.place(local, quats, scales, opacities, colors, placement, flag) for flag in (False, True)]
packed, antialiased = map(arrays.pack, worlds)
stored |= {"means": local, "quats": quats, "scales": scales, "opacities": opacities, "colors": colors, "placement": placement}
view = np.linalg.inv(placement @ np.diag([1 / 1.5] * 3 + [1]))
view[2, 3] -= 0.8  # OpenGL: in front is negative z
for kind in ("perspective", "orthographic"):
    if kind == "perspective":
        projection = np.array([[2.2, 0, 0.1, 0], [0, 2.75, -0.05, 0], [0, 0, -1.002, -0.02], [0, 0, -1, 0]], np.float64)
    else:
        projection = np.array([[2.5, 0, 0, 0.1], [0, 3.1, 0, 0], [0, 0, -0.01, -0.1], [0, 0, 0, 1]], np.float64)
    camera = camera_class.from_opengl(view, projection, *SIZE)
    picture = drawing.SplatPicture()
    order = arrays.depth_order(packed, camera)
    stored[kind] = in_buffer(lambda: picture.draw(packed, order, camera, projection))  # noqa: B023 - called at once
    stored[f"{kind}_antialiased"] = in_buffer(lambda: picture.draw(antialiased, order, camera, projection))  # noqa: B023
    store_camera(kind, camera)
depths = packed.offsets @ camera.world_to_camera[2, :3].astype(np.float32)
ordered = depths[order.reshape(-1)[:count].astype(int)]
report(sorted=bool((np.diff(ordered) <= 0).all()), permutation=len(set(order.reshape(-1)[:count].tolist())) == count)


# An avatar through a viewport that looks through the scene's camera.
space = next(a.spaces.active for s in bpy.data.screens for a in s.areas if a.type == "VIEW_3D")
space.shading.type = "SOLID"
depsgraph = bpy.context.evaluated_depsgraph_get()
eye = scene.camera.evaluated_get(depsgraph)
region_data = SimpleNamespace(
    view_matrix=eye.matrix_world.inverted(), window_matrix=eye.calc_matrix_camera(depsgraph, x=SIZE[0], y=SIZE[1])
)
context = SimpleNamespace(
    region=SimpleNamespace(width=SIZE[0], height=SIZE[1]), region_data=region_data, space_data=space, scene=scene
)
viewport = overlay.Viewport(jobs_module.SplatJobs(wait_for_rest=lambda is_outdated: None))


def draw(playing: bool = False) -> None:
    viewport.draw(context, bpy.context.evaluated_depsgraph_get(), playing)


def settle() -> None:
    in_buffer(draw)
    if not viewport.jobs.wait(120):
        raise RuntimeError("the splats do not come")
    in_buffer(draw)


def triangles(corners: np.ndarray, color: tuple[float, ...]) -> None:
    """Draw world triangles as Blender draws objects: with depth."""
    gpu.matrix.load_matrix(region_data.view_matrix)
    gpu.matrix.load_projection_matrix(region_data.window_matrix)
    gpu.state.depth_test_set("LESS_EQUAL")
    gpu.state.depth_mask_set(True)
    shader = gpu.shader.from_builtin("UNIFORM_COLOR")
    shader.uniform_float("color", color)
    batch_for_shader(shader, "TRIS", {"pos": np.ascontiguousarray(corners.reshape(-1, 3), np.float32)}).draw(shader)
    gpu.state.depth_test_set("NONE")
    gpu.state.depth_mask_set(False)
    gpu.matrix.load_matrix(Matrix.Identity(4))
    gpu.matrix.load_projection_matrix(Matrix.Identity(4))


def wall(y: float, x0: float, x1: float) -> np.ndarray:
    a, b, c, d = (x0, y, -3), (x1, y, -3), (x1, y, 3), (x0, y, 3)
    return np.array([a, b, c, a, c, d], np.float64)


first = in_buffer(draw)
statuses = [viewport.status()]
settle()
alone = in_buffer(draw)
statuses.append(viewport.status())
stored["avatar"] = alone
store_camera("avatar", viewport._asked.camera)
stored["avatar_placement"] = viewport._scene.shots[0].model_to_world
info = module("grmm_blender.session_host").open_avatar(viewport._scene.shots[0].source)
direction = module("grmm_blender.viewport.sources").view_direction(viewport._scene.shots[0], viewport._asked.camera)
found = module("grmm_blender.session_host").get_session().gaussians(info.id, viewport._scene.shots[0].controls, direction)
for name in ("means", "quats", "scales", "opacities", "colors"):
    stored[f"avatar_{name}"] = getattr(found, name)
# In a close-up, what learned to be a closed surface is as wide as a pixel of the pictures it learned from.
sources, session_host = module("grmm_blender.viewport.sources"), module("grmm_blender.session_host")
shot, far, near = viewport._scene.shots[0], viewport._asked.camera, camera_class.orbit(*SIZE, distance=0.02)
near = near.transformed(np.linalg.inv(shot.model_to_world))
small = SimpleNamespace(gaussians=lambda *_, **__: found._replace(scales=0.02 * found.scales))
kept, session_host.get_session = session_host.get_session, lambda: small
opened, widths, covers = session_host.open_avatar, [], []
for antialiased_one, eye, lod in ((False, near, 0), (True, near, 0), (True, far, 0), (True, near, 1)):
    session_host.open_avatar = lambda _, flag=antialiased_one: dataclasses.replace(info, antialiased=flag)
    part = sources.world_gaussians(shot, eye, lod)
    spread = np.sort(np.linalg.eigvalsh(part.covariances[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)))[:, 1:]
    widths.append(float(spread.min() ** 0.5))
    covers.append(np.sqrt(spread.prod(-1)) * part.opacities)
session_host.get_session, session_host.open_avatar = kept, opened
report(widths=widths, paler=float(np.abs(covers[0] - covers[1]).max() / covers[0].max()))
solid = alone[..., 3] > 0.98
RED, BLUE = (1.0, 0.0, 0.0, 1.0), (0.0, 0.0, 1.0, 1.0)
half = SIZE[0] // 2
front = in_buffer(lambda: triangles(wall(-0.5, -9, 9), RED), draw)
behind = in_buffer(lambda: triangles(wall(0.6, -9, 9), RED), draw)
later = in_buffer(draw, lambda: triangles(wall(0.6, -9, 9), BLUE))
later_front = in_buffer(draw, lambda: triangles(wall(-0.5, -9, 9), BLUE))
own = viewport._scene.meshes
report(
    statuses=statuses,
    nothing_at_first=float(first.max()),
    covered=float(solid.mean()),
    hidden_by_front=float(np.abs(front - RED).max()),
    over_behind=float(np.abs(behind[solid] - alone[solid]).max()),
    beside_behind=float(np.abs(behind[0, 0] - RED).max()),
    hides_later=float(np.abs(later[solid] - alone[solid]).max()),
    hidden_by_later=float(np.abs(later_front - BLUE).max()),
    own_mesh=float((np.abs(in_buffer(lambda: triangles(own[0], RED), draw)[solid] - alone[solid]).max(-1) > 0.03).mean()),
    own_triangles=len(own[0]),
)

# In a view without perspective, whose plane goes through the middle of the head, as those of the keys of the numeric pad.
perspective = region_data.view_matrix.copy(), region_data.window_matrix.copy()
region_data.view_matrix = Matrix(((1, 0, 0, 0), (0, 0, 1, 0), (0, -1, 0, 0), (0, 0, 0, 1)))
region_data.window_matrix = Matrix(((4, 0, 0, 0), (0, 5, 0, 0), (0, 0, -0.001, 0), (0, 0, 0, 1)))
settle()
flat = in_buffer(draw)
covered = flat[..., 3] > 0.98
through = np.abs(in_buffer(lambda: triangles(own[0], RED), draw)[covered] - flat[covered]).max(-1) > 0.03
report(own_mesh_ortho=float(through.mean()), ortho_covered=float(covered.mean()))
small = module("grmm_blender.viewport.sources").small_picture(viewport._scene.shots, viewport._asked.camera)
report(small_ortho=[float(small.depth.min()), float(small.depth.max())])
region_data.view_matrix, region_data.window_matrix = perspective
settle()

# Bounds instead of the mesh: nothing to stand before any more. In an edit mode the mesh alone is shown.
head = heads(scene)[0]
head.display_type = "BOUNDS"
overlay._on_change()
in_buffer(draw)
report(bounds_meshes=len(viewport._scene.meshes))
head.display_type = "TEXTURED"
bpy.context.view_layer.objects.active = head
bpy.ops.object.mode_set(mode="SCULPT")
overlay._on_change()
report(sculpt=float(in_buffer(draw).max()))
bpy.ops.object.mode_set(mode="OBJECT")

# Bones stand over the splats while the rig is posed, and only then.
rig = head.parent
bones = module("grmm_blender.viewport.bones")
overlays = SimpleNamespace(show_overlays=True, show_bones=True)
view = SimpleNamespace(
    space_data=SimpleNamespace(overlay=overlays), view_layer=bpy.context.view_layer, preferences=bpy.context.preferences
)


def draw_bones() -> None:
    gpu.matrix.load_matrix(region_data.view_matrix)
    gpu.matrix.load_projection_matrix(region_data.window_matrix)
    bones.draw_bones(view, bpy.context.evaluated_depsgraph_get())
    gpu.matrix.load_matrix(Matrix.Identity(4))
    gpu.matrix.load_projection_matrix(Matrix.Identity(4))


def changed_by_bones() -> float:
    settle()
    return float((np.abs(in_buffer(draw, draw_bones) - in_buffer(draw))[solid].max(-1) > 0.1).mean())


def bone_colors() -> set[tuple[float, ...]]:
    found = bones.posed_bones(view, bpy.context.evaluated_depsgraph_get())
    return {tuple(round(value, 3) for value in color[:3]) for *_, color in found}


looked_at = changed_by_bones()
bpy.context.view_layer.objects.active = rig
bpy.ops.object.mode_set(mode="POSE")
posed = changed_by_bones()
colors = bone_colors()
names = [bone.name for bone in rig.pose.bones if any(c.is_visible_effectively for c in bone.bone.collections)]
bpy.ops.pose.select_all(action="SELECT")
selected = bone_colors()
overlays.show_bones = False
report(bones=[looked_at, posed, changed_by_bones()], bone_names=names, bone_colors=[len(colors), len(colors & selected)])
bpy.ops.object.mode_set(mode="OBJECT")
bpy.context.view_layer.objects.active = head

# Only what has changed is made anew.
overlay._on_change()
settle()
before = viewport._drawable.packed
overlay._on_change()
settle()
report(nothing_changed=viewport._drawable.packed is before)

# A rig that is dragged and turned takes its splats along at once; new ones come a moment later.
settle()
standing = in_buffer(draw)
rests, at_rest = threading.Event(), viewport.jobs._wait_for_rest
viewport.jobs._wait_for_rest = lambda is_outdated: rests.wait(60)
before = viewport._drawable.packed
rig.location.x, rig.rotation_euler = 0.05, (0.0, 0.1, 0.05)
bpy.context.view_layer.update()
overlay._on_change()
along = in_buffer(draw)
went_along = viewport._drawable.packed is before
shown, made = viewport._drawable, viewport.jobs._made
same = [jobs_module.same_shot(one, two) for one, two in zip(made.scene.shots, shown.request.scene.shots, strict=True)]
report(dragged_shown=[shown.level, shown.request.level, made.level, same, list(shown.messages)])  # where it did not go along
rests.set()
viewport.jobs._wait_for_rest = at_rest
settle()
newest = in_buffer(draw)
rig.location.x, rig.rotation_euler = 0.0, (0.0, 0.0, 0.0)
bpy.context.view_layer.update()
overlay._on_change()
settle()
report(dragged=[went_along, float(np.abs(along - newest).mean()), float(np.abs(standing - newest).mean())])
# Where full detail takes long to make, a dragged rig keeps what it has until it rests; a changed face does not.
levels, make, pace = [], viewport.jobs._make, viewport.jobs.pace
viewport.jobs._make = lambda request, level: levels.append(level) or make(request, level)
for change in (lambda: setattr(rig.location, "x", 0.03), lambda: (head.__setitem__("jawOpen", 0.3), head.update_tag())):
    viewport.jobs.pace = type(pace)()
    for level in (0, 0, 1):
        viewport.jobs.pace.record(level, 5.0)
    change()
    bpy.context.view_layer.update()
    overlay._on_change()
    settle()
report(dragged_levels=levels)
viewport.jobs._make, viewport.jobs.pace = make, pace
rig.location.x, head["jawOpen"] = 0.0, 0.0
head.update_tag()
bpy.context.view_layer.update()
overlay._on_change()
settle()

# A head that takes the scene's light shows roughly what lamps do; the others stay as they are.
sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
sun.data.energy = 3.0
scene.collection.objects.link(sun)


def lit_from(side: float) -> np.ndarray:
    sun.rotation_euler = (0.0, side * np.pi / 2, 0.0)
    bpy.context.view_layer.update()
    overlay._on_change()
    settle()
    return in_buffer(draw)


unlit = lit_from(1.0)
head.grmm.lighting = "SCENE"
space.shading.type, space.shading.use_scene_lights, space.shading.use_scene_world = "MATERIAL", True, True
stored["lit_right"], stored["lit_left"] = lit_from(1.0), lit_from(-1.0)
space.shading.type = "SOLID"  # solid view has lamps of its own: that the scene's sun turns is not seen
first, again = lit_from(1.0), lit_from(-1.0)
lamps = bpy.context.preferences.system.solid_lights
for lamp in lamps:
    lamp.use = lamp == lamps[0]
lamps[0].diffuse_color = (0.8, 0.8, 0.8)
for side, name in ((1.0, "solid_right"), (-1.0, "solid_left")):
    lamps[0].direction = (side, 0.0, 0.0)
    stored[name] = lit_from(1.0)
space.shading.light = "FLAT"
report(
    solid=[float(np.abs(first - again).max()), float(np.abs(first - unlit).mean()), float(np.abs(lit_from(1.0) - unlit).max())]
)
space.shading.light = "STUDIO"
head.grmm.lighting = "STUDIO"
scene.collection.objects.unlink(sun)
after = lit_from(1.0)
report(studio=[float(np.abs(picture - alone).max()) for picture in (unlit, after)])

head["jawOpen"] = 1.0
head.update_tag()
bpy.context.view_layer.update()
overlay._on_change()
settle()
report(pose_changed=float(np.abs(in_buffer(draw) - alone).mean()))

# Playback: the mesh where it is wanted, or where nothing keeps up.
settings = scene.grmm_viewport
settings.playback = "MESH"
report(mesh=[float(in_buffer(lambda: draw(playing=True)).max()), viewport.status()])
settings.playback = "HOLD_RATE"
in_buffer(lambda: draw(playing=True))
for level in range(5):
    viewport.jobs.pace.record_frame(level, 60.0, 0.01)
report(too_slow=[float(in_buffer(lambda: draw(playing=True)).max()), viewport.status()])
viewport._clock = lambda: 0.0  # so that nothing here depends on the machine's pace
overlay.splat_view.WAIT_SECONDS = 60.0
overlay._on_change()
settle()
stored["level"] = in_buffer(draw)
viewport.jobs.pace = type(viewport.jobs.pace)()
for level in range(4):
    viewport.jobs.pace.record_frame(level, 60.0, 0.01)
# The first small picture is that of compiling: it is not waited for, and does not count as slow.
first = in_buffer(lambda: draw(playing=True))
counted = 4 in viewport.jobs.pace._shown
settle()
small = in_buffer(lambda: draw(playing=True))
report(first_small=[float(first.max()), counted, viewport.jobs.pace.is_begun(4)])
stored["small"] = small
shown = viewport._drawable.request
far = shown.camera.resized(800, 600)
far = far.crop(-600, -500, 2000, 1500)
near = sources.small_picture(shown.scene.shots, far)
whole = sources._picture_of(shown.scene.shots, far, (0, 0, far.width, far.height))
stored["small_far"], stored["small_whole"] = near.color[..., 3], whole.color[..., 3]
reach, sources.REACH = sources.REACH, 0.05
report(frames=[near.frame, sources.small_picture(shown.scene.shots, far).frame])
sources.REACH = reach
report(small=[float(small[..., 3].max()), viewport.status(), viewport._drawable.picture is not None])
# Without a graphics card, as here, a small picture is tried before any Gaussians.
viewport.jobs.pace = type(viewport.jobs.pace)()
overlay._on_change()
in_buffer(lambda: draw(playing=True))
report(software=viewport.status())
# Each frame of playback shows its own splats, and the time of few frames is taken, for that waits for the card.
overlay.splat_view._is_software = lambda: False
viewport.jobs.pace = type(viewport.jobs.pace)()
viewport.jobs.pace.record(0, 0.0)
finished, finish = [], viewport._picture.finish
viewport._picture.finish = lambda: finished.append(finish())
for _ in range(40):
    in_buffer(lambda: draw(playing=True))
report(waits=len(finished), measured=len(viewport.jobs.pace._shown))
asked = []
for value in (0.0, 0.5, 1.0):
    head["jawOpen"] = value
    head.update_tag()
    bpy.context.view_layer.update()
    overlay._on_change()
    in_buffer(lambda: draw(playing=True))
    asked.append(viewport._drawable.request is viewport._asked)
report(own=asked, played=viewport._drawable.level)
settings.playback = "FULL"
report(full=float(in_buffer(lambda: draw(playing=True))[..., 3].max()), after=viewport.status())

# An avatar that cannot be drawn says why; a splat cloud beside it is drawn all the same.
cloud_class = module("grmm_core.formats").SplatCloud
build = module("grmm_blender.splats.build")
sphere = rng.normal(size=(500, 3))
sphere = (0.1 * sphere / np.linalg.norm(sphere, axis=-1, keepdims=True)).astype(np.float32)
harmonics = np.zeros((500, 4, 3), np.float32)
harmonics[:, 0, 0] = 1.7
cloud = cloud_class(sphere, quats[:500], np.full((500, 3), 0.02, np.float32), np.full(500, 0.9, np.float32), harmonics)
ball = build.new_cloud("Ball", cloud)
scene.collection.objects.link(ball)
head.grmm.source = str(folder / "missing.grmm")
bpy.context.view_layer.update()
overlay._on_change()
settle()
picture = in_buffer(draw)
middle = picture[SIZE[1] // 2, SIZE[0] // 2]
report(cloud=[float(value) for value in middle], error=viewport.status())
report(shot_names=[shot.name for shot in viewport._scene.shots])

# A panel for all of it is registered, and drawing callbacks are not: there are no windows here.
report(panel=hasattr(bpy.types, "GRMM_PT_splat_viewport"), callbacks=len(module("grmm_blender.events")._drawing))
np.savez(folder / "viewport.npz", **stored)
viewport.jobs.request(None)
