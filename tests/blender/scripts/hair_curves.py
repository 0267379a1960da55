"""Hair as Blender's curves: hair_curves.py WEIGHTS FOLDER. Reports what the test judges."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
from mathutils import kdtree
from render_support import heads, load_png, new_scene, render
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
scene = new_scene(weights)
head = heads(scene)[0]
rig = head.parent
hair = head.grmm.hair
avatars = module("grmm_blender.scene.avatars")
exporting = module("grmm_blender.exporting")
count = 0


def shot() -> np.ndarray:
    global count
    count += 1
    return load_png(render(folder / f"{count}.png"))


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Mean difference of two pictures, of 255."""
    return float(np.abs(one - other).mean())


def worn():
    """The avatar as the scene shows it now."""
    bpy.context.view_layer.update()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    avatar = avatars.avatars_in(scene)[0]
    return avatars.DrawnAvatar(avatar, avatar.model_to_world(depsgraph)).shot(depsgraph)


def splats(hair_use=None) -> np.ndarray:
    host, found = module("grmm_blender.session_host"), worn()
    use = module("grmm_blender.engine.pipeline").hair_of(found) if hair_use is None else hair_use
    return host.get_session().gaussians(host.open_avatar(found.source).id, found.controls, hair=use).means


# A groom becomes curves: the same picture, at rest and with the head turned and the face moving.
hair.groom, hair.melanin = "crop", 0.4
plain = shot()
head["jawOpen"], head["browInnerUp"], head["shape"][1] = 0.5, 1.0, 2.0
rig.pose.bones["neck"].rotation_euler = (0.2, 0.4, 0.1)
rig.location.x += 0.02
head.update_tag()
turned = shot()
bpy.ops.grmm.hair_as_curves(sculpt=False)
curves, data = hair.curves, hair.curves.data
turned_curves, strands = shot(), worn().strands

