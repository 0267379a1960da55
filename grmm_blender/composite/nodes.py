"""The compositor's part of a composite: a Render Layers node of the partner scene and one group that puts it in.

The group stands where the main scene's picture enters the output, behind the user's own nodes, so that any tree stays in
use. Blender 4.5 keeps a tree inside the scene that ends in a Composite node; 5.x uses a node group that ends in a group
output. Our nodes carry a custom property, by which they are found again.
"""

from __future__ import annotations

import bpy

TAG = "grmm_composite"
MERGE, AVATARS, SCENE = "merge", "avatars", "scene"
GROUP_NAME = "GRMM Composite"
COMPARE = "Compare Depth"
_SPACING = 220.0  # between nodes, in the node editor's units


def merge_node(scene: bpy.types.Scene) -> bpy.types.Node | None:
    """Return the group node of a scene's composite, or None."""
    tree = _tree(scene)
    return None if tree is None else _tagged(tree, MERGE)


def insert(scene: bpy.types.Scene, partner: bpy.types.Scene) -> None:
    """Add the nodes to a scene, or point those that are there to the partner."""
    tree = _ensure_tree(scene)
    avatars = _tagged(tree, AVATARS) or _new(tree, "CompositorNodeRLayers", AVATARS)
    avatars.scene, avatars.layer = partner, partner.view_layers[0].name
    avatars.label = "Avatars"
    merge = _tagged(tree, MERGE)
    if merge is not None and any(output.is_linked for output in merge.outputs):
        _link_avatars(tree, avatars, merge)
        return
    output = _output_socket(tree)
    source = _scene_source(tree, scene, output)
    merge = merge or _new(tree, "CompositorNodeGroup", MERGE)
    merge.node_tree = _merge_group()
    end = output.node
    merge.location = (end.location.x, end.location.y)
    avatars.location = (merge.location.x - 1.5 * _SPACING, merge.location.y - 1.5 * _SPACING)
    end.location.x += 1.2 * _SPACING
    # A viewer that looks at the same picture goes on looking at what will be saved.
    viewers = [
        link.to_socket for link in tree.links if link.from_socket == source and link.to_node.bl_idname == "CompositorNodeViewer"
    ]
    tree.links.new(source, merge.inputs["Scene"])
    for target in (output, *viewers):
        tree.links.new(merge.outputs["Image"], target)
    depth = _depth_of(tree, scene, source)
    if depth is not None:
        tree.links.new(depth, merge.inputs["Scene Depth"])
    _link_avatars(tree, avatars, merge)


def remove(scene: bpy.types.Scene) -> None:
    """Take the nodes out and join what they stood between; a tree that was made for the composite goes as a whole."""
    tree = _tree(scene)
    if tree is None:
        return
    if scene.grmm_composite.made_tree and all(TAG in node or _is_default(node) for node in tree.nodes):
        scene.grmm_composite.made_tree = False
        _drop_tree(scene)
        return
    merge = _tagged(tree, MERGE)
    if merge is not None:
        links = merge.inputs["Scene"].links
        source = links[0].from_socket if links else None
        targets = [link.to_socket for link in merge.outputs["Image"].links]
        end = next((socket.node for socket in targets if socket.node.bl_idname in _OUTPUTS), None)
        if end is not None:
            end.location.x -= 1.2 * _SPACING
        for target in targets:
            if source is not None:
                tree.links.new(source, target)
    for node in [node for node in tree.nodes if node.get(TAG) in (MERGE, AVATARS)]:
        tree.nodes.remove(node)
    added = _tagged(tree, SCENE)
    if added is not None and not any(output.is_linked for output in added.outputs):
        tree.nodes.remove(added)


_OUTPUTS = ("CompositorNodeComposite", "NodeGroupOutput")


def _in_scene(scene: bpy.types.Scene) -> bool:
    """Whether this Blender keeps the tree inside the scene (4.5) instead of in a node group."""
    return not hasattr(scene, "compositing_node_group")


