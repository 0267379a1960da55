"""What the panel's sliders do to curves, as geometry nodes: so Cycles and EEVEE draw the hair that splats show.

Length, curl and frizz move points as `StrandBlock.styled` does; splats then take the points as Blender evaluates them.
Thickness and density change the curves' radii, which splats do not read: they have their own.
"""

from __future__ import annotations

import math

import bpy

from ...grmm_core.hair.roots import SCALP
from ...grmm_core.hair.strands import CURL, FRIZZ
from ...grmm_core.session import HEAD_TO_BLENDER
from ..linking import link_beside
from ..rig.avatar import is_avatar
from .curve_children import Family, with_children
from .node_fields import Nodes, Value

PART = "grmm_part"  # of a curve, an attribute: one more than its number in `roots.GROUPS`, or else its root says what it is
TIED = "grmm_tied"  # of a curve, an attribute: a knot holds it, see `knots`; none is false
MODIFIER_NAME = "GRMM Hair Sliders"
NEUTRAL = {"length": 1.0, "curl": 0.0, "frizz": 0.0}  # of the sliders that move points
SLIDERS = "grmm.hair."  # data path of a head's sliders
_OTHERS = ("thickness", "density")
_SIDEWAYS = tuple((HEAD_TO_BLENDER[:3, :3] @ (0.31, 0.42, 0.85)).tolist())  # strands' directions across, see `strands.across`
_EPSILON = 1e-4


