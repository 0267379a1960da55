"""Curves that are edited as brushes do: hair_edited.py WEIGHTS FOLDER. Reports what is worn and drawn after each step."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from render_support import heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
avatars = module("grmm_blender.scene.avatars")
found: dict[str, list] = {}
pictures: dict[str, np.ndarray] = {}


def worn():
    """The shot of the scene's avatar."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    avatar = avatars.avatars_in(scene)[0]
    return avatars.DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph)


def judge(name: str) -> None:
    """Keep what is worn: its note, hairs, points, least width; and the picture."""
    shot = worn()
    groom = None if shot.strands is None else shot.strands.groom
    sizes = [0, 0, 0.0] if groom is None else [len(groom), len(groom.points), float(groom.widths.max(1).min())]
    found[name] = [shot.note, *sizes]
    pictures[name] = load_png(render(folder / f"{name}.png"))


def values(name: str, size: int) -> np.ndarray:
    array = np.empty(len(data.attributes[name].data) * size, np.float32)
    data.attributes[name].data.foreach_get("vector" if size > 1 else "value", array)
    return array.reshape(-1, size) if size > 1 else array


def put(name: str, array: np.ndarray) -> None:
    data.attributes[name].data.foreach_set("vector" if array.ndim > 1 else "value", array.astype(np.float32).ravel())
    data.update_tag()


def cut(first: int, last: int, share: float) -> None:
    """Shorten some curves towards their roots."""
    points = values("position", 3)
    for curve in list(data.curves)[first:last]:
        some = slice(curve.first_point_index, curve.first_point_index + curve.points_length)
        points[some] = points[some][:1] + share * (points[some] - points[some][:1])
    put("position", points)


head = heads(scene)[0]
hair = head.grmm.hair
hair.groom = "bob"
bpy.ops.grmm.hair_as_curves(sculpt=False)
curves = hair.curves
data = curves.data
count = len(data.curves)
judge("whole")

# A density brush adds hairs beside others; what was not told about them is the attributes' zero, also the radius.
uv, points = values("surface_uv_coordinate", 2), values("position", 3)
steps = data.curves[0].points_length
data.add_curves([steps] * 40)
more, places = values("position", 3), values("surface_uv_coordinate", 2)
for k in range(40):
    start = data.curves[count + k].first_point_index
    more[start : start + steps] = points[k * steps : (k + 1) * steps] + 0.001
places[count:] = uv[:40]
put("position", more)
put("surface_uv_coordinate", places)
judge("added")
data.remove_curves(indices=list(range(count, count + 40)))
judge("as before")

cut(0, count, 0.3)
judge("cut")
data.resize_curves([2 + k % 7 for k in range(count)])
judge("other counts")
put("radius", np.zeros(len(data.points)))
judge("no radius")

# Nodes that move hair by the frame: every frame draws it, files hold it.
group = bpy.data.node_groups.new("Rise", "GeometryNodeTree")
for way in ("INPUT", "OUTPUT"):
    group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
lift, time = (group.nodes.new(f"GeometryNode{name}") for name in ("SetPosition", "InputSceneTime"))
up, scaled = group.nodes.new("ShaderNodeCombineXYZ"), group.nodes.new("ShaderNodeMath")
scaled.operation = "MULTIPLY"
scaled.inputs[1].default_value = 0.01
group.links.new(time.outputs["Frame"], scaled.inputs[0])
group.links.new(scaled.outputs[0], up.inputs["Z"])
group.links.new(start.outputs[0], lift.inputs["Geometry"])
group.links.new(up.outputs[0], lift.inputs["Offset"])
group.links.new(lift.outputs[0], end.inputs[0])
curves.modifiers.new("Rise", "NODES").node_group = group
heights = []
for frame in (1, 2, 3):
    scene.frame_set(frame)
    heights.append(float(worn().strands.points[:, 1].mean()))
    judge(f"frame {frame}")
bpy.ops.grmm.save_avatar(filepath=str(folder / "edited.grmm"))
saved = module("grmm_core.avatar").load_avatar(folder / "edited.grmm").hair.groom
bpy.ops.wm.save_as_mainfile(filepath=str(folder / "edited.blend"))
bpy.ops.wm.open_mainfile(filepath=str(folder / "edited.blend"))
scene = bpy.context.scene
judge("reopened")

head = heads(scene)[0]
data = head.grmm.hair.curves.data
data.remove_curves()
judge("none left")
head.grmm.hair.curves = None
head.grmm.hair.groom = "NONE"
judge("bald")


def apart(one: str, other: str) -> float:
    return 255.0 * float(np.abs(pictures[one] - pictures[other]).mean())


pairs = [
    ("whole", "added"), ("whole", "as before"), ("whole", "cut"), ("cut", "other counts"), ("frame 1", "frame 2"),
    ("frame 2", "frame 3"), ("frame 3", "reopened"), ("none left", "bald"), ("whole", "bald"), ("no radius", "bald"),
]  # fmt: skip
report(found=found, count=count, steps=steps, heights=heights, saved=[len(saved), len(saved.points)])
report(apart={f"{one}, {other}": apart(one, other) for one, other in pairs})