# Other engines draw them in the color of the sliders.
painted = next(node for node in data.materials[0].node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs["Base Color"]
before = list(painted.default_value)[:3]
hair.melanin, hair.redness, hair.grey, hair.dye, hair.dye_red, hair.tips = 0.2, 0.6, 0.3, 0.25, 0.9, -0.4
bpy.context.view_layer.update()
core_hair, pigment = module("grmm_core.hair"), module("grmm_core.hair.pigment")
mixed = core_hair.HairSettings(melanin=0.2, redness=0.6, grey=0.3, dye=0.25, dye_red=0.9, tips=-0.4)
color = pigment.albedos(mixed, np.zeros(1), np.full((1, 2), 0.5))[0].mean(0)
report(painted=list(painted.default_value)[:3], before=before, color=[float(value) for value in color])
for name in ("melanin", "redness", "grey", "dye", "dye_red", "tips"):
    hair.property_unset(name)
hair.melanin = 0.4
at_rest = module("grmm_core.hair").library_groom("crop")
report(
    turned=apart(turned_curves, turned),
    moved=apart(turned, plain),
    count=[len(data.curves), len(at_rest)],
    surface=data.surface == head,
    shown=curves.display_type,
    points=list(strands.points.shape),
)
hair.curves = None
report(groom_again=apart(shot(), turned))
hair.curves = curves

# Combed: what the head's curves say is what is drawn, also where geometry nodes have the last word.
original = np.empty(3 * len(data.points), np.float32)
data.attributes["position"].data.foreach_get("vector", original)
along = np.concatenate([np.linspace(0, 1, curve.points_length) for curve in data.curves])
combed = original.reshape(-1, 3) + along[:, None] * np.array([0.0, 0.0, 0.05])
data.attributes["position"].data.foreach_set("vector", combed.astype(np.float32).ravel())
data.update_tag()
rise = worn().strands.points - strands.points
report(
    comb=apart(shot(), turned_curves),
    rise=float(np.linalg.norm(rise, axis=1).max()),
    version=worn().strands.version != strands.version,
)
group = bpy.data.node_groups.new("Thin", "GeometryNodeTree")
for way in ("INPUT", "OUTPUT"):
    group.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
start, end = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
lift, drop = group.nodes.new("GeometryNodeSetPosition"), group.nodes.new("GeometryNodeDeleteGeometry")
chance = group.nodes.new("FunctionNodeRandomValue")
chance.data_type, drop.domain = "BOOLEAN", "CURVE"
lift.inputs["Offset"].default_value = (0.0, 0.0, 0.01)
group.links.new(start.outputs[0], lift.inputs["Geometry"])
group.links.new(lift.outputs[0], drop.inputs["Geometry"])
group.links.new(next(socket for socket in chance.outputs if socket.type == "BOOLEAN"), drop.inputs["Selection"])
group.links.new(drop.outputs[0], end.inputs[0])
whole = worn().strands
curves.modifiers.new("Thin", "NODES").node_group = group
thin = worn().strands
report(thin=len(thin.groom) / len(whole.groom), thin_picture=float(shot()[..., 3].max()))
again = worn().strands
report(kept=again.version == thin.version, same_shot=again is thin)

# Files: the avatar's own, with what nodes do; splats; curves in USD.
file = folder / "combed.grmm"
bpy.ops.grmm.save_avatar(filepath=str(file))
saved = module("grmm_core.avatar").load_avatar(file)
report(
    saved=len(saved.hair.groom) / len(thin.groom),
    saved_bytes=file.stat().st_size,
    melanin=saved.hair.settings.melanin,
    here=len(splats()),
    bald=len(splats(module("grmm_core.session").HairUse("none"))),
)
bpy.ops.grmm.export_splats(filepath=str(folder / "hair.ply"), format=".ply", pose="FRAME", degree=0)
exported, resting = (
    exporting.splats_of(avatars.avatars_in(scene)[0], bpy.context.evaluated_depsgraph_get(), options)()
    for options in (exporting.SplatOptions(0, whole=True), exporting.SplatOptions(0, canonical=True, whole=True))
)
report(exported=exported.count, resting=resting.count, ply=(folder / "hair.ply").stat().st_size > 60 * exported.count)
bpy.context.view_layer.objects.active = rig
bpy.ops.grmm.export_cache(filepath=str(folder / "hair.usda"), first=1, last=2)
text = (folder / "hair.usda").read_text("utf-8")
report(usd=text.count("def BasisCurves"))
hair.curves = None
bpy.ops.grmm.export_cache(filepath=str(folder / "groom.usda"), first=1, last=1)
text = (folder / "groom.usda").read_text("utf-8")
report(usd_groom=text.count("def BasisCurves"), left=len(bpy.data.hair_curves), own_error="")
hair.curves = curves

# Hidden in the viewport and in renders, curves still are hair.
curves.modifiers.remove(curves.modifiers["Thin"])
seen = shot()
curves.hide_render = True
report(hidden=apart(shot(), seen))
curves.hide_render = False
curves.hide_set(True)
report(hidden_points=worn().strands.points is None)
curves.hide_set(False)


# Sliders of the shape change what the curves are, too.
def evaluated() -> tuple[np.ndarray, np.ndarray]:
    """What other engines draw: points and radii of the evaluated curves."""
    bpy.context.view_layer.update()
    found = curves.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    points, radii = np.empty(3 * len(found.points), np.float32), np.empty(len(found.points), np.float32)
    found.attributes["position"].data.foreach_get("vector", points)
    found.attributes["radius"].data.foreach_get("value", radii)
    return points.reshape(len(found.curves), -1, 3), radii.reshape(len(found.curves), -1)


def length(points: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1).mean())


whole, wide = evaluated()
version = worn().strands.version
hair.length = 0.4
cut = evaluated()[0]
report(short=float((shot()[..., 3] > 128).mean()), long=float((seen[..., 3] > 128).mean()), cut=length(cut) / length(whole))
use = module("grmm_blender.engine.pipeline").hair_of(worn())
report(used=[use.settings.length, use.settings.melanin])
hair.length = 1.5
grown = evaluated()[0]
report(grown=length(grown) / length(whole))
for name, points, factor in (("cut_as_splats", cut, 0.4), ("grown_as_splats", grown, 1.5)):
    off = np.linalg.norm(points - module("grmm_core.hair.strands").lengthened(whole, factor), axis=2)
    report(**{name: np.median(off, 0).tolist()})
