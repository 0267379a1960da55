"""What a head consists of, and edits of it without the model: rig_structure.py."""

from __future__ import annotations

import math

import bpy
import numpy as np
from rig_support import core_mesh, fresh_head, largest, mesh_of, new_head, randomise, update, without_detail
from support import empty_scene, module, report

live = module("grmm_blender.rig.live")
avatars_in = module("grmm_blender.scene.avatars").avatars_in


def structure(avatar) -> dict:
    head, rig = avatar.object, avatar.armature
    drivers = [*head.data.shape_keys.animation_data.drivers, *rig.animation_data.drivers]
    limits = {name: head.id_properties_ui(name).as_dict() for name in ("jawOpen", "shape", "z_exp", "residual_strength")}
    return {
        "driver_types": sorted({curve.driver.type for curve in drivers}),
        "valid": all(curve.is_valid and curve.driver.is_valid for curve in drivers),
        "keys": [key.name for key in head.data.shape_keys.key_blocks],
        "properties": [key for key in head.keys() if key != "grmm"],  # noqa: SIM118
        "overridable": all(head.is_property_overridable_library(f'["{n}"]') for n in ("jawOpen", "shape", "residual_strength")),
        "limits": {n: [u["min"], u["max"], u["soft_min"], u["soft_max"], bool(u["description"])] for n, u in limits.items()},
        "bones": sorted(bone.name for bone in rig.data.bones if not bone.name.startswith(("MCH-", "DEF-", "DRV-"))),
        "preserve_volume": head.modifiers[0].use_deform_preserve_volume,
        "uv_overlap_free": len(head.data.uv_layers) == 1,
    }


def bone_and_slider_add_up(avatar) -> float:
    """Turn the jaw by hand while an expression opens it."""
    avatar.object["jawOpen"] = 0.6
    avatar.armature.pose.bones["jaw"].rotation_euler = (0.1, -0.05, 0.02)
    update(avatar)
    return largest(mesh_of(avatar) - core_mesh(avatar))


def clamped(avatar) -> float:
    avatar.object.keyframe_insert('["jawOpen"]', frame=1)
    curve = next(iter(module("grmm_blender.rig.actions").action_curves(avatar.object)))
    curve.keyframe_points[0].co[1] = 50.0
    curve.update()
    bpy.context.scene.frame_set(1)
    value = float(avatar.controls().aligned[24])
    avatar.object.animation_data_clear()
    return value


def not_a_number(avatar) -> list:
    avatar.object["jawOpen"] = math.nan
    update(avatar)
    message = live.state_of(avatar).message
    avatar.object["jawOpen"] = 0.0
    update(avatar)
    return [message, live.state_of(avatar).message, largest(mesh_of(avatar) - core_mesh(avatar))]


def undone(avatar) -> dict:
    """Undo a change of shape: mesh, joints and properties go back together."""
    name = avatar.object.name
    bpy.ops.ed.undo_push(message="before")
    before = mesh_of(avatar)
    randomise(avatar, np.random.default_rng(1))
    bpy.ops.ed.undo_push(message="after")
    changed = largest(mesh_of(avatar) - before)
    bpy.ops.ed.undo()
    again = module("grmm_blender.rig.avatar").Avatar(bpy.data.objects[name])
    update(again)
    return {
        "changed": changed,
        "back": largest(mesh_of(again) - before),
        "parity": largest(mesh_of(again) - core_mesh(again)),
    }


def duplicates() -> dict:
    first = without_detail(fresh_head(painted=True))
    randomise(first, np.random.default_rng(2))
    for obj in (first.object, first.armature):
        obj.select_set(True)
    bpy.ops.object.duplicate(linked=False)
    second = next(a for a in avatars_in(bpy.context.scene) if a != first)
    before = mesh_of(first)
    randomise(second, np.random.default_rng(3))
    full = {
        "first": largest(mesh_of(first) - before),
        "second": largest(mesh_of(second) - core_mesh(second)),
        "apart": largest(mesh_of(second) - before),
        "own_rig": second.armature != first.armature,
    }
    bpy.ops.object.select_all(action="DESELECT")
    for obj in (first.object, first.armature):
        obj.select_set(True)
    bpy.ops.object.duplicate(linked=True)
    third = next(a for a in avatars_in(bpy.context.scene) if a not in (first, second))
    randomise(third, np.random.default_rng(4))
    shared = {"message": live.limitation(third), "first": largest(mesh_of(first) - core_mesh(first))}
    bpy.context.view_layer.objects.active = third.object
    bpy.ops.grmm.make_independent()
    randomise(third, np.random.default_rng(5))
    shared |= {
        "after": live.limitation(third),
        "third": largest(mesh_of(third) - core_mesh(third)),
        "first_after": largest(mesh_of(first) - core_mesh(first)),
    }
    # one deleted
    for obj in (second.object, second.armature):
        bpy.data.objects.remove(obj)
    randomise(first, np.random.default_rng(6))
    deleted = {"left": len(avatars_in(bpy.context.scene)), "parity": largest(mesh_of(first) - core_mesh(first))}
    bpy.data.objects.remove(third.armature)
    bpy.context.view_layer.update()
    no_rig = {"message": live.limitation(third), "pose": largest(third.controls().pose)}
    return {"full": full, "linked": shared, "deleted": deleted, "no_rig": no_rig}


