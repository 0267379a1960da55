"""A head in the scene that Blender starts with, and in others: first_contact.py WEIGHTS FOLDER."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
from bpy_extras.object_utils import world_to_camera_view
from render_support import exact_colors, load_png, render, unpainted, use_weights
from support import module, report

weights, folder = sys.argv[1], Path(sys.argv[2])
use_weights(weights)
avatars = module("grmm_blender.scene.avatars")
staging = module("grmm_blender.staging")
locked_to_rig = module("grmm_blender.rig.avatar").locked_to_rig


def startup() -> bpy.types.Scene:
    bpy.ops.wm.read_homefile(use_factory_startup=True, use_factory_startup_app_template_only=True)
    return bpy.context.scene


def lowest() -> float:
    """World height of the lowest point of the head."""
    head = avatars.avatars_in(bpy.context.scene)[0].object
    depsgraph = bpy.context.evaluated_depsgraph_get()
    evaluated = head.evaluated_get(depsgraph)
    return min((evaluated.matrix_world @ vertex.co).z for vertex in evaluated.data.vertices)


def add_as_in_a_window() -> None:
    """Add a head from the header with what the operator's `invoke` chooses; without a window Blender leaves that out."""
    window = bpy.context.window_manager.windows[0]
    area = next(area for area in window.screen.areas if area.type == "VIEW_3D")
    header = next(region for region in area.regions if region.type == "HEADER")
    with bpy.context.temp_override(window=window, area=area, region=header):
        add()


def add() -> None:
    """Call the operator."""
    bpy.ops.grmm.add_head(person="RANDOM", seed=3, stand=True, set_up=staging.is_as_started(bpy.context.scene))


def seen(avatar: object, screen: bpy.types.Screen | None = None) -> bool:
    """Whether a viewport looks at the head: its *Add* menu belongs to its header, which has no view of its own."""
    screen = screen or bpy.context.window_manager.windows[0].screen
    views = [area.spaces.active.region_3d for area in screen.areas if area.type == "VIEW_3D"]
    free = [view for view in views if view.view_perspective != "CAMERA"]
    return all(view.view_distance < 1.5 and (view.view_location - avatar.root.location).length < 0.3 for view in free)


# Somebody presses Add and F12 and nothing else.
scene = startup()
report(objects=sorted(obj.name for obj in scene.objects), as_started=staging.is_as_started(scene))
add_as_in_a_window()
avatar = avatars.avatars_in(scene)[0]
report(
    active=bpy.context.object == avatar.armature,
    moves_instead=[
        rig and rig.name
        for rig in map(locked_to_rig, ([], [avatar.object], [avatar.object, avatar.armature], [scene.objects["Cube"]]))
    ]
    == [None, avatar.armature.name, None, None],
    selected=sorted(obj.name for obj in bpy.context.selected_objects) == sorted([avatar.name, avatar.armature.name]),
    stands=lowest(),
    engine=scene.render.engine,
    graded=scene.view_settings.view_transform,
    started_again=staging.is_as_started(scene),
    seen=seen(avatar),
    unseen=[screen.name for screen in bpy.data.screens if not seen(avatar, screen)],
    screens=len(bpy.data.screens),
)
exact_colors(scene)
scene.render.resolution_x, scene.render.resolution_y, scene.render.film_transparent = 160, 90, True
alpha = load_png(render(folder / "f12.png"))[..., 3] / 255
rows = alpha.max(axis=1) > 0.5
report(covered=float(alpha.mean()), height=float(rows.mean()), edges=[float(alpha[0].max()), float(alpha[:, 0].max())])

# A scene in which somebody has moved anything is left alone, and so it is by scripts.
scene = startup()
scene.objects["Cube"].location.x = 3.0
add_as_in_a_window()
moved = [scene.render.engine != "GRMM", [round(x, 3) for x in scene.camera.location], lowest()]
scene = startup()
with unpainted():
    bpy.ops.grmm.add_head(person="RANDOM", seed=3)
scripted = [scene.render.engine != "GRMM", [round(x, 3) for x in scene.camera.location], list(bpy.context.object.location)]
bpy.ops.grmm.portrait_camera()
bpy.ops.grmm.portrait_camera()
cameras = sorted(obj.name for obj in scene.objects if obj.type == "CAMERA")
report(moved=moved, scripted=scripted, portrait=[scene.camera.name, cameras, scene.render.engine])