def _tree(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    if _in_scene(scene):
        return scene.node_tree if scene.use_nodes else None
    return scene.compositing_node_group


def _ensure_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    tree = _tree(scene)
    if tree is None:
        scene.grmm_composite.made_tree = True
        if _in_scene(scene):
            made = scene.node_tree is None
            scene.use_nodes = True
            scene.grmm_composite.made_tree = made
            return scene.node_tree
        tree = bpy.data.node_groups.new(f"{scene.name} Compositing", "CompositorNodeTree")
        scene.compositing_node_group = tree
    elif not _in_scene(scene) and (tree.users - tree.use_fake_user > 1 or tree.library is not None):
        # Other scenes use it too, and would get this scene's avatars.
        tree = tree.copy()
        scene.compositing_node_group = tree
    return tree


def _drop_tree(scene: bpy.types.Scene) -> None:
    if _in_scene(scene):
        for node in [node for node in scene.node_tree.nodes if TAG in node]:
            scene.node_tree.nodes.remove(node)
        scene.use_nodes = False
        return
    tree = scene.compositing_node_group
    scene.compositing_node_group = None
    if not tree.users:
        bpy.data.node_groups.remove(tree)


def _is_default(node: bpy.types.Node) -> bool:
    """Whether it is one of the nodes that Blender puts into a new tree."""
    return node.bl_idname in (*_OUTPUTS, "CompositorNodeRLayers", "CompositorNodeViewer", "NodeReroute")


def _tagged(tree: bpy.types.NodeTree, role: str) -> bpy.types.Node | None:
    return next((node for node in tree.nodes if node.get(TAG) == role), None)


def _new(tree: bpy.types.NodeTree, kind: str, role: str) -> bpy.types.Node:
    node = tree.nodes.new(kind)
    node[TAG] = role
    return node


def _link_avatars(tree: bpy.types.NodeTree, avatars: bpy.types.Node, merge: bpy.types.Node) -> None:
    tree.links.new(avatars.outputs["Image"], merge.inputs["Avatars"])
    depth = _depth_socket(avatars)
    if depth is not None:
        tree.links.new(depth, merge.inputs["Avatars Depth"])


def _output_socket(tree: bpy.types.NodeTree) -> bpy.types.NodeSocket:
    """Return the input of the tree's end that is the picture, adding the end where it is missing."""
    ends = [node for node in tree.nodes if node.bl_idname in _OUTPUTS]
    linked = [node for node in ends if node.inputs and node.inputs[0].is_linked]
    active = [node for node in ends if getattr(node, "is_active_output", False)]
    if hasattr(bpy.types, "CompositorNodeComposite"):
        end = next(iter((*linked, *ends)), None) or _new(tree, "CompositorNodeComposite", SCENE)
        return end.inputs["Image"]
    items = [item for item in tree.interface.items_tree if item.item_type == "SOCKET" and item.in_out == "OUTPUT"]
    if not items:
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    end = next(iter((*active, *linked, *ends)), None) or tree.nodes.new("NodeGroupOutput")
    return end.inputs[0]


def _scene_source(tree: bpy.types.NodeTree, scene: bpy.types.Scene, output: bpy.types.NodeSocket) -> bpy.types.NodeSocket:
    """Return what the output showed until now: the user's last node, else the scene's own picture."""
    if output.is_linked:
        return output.links[0].from_socket
    node = _scene_layers(tree, scene)
    if node is None:
        node = _new(tree, "CompositorNodeRLayers", SCENE)
        node.scene, node.layer = scene, scene.view_layers[0].name
        node.location = (output.node.location.x - 1.5 * _SPACING, output.node.location.y)
    return node.outputs["Image"]


def _scene_layers(tree: bpy.types.NodeTree, scene: bpy.types.Scene) -> bpy.types.Node | None:
    return next((node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers" and node.scene == scene), None)


def _depth_of(tree: bpy.types.NodeTree, scene: bpy.types.Scene, source: bpy.types.NodeSocket) -> bpy.types.NodeSocket | None:
    node = source.node if source.node.bl_idname == "CompositorNodeRLayers" else _scene_layers(tree, scene)
    return None if node is None else _depth_socket(node)


def _depth_socket(layers: bpy.types.Node) -> bpy.types.NodeSocket | None:
    """Engines name the pass as they like; nodes also keep switched-off sockets of passes that the engine does not have."""
    return next((socket for socket in layers.outputs if socket.name in ("Depth", "Z") and socket.enabled), None)


def _merge_group() -> bpy.types.NodeTree:
    """Return the group that puts avatars into a scene; its meaning is in the description of `_build_merge`."""
    for tree in bpy.data.node_groups:
        if tree.get(TAG) == MERGE and tree.library is None:
            return tree
    tree = bpy.data.node_groups.new(GROUP_NAME, "CompositorNodeTree")
    tree[TAG] = MERGE
    _build_merge(tree)
    return tree


def _build_merge(tree: bpy.types.NodeTree) -> None:
    """Fill the group: avatars over the scene, or the scene over the avatars where it is nearer.

    The engine has already cut avatars by the meshes in front of them, so "over" is right and has soft edges. Comparing depths
    as well is for what the engine does not see (hair, volumes, point clouds); its edges are hard, as in Z Combine.
    """
    face = tree.interface
    for name, kind in (
        ("Scene", "Color"), ("Scene Depth", "Float"), ("Avatars", "Color"), ("Avatars Depth", "Float"), (COMPARE, "Float"),
    ):  # fmt: skip
        socket = face.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
        if kind == "Float":
            socket.default_value = 0.0 if name == COMPARE else 1.0e10
        if name == COMPARE:
            socket.description = "1 compares depths as well: for hair, volumes and point clouds in front of avatars"
            socket.min_value, socket.max_value = 0.0, 1.0
    face.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
    face.new_socket("Depth", in_out="OUTPUT", socket_type="NodeSocketFloat")
    given, result = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")

    def math(operation: str, first: object, second: object, column: float, row: float) -> bpy.types.NodeSocket:
        kind = "CompositorNodeMath" if hasattr(bpy.types, "CompositorNodeMath") else "ShaderNodeMath"
        node = tree.nodes.new(kind)
        node.operation = operation
        node.location = (column * _SPACING, row * _SPACING)
        for socket, value in zip(node.inputs, (first, second), strict=False):
            if isinstance(value, float):
                socket.default_value = value
            else:
                tree.links.new(value, socket)
        return node.outputs[0]

    def over(below: bpy.types.NodeSocket, above: bpy.types.NodeSocket, row: float) -> bpy.types.NodeSocket:
        node = tree.nodes.new("CompositorNodeAlphaOver")
        node.location = (2 * _SPACING, row * _SPACING)
        colors = [socket for socket in node.inputs if socket.type == "RGBA"]  # below, above in every version
        tree.links.new(below, colors[0])
        tree.links.new(above, colors[1])
        return node.outputs[0]

    out = given.outputs
    nearer = math("LESS_THAN", out["Avatars Depth"], out["Scene Depth"], 1, -1)
    always = math("SUBTRACT", 1.0, out[COMPARE], 1, -2)
    factor = math("MAXIMUM", nearer, always, 2, -2)
    front, behind = over(out["Scene"], out["Avatars"], 1), over(out["Avatars"], out["Scene"], 0)
    tree.links.new(_mix(tree, factor, behind, front), result.inputs["Image"])
    tree.links.new(math("MINIMUM", out["Avatars Depth"], out["Scene Depth"], 3, -2), result.inputs["Depth"])
    result.location = (4 * _SPACING, 0)


def _mix(
    tree: bpy.types.NodeTree, factor: bpy.types.NodeSocket, first: bpy.types.NodeSocket, second: bpy.types.NodeSocket
) -> bpy.types.NodeSocket:
    """Blend two pictures linearly, alpha included."""
    if hasattr(bpy.types, "CompositorNodeMixRGB"):
        node = tree.nodes.new("CompositorNodeMixRGB")
        inputs, output = node.inputs, node.outputs[0]
    else:
        node = tree.nodes.new("ShaderNodeMix")
        node.data_type = "RGBA"
        node.clamp_factor = True
        enabled = [socket for socket in node.inputs if socket.enabled]
        inputs, output = enabled, next(socket for socket in node.outputs if socket.enabled)
    node.location = (3 * _SPACING, 0)
    for socket, source in zip(inputs, (factor, first, second), strict=False):
        tree.links.new(source, socket)
    return output
