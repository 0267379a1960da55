"""Steps of the walk that look closer: an eye from near, played frames, the search, tooltips, undo of the look, copies."""

from __future__ import annotations

import time

from .blender import WalkedBlender, WalkError
from .steps import HEAD, MIDDLE, SELECT_RIG, place

WORDS = ("grmm", "blink")  # typed into the search
PLAYED_PICTURES = 3
SEARCH_SECONDS = 7.0  # until the menu is there: what is typed before is lost
UNDO_SECONDS = 60.0  # software OpenGL draws before it hears of a key
TOOLTIPS = {"random": 146, "mirror": 100, "copy": 55}  # pixels from the sidebar's right edge to icons of a region's heading
HEADING = 440  # pixels from the sidebar's upper edge to the heading of the first region
_KEEP_VIEW = """
region = area.spaces.active.region_3d
bpy.app.driver_namespace["walk view"] = [region.view_location.copy(), region.view_rotation.copy(), region.view_distance,
                                         area.spaces.active.clip_start]
"""
_NEAR_EYE = """
from mathutils import Vector
eye = head.parent.matrix_world @ head.parent.pose.bones["left_eye"].head
region.view_location, region.view_distance = eye, 0.06
region.view_rotation = Vector((0.0, -1.0, 0.0)).to_track_quat("Z", "Y")
region.view_perspective, area.spaces.active.clip_start = "PERSP", 0.005
"""
_VIEW_AGAIN = """
region, space = area.spaces.active.region_3d, area.spaces.active
region.view_location, region.view_rotation, region.view_distance, space.clip_start = bpy.app.driver_namespace["walk view"]
"""
_LOOK = "result = [head.grmm.hair.groom, round(head.grmm.hair.melanin, 3), head.grmm.lighting]"
_PLACES = """
heads = sorted((o for o in bpy.context.scene.objects if "jawOpen" in o.keys()), key=lambda found: found.name)
result = [[round(value, 4) for value in head.matrix_world.translation] for head in heads]
"""


_WHY = """
import sys
overlay = next(module for name, module in sys.modules.items() if name.endswith("viewport.overlay"))
result = overlay._why_it_stays(bpy.context)
"""
_SPLIT = """
bpy.ops.screen.area_split(direction="VERTICAL", factor=0.5)
"""
_TWO_WAYS = """
one, other = [area for area in window.screen.areas if area.type == "VIEW_3D"]
one.spaces.active.region_3d.view_perspective = "CAMERA"
other.spaces.active.shading.type = "RENDERED"
"""
_JOIN = """
one, other = [area for area in window.screen.areas if area.type == "VIEW_3D"]
one.spaces.active.region_3d.view_perspective = "PERSP"
with bpy.context.temp_override(window=window, area=other, region=other.regions[-1]):
    bpy.ops.screen.area_close()
"""
LARGE_INTERFACE, INTERFACE_SECONDS = 2.0, 6.0  # panels move to their new places for a while
DRAG_SECONDS = 3.0  # until software OpenGL has drawn what a key has begun


def head_alone(blender: WalkedBlender) -> None:
    """Select the head without its rig and press G: it stays, and the viewport says why."""
    blender.run(HEAD + "bpy.ops.object.select_all(action='DESELECT')\nhead.select_set(True)\n"
                "bpy.context.view_layer.objects.active = head")  # fmt: skip
    blender.settle()
    blender.move(*MIDDLE)
    blender.key("g")
    time.sleep(DRAG_SECONDS)
    blender.move(MIDDLE[0] + 40, MIDDLE[1])
    blender.picture("head_stays", DRAG_SECONDS, settled=False)
    why = blender.run(_WHY)
    blender.key("Escape")
    blender.run(SELECT_RIG)
    if not why:
        raise WalkError("nothing says why G does not move a head")


def many_views(blender: WalkedBlender) -> None:
    """Four views in one, two viewports, the head alone in one (local view), an interface of twice the size."""
    for title in ("four_views", ""):
        blender.run("bpy.ops.screen.region_quadview()")
        if title:
            blender.picture(title, 3)
    blender.run(_SPLIT)
    time.sleep(1.0)
    blender.run(_TWO_WAYS)
    blender.picture("two_viewports", 3)
    blender.run(_JOIN)
    time.sleep(1.0)
    blender.run("area.spaces.active.shading.type = 'SOLID'\narea.spaces.active.region_3d.view_perspective = 'PERSP'")
    for title in ("local_view", ""):
        blender.run(SELECT_RIG + "[child.select_set(True) for child in rig.children]\nbpy.ops.view3d.localview()")
        if title:
            blender.picture(title, 3)
    blender.run(f"bpy.context.preferences.view.ui_scale = {LARGE_INTERFACE}")
    time.sleep(INTERFACE_SECONDS)
    blender.run("for found in window.screen.areas:\n    found.tag_redraw()")
    blender.picture("large_interface", 3, settled=False)
    blender.run("bpy.context.preferences.view.ui_scale = 1.0")
    blender.run(SELECT_RIG)


