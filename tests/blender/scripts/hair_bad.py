"""Curves that cannot be hair: hair_bad.py WEIGHTS FOLDER. Reports the sentence for each, and whether the avatar is drawn."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import bpy
import numpy as np
from render_support import heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights, heads=2)
head, other = heads(scene)
avatars = module("grmm_blender.scene.avatars")
hair = head.grmm.hair
hair.groom = "crop"
found: dict[str, list] = {}


def fresh() -> bpy.types.Object:
    if hair.curves not in (None, groomed):
        bpy.data.hair_curves.remove(hair.curves.data)  # with its object: Blender would evaluate eight million points each time
    made = groomed.copy()
    made.data = groomed.data.copy()
    scene.collection.objects.link(made)
    hair.curves = made
    return made


def set_values(data: bpy.types.Curves, name: str, field: str, change: Callable[[np.ndarray], None]) -> None:
    attribute = data.attributes[name]
    values = np.empty(len(attribute.data) * (3 if name == "position" else 2), np.float32)
    attribute.data.foreach_get(field, values)
    change(values)
    attribute.data.foreach_set(field, values)
    data.update_tag()


def judge(name: str) -> None:
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    drawn = avatars.DrawnAvatar(avatars.Avatar(head), avatars.Avatar(head).model_to_world(depsgraph))
    shot = drawn.shot(depsgraph)
    found[name] = [shot.note, shot.hair.groom, shot.strands is None]


judge("groom")
picture = load_png(render(folder / "groom.png"))
bpy.context.view_layer.objects.active = head
bpy.ops.grmm.hair_as_curves(sculpt=False)
groomed = hair.curves

curves = fresh()
curves.data.surface = None
judge("no surface")
again = load_png(render(folder / "bad.png"))
panel = module("grmm_blender.hair").message_of(curves)
curves.data.surface = other
judge("another head")
curves.data.surface = head
curves.data.attributes.remove(curves.data.attributes["surface_uv_coordinate"])
judge("no coordinates")

curves = fresh()
set_values(curves.data, "surface_uv_coordinate", "vector", lambda uv: np.add(uv, 3.0, out=uv))
judge("beside the map")

curves = fresh()
set_values(curves.data, "position", "vector", lambda points: points.__setitem__(30, np.nan))
judge("nan")

curves = fresh()
curves.data.resize_curves([1] * len(curves.data.curves))
judge("one point")

curves = fresh()
curves.data.resize_curves([8_000_001], indices=[0])
judge("eight million")

curves = fresh()
curves.data.remove_curves()
judge("empty")

empty = bpy.data.objects.new("Nothing", bpy.data.hair_curves.new("Nothing"))
empty.data.surface = head
scene.collection.objects.link(empty)
hair.curves = empty
judge("new")
hair.curves = None
judge("removed")
report(found=found, same=float(np.abs(picture - again).max()), panel=panel)
