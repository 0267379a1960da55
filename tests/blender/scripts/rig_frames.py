"""Frame changes with an animated shape, whose small components go straight into the evaluated scene: rig_frames.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import ClassVar

import bpy
import numpy as np
from rig_support import core_mesh, fresh_head, largest, mesh_of, randomise, without_detail
from support import module, report

folder = Path(sys.argv[1])
live, mesh = module("grmm_blender.rig.live"), module("grmm_blender.rig.mesh")
generator = np.random.default_rng(0)
avatar = without_detail(fresh_head())
scene = bpy.context.scene
for frame in (1, 11, 21):
    randomise(avatar, generator)
    avatar.object.keyframe_insert('["shape"]', frame=frame)


def error() -> float:
    return largest(mesh_of(avatar) - core_mesh(avatar))


def stored_error() -> float:
    """The key in the data against what the present shape wants."""
    keys = avatar.object.data.shape_keys.key_blocks
    head = module("grmm_core.head").load_open_head()
    first = mesh.leading_shapes(head)
    small = mesh.to_blender(head.shape_dirs[:, :, first:] @ avatar.controls().shape[first:])
    return largest(mesh.read_key(keys["shape.rest"]) - mesh.read_key(keys["Basis"]) - small.ravel())


frames = []
for frame in (3, 18, 7, 21, 7, 7):
    scene.frame_set(frame)
    frames.append(error())
report(frames=frames, waiting=live.state_of(avatar).ahead is not None)

# only small components animated: nothing else tells Blender to evaluate the mesh again
for curve in module("grmm_blender.rig.actions").action_curves(avatar.object):
    curve.mute = curve.array_index < 200
small = []
for frame in (4, 14):
    scene.frame_set(frame)
    small.append(error())
report(small=small)

avatar.object.data.update_tag()  # Blender copies the keys again
bpy.context.view_layer.update()
report(copied=error())
scene.frame_set(9)
avatar.object["jawOpen"] = 0.7
avatar.object.update_tag()
bpy.context.view_layer.update()
report(edited=error(), stored=stored_error())
scene.frame_set(16)
expected = mesh_of(avatar)
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "frames.blend"))
report(saved=stored_error())
scene.frame_set(2)
bpy.ops.wm.open_mainfile(filepath=str(folder / "frames.blend"))
avatar, scene = module("grmm_blender.scene.avatars").avatars_in(bpy.context.scene)[0], bpy.context.scene
report(opened=largest(mesh_of(avatar) - expected))

# two view layers have an evaluated scene each
scene.frame_set(5)
other = scene.view_layers.new("other")
other.update()
scene.frame_set(12)
bpy.context.window.view_layer = other
bpy.context.view_layer.update()
layers = [error()]
scene.frame_set(6)
layers.append(error())
bpy.context.window.view_layer = scene.view_layers[0]
scene.frame_set(6)
layers.append(error())
scene.frame_set(13)
layers.append(error())
report(layers=layers)


class Probe(bpy.types.RenderEngine):
    """Notes the meshes of renders, which have an evaluated scene of their own."""

    bl_idname = "GRMM_TEST_PROBE"
    bl_label = "Probe"
    meshes: ClassVar[dict[int, np.ndarray]] = {}

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        head = depsgraph.objects[avatar.name]
        flat = np.empty(len(head.data.vertices) * 3, np.float32)
        head.data.attributes["position"].data.foreach_get("vector", flat)
        points = flat.reshape(-1, 3)
        self.meshes[depsgraph.scene.frame_current] = np.stack([points[:, 0], points[:, 2], -points[:, 1]], 1)
        self.end_result(self.begin_result(0, 0, 8, 8))


bpy.utils.register_class(Probe)
scene.render.engine, scene.render.resolution_x, scene.render.resolution_y = "GRMM_TEST_PROBE", 8, 8
scene.camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
scene.collection.objects.link(scene.camera)
scene.view_layers.remove(scene.view_layers["other"])
scene.render.filepath = str(folder / "probe_")
for curve in module("grmm_blender.rig.actions").action_curves(avatar.object):
    curve.mute = False
scene.frame_set(8)
scene.frame_set(9)
waiting = live.state_of(avatar).ahead is not None
bpy.ops.render.render()
scene.frame_start, scene.frame_end = 15, 17
bpy.ops.render.render(animation=True)
bpy.utils.unregister_class(Probe)
errors = {}
for frame, rendered in Probe.meshes.items():
    scene.frame_set(frame)
    errors[frame] = largest(rendered - core_mesh(avatar))
report(rendered=errors, waiting_for_render=waiting)
