"""Helpers for scripts that render with the GRMM engine: a scene with an avatar, cameras, expected pictures."""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from support import empty_scene, module

SEED = 3  # of the random person that the tests look at


def use_weights(path: str) -> None:
    """Run the model with the given weights: in this process where there is torch, else in a worker."""
    host = module("grmm_blender.session_host")
    threads = int(os.environ.get("GRMM_TEST_THREADS", "1"))
    host.configure(host.RuntimeSettings(weights=path, device="cpu", threads=threads))


@contextlib.contextmanager
def unpainted() -> Iterator[None]:
    """Heads that are added meanwhile lack what takes seconds, and only pictures of their mesh show.

    Random people keep their plain faces, and in paintings the studio's light is left.
    """
    repaint, materials = module("grmm_blender.rig.repaint"), module("grmm_blender.rig.materials")
    kept = repaint.ask, materials.unlit
    repaint.ask, materials.unlit = lambda avatar: None, lambda head, vertices, painting: painting
    try:
        yield
    finally:
        repaint.ask, materials.unlit = kept


def new_scene(weights: str, heads: int = 1, size: tuple[int, int] = (96, 80)) -> bpy.types.Scene:
    """Return an empty scene with heads beside one another and a camera in front, set up for exact colors.

    The heads are `unpainted`.
    """
    empty_scene()
    use_weights(weights)
    scene = bpy.context.scene
    for index in range(heads):
        with unpainted():
            bpy.ops.grmm.add_head(person="RANDOM", seed=SEED + index)
        rig = bpy.context.object if bpy.context.object.type == "ARMATURE" else bpy.context.object.parent
        rig.location = (0.35 * index, 0.25 * index, 0.0)
    scene.render.engine = "GRMM"
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.film_transparent = True
    exact_colors(scene)
    add_camera(scene)
    return scene


def exact_colors(scene: bpy.types.Scene) -> None:
    """Save the network's colors as they are."""
    scene.view_settings.view_transform = "Standard"
    scene.render.dither_intensity = 0.0
    scene.render.image_settings.file_format = "PNG"
    scene.render.image_settings.color_mode = "RGBA"


def add_camera(scene: bpy.types.Scene, location: tuple[float, float, float] = (0.1, -1.1, 0.02)) -> bpy.types.Object:
    """Add a camera that looks at the first head, and make it the scene's."""
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location = location
    camera.rotation_euler = (math.pi / 2, 0.0, math.atan2(location[0], -location[1]))
    camera.data.lens = 80.0
    scene.camera = camera
    bpy.context.view_layer.update()
    return camera


def heads(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """Return the head objects, sorted by name."""
    return [avatar.object for avatar in module("grmm_blender.scene.avatars").avatars_in(scene)]


def render(path: Path | str) -> Path:
    """Press F12 and save; returns the file."""
    scene = bpy.context.scene
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    return Path(path)


def full_camera(scene: bpy.types.Scene) -> Any:
    """Return the core camera of the scene's full picture."""
    scale = scene.render.resolution_percentage / 100
    size = int(scene.render.resolution_x * scale), int(scene.render.resolution_y * scale)
    cameras, depsgraph = module("grmm_blender.scene.cameras"), bpy.context.evaluated_depsgraph_get()
    return cameras.render_camera(depsgraph, cameras.scene_camera(depsgraph), *size)


def expected(scene: bpy.types.Scene, camera: Any, **options: Any) -> dict[str, np.ndarray]:
    """Draw the scene's avatars through a camera with the session alone."""
    session = module("grmm_core.session")
    host = module("grmm_blender.session_host")
    depsgraph = bpy.context.evaluated_depsgraph_get()
    instances = [
        session.Instance(host.open_avatar(a.source).id, a.controls(depsgraph), a.model_to_world(depsgraph))
        for a in module("grmm_blender.scene.avatars").avatars_in(scene)
    ]
    return host.get_session().render(instances, camera, session.RenderOptions(**options))


def expected_png(buffers: dict[str, np.ndarray]) -> np.ndarray:
    """Return what a PNG of the buffers holds, [H, W, 4] 0..255 as float."""
    return module("grmm_core.pictures.color").straight_rgba(buffers["rgb"], buffers["alpha"]) * 255.0


def load_png(path: Path | str) -> np.ndarray:
    """Return the stored bytes of a PNG, [H, W, 4] 0..255 as float, top row first."""
    image = bpy.data.images.load(str(path))
    image.colorspace_settings.name = "Non-Color"
    image.alpha_mode = "CHANNEL_PACKED"
    values = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    values = values.reshape(image.size[1], image.size[0], image.channels)[::-1] * 255.0
    bpy.data.images.remove(image)
    return values


def difference(found: np.ndarray, wanted: np.ndarray) -> float:
    """Return the largest difference of two pictures, of colors where something is to be seen, in steps of 1/255."""
    visible = np.round(wanted[..., 3:]) > 0
    color = np.where(visible, np.abs(found[..., :3] - wanted[..., :3]), 0.0).max()
    return float(max(color, np.abs(found[..., 3] - wanted[..., 3]).max()))
