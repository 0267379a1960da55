"""What Blender's own commands do to an avatar (Apply, hide, delete, scale, instance, push down): object_edits.py WEIGHTS."""

from __future__ import annotations

import sys

import bpy
import numpy as np
from render_support import heads, new_scene
from rig_support import core_mesh, largest, mesh_of, update, without_detail
from support import module, report

walk = module("grmm_blender.scene.walk")
armature = module("grmm_blender.rig.armature")
actions = module("grmm_blender.rig.actions")
Avatar = module("grmm_blender.rig.avatar").Avatar


def fresh() -> Avatar:
    """An avatar in a new scene."""
    global scene
    scene = new_scene(sys.argv[1])
    return Avatar(heads(scene)[0])


def select(obj: bpy.types.Object) -> None:
    for other in bpy.context.selected_objects:
        other.select_set(False)
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj


def with_curves(avatar: Avatar) -> bpy.types.Object:
    avatar.object.grmm.hair.groom = "bob"
    select(avatar.object)
    bpy.ops.grmm.hair_as_curves(sculpt=False)
    return avatar.object.grmm.hair.curves


def shown() -> list:
    """Shots of what a picture shows."""
    bpy.context.view_layer.update()
    return list(walk.read_scene(bpy.context.evaluated_depsgraph_get()).avatars)


def applied() -> dict:
    """Placement, joints and hair before and after transforms are applied to the rig; then the mesh of a posed head."""
    found = {}
    for name in ("location", "rotation", "scale"):
        avatar = without_detail(fresh())
        with_curves(avatar)
        rig = avatar.armature
        rig.location, rig.rotation_euler, rig.scale = (0.2, 0.1, -0.1), (0.1, 0.2, 0.6), (1.4, 1.4, 1.4)
        before = shown()[0]
        joints = armature.rest_joints(rig, avatar.place_in_rig)
        select(rig)
        bpy.ops.object.transform_apply(**{kind: kind == name for kind in ("location", "rotation", "scale")})
        after = shown()[0]
        hair = largest(after.strands.points - before.strands.points)
        found[name] = [
            largest(after.model_to_world - before.model_to_world), hair, after.note,
            largest(armature.rest_joints(rig, avatar.place_in_rig) - joints),
        ]  # fmt: skip
        rig.pose.bones["neck"].rotation_euler = (0.2, 0.1, -0.3)
        rig.pose.bones["jaw"].rotation_euler[0] = 0.2
        avatar.object["shape"] = (np.arange(len(avatar.object["shape"])) % 3 - 1.0).tolist()
        update(avatar)
        bpy.context.view_layer.update()
        found[name].append(largest(mesh_of(avatar) - core_mesh(avatar)))
        bones = len(rig.data.bones)
        select(rig)
        try:
            bpy.ops.grmm.add_motion(feature="look")
            found[name].append("")
        except RuntimeError as error:
            found[name].append(str(error) if len(rig.data.bones) == bones else "left half-made")
        rig.pose.bones["root"].location = (0.0, 0.14, 0.0)
        moved = shown()[0].model_to_world
        found[name].append(float(np.linalg.norm(moved[:3, 3] - after.model_to_world[:3, 3])))
    return found


def hidden() -> list:
    """Curves that nothing evaluates, on a head that moves."""
    avatar = fresh()
    curves = with_curves(avatar)
    before = shown()[0]
    curves.hide_viewport = curves.hide_render = True
    avatar.armature.location = (0.3, 0.0, 0.0)
    after = shown()[0]
    same = len(after.strands.groom.points) == len(before.strands.groom.points)
    return [after.note, largest(after.strands.groom.points - before.strands.groom.points) if same else -1.0]


def deleted() -> list:
    """The hair's object is deleted: the groom of the panel is worn again."""
    avatar = fresh()
    select(with_curves(avatar))
    bpy.ops.object.delete()
    shot = shown()[0]
    return [avatar.object.grmm.hair.curves is None, shot.strands is None, shot.hair.groom, shot.note]


def without_size() -> list:
    """A head that is scaled to nothing is not there; another one is."""
    avatar = fresh()
    with_curves(avatar)
    select(avatar.armature)
    bpy.ops.grmm.add_head(person="RANDOM", seed=5)
    avatar.armature.scale = (0.0, 0.0, 0.0)
    return [len(shown()), shown()[0].name != avatar.name]


def instanced() -> dict:
    """An avatar that a scene has as the instance of a collection alone, with nodes that shift its hair."""
    avatar = fresh()
    curves = with_curves(avatar)
    nodes = bpy.data.node_groups.new("Up", "GeometryNodeTree")
    for way in ("INPUT", "OUTPUT"):
        nodes.interface.new_socket("Geometry", in_out=way, socket_type="NodeSocketGeometry")
    begin, move, end = (nodes.nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeSetPosition", "NodeGroupOutput"))
    move.inputs["Offset"].default_value = (0.0, 0.0, 0.05)
    nodes.links.new(begin.outputs[0], move.inputs[0])
    nodes.links.new(move.outputs[0], end.inputs[0])
    curves.modifiers.new("Up", "NODES").node_group = nodes
    avatar.object.grmm.lighting = "SCENE"
    direct = shown()[0]
    collection = bpy.data.collections.new("Person")
    for obj in (avatar.object, avatar.armature, curves):
        for used in obj.users_collection:
            used.objects.unlink(obj)
        collection.objects.link(obj)
    holder = bpy.data.objects.new("Instance", None)
    holder.instance_type, holder.instance_collection = "COLLECTION", collection
    holder.location = (0.5, 0.0, 0.0)
    scene.collection.objects.link(holder)
    bpy.context.view_layer.update()
    there = walk.read_scene(bpy.context.evaluated_depsgraph_get())
    one = there.avatars[0]
    return {
        "place": largest(one.model_to_world[:3, 3] - direct.model_to_world[:3, 3] - [0.5, 0.0, 0.0]),
        "lit": there.lighting is not None and one.response is not None,
        "hair": largest(one.strands.points - direct.strands.points),
        "passes": [obj.name for obj in walk.drawn_objects(scene, instanced=True)] == [avatar.name],
        "alone": [obj.name for obj in walk.drawn_objects(scene)],
    }


def pushed_down() -> float:
    """What an action of half influence does once it is in a track."""
    avatar = fresh()
    head = avatar.object
    for frame in (1, 10):
        head["jawOpen"] = 1.0
        head.keyframe_insert('["jawOpen"]', frame=frame)
    head.animation_data.action_influence = 0.5
    actions.put_aside(head, push_down=True)
    scene.frame_set(6)
    return head["jawOpen"]


report(
    applied=applied(),
    hidden=hidden(),
    deleted=deleted(),
    without_size=without_size(),
    instanced=instanced(),
    pushed=pushed_down(),
)
