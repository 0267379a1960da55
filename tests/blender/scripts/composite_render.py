"""A scene with a composited avatar, rendered and looked at: composite_render.py WEIGHTS FOLDER [CYCLES|BLENDER_EEVEE]."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import heads, load_png, new_scene, render
from support import report

weights, folder = sys.argv[1], Path(sys.argv[2])
engine = sys.argv[3] if len(sys.argv) > 3 else "CYCLES"
scene = new_scene(weights)
scene.camera.location.x = 0.0
scene.camera.rotation_euler.z = 0.0
alone = load_png(render(folder / "alone.png"))  # by the GRMM engine, transparent
half = scene.render.resolution_x // 2


def wall(name: str, distance: float, x0: float, x1: float, color: tuple[float, float, float, float]) -> bpy.types.Object:
    """A glowing plane across the picture at a distance in front of the head's origin."""
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata([(x0, -distance, -2), (x1, -distance, -2), (x1, -distance, 2), (x0, -distance, 2)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new(name)
    if bpy.app.version < (5, 0):
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    glow, output = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeOutputMaterial")
    glow.inputs["Color"].default_value = color
    tree.links.new(glow.outputs[0], output.inputs["Surface"])
    mesh.materials.append(material)
    obj = bpy.data.objects.new(name, mesh)
    scene.collection.objects.link(obj)
    return obj


def state() -> dict[str, object]:
    """What a composite adds to the file."""
    tree = scene.node_tree if hasattr(scene, "node_tree") else scene.compositing_node_group
    used = tree is not None and (hasattr(scene, "compositing_node_group") or scene.use_nodes)
    return {
        "scenes": len(bpy.data.scenes),
        "nodes": len(tree.nodes) if used else 0,
        "groups": sum(1 for group in bpy.data.node_groups if "grmm_composite" in group and group.users),
        "camera": [head.visible_camera for head in heads(scene)],
    }


def shot(name: str) -> np.ndarray:
    return load_png(render(folder / f"{name}.png"))[..., :3]


wall("Behind", -0.6, -5.0, 5.0, (1.0, 0.0, 0.0, 1.0))
if engine == "BLENDER_EEVEE":
    import gpu

    gpu.init()  # without a window
    scene.eevee.taa_render_samples = 4
scene.render.engine = engine
scene.cycles.samples, scene.cycles.use_denoising, scene.cycles.device = 4, False, "CPU"
scene.render.film_transparent = False
if hasattr(scene.cycles, "use_adaptive_sampling"):
    scene.cycles.use_adaptive_sampling = False
red = np.array([255.0, 0.0, 0.0])
before = state()
report(before=before, done=bpy.ops.grmm.composite_set_up() == {"FINISHED"})
first = state()
bpy.ops.grmm.composite_set_up()
report(first=first, second=state())

solid, empty = alone[..., 3] > 254.5, alone[..., 3] < 0.5
found = shot("behind")
report(
    behind_avatar=float(np.abs(found - alone[..., :3])[solid].max()),
    behind_wall=float(np.abs(found - red)[empty].max()),
    solid=float(solid.mean()),
)

# An object that comes later, in front of the left half of the face, and a camera setting that changes later.
front = wall("Front", 0.4, -5.0, 0.0, (0.0, 1.0, 0.0, 1.0))
green = np.array([0.0, 255.0, 0.0])
found = shot("front")
report(
    front_left=float(np.abs(found[:, : half - 1] - green).max()),
    front_right=float(np.abs(found - alone[..., :3])[:, half + 1 :][solid[:, half + 1 :]].max()),
)
scene.render.resolution_percentage = 50
report(half_size=list(shot("small").shape[:2]))
scene.render.resolution_percentage = 100

# With depths compared as well, the same picture but for edges; what the engine cannot see then hides too.
partner = scene.grmm_composite.partner
tree = scene.node_tree if hasattr(scene, "node_tree") else scene.compositing_node_group
merge = next(node for node in tree.nodes if node.get("grmm_composite") == "merge")
partner.grmm_render.use_occlusion = False
over = shot("unseen")
merge.inputs["Compare Depth"].default_value = 1.0
compared = shot("compared")
report(
    unseen=float(np.abs(over - alone[..., :3])[solid].max()),
    compared_left=float(np.abs(compared[:, : half - 1] - green).max()),
    compared_right=float(np.abs(compared - alone[..., :3])[:, half + 1 :][solid[:, half + 1 :]].max()),
)
partner.grmm_render.use_occlusion = True

# A picture that Blender saves although its avatars could not be drawn does not pass for a good one.
head = heads(scene)[0]
source, head.grmm.source = head.grmm.source, str(folder / "missing.grmm")
report(failed=[int(each) for each in np.ptp(shot("failed"), axis=(0, 1))], failed_color=shot("failed")[0, 0].tolist())
head.grmm.source = source

# A second head takes part without being asked.
bpy.ops.grmm.add_head(person="RANDOM", seed=5)
bpy.context.view_layer.update()
bpy.ops.grmm.composite_set_up()
report(two=state()["camera"])


# A groom that is worn throws its shadow through curves that nobody sees, of the groom that is worn when it is put right.
bald = len(bpy.data.hair_curves)
counts = []
for groom in ("bob", "crop", "crop"):
    heads(scene)[0].grmm.hair.groom = groom
    bpy.ops.grmm.composite_set_up()
    worn = [obj for obj in scene.objects if obj.type == "CURVES"]
    counts.append((len(worn), len(bpy.data.hair_curves) - bald, len(worn[0].data.curves), worn[0].visible_camera))
report(hair=counts)
bpy.ops.grmm.composite_remove()
report(removed=state(), hair_left=len(bpy.data.hair_curves) - bald)
