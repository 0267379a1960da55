"""Depths of scene meshes that are kept between pictures: engine_occluders.py WEIGHTS FOLDER

Whatever changes in front of the avatar, the next picture must be the one that a fresh start gives.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from render_support import heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights, size=(64, 56))
camera = scene.camera
camera.location.x, camera.rotation_euler.z = 0.0, 0.0
final = module("grmm_blender.engine.final")
occlusion = module("grmm_blender.engine.occlusion")
values = module("grmm_blender.scene.shot")
zbuffer = module("grmm_core.geometry.zbuffer")
cameras = module("grmm_core.geometry.camera")
count = 0


def shot() -> np.ndarray:
    global count
    count += 1
    return load_png(render(folder / f"{count}.png"))


def fresh() -> np.ndarray:
    """The picture of a Blender that has drawn nothing before."""
    final._forget()
    return shot()


# The avatar moves before a scene that stands: the scene is drawn twice (the second time with a margin), then never again.
bpy.ops.mesh.primitive_cube_add(size=0.12, location=(0.05, -0.3, 0.0))
cube = bpy.context.object
head = heads(scene)[0]
drawn = []
for step in range(5):
    head["jawOpen"] = 0.1 * step
    head.update_tag()
    before = final._depths.drawn
    shot()
    drawn.append(final._depths.drawn - before)
report(drawn=drawn)

changes: dict[str, list[float]] = {}
last = shot()


def attempt(name: str, change: Callable[[], object]) -> None:
    """Change something; note how far the picture is from a fresh one, and from the one before."""
    global last
    change()
    bpy.context.view_layer.update()
    found = shot()
    wanted = fresh()
    changes[name] = [float(np.abs(found - wanted).max()), float(np.abs(found - last).max())]
    last = found


def set_vertices(mesh: bpy.types.Mesh, scale: float) -> None:
    positions = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("co", positions)
    mesh.vertices.foreach_set("co", positions * np.float32(scale))
    mesh.update()


attempt("moved", lambda: setattr(cube.location, "x", 0.0))
attempt("turned", lambda: setattr(cube.rotation_euler, "y", 0.7))
attempt("edited", lambda: set_vertices(cube.data, 0.6))


def drop_front() -> None:
    """The same vertices and corners less the face that looks at the camera."""
    mesh = cube.data
    points = [tuple(vertex.co) for vertex in mesh.vertices]
    faces = [tuple(face.vertices) for face in mesh.polygons if face.normal.y > -0.5]
    mesh.clear_geometry()
    mesh.from_pydata(points, [], faces[:3])


attempt("faces", drop_front)
bpy.data.objects.remove(cube)
bpy.ops.mesh.primitive_cube_add(size=0.12, location=(0.0, -0.3, 0.0))
cube = bpy.context.object
last = shot()
attempt("modifier", lambda: cube.modifiers.new("Subdivision", "SUBSURF"))
attempt("other_mesh", lambda: setattr(cube, "data", bpy.data.meshes.new("Empty")))
bpy.ops.mesh.primitive_uv_sphere_add(radius=0.08, location=(0.0, -0.3, 0.05))
ball = bpy.context.object
cube.data = ball.data
last = shot()
attempt("hidden", lambda: setattr(ball, "hide_render", True))
attempt("shown", lambda: setattr(ball, "hide_render", False))
attempt("holdout", lambda: [setattr(scene.render, "film_transparent", False), setattr(ball, "is_holdout", True)])
attempt("beside", lambda: setattr(ball.location, "x", 0.1))
attempt("no_holdout", lambda: setattr(ball, "is_holdout", False))
scene.render.film_transparent = True
last = shot()
attempt("camera", lambda: setattr(camera.location, "x", 0.02))
attempt("lens", lambda: setattr(camera.data, "lens", 70.0))
attempt("samples", lambda: setattr(scene.grmm_render, "occlusion_samples", 1))
scene.grmm_render.occlusion_samples = 3
last = shot()
attempt("clip", lambda: setattr(camera.data, "clip_start", 1.0))
camera.data.clip_start = 0.1


# A shape key that is animated: each frame has another mesh under the same name.
cube.data = bpy.data.meshes.new("Wall")
cube.location = (0.0, -0.3, 0.0)
cube.data.from_pydata([(-0.2, 0, -0.2), (0.0, 0, -0.2), (0.0, 0, 0.2), (-0.2, 0, 0.2)], [], [(0, 1, 2, 3)])
cube.shape_key_add(name="Basis")
moved = cube.shape_key_add(name="Moved")
for point in moved.data:
    point.co.x += 0.2
for frame, value in ((1, 0.0), (9, 1.0)):
    moved.value = value
    moved.keyframe_insert("value", frame=frame)
scene.frame_set(1)
last = shot()
for frame in (5, 9, 3):
    attempt(f"frame_{frame}", lambda frame=frame: scene.frame_set(frame))
bpy.data.objects.remove(cube)
bpy.data.objects.remove(ball)

# Two different meshes, instanced: neither may be taken for the other.
instancers = []
for name, x, size in (("Left", -0.06, 0.02), ("Right", 0.06, 0.09)):
    bpy.ops.mesh.primitive_cube_add(size=size)
    source = bpy.context.object
    collection = bpy.data.collections.new(name)
    source.users_collection[0].objects.unlink(source)
    collection.objects.link(source)
    holder = bpy.data.objects.new(name, None)
    holder.instance_type, holder.instance_collection = "COLLECTION", collection
    holder.location = (x, -0.3, 0.0)
    scene.collection.objects.link(holder)
    instancers.append(holder)
last = shot()
one = last[..., 3]
bpy.data.objects.remove(instancers[0])
only_right = shot()[..., 3]
report(left_hides=float((one < only_right).mean()), right_hides=float((only_right < 128).mean()))
instancers[1].instance_collection = bpy.data.collections["Left"]
last = only = shot()
report(swapped=float(np.abs(only[..., 3] - only_right).max()), swapped_fresh=float(np.abs(fresh() - only).max()))
report(changes=changes)

# Against all samples of the whole picture, for parts of it in any order.
rng = np.random.default_rng(2)
view = cameras.Camera.orbit(50, 40, yaw=20.0, pitch=5.0, distance=1.0, fov=40.0)
depths = occlusion.OccluderDepths()
errors = []


def pieces() -> object:
    corners = rng.uniform(-0.3, 0.3, (30, 1, 3)) + rng.uniform(-0.1, 0.1, (30, 3, 3))
    return values.Occluder(np.float32(corners), np.eye(4))


for trial in range(24):
    if trial % 3 == 0:
        part = [pieces(), pieces()]
    film = bool(trial % 2)
    scene_depths = depths.of(values.Occluders((part[0],), (part[1],)), view, 3, (0.1, 100.0))
    x, y = int(rng.integers(0, 20)), int(rng.integers(0, 15))
    height, width = int(rng.integers(5, 25)), int(rng.integers(5, 30))
    depth = np.where(rng.uniform(size=(height, width)) < 0.6, rng.uniform(0.6, 1.4, (height, width)), 1e10).astype(np.float32)
    found = scene_depths.visibility(depth, (x, y), film)
    plain, cut = (zbuffer.triangle_depth(each.placed(), view, 3, 0.1, 100.0) for each in part)
    box = slice(3 * y, 3 * (y + height)), slice(3 * x, 3 * (x + width))
    wanted = (np.minimum(plain, cut)[box].reshape(height, 3, width, 3) > depth[:, None, :, None]).mean(axis=(1, 3))
    seen = np.ones_like(wanted) if found.avatars is None else found.avatars[..., 0]
    there = depth < 1e10
    errors.append(float(np.abs(seen - wanted)[there].max(initial=0.0)))
    if film:
        holes = ((cut < 1e10) & (cut <= plain))[box].reshape(height, 3, width, 3).mean(axis=(1, 3))
        errors.append(float(np.abs(found.background[..., 0] - (1 - holes)).max()))
report(errors=max(errors), draws=depths.drawn)

# What is kept stays within the budget.
small = occlusion.OccluderDepths(budget=1)
small.of(values.Occluders((part[0],)), view, 3, (0.1, 100.0)).visibility(np.full((40, 50), 1.0, np.float32), (0, 0), False)
report(left=len(small._kept))
