"""Strands between curves for Cycles and EEVEE, as geometry nodes: as many, as fine and where splats have them.

A curve stands for a wisp. Splats draw it as several strands (`strands._spread`); drawn as it is, it is a wire of a millimetre.
Children are copies that stand around their curve at the root and gather towards its tip. They are made in renders of engines
that draw curves, and in viewports only if the modifier's input says so: each frame of playback would wait for them. `read`
leaves them out.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.hair import Groom
from ...grmm_core.hair.roots import SCALP
from ...grmm_core.hair.strands import (
    CROPPED,
    FINEST,
    MOST_CHILDREN,
    ROOT_SPREAD,
    SHORTER,
    STUBBLE,
    TIP_SPREAD,
    TOGETHER,
    root_distance,
)
from ..compat import node_input, set_node_input
from .node_fields import Nodes, Value

CHILD = "grmm_child"  # of a curve, an attribute: 0 is one of the object's own
OUT = "grmm_out"  # of a curve, an attribute: the way out of the skin at its root, at rest
IN_RENDERS, IN_VIEWPORTS = "Strands a Curve", "Strands a Curve in Viewports"  # inputs of the modifier
_APART = 0.003  # metres between curves that somebody will draw, about
_GOLDEN = 2.399963  # radians


@dataclass(frozen=True)
class Family:
    """Of the scalp's curves: how many strands each stands for, and how far apart they are in metres."""

    strands: int = MOST_CHILDREN
    apart: float = _APART

    @staticmethod
    def of(groom: Groom | None, vertices: np.ndarray, faces: np.ndarray) -> Family:
        """What splats make of a groom on a head with vertices [V, 3] and triangles [F, 3]; None is one to be drawn."""
        scalp = None if groom is None else groom.select(groom.groups == SCALP)
        if scalp is None or not len(scalp):
            return Family()
        strands = int(np.clip(round(float(scalp.widths[:, 0].mean()) / FINEST), 1, MOST_CHILDREN))
        return Family(strands, root_distance(scalp, vertices, faces))


