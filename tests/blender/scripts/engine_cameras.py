"""Every form of camera against Blender's own projection and against the session: engine_cameras.py WEIGHTS FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from bpy_extras.object_utils import world_to_camera_view
from mathutils import Vector
from render_support import difference, expected, expected_png, full_camera, load_png, new_scene, render
from support import report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
camera, data, settings = scene.camera, scene.camera.data, scene.render
points = np.random.default_rng(0).uniform(-0.15, 0.15, (20, 3))


def portrait() -> None:
    settings.resolution_x, settings.resolution_y = 60, 96


def sensor_vertical() -> None:
    data.sensor_fit, data.sensor_height = "VERTICAL", 18.0


def sensor_horizontal_portrait() -> None:
    portrait()
    data.sensor_fit, data.sensor_width = "HORIZONTAL", 24.0


def shift() -> None:
    data.shift_x, data.shift_y = 0.21, -0.13


def percentage() -> None:
    settings.resolution_percentage = 75


def pixel_aspect() -> None:
    settings.pixel_aspect_x, settings.pixel_aspect_y = 1.0, 1.5


def ortho() -> None:
    data.type, data.ortho_scale, data.shift_x = "ORTHO", 0.5, 0.1


def scaled_parent() -> None:
    parent = bpy.data.objects.new("Parent", None)
    scene.collection.objects.link(parent)
    parent.scale, parent.rotation_euler = (2.0, 2.0, 2.0), (0.1, 0.0, 0.2)
    camera.parent = parent
    camera.location = (0.05, -0.55, 0.02)


SETUPS = (None, portrait, sensor_vertical, sensor_horizontal_portrait, shift, percentage, pixel_aspect, ortho, scaled_parent)
results = {}
for setup in SETUPS:
    settings.resolution_x, settings.resolution_y, settings.resolution_percentage = 96, 80, 100
    settings.pixel_aspect_x = settings.pixel_aspect_y = 1.0
    data.type, data.sensor_fit, data.sensor_width, data.sensor_height = "PERSP", "AUTO", 36.0, 24.0
    data.shift_x = data.shift_y = 0.0
    if setup:
        setup()
    bpy.context.view_layer.update()
    core = full_camera(scene)
    local = points @ core.world_to_camera[:3, :3].T + core.world_to_camera[:3, 3]
    depth = np.ones(len(points)) if core.orthographic else local[:, 2]
    pixels = np.stack([core.fx * local[:, 0] / depth + core.cx, core.fy * local[:, 1] / depth + core.cy], 1)
    # Blender's helper for add-ons measures from the lower left corner, 0..1.
    theirs = np.array([world_to_camera_view(scene, camera, Vector(p))[:2] for p in points])
    theirs = np.stack([theirs[:, 0] * core.width, (1.0 - theirs[:, 1]) * core.height], 1)
    name = setup.__name__ if setup else "default"
    file = render(folder / f"{name}.png")
    picture = expected_png(expected(scene, core))
    results[name] = {
        "projection": float(np.abs(pixels - theirs).max()),
        "picture": difference(load_png(file), picture),
        "covered": float((picture[..., 3] > 127).mean()),
        "size": [core.width, core.height],
    }
report(cameras=results)