def filled() -> list[float]:
    """Share of the picture's shorter side that the head's height takes; how far it is from the middle, 0.5 at an edge."""
    bpy.context.view_layer.update()
    head, render = avatars.avatars_in(scene)[0].object, scene.render
    places = [world_to_camera_view(scene, scene.camera, head.matrix_world @ vertex.co) for vertex in head.data.vertices]
    height = (max(place.y for place in places) - min(place.y for place in places)) * render.resolution_y
    away = max(max(abs(place.x - 0.5), abs(place.y - 0.5)) for place in places)
    return [height / min(render.resolution_x, render.resolution_y), away]


formats = []
for scene.render.resolution_x, scene.render.resolution_y in ((1920, 1080), (1080, 1080), (1080, 1920)):
    formats.append(filled())
report(formats=formats, sensor=scene.camera.data.sensor_width)

# Avatar files are imported and dropped like others.
host = module("grmm_blender.session_host")
path = folder / "person.grmm"
host.get_session().save(host.open_avatar("sample:4").id, path)
scene = startup()
handler = bpy.types.GRMM_FH_avatar
operator = getattr(bpy.ops.grmm, handler.bl_import_operator.partition(".")[2])
dropped = operator("INVOKE_DEFAULT", filepath=str(path)) == {"FINISHED"}
report(dropped=[dropped, handler.bl_file_extensions, Path(avatars.avatars_in(scene)[0].source).name])
try:
    bpy.ops.grmm.open_avatar(filepath="")
    message = ""
except RuntimeError as error:
    message = str(error)
report(none_chosen=message)

# Who deletes a head does not keep its rig; what hangs on a rig keeps it.
left_rigs = module("grmm_blender.rig.left_rigs").LeftRigs()


def after_deleting(name: str, hat: bool = False, other_bone: bool = False) -> list[bool]:
    startup()
    with unpainted():
        bpy.ops.grmm.add_head(person="RANDOM", seed=3)
    avatar = avatars.avatars_in(bpy.context.scene)[0]
    rig = avatar.armature
    if hat:
        item = bpy.data.objects.new("Hat", None)
        item.parent = rig
        bpy.context.scene.collection.objects.link(item)
    if other_bone:
        rig.data.bones["neck"].name = "Chest"
    left_rigs.forget()
    before = left_rigs.notice_deleted()
    bpy.data.objects.remove(avatar.object if name == "head" else bpy.data.objects["Cube"])
    noticed = left_rigs.notice_deleted()
    left_rigs.remove()
    return [before, noticed, any(obj.type == "ARMATURE" for obj in bpy.data.objects)]


# Who deletes a rig alone has the head as a mesh, where it stood and free to be moved.
startup()
with unpainted():
    bpy.ops.grmm.add_head(person="RANDOM", seed=3)
kept = avatars.avatars_in(bpy.context.scene)[0]
rig, left_head = kept.armature, kept.object
rig.location, rig.rotation_euler, rig.scale = (1.0, 2.0, 3.0), (0.0, 0.0, 0.5), (2.0, 2.0, 2.0)
left_rigs.forget()
left_rigs.notice_deleted()
bpy.context.view_layer.update()
left_rigs.note_place(kept)
stood = left_head.matrix_world.copy()
bpy.data.objects.remove(rig)
bpy.context.view_layer.update()
jumped = (left_head.matrix_world.translation - stood.translation).length
noticed_head = left_rigs.notice_deleted()
left_rigs.note_place(kept)  # as the handler of edits does once more, for what the deletion has moved
left_rigs.remove()
bpy.context.view_layer.update()
off = max(abs(a - b) for one, other in zip(left_head.matrix_world, stood, strict=True) for a, b in zip(one, other, strict=True))
report(rig_deleted=[jumped > 1.0, noticed_head, off < 1e-5, any(left_head.lock_location), left_rigs.notice_deleted()])
report(
    deleted={
        "head": after_deleting("head"),
        "cube": after_deleting("cube"),
        "with a hat": after_deleting("head", hat=True),
        "with another bone": after_deleting("head", other_bone=True),
    },
    armatures=len(bpy.data.armatures),
)