def with_children(
    nodes: Nodes, geometry: bpy.types.NodeSocket, start: bpy.types.Node, scalp: bpy.types.NodeSocket, family: Family
) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """Curves with their children, and how many strands each of them is one of.

    Args:
        nodes: Of the sliders' tree, which gets the inputs `IN_RENDERS` and `IN_VIEWPORTS`.
        geometry: The curves.
        start: The tree's input.
        scalp: Which of them have children.
        family: What the inputs begin with, and how far children are from their curve.
    """
    for name, value in ((IN_RENDERS, family.strands), (IN_VIEWPORTS, 1)):
        socket = nodes.tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketInt")
        socket.default_value, socket.min_value, socket.max_value = value, 1, 4 * MOST_CHILDREN
        socket.description = "How many strands Cycles and EEVEE draw for each curve of the scalp"
    given = [start.outputs[name] for name in (IN_RENDERS, IN_VIEWPORTS)]
    seen = nodes.new("GeometryNodeIsViewport").outputs[0]
    count = nodes.new("GeometryNodeSwitch", input_type="INT")
    for number, socket in enumerate((seen, *given)):
        nodes.tree.links.new(socket, count.inputs[number])
    more = nodes.math("MULTIPLY", nodes.math("SUBTRACT", count.outputs[0], 1.0), _for_other_engines(nodes))
    strands = nodes.math("ADD", more, 1.0)

    root = _sampled(nodes, geometry, 0.0)
    ends = nodes.vector("SUBTRACT", _sampled(nodes, geometry, 1.0).outputs["Position"], root.outputs["Position"])
    held = nodes.new("GeometryNodeInputNamedAttribute", {"Name": OUT}, data_type="FLOAT_VECTOR").outputs[0]
    none = nodes.math("LESS_THAN", nodes.new("ShaderNodeVectorMath", {0: held}, operation="LENGTH").outputs["Value"], 0.5)
    out = nodes.vector("ADD", held, nodes.vector("SCALE", root.outputs["Tangent"], none))  # curves that somebody drew
    long = nodes.new("GeometryNodeSplineLength").outputs["Length"]
    short = nodes.math("DIVIDE", nodes.math("SUBTRACT", CROPPED, long), CROPPED - STUBBLE)
    short = nodes.math("MINIMUM", nodes.math("MAXIMUM", short, 0.0), 1.0)
    captured = nodes.new("GeometryNodeCaptureAttribute", {0: geometry}, domain="CURVE")
    kept = []
    for name, kind, value in (("Ends", "VECTOR", ends), ("Out", "VECTOR", out), ("Short", "FLOAT", short)):
        captured.capture_items.new(kind, name)
        nodes.tree.links.new(value, captured.inputs[name])
        kept.append(captured.outputs[name])
    ends, out, short = kept

    amount = nodes.math("MULTIPLY", more, scalp)
    copies = nodes.new("GeometryNodeDuplicateElements", {"Geometry": captured.outputs[0], "Amount": amount}, domain="SPLINE")
    of_curve = nodes.new("GeometryNodeCurveOfPoint").outputs[0]
    across = nodes.vector("NORMALIZE", nodes.vector("CROSS_PRODUCT", out, (0.31, 0.42, 0.85)))
    other = nodes.vector("CROSS_PRODUCT", out, across)
    angle = nodes.math("MULTIPLY", of_curve, _GOLDEN)
    far = nodes.math("MULTIPLY", nodes.math("SQRT", nodes.chance(of_curve, 7)), ROOT_SPREAD * family.apart)
    at_root = nodes.vector(
        "ADD",
        nodes.vector("SCALE", across, nodes.math("MULTIPLY", far, nodes.math("COSINE", angle))),
        nodes.vector("SCALE", other, nodes.math("MULTIPLY", far, nodes.math("SINE", angle))),
    )
    noise = nodes.new(
        "ShaderNodeCombineXYZ", {i: nodes.math("SUBTRACT", nodes.chance(of_curve, 8 + i), 0.5) for i in range(3)}
    ).outputs[0]
    gathered = nodes.math("ADD", nodes.math("MULTIPLY", short, 1.0 - TOGETHER), TOGETHER)
    at_tip = nodes.vector(
        "ADD",
        nodes.vector("SCALE", at_root, gathered),
        nodes.vector("SCALE", noise, 3.0**0.5 * TIP_SPREAD * family.apart),  # as wide as half that normally distributed
    )
    less = nodes.math("MULTIPLY", nodes.math("MULTIPLY", nodes.chance(of_curve, 11), -SHORTER), short)
    at_tip = nodes.vector("ADD", at_tip, nodes.vector("SCALE", ends, less))
    along = nodes.new("GeometryNodeSplineParameter").outputs["Factor"]
    back = nodes.math("SUBTRACT", 1.0, along)
    offset = nodes.vector("ADD", nodes.vector("SCALE", at_root, back), nodes.vector("SCALE", at_tip, along))
    placed = nodes.new("GeometryNodeSetPosition", {"Geometry": copies.outputs[0], "Offset": offset}).outputs[0]
    marked = nodes.new(
        "GeometryNodeStoreNamedAttribute", {"Geometry": placed, "Name": CHILD, "Value": 1}, data_type="INT", domain="CURVE"
    ).outputs[0]
    both = nodes.new("GeometryNodeJoinGeometry")
    for socket in (marked, geometry):  # what is linked last comes first
        nodes.tree.links.new(socket, both.inputs[0])
    return both.outputs[0], strands


@contextlib.contextmanager
def childless(modifier: bpy.types.Modifier | None) -> Iterator[None]:
    """Let a modifier that `with_children` is part of make none for a while: files hold the curves that somebody combed."""
    if modifier is None or modifier.node_group.interface.items_tree.get(IN_RENDERS) is None:  # as in older files
        yield
        return
    kept = {name: node_input(modifier, name) for name in (IN_RENDERS, IN_VIEWPORTS)}
    try:
        for name in kept:
            set_node_input(modifier, name, 1)
        yield
    finally:
        for name, value in kept.items():
            set_node_input(modifier, name, value)


def _for_other_engines(nodes: Nodes) -> bpy.types.NodeSocket:
    """1 where the scene's engine draws curves, 0 where it draws splats, which have strands of their own."""
    socket = nodes.new("ShaderNodeValue", label="Draws Curves").outputs[0]
    socket.default_value = 1.0  # where the extension is not there
    driver = socket.driver_add("default_value").driver
    driver.type = "AVERAGE"  # of one: no script runs
    variable = driver.variables.new()
    variable.type = "CONTEXT_PROP"
    variable.targets[0].context_property, variable.targets[0].data_path = "ACTIVE_SCENE", "grmm_render.draws_curves"
    return socket


def _sampled(nodes: Nodes, geometry: bpy.types.NodeSocket, factor: Value) -> bpy.types.Node:
    """Each curve at a place of its own."""
    index = nodes.new("GeometryNodeInputIndex").outputs[0]
    return nodes.new("GeometryNodeSampleCurve", {"Curves": geometry, "Factor": factor, "Curve Index": index}, mode="FACTOR")
