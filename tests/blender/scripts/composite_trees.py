"""Composites beside the user's own nodes, with undo, wrong scenes, and in saved files: composite_trees.py FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from render_support import unpainted
from support import empty_scene, module, report


def tree_of(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    if hasattr(scene, "compositing_node_group"):
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def own_tree(scene: bpy.types.Scene) -> bpy.types.NodeTree:
    """A tree as a user has it: scene, an adjustment, output."""
    if hasattr(scene, "compositing_node_group"):
        tree = bpy.data.node_groups.new("Mine", "CompositorNodeTree")
        scene.compositing_node_group = tree
        tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        end = tree.nodes.new("NodeGroupOutput")
    else:
        scene.use_nodes = True
        tree = scene.node_tree
        tree.nodes.clear()
        end = tree.nodes.new("CompositorNodeComposite")
    layers, blur = tree.nodes.new("CompositorNodeRLayers"), tree.nodes.new("CompositorNodeInvert")
    layers.scene = scene
    blur.name = "Mine"
    tree.links.new(layers.outputs["Image"], blur.inputs["Color"])
    tree.links.new(blur.outputs[0], end.inputs[0])
    return tree


def chain(scene: bpy.types.Scene) -> list[str]:
    """Names of the nodes from the output back along each first picture."""
    tree = tree_of(scene)
    node = next(n for n in tree.nodes if n.bl_idname in ("CompositorNodeComposite", "NodeGroupOutput"))
    found = []
    while node is not None:
        found.append(node.bl_idname.removeprefix("CompositorNode"))
        socket = next((s for s in node.inputs if s.type == "RGBA" and s.is_linked), None)
        node = socket.links[0].from_node if socket is not None else None
    return found[1:]


def message(operator: object) -> str:
    try:
        operator()
    except RuntimeError as error:
        return str(error)
    return ""


scene = empty_scene()
scene.render.engine = "CYCLES"
report(no_avatar=message(bpy.ops.grmm.composite_set_up))
with unpainted():
    bpy.ops.grmm.add_head()
head = bpy.context.object
scene.render.engine = "GRMM"
report(grmm=message(bpy.ops.grmm.composite_set_up), none=message(bpy.ops.grmm.composite_remove))
scene.render.engine = "CYCLES"

tree = own_tree(scene)
before = chain(scene)
bpy.ops.grmm.composite_set_up()
inserted = chain(scene)
bpy.ops.grmm.composite_remove()
report(before=before, inserted=inserted, after=chain(scene), handed=head.grmm_handed_over, visible=head.visible_camera)

# A head that its user hid stays hidden in the composite and afterwards.
head.visible_camera = False
bpy.ops.grmm.composite_set_up()
hidden = head.grmm_handed_over
bpy.ops.grmm.composite_remove()
report(hidden=[hidden, head.visible_camera])
head.visible_camera = True

# In a composite avatars take the light of the scene by one click.
(mesh,) = (avatar.object for avatar in module("grmm_blender.scene.avatars").avatars_in(scene))
lit = [mesh.grmm.lighting]
bpy.ops.grmm.composite_light()
report(lit=[*lit, mesh.grmm.lighting, message(bpy.ops.grmm.composite_light)])

# What the partner follows: collections with their visibility, cameras, markers, size.
bpy.ops.grmm.composite_set_up()
partner = scene.grmm_composite.partner
shown, excluded = bpy.data.collections.new("Shown"), bpy.data.collections.new("Excluded")
scene.collection.children.link(shown)
scene.collection.children.link(excluded)
camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
shown.objects.link(camera)
scene.camera = camera
scene.timeline_markers.new("Cut", frame=7).camera = camera
scene.render.resolution_x = 321
bpy.context.view_layer.layer_collection.children["Excluded"].exclude = True
bpy.context.view_layer.update()
module("grmm_blender.composite.scenes").sync(scene)
layer = partner.view_layers[0].layer_collection
report(
    children=sorted(c.name for c in partner.collection.children),
    excluded=[layer.children["Shown"].exclude, layer.children["Excluded"].exclude],
    camera=partner.camera == camera,
    marker=[(m.frame, m.camera == camera) for m in partner.timeline_markers],
    size=partner.render.resolution_x,
    settled=module("grmm_blender.composite.scenes").sync(scene),
)

# From inside the partner there is nothing to set up.
other = ""
try:
    module("grmm_blender.composite.scenes").set_up(partner)
except module("grmm_core.errors").GrmmError as error:
    other = str(error)
report(inside=other)

path = Path(sys.argv[1]) / "composite.blend"
bpy.ops.wm.save_as_mainfile(filepath=str(path))
bpy.ops.wm.open_mainfile(filepath=str(path))
scene = bpy.context.scene
partner = scene.grmm_composite.partner
report(reopened=[partner is not None and partner.grmm_composite.main == scene, chain(scene)])

# The partner was deleted by hand: set up again, and remove, both work.
bpy.data.scenes.remove(partner)
bpy.ops.grmm.composite_set_up()
again = [len(bpy.data.scenes), chain(scene)]
bpy.ops.grmm.composite_remove()
report(again=again, last=[len(bpy.data.scenes), chain(scene)])

# Undo takes everything back at once.
bpy.ops.ed.undo_push(message="before")
bpy.ops.grmm.composite_set_up()
bpy.ops.ed.undo_push(message="composite")
bpy.ops.ed.undo()
scene = bpy.context.scene
report(undone=[len(bpy.data.scenes), chain(scene), scene.grmm_composite.partner is None])
bpy.ops.ed.redo()
scene = bpy.context.scene
report(redone=[len(bpy.data.scenes), chain(scene), scene.grmm_composite.partner is not None])