def elsewhere() -> dict:
    """Heads added from edit-like modes, hidden collections, and with names taken."""
    fresh_head(painted=True)
    rig = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).armature
    bpy.context.view_layer.objects.active = rig
    bpy.ops.object.mode_set(mode="POSE")
    polled = bpy.ops.grmm.add_head.poll()
    bpy.ops.object.mode_set(mode="OBJECT")
    hidden = bpy.data.collections.new("hidden")
    bpy.context.scene.collection.children.link(hidden)
    layer = bpy.context.view_layer.layer_collection.children["hidden"]
    bpy.context.view_layer.active_layer_collection = layer
    layer.exclude = True
    second = new_head(painted=True)
    return {"pose_mode": polled, "second": second.object.name in bpy.context.view_layer.objects, "name": second.name}


def painted() -> dict:
    """What the mesh looks like without splats, before and after it becomes another person, and with a user's own material."""
    avatar = fresh_head(painted=True)
    mesh = avatar.object.data

    def look() -> dict:
        materials = {material["grmm_part"]: material for material in mesh.materials}
        textures = [node.image for m in materials.values() for node in m.node_tree.nodes if node.type == "TEX_IMAGE"]
        image = textures[0]
        return {
            "parts": {part: [round(value, 3) for value in m.diffuse_color[:3]] for part, m in materials.items()},
            "one_image": len({texture.name for texture in textures}) == 1 and image.packed_file is not None,
            "size": list(image.size),
            "pixels": np.array(image.pixels[:], np.float32).reshape(-1, 4)[:, :3].mean(0).tolist(),
            "faces": {part: int((index == k).sum()) for k, part in enumerate(materials)},
        }

    index = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("material_index", index)
    first = look()
    identity = module("grmm_blender.rig.identity").read_identity("default")
    lit = module("grmm_core.model.plain_face").accented(identity.head, identity.painting) / 255.0
    image = mesh.materials[0].node_tree.nodes.active.image
    over = np.array(image.pixels[:], np.float32).reshape(*lit.shape[:2], 4)[..., :3][lit > 0.4] / lit[lit > 0.4]
    first["over_painting"] = np.quantile(over, (0.05, 0.95)).tolist()
    bpy.ops.grmm.relink_avatar(filepath=str(module("grmm_core.avatar.library").library_path("beard")))
    mesh.polygons.foreach_get("material_index", index)
    second = look()
    mesh.materials[0] = bpy.data.materials.new("of the user")
    bpy.ops.grmm.relink_avatar(filepath=str(module("grmm_core.avatar.library").library_path("afro")))
    kept = mesh.materials[0].name
    empty_scene()
    bpy.ops.grmm.add_head(person="RANDOM", seed=3)
    avatar = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
    mesh = avatar.object.data
    mesh.polygons.foreach_get("material_index", index)
    random, was_plain = look(), module("grmm_blender.rig.materials").is_plain(mesh)
    count = len(bpy.data.materials), len(bpy.data.images)
    module("grmm_blender.rig.build").change_identity(avatar, module("grmm_blender.rig.identity").read_identity("sample:4"))
    again = len(bpy.data.materials), len(bpy.data.images)
    repaint = module("grmm_blender.rig.repaint")
    at_once, repaint.ask = repaint.ask, lambda avatar: None
    module("grmm_blender.rig.build").change_identity(avatar, module("grmm_blender.rig.identity").read_identity("sample:3"))
    repaint.ask, repaint._looks = at_once, 99
    by_timer = []
    for _ in range(2):  # as in a window: the first look has it painted on a thread, the second puts it in its place
        by_timer.append(module("grmm_blender.rig.materials").is_plain(mesh))
        repaint._look()
        repaint._painter.wait(120)
    by_timer.append(module("grmm_blender.rig.materials").is_plain(mesh))
    made = {"random": random, "plain": was_plain, "left": [count, again], "by_timer": by_timer, "light": light_taken_off()}
    runtime = module("grmm_blender.session_host").runtime_status().available
    return {"first": first, "second": second, "kept": kept, "runtime": runtime, **made}


def light_taken_off():
    """As in a window: the light is on the painting of a head that is added, until a thread has taken it off."""
    materials, repaint = module("grmm_blender.rig.materials"), module("grmm_blender.rig.repaint")
    identity = module("grmm_blender.rig.identity").read_identity("default")
    empty_scene()
    bpy.ops.grmm.add_head()
    mesh = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).object.data

    def pixels():
        image = mesh.materials[0].node_tree.nodes.active.image
        return np.array(image.pixels[:], np.float32).reshape(*identity.painting.shape[:2], 4)[..., :3]

    wanted = pixels()
    materials.add_materials(mesh, identity, soon=True)
    seen = [[materials.is_lit(mesh), float(abs(pixels() - wanted).max())]]
    repaint._look()
    repaint._painter.wait(120)
    repaint._look()
    seen.append([materials.is_lit(mesh), float(abs(pixels() - wanted).max())])
    materials.add_materials(mesh, identity, soon=True)
    repaint.look_soon()  # of a file that background Blender opens
    return [*seen, [materials.is_lit(mesh), float(abs(pixels() - wanted).max())]]


avatar = without_detail(fresh_head(painted=True))
report(structure=structure(avatar), added=bone_and_slider_add_up(avatar), clamped=clamped(avatar))
report(nan=not_a_number(avatar))
report(undo=undone(avatar))
report(**duplicates())
report(elsewhere=elsewhere())
report(painted=painted())
