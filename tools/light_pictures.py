"""Pictures of avatars in a Cycles scene's light: `python -m tools.light_pictures [--person ID] [--output FILE]`.

The painted mesh of an avatar, which Cycles shades, stands beside the avatar, which *Composite Avatars* puts in, in the same
lamps and world: without its hair, with hair that throws its shadow on a wall, and both under hats, which are meshes of the
scene. Needs the bpy wheel in this Python.
"""

from __future__ import annotations

import argparse
import importlib
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from tools.bench_blender import with_extension
from tools.build_extension import BuildError

OUTPUT = Path(__file__).resolve().parents[1] / "docs/images/light_composite.jpg"
SIZE = (440, 360)
SAMPLES = 32
APART = 0.17  # metres of each head from the middle
FELT = (0.05, 0.07, 0.16)
QUALITY = 88


def pictures(person: str, folder: Path) -> list[np.ndarray]:
    """Render without hair, with hair, and with hats, [H, W, 3] uint8 each."""
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.grmm.add_head(**({"person": "LIBRARY", "library": person} if person else {}))
    head = importlib.import_module("bl_ext.user_default.grmm.grmm_blender.rig.avatar").avatar_of(bpy.context.object).object
    head.grmm.lighting = "SCENE"
    (head.parent or head).location.x += APART
    bpy.context.view_layer.update()
    twin = bpy.data.objects.new(
        "Twin", bpy.data.meshes.new_from_object(head.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    )
    twin.matrix_world = head.matrix_world.copy()
    twin.location.x -= 2.0 * APART
    twin.data.shade_smooth()  # in the materials of the bare mesh, which is painted with the person
    scene.collection.objects.link(twin)
    _light(scene)
    _camera(scene)
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", SAMPLES, True
    scene.render.resolution_x, scene.render.resolution_y = SIZE
    scene.view_settings.view_transform = "Standard"
    _wall()
    shots = []
    for name, hair in (("bare", "NONE"), ("hair", "OWN")):
        head.grmm.hair.groom = hair
        bpy.ops.grmm.composite_set_up()  # again: puts the strands right that throw shadows
        shots.append(_shot(scene, folder / f"{name}.png"))
    for x in (-APART, APART):
        _hat(x)
    return [*shots, _shot(scene, folder / "hats.png")]


def _material(name: str, color: tuple[float, float, float], roughness: float) -> Any:
    import bpy

    material = bpy.data.materials.new(name)
    material.use_nodes = True
    shader = next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED")
    shader.inputs["Base Color"].default_value, shader.inputs["Roughness"].default_value = (*color, 1.0), roughness
    return material


def _light(scene: Any) -> None:
    """A soft key light from the left above, a colder one from the right behind, and a dim world."""
    import bpy
    from mathutils import Vector

    for place, watts, size, color in (
        ((-0.7, -1.3, 1.0), 38.0, 0.3, (1.0, 0.93, 0.85)),
        ((1.3, 0.6, 0.5), 30.0, 0.5, (0.6, 0.8, 1.0)),
    ):
        data = bpy.data.lights.new("Lamp", "AREA")
        data.energy, data.size, data.color = watts, size, color
        lamp = bpy.data.objects.new("Lamp", data)
        lamp.location, lamp.rotation_euler = place, (-Vector(place)).to_track_quat("-Z", "Y").to_euler()
        scene.collection.objects.link(lamp)
    world = scene.world = bpy.data.worlds.new("World")
    world.use_nodes = True
    background = next(node for node in world.node_tree.nodes if node.type == "BACKGROUND")
    background.inputs["Color"].default_value = (0.05, 0.055, 0.065, 1.0)


def _camera(scene: Any) -> None:
    import bpy

    scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(scene.camera)
    scene.camera.location, scene.camera.rotation_euler, scene.camera.data.lens = (
        (0.0, -1.75, 0.0),
        (math.pi / 2, 0.0, 0.0),
        85.0,
    )


def _wall() -> None:
    """A wall close behind the heads, for their shadows."""
    import bpy

    bpy.ops.mesh.primitive_plane_add(size=2.0, location=(0.0, 0.22, 0.0), rotation=(math.pi / 2, 0.0, 0.0))
    bpy.context.object.data.materials.append(_material("Wall", (0.5, 0.5, 0.5), 0.9))


def _hat(x: float) -> None:
    """A brim and a crown."""
    import bpy

    felt = bpy.data.materials.get("Felt") or _material("Felt", FELT, 0.9)
    for radius, depth, height in ((0.155, 0.006, 0.10), (0.10, 0.09, 0.145)):
        bpy.ops.mesh.primitive_cylinder_add(vertices=96, radius=radius, depth=depth, location=(x, 0.0, height))
        bpy.context.object.data.materials.append(felt)


def _shot(scene: Any, path: Path) -> np.ndarray:
    import bpy
    from PIL import Image

    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True, scene=scene.name)
    return np.asarray(Image.open(path).convert("RGB"))


def main() -> int:
    """Render and write the JPEG; returns the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--person", default="", help="avatar of the library instead of the default one")
    parser.add_argument("--output", type=Path, default=OUTPUT, help="JPEG (%(default)s)")
    arguments = parser.parse_args()
    from PIL import Image

    try:
        with tempfile.TemporaryDirectory(prefix="grmm-light-") as folder:
            shots = with_extension(lambda: {"shots": pictures(arguments.person, Path(folder))})["shots"]
    except BuildError as error:
        print(f"light_pictures: {error}", file=sys.stderr)
        return 1
    Image.fromarray(np.concatenate(shots, 1)).save(arguments.output, quality=QUALITY)
    return 0


if __name__ == "__main__":
    sys.exit(main())
