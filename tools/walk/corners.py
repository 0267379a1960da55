"""Steps of the walk that are easily forgotten: menus, other editors, questions, undo of adding, playing, no window at all."""

from __future__ import annotations

import time

from .animator import answer_browser
from .blender import WalkedBlender, WalkError
from .closer import SEARCH_SECONDS
from .steps import DROP_SECONDS, FILE_SECONDS, HEAD, MIDDLE, RIGS, SELECT_RIG

KEYED_REGIONS = {"Brows", "Jaw", "Mouth"}  # some of those that a performance moves
RENDER_SECONDS = 400.0
_EDITOR = """
area = max(window.screen.areas, key=lambda found: found.width * found.height)
area.ui_type = {kind!r}
"""
_CHANNELS = """
area = max(window.screen.areas, key=lambda found: found.width * found.height)
region = next(part for part in area.regions if part.type == "WINDOW")
with bpy.context.temp_override(window=window, area=area, region=region):
    bpy.ops.anim.channels_expand(all=True)
    {view}
"""
_GROUPS = """
head.keyframe_insert('["tongueOut"]', frame=3)
bpy.context.view_layer.update()
"""
_GROUPED = """
data = head.animation_data
bag = next(bag for layer in data.action.layers for strip in layer.strips for bag in strip.channelbags
           if bag.slot == data.action_slot)
result = sorted({curve.group.name if curve.group else "" for curve in bag.fcurves})
"""
_MENUS = ("VIEW3D_MT_add", "GRMM_MT_add", "TOPBAR_MT_file_import")
_LIBRARY = """
import sys
name = next(name for name in sys.modules if name.endswith("grmm_core.avatar.library"))
path = sys.modules[name].library_path("beard")
result = [str(path.parent), path.name]
"""
_ADDON = "name = next(name for name in bpy.context.preferences.addons.keys() if name.endswith('grmm'))\n"
_PROPERTIES = """
area = next(area for area in window.screen.areas if area.type == "PROPERTIES")
area.spaces.active.context = {context!r}
"""
_FACE = """
image = bpy.data.images.load({path!r})
width, height = image.size
at = 4 * (width * (height // 2) + width // 2)
result = list(image.pixels[at:at + 3])
bpy.data.images.remove(image)
"""


def menus(blender: WalkedBlender) -> None:
    """Open the menus that have entries of ours: *Add*, what is below *GRMM* there, *File > Import*."""
    for name in _MENUS:
        blender.move(*MIDDLE)
        blender.run(f"bpy.ops.wm.call_menu('INVOKE_DEFAULT', name={name!r})")
        blender.move(MIDDLE[0] + 5, MIDDLE[1] + 5)
        blender.picture(f"menu_{name.rpartition('_')[2]}", 3, settled=False)
        blender.key("Escape")


def import_avatar(blender: WalkedBlender) -> None:
    """Choose an avatar's file in the browser of *File > Import*, undo it, redo it and undo it again."""
    rigs = blender.run(RIGS)
    folder, name = blender.run(_LIBRARY)
    blender.run("bpy.context.scene.cursor.location = (0.4, 0.0, 1.0)\nbpy.ops.ed.undo_push(message='walk')")
    blender.run("bpy.ops.grmm.open_avatar('INVOKE_DEFAULT', True)")
    answer_browser(blender, folder, name)
    _wait_for_rigs(blender, rigs + 1, "an avatar's file that is chosen is not added")
    blender.picture("avatar_imported", 4)
    for keys, wanted in ((("ctrl", "z"), rigs), (("ctrl", "shift", "z"), rigs + 1), (("ctrl", "z"), rigs)):
        blender.move(*MIDDLE)
        blender.key(*keys)
        _wait_for_rigs(blender, wanted, f"{'-'.join(keys)} across adding a head does nothing")
        blender.picture(f"adding_{'redone' if 'shift' in keys else 'undone'}", 3)
    blender.run("bpy.context.scene.cursor.location = (0.0, 0.0, 0.0)")


def _wait_for_rigs(blender: WalkedBlender, wanted: int, otherwise: str) -> None:
    deadline = time.monotonic() + DROP_SECONDS
    while blender.run(RIGS) != wanted:
        if time.monotonic() > deadline:
            raise WalkError(f"{otherwise}: {blender.run(RIGS)} rigs, {wanted} expected")
        time.sleep(0.5)