def close_up(blender: WalkedBlender) -> None:
    """Look at an eye from six centimetres: closed, no grid."""
    blender.run(HEAD + _KEEP_VIEW + _NEAR_EYE)
    blender.picture("eye", 3)
    blender.run(_VIEW_AGAIN)


def search(blender: WalkedBlender) -> None:
    """Type words into the search."""
    blender.settle()
    for word in WORDS:
        blender.move(*MIDDLE)
        blender.key("F3")
        time.sleep(SEARCH_SECONDS)
        blender.type(word)
        blender.picture(f"search_{word}", 2, settled=False)
        blender.key("Escape")
        blender.key("Escape")


def tooltips(blender: WalkedBlender) -> None:
    """Rest the mouse on icons without a label."""
    _, top, right, _ = place(blender, "UI")
    for name, from_right in TOOLTIPS.items():
        blender.move(right - from_right, top + HEADING)
        blender.move(right - from_right + 1, top + HEADING + 1)
        blender.picture(f"tooltip_{name}", 3, settled=False)
    blender.move(*MIDDLE)


def played_frames(blender: WalkedBlender) -> None:
    """Play with full splats in pose mode: splats, bones and mesh of one frame."""
    settings = "settings = bpy.context.scene.grmm_viewport\n"
    before = blender.run(settings + "result = settings.playback\nsettings.playback = 'FULL'")
    blender.run(SELECT_RIG + "bpy.ops.object.mode_set(mode='POSE')\nbpy.ops.screen.animation_play()")
    for number in range(PLAYED_PICTURES):
        blender.picture(f"played_{number}", 3, settled=False)
    blender.run("bpy.ops.screen.animation_cancel(restore_frame=False)\nbpy.ops.object.mode_set(mode='OBJECT')")
    blender.run(settings + f"settings.playback = {before!r}")


def look_undone(blender: WalkedBlender) -> None:
    """Change style, color and light, a step each; undo and redo all of them."""
    states = [blender.run(HEAD + _LOOK)]
    for change in ("hair.groom = 'bob'", "hair.melanin = 0.05", "lighting = 'SCENE'"):
        blender.run(HEAD + f"head.grmm.{change}\nbpy.ops.ed.undo_push(message='walk')")
        states.append(blender.run(HEAD + _LOOK))
    blender.picture("look_changed", 2)
    for keys, wanted in ((("ctrl", "z"), states[-2::-1]), (("ctrl", "shift", "z"), states[1:])):
        for state in wanted:
            _press(blender, keys, state)
        blender.picture(f"look_{'redone' if 'shift' in keys else 'undone'}", 2)
    for state in states[-2::-1]:
        _press(blender, ("ctrl", "z"), state)


def _press(blender: WalkedBlender, keys: tuple[str, ...], wanted: object) -> None:
    blender.move(*MIDDLE)
    blender.key(*keys)
    deadline = time.monotonic() + UNDO_SECONDS
    while (found := blender.run(HEAD + _LOOK)) != wanted:
        if time.monotonic() > deadline:
            raise WalkError(f"after {'-'.join(keys)} the look is {found}, not {wanted}")
        time.sleep(0.5)


def copies(blender: WalkedBlender) -> None:
    """Duplicate a head beside itself, delete the copy's rig: its head stays where it stood; undo all."""
    blender.run(
        SELECT_RIG + "[child.select_set(True) for child in rig.children]\nbpy.ops.object.duplicate()\n"
        "bpy.context.view_layer.objects.active.location.x -= 0.3\n"
        "bpy.ops.ed.undo_push(message='walk')"
    )
    blender.picture("copy", 3)
    stood = blender.run(_PLACES)
    blender.run(
        "rig = bpy.context.view_layer.objects.active\nbpy.ops.object.select_all(action='DESELECT')\nrig.select_set(True)\n"
        "bpy.ops.ed.undo_push(message='walk')"
    )
    blender.move(*MIDDLE)
    blender.key("Delete")
    blender.picture("rig_deleted", 4)
    if blender.run(_PLACES) != stood:
        raise WalkError(f"heads stood at {stood} and are at {blender.run(_PLACES)} after a rig is deleted")
    blender.run("for head in [o for o in bpy.context.scene.objects if 'jawOpen' in o.keys() and o.parent is None]:\n"
                "    bpy.data.objects.remove(head)")  # fmt: skip
