"""Writing fields as geometry nodes. Used by `curve_sliders` and `curve_children`."""

from __future__ import annotations

import bpy

Value = bpy.types.NodeSocket | float | tuple[float, ...]


class Nodes:
    """Writes fields as nodes of a tree."""

    def __init__(self, tree: bpy.types.NodeTree) -> None:
        self.tree = tree

    def new(self, kind: str, inputs: dict[str | int, Value] | None = None, **options: object) -> bpy.types.Node:
        """A node with some inputs given, by name or number."""
        node = self.tree.nodes.new(kind)
        node.location = 180.0 * (len(self.tree.nodes) % 12), -220.0 * (len(self.tree.nodes) // 12)
        for name, value in options.items():
            setattr(node, name, value)
        for key, given in (inputs or {}).items():
            if isinstance(given, bpy.types.NodeSocket):
                self.tree.links.new(given, node.inputs[key])
            else:
                node.inputs[key].default_value = given
        return node

    def math(self, operation: str, *values: Value) -> bpy.types.NodeSocket:
        """A number of numbers."""
        return self.new("ShaderNodeMath", dict(enumerate(values)), operation=operation).outputs[0]

    def vector(self, operation: str, *values: Value) -> bpy.types.NodeSocket:
        """A vector of vectors; "SCALE" takes a number second."""
        keys = (0, "Scale") if operation == "SCALE" else range(len(values))
        return self.new("ShaderNodeVectorMath", dict(zip(keys, values, strict=True)), operation=operation).outputs[0]

    def chance(self, curve: bpy.types.NodeSocket, seed: int) -> bpy.types.NodeSocket:
        """A number 0..1 for each curve."""
        node = self.new("FunctionNodeRandomValue", {"ID": curve, "Seed": seed}, data_type="FLOAT")
        return next(socket for socket in node.outputs if socket.type == "VALUE")

    def setting(self, head: bpy.types.Object, name: str) -> bpy.types.NodeSocket:
        """A slider of the panel."""
        socket = self.new("ShaderNodeValue", label=name.capitalize()).outputs[0]
        driver = socket.driver_add("default_value").driver
        driver.type = "AVERAGE"  # of one: no script runs
        variable = driver.variables.new()
        variable.targets[0].id, variable.targets[0].data_path = head, f"grmm.hair.{name}"
        return socket