def channels(blender: WalkedBlender) -> None:
    """Key a slider beside a recording, and look at the curves in dope sheet and graph editor: grouped by region."""
    blender.run(SELECT_RIG + HEAD + _GROUPS + "head.select_set(True)\nbpy.context.view_layer.objects.active = head")
    time.sleep(1.0)
    groups = blender.run(HEAD + _GROUPED)
    for kind, view in (("DOPESHEET", "bpy.ops.action.view_all()"), ("FCURVES", "bpy.ops.graph.view_all()")):
        blender.run(_EDITOR.format(kind=kind))
        time.sleep(1.0)
        blender.run(_CHANNELS.format(view=view))
        blender.picture(kind.lower(), 3, settled=False)
        blender.run(_EDITOR.format(kind="VIEW_3D"))
    blender.run(SELECT_RIG)
    if "" in groups or not set(groups) >= KEYED_REGIONS:
        raise WalkError(f"the channels of the head are in the groups {groups}")


def questions(blender: WalkedBlender) -> None:
    """Open what asks before it works: the search for a pose, into which is typed, and the name of a new one."""
    for name, typed in (("apply_pose", "la"), ("save_pose", "")):
        blender.move(*MIDDLE)
        blender.run(SELECT_RIG + f"bpy.ops.grmm.{name}('INVOKE_DEFAULT', True)")
        blender.move(MIDDLE[0] + 5, MIDDLE[1] + 5)
        time.sleep(SEARCH_SECONDS)
        if typed:
            blender.type(typed)
        blender.picture(f"asks_{name}", 3, settled=False)
        blender.key("Escape")
        blender.key("Escape")


def graded(blender: WalkedBlender) -> None:
    """Choose AgX: the engine's panel says that pictures are graded."""
    chosen = "bpy.context.scene.view_settings.view_transform = {!r}"
    blender.run(
        chosen.format("AgX") + "\narea.spaces.active.shading.type = 'RENDERED'\n" + _PROPERTIES.format(context="RENDER")
    )
    blender.picture("graded", 6)
    blender.run(chosen.format("Standard"))
    blender.run("area.spaces.active.shading.type = 'SOLID'\n" + _PROPERTIES.format(context="OBJECT"))


def disabled_while_playing(blender: WalkedBlender) -> None:
    """Disable the extension while a recording plays with full splats, and enable it again: playing goes on."""
    blender.run("bpy.context.scene.grmm_viewport.playback = 'FULL'\nbpy.ops.screen.animation_play()")
    blender.picture("plays", 4, settled=False)
    blender.run(_ADDON + "bpy.ops.preferences.addon_disable(module=name)\nbpy.app.driver_namespace['walk addon'] = name")
    blender.picture("plays_disabled", 4, settled=False)
    playing = blender.run("result = bpy.context.screen.is_animation_playing")
    blender.run("bpy.ops.preferences.addon_enable(module=bpy.app.driver_namespace['walk addon'])")
    blender.picture("plays_enabled", 6, settled=False)
    blender.run("bpy.ops.screen.animation_cancel(restore_frame=False)\nbpy.context.scene.grmm_viewport.playback = 'HOLD_RATE'")
    blender.picture("played", 3)
    if not playing:
        raise WalkError("playing ends when the extension is disabled")


def without_window(blender: WalkedBlender) -> None:
    """Save, and render a frame as a farm does: `blender -b FILE -f 1`."""
    path, picture = (blender.inner(blender.shared / name) for name in ("farm.blend", "farm_####"))
    blender.run(f"bpy.ops.wm.save_userpref()\nbpy.ops.wm.save_as_mainfile(filepath={path!r}, copy=True)", FILE_SECONDS)
    begin, before = time.monotonic(), len(blender.console)
    blender.background("-b", path, "-o", picture, "-F", "PNG", "-x", "1", "-f", "1", timeout=RENDER_SECONDS)
    blender.note(f"blender -b FILE -f 1 took {time.monotonic() - begin:.1f} s")
    made = blender.shared / "farm_0001.png"
    if not made.exists() or "Engine: GRMM" not in blender.console[before:]:
        raise WalkError("blender -b FILE -f 1 leaves no picture of the engine")
    blender.keep(made, "without_window")
    colors = blender.run(_FACE.format(path=blender.inner(made)))
    if not colors[0] > colors[2] > 0.05:
        raise WalkError(f"there is no face in the middle of what blender -b renders: {colors}")