def add_sliders(obj: bpy.types.Object, head: bpy.types.Object, points: int, family: Family) -> None:
    """Give curves of about so many points each a modifier that follows the sliders of a head's Hair panel, with children."""
    tree = bpy.data.node_groups.new(f"{obj.name} sliders", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    tree.is_modifier = True
    nodes = Nodes(tree)
    length, curl, frizz, thickness, density = (nodes.setting(head, name) for name in (*NEUTRAL, *_OTHERS))
    position, curve = nodes.new("GeometryNodeInputPosition").outputs[0], nodes.new("GeometryNodeCurveOfPoint").outputs[0]
    along = nodes.new("GeometryNodeSplineParameter").outputs["Factor"]
    start = nodes.new("NodeGroupInput")
    geometry = start.outputs[0]
    part = nodes.new("GeometryNodeInputNamedAttribute", {"Name": PART}, data_type="FLOAT").outputs[0]
    scalp = nodes.math("LESS_THAN", part, SCALP + 1.5)  # brows and beards keep their shape; 0 is hair that somebody drew

    def placed(selection: Value, **where: Value) -> bpy.types.NodeSocket:
        selection = nodes.math("MULTIPLY", selection, scalp)
        given = {"Geometry": geometry, "Selection": selection, **{name.capitalize(): value for name, value in where.items()}}
        return nodes.new("GeometryNodeSetPosition", given).outputs[0]  # type: ignore[arg-type]

    def sampled(factor: Value) -> bpy.types.NodeSocket:
        node = nodes.new("GeometryNodeSampleCurve", {"Curves": geometry, "Factor": factor, "Curve Index": curve}, mode="FACTOR")
        return node.outputs["Position"]

    # fewer waves
    inside = nodes.math("MULTIPLY", nodes.math("GREATER_THAN", along, 0.0), nodes.math("LESS_THAN", along, 1.0 - _EPSILON))
    blurred = nodes.new("GeometryNodeBlurAttribute", {"Iterations": 2 * points // 3}, data_type="FLOAT_VECTOR")
    for name, value in (("Value", position), ("Weight", inside)):
        tree.links.new(value, next(socket for socket in blurred.inputs if socket.name == name and socket.enabled))
    straight = next(socket for socket in blurred.outputs if socket.enabled)
    straighter = nodes.vector("SCALE", nodes.vector("SUBTRACT", straight, position), nodes.math("MULTIPLY", curl, -1.0))
    geometry = placed(nodes.math("LESS_THAN", curl, -_EPSILON), offset=straighter)
    # cut, or grown on as the last third goes, see `strands.lengthened`; never by more than two thirds
    reached = nodes.math("MULTIPLY", along, length)
    end = sampled(1.0)
    twice = nodes.vector("SCALE", nodes.vector("SUBTRACT", end, sampled(2.0 / 3.0)), 2.0)
    grown, again = nodes.math("GREATER_THAN", reached, 1.0), nodes.math("GREATER_THAN", reached, 4.0 / 3.0)
    turned = nodes.math("SUBTRACT", grown, again)

    def over(limit: float, most: float) -> bpy.types.NodeSocket:
        return nodes.math("MINIMUM", nodes.math("MAXIMUM", nodes.math("SUBTRACT", reached, limit), 0.0), most)

    back = nodes.math("SUBTRACT", nodes.math("MINIMUM", reached, 1.0), over(1.0, 1.0 / 3.0))
    place = sampled(nodes.math("ADD", back, over(4.0 / 3.0, 1.0 / 3.0)))
    place = nodes.vector("SCALE", place, nodes.math("SUBTRACT", 1.0, nodes.math("MULTIPLY", turned, 2.0)))
    place = nodes.vector("ADD", place, nodes.vector("SCALE", end, nodes.math("MULTIPLY", turned, 2.0)))
    place = nodes.vector("ADD", place, nodes.vector("SCALE", twice, again))
    other = nodes.math("GREATER_THAN", nodes.math("ABSOLUTE", nodes.math("SUBTRACT", length, 1.0)), _EPSILON)
    held = nodes.new("GeometryNodeInputNamedAttribute", {"Name": TIED}, data_type="FLOAT").outputs[0]
    geometry = placed(nodes.math("MULTIPLY", other, nodes.math("SUBTRACT", 1.0, held)), position=place)
    # waves and frizz
    long = nodes.new("GeometryNodeSplineLength").outputs["Length"]
    swing = nodes.math("MULTIPLY", nodes.math("MINIMUM", nodes.math("DIVIDE", long, 0.12), 1.0), along)

    def angle(wavelength: float, most: float, factor: float, phase: Value) -> bpy.types.NodeSocket:
        turns = nodes.math("MINIMUM", nodes.math("MAXIMUM", nodes.math("DIVIDE", long, wavelength), 1.0), most)
        turn = nodes.math("MULTIPLY", nodes.math("MULTIPLY", turns, along), factor)
        return nodes.math("ADD", turn, phase)

    tangent = nodes.new("GeometryNodeInputTangent").outputs[0]
    side = nodes.vector("NORMALIZE", nodes.vector("CROSS_PRODUCT", tangent, _SIDEWAYS))
    up = nodes.vector("CROSS_PRODUCT", tangent, side)
    swung = angle(0.045, points / 5.0, math.tau, nodes.chance(curve, 1))
    wave = nodes.vector(
        "ADD",
        nodes.vector("SCALE", side, nodes.math("COSINE", swung)),
        nodes.vector("SCALE", up, nodes.math("SINE", swung)),
    )
    waved = nodes.math("MULTIPLY", nodes.math("MULTIPLY", nodes.math("MAXIMUM", curl, 0.0), CURL), swing)
    parts = []
    for seed in (2, 3, 4):  # x, y and z
        phase = nodes.math("MULTIPLY", nodes.chance(curve, seed), math.tau)
        slow, fast = angle(0.025, points / 3.0, math.tau, phase), angle(0.025, points / 3.0, 14.1, phase)
        parts.append(nodes.math("ADD", nodes.math("SINE", slow), nodes.math("MULTIPLY", nodes.math("SINE", fast), 0.5)))
    noise = nodes.new("ShaderNodeCombineXYZ", dict(enumerate(parts))).outputs[0]
    shy = nodes.math("POWER", nodes.chance(curve, 5), 2.0)  # most hairs keep to their course
    ruffled = nodes.math("MULTIPLY", nodes.math("MULTIPLY", nodes.math("MULTIPLY", frizz, FRIZZ), shy), swing)
    moved = nodes.vector("ADD", nodes.vector("SCALE", wave, waved), nodes.vector("SCALE", noise, ruffled))
    some = nodes.math("GREATER_THAN", nodes.math("ADD", nodes.math("MAXIMUM", curl, 0.0), frizz), _EPSILON)
    geometry = placed(some, offset=moved)
    # more and finer strands; thickness and density
    geometry, strands = with_children(nodes, geometry, start, scalp, family)
    thickness = nodes.math("DIVIDE", thickness, strands)
    there = nodes.math("LESS_THAN", nodes.chance(curve, 6), nodes.math("MULTIPLY", density, 1.0 + _EPSILON))
    times = nodes.math("SUBTRACT", nodes.math("MULTIPLY", thickness, there), 1.0)
    times = nodes.math("ADD", nodes.math("MULTIPLY", times, scalp), 1.0)
    radius = nodes.math("MULTIPLY", nodes.new("GeometryNodeInputRadius").outputs[0], times)
    thick = nodes.new("GeometryNodeSetCurveRadius", {"Curve": geometry, "Radius": radius}).outputs[0]
    tree.links.new(thick, nodes.new("NodeGroupOutput").inputs[0])
    obj.modifiers.new(MODIFIER_NAME, "NODES").node_group = tree


def claim(obj: bpy.types.Object, head: bpy.types.Object) -> bool:
    """Give curves that were duplicated with their head sliders and a color of their own; returns whether they had none.

    Blender gives copies the nodes and the material of the first, which go on following the first head's sliders.
    """
    modifier, changed = obj.modifiers.get(MODIFIER_NAME), False
    if obj.library is not None or obj.override_library is not None or head.library is not None:
        return False
    tree = modifier.node_group if modifier is not None else None
    if tree is not None and tree.library is None and _others(tree, head):
        modifier.node_group = copy = tree.copy()
        _follow(_others(copy, head), head)
        changed = True
    if obj.data.library is not None or obj.data.users > 1:
        return changed
    for number, material in enumerate(obj.data.materials):
        if material is not None and material.library is None and material.node_tree and _others(material.node_tree, head):
            obj.data.materials[number] = copy = material.copy()
            _follow(_others(copy.node_tree, head), head)
            changed = True
    return changed


def shared_with(head: bpy.types.Object) -> bpy.types.Object | None:
    """The head whose hair the curves of a head's hair are as well, after a duplicate that did not copy them; else None."""
    curves = head.grmm.hair.curves
    other = curves.data.surface if curves is not None and curves.type == "CURVES" else None
    if other in (None, head) or not is_avatar(other):
        return None
    theirs = other.grmm.hair.curves
    return other if theirs is not None and theirs.data == curves.data else None


def copy_shared(head: bpy.types.Object) -> None:
    """Give a head that shares the curves of its hair with another one curves of its own, as they are combed."""
    other, obj = shared_with(head), head.grmm.hair.curves
    if other is None:
        return
    if other.grmm.hair.curves == obj:
        obj = obj.copy()
        link_beside(obj, head)
        obj.parent = head
    obj.data = obj.data.copy()
    obj.data.surface = head
    head.grmm.hair.curves = obj
    claim(obj, head)


def _others(tree: bpy.types.NodeTree, head: bpy.types.Object) -> list[bpy.types.DriverTarget]:
    """Sliders of other heads that nodes follow."""
    drivers = tree.animation_data.drivers if tree.animation_data is not None else ()
    targets = [target for curve in drivers for variable in curve.driver.variables for target in variable.targets]
    return [one for one in targets if one.id not in (None, head) and one.data_path.startswith(SLIDERS)]


def _follow(targets: list[bpy.types.DriverTarget], head: bpy.types.Object) -> None:
    for target in targets:
        target.id = head


def follows_sliders(obj: bpy.types.Object, final: bool) -> bool:
    """Whether the sliders' modifier is on: in renders if `final`, else in viewports."""
    modifier = obj.modifiers.get(MODIFIER_NAME)
    return modifier is not None and bool(modifier.show_render if final else modifier.show_viewport)


def keeps_course(panel: bpy.types.PropertyGroup) -> bool:
    """Whether the sliders of a panel leave points where they are."""
    return all(getattr(panel, name) == value for name, value in NEUTRAL.items())