hair.property_unset("length")
hair.curl, hair.frizz, hair.thickness, hair.density = 1.0, 1.0, 2.0, 0.5
waved, thick = evaluated()
report(
    waved=float(np.linalg.norm(waved - whole, axis=2)[:, -1].mean()), rooted=float(np.abs(waved - whole)[:, 0].max()),
    thick=float(np.median(thick[thick > 0] / wide[thick > 0])), there=float((thick[:, 0] > 0).mean()),
    same_groom=worn().strands.version == version,
)  # fmt: skip
hair.curl, hair.frizz = -1.0, 0.0
report(straight=length(evaluated()[0]) / length(whole))
hair.curl, hair.thickness, hair.density = 0.0, 1.0, 1.0
report(unchanged=float(np.abs(evaluated()[0] - whole).max()))

# Engines that draw curves get the strands between them, in renders or where the modifier's input asks for them.
children = module("grmm_blender.hair.curve_children")
modifier = curves.modifiers["GRMM Hair Sliders"]
compat = module("grmm_blender.compat")
most = compat.node_input(modifier, children.IN_RENDERS)
compat.set_node_input(modifier, children.IN_VIEWPORTS, most)
curves.update_tag()
alone = len(evaluated()[0])
scene.render.engine = "CYCLES"
curves.update_tag()
family, fine = evaluated()
read = worn().strands
scalp = np.array([item.value for item in data.attributes["grmm_part"].data]) == 1
parents = kdtree.KDTree(len(whole))
for number, strand in enumerate(whole):
    parents.insert(strand[0], number)
parents.balance()
near = np.array([parents.find(strand[0])[2] for strand in family[len(whole) :]])
report(
    most=most,
    family=(len(family) - len(whole)) / scalp.sum(),
    alone=alone / len(whole),
    parents=float(np.abs(family[: len(whole)] - whole).max()),
    near=float(near.max()),
    tips=len(np.unique(family[:, -1], axis=0)) / len(family),
    finer=float(np.median(fine[: len(whole)][scalp] / wide[scalp])),
    strands=[len(read.groom), len(read.points)],
    own=[len(data.curves), len(data.points)],
)
compat.set_node_input(modifier, children.IN_VIEWPORTS, 1)
scene.render.engine = "GRMM"
curves.update_tag()

# Sculpt mode shows Blender's curves; out of it, splats alone.
for other in list(bpy.context.selected_objects):
    other.select_set(False)
bpy.context.view_layer.objects.active = rig
overlays = [area.spaces.active.overlay for area in module("grmm_blender.windows").areas("VIEW_3D")]
for overlay in overlays:
    overlay.show_sculpt_curves_cage = True
bpy.ops.grmm.hair_as_curves()
bpy.context.view_layer.update()
report(caged=[overlay.show_sculpt_curves_cage for overlay in overlays])
report(combed_avatar=module("grmm_blender.rig.avatar").avatar_of(curves).object == head)
report(mode=curves.mode, active=bpy.context.object == curves, edited=curves.display_type)
bpy.ops.object.mode_set(mode="OBJECT")
bpy.context.view_layer.update()
report(after=curves.display_type)

# What a photo says of the colors of strands is an attribute of their points, and is read back.
ends = np.random.default_rng(0).uniform(-0.3, 0.3, (2, len(at_rest), 1, 3))
places = np.linspace(0.0, 1.0, module("grmm_core.hair.groom").TINTS)[:, None]
tinted = core_hair.Groom(**vars(at_rest) | {"tints": (ends[0] * (1 - places) + ends[1] * places).astype(np.float32)})
hair.curves = module("grmm_blender.hair.build").make_curves(avatars.avatars_in(scene)[0], tinted)
read = worn().strands.groom
off = np.abs(read.tints - tinted.tints).max() if len(read) == len(tinted) else -1.0
report(tints=float(off), untinted=at_rest.tints is None)

# Cycles and EEVEE draw these colors, too.
scene.render.engine, scene.cycles.samples, scene.cycles.use_denoising = "CYCLES", 4, False
scene.world = bpy.data.worlds.new("white")
scene.world.use_nodes = True
scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (1.0, 1.0, 1.0, 1.0)
head.hide_render, redder = True, []
for red in (0.0, 0.4):
    own = np.zeros_like(tinted.tints) + np.array([red, 0.0, 0.0], np.float32)
    bpy.data.objects.remove(hair.curves)
    groom = core_hair.Groom(**vars(at_rest) | {"tints": own})
    hair.curves = module("grmm_blender.hair.build").make_curves(avatars.avatars_in(scene)[0], groom)
    picture = shot().astype(float)
    redder.append(float((picture[..., 0] - picture[..., 1])[picture[..., 3] > 200].mean()))
report(redder=redder)
