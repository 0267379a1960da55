"""The walk: what an animator does first, each step a picture. `order.STEPS` is their order.

Operators are called with an undo step, as a click on them makes one (`True` after the way to call them). A step takes the
driven Blender; it raises where something is wrong that a program can see (no face in the render, a traceback in the console),
and leaves the rest to whoever looks at the pictures.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from tools.demo.performance import write_performance

from .blender import WalkedBlender, WalkError

Step = Callable[[WalkedBlender], None]
SPLASH_CLOSE = (40, 700)  # pixels: outside the splash, over the timeline's left end
MIDDLE = (500, 400)  # pixels: in the viewport, beside its panels
PHOTO = Path(__file__).resolve().parents[2] / "tests" / "data" / "photos" / "astronaut.jpg"
RENDER_SECONDS, POSES_SECONDS, FILE_SECONDS, ESCAPE_SECONDS, DROP_SECONDS = 400.0, 400.0, 300.0, 20.0, 60.0
SCROLLS = 60  # clicks of the wheel from the sidebar's upper panels to its end
HEAD = "head = next((o for o in bpy.context.scene.objects if 'jawOpen' in o.keys()), None)\n"
SELECT_RIG = """
rig = next(o for o in bpy.context.scene.objects if o.type == "ARMATURE")
bpy.ops.object.select_all(action="DESELECT")
rig.select_set(True)
bpy.context.view_layer.objects.active = rig
"""
_OPEN_PANELS = """
for name in {names}:
    panel = getattr(bpy.types, name)
    bpy.utils.unregister_class(panel)
    panel.bl_options = set()
    bpy.utils.register_class(panel)
"""
_LOOK_PANELS = ("GRMM_PT_hair", "GRMM_PT_light")
STRANDS = """
bpy.app.driver_namespace["walk"] = {name: getattr(head.grmm.hair, name) for name in ("groom", "curl", "melanin")}
head.grmm.hair.groom = "bob"
head.grmm.hair.curl = 0.5
head.grmm.hair.melanin = 0.3
"""
LAMP = """
from mathutils import Vector
head.grmm.lighting = "SCENE"
lamp = next(o for o in bpy.context.scene.objects if o.type == "LIGHT")
lamp.data.energy, lamp.data.shadow_soft_size = 30.0, 0.1
lamp.location = head.matrix_world.translation + head.matrix_world.to_3x3() @ Vector((0.6, -0.7, 0.5))
"""
_PLACE = """
part = next(part for part in area.regions if part.type == {kind!r})
result = [part.x, window.height - part.y - part.height, part.x + part.width, window.height - part.y]
"""
_KEYED = "result = [head is not None, bool(head and head.animation_data and head.animation_data.action)]"
STUDIO = """
head.grmm.lighting = "STUDIO"
for name, value in bpy.app.driver_namespace.get("walk", {}).items():
    setattr(head.grmm.hair, name, value)
"""
_STATUSES = """
import sys
result = next(module for name, module in sys.modules.items() if name.endswith("viewport.overlay")).statuses()
"""
_ADD = """
with bpy.context.temp_override(window=window, area=area, region=header):
    bpy.ops.grmm.add_head("INVOKE_DEFAULT", True)
"""
RIGS = "result = sum(o.type == 'ARMATURE' for o in bpy.context.scene.objects)"
_BEFORE_F12 = """
def note_drawn(*_):
    bpy.app.driver_namespace["walk drawn"] = True
if note_drawn.__name__ not in (handler.__name__ for handler in bpy.app.handlers.render_complete):
    bpy.app.handlers.render_complete.append(note_drawn)
bpy.app.driver_namespace["walk drawn"] = False
"""
_DRAWN = "result = bpy.app.driver_namespace['walk drawn'] and not bpy.app.is_job_running('RENDER')"


def start(blender: WalkedBlender) -> None:
    """Close the splash as a newcomer does."""
    blender.key("Escape")
    blender.click(*SPLASH_CLOSE)
    blender.picture("start")


def install(blender: WalkedBlender) -> None:
    """Install the zip from disk."""
    path = blender.inner(blender.shared / "grmm.zip")
    begin = time.monotonic()
    found = blender.run(
        f"bpy.ops.extensions.package_install_files(filepath={path!r}, repo='user_default', enable_on_install=True)\n"
        "result = [name for name in bpy.context.preferences.addons.keys() if name.endswith('grmm')]",
        300,
    )
    if not found:
        raise WalkError("the extension is not enabled after installing")
    blender.note(f"installing took {time.monotonic() - begin:.1f} s")
    blender.picture("installed")


def add_head(blender: WalkedBlender) -> None:
    """Add the default head into the startup scene, from the header's menu: the viewport looks at it."""
    blender.run(f"header = next(part for part in area.regions if part.type == 'HEADER')\n{_ADD}", 120)
    blender.picture("added", 10, settled=False)


def first_render(blender: WalkedBlender) -> None:
    """F12 and nothing else: how long the first picture takes, and a second one with everything loaded."""
    for title in ("first_render", "second_render"):
        begin = blender.processor_seconds()
        seconds = _f12(blender)
        used = blender.processor_seconds() - begin
        blender.note(f"from F12 to the picture: {seconds:.1f} s, {used:.1f} s of processors' time ({title})")
        blender.picture(title, 1)
        saved = blender.shared / f"{title}.png"
        blender.run(f"bpy.data.images['Render Result'].save_render({blender.inner(saved)!r})")
        blender.keep(saved, f"{title}_result")
        close_windows(blender)
    colors = blender.run(
        f"image = bpy.data.images.load({blender.inner(saved)!r})\nwidth, height = image.size\n"
        "at = 4 * (width * (height // 2) + width // 2)\nresult = list(image.pixels[at:at + 3])"
    )
    if not colors[0] > colors[2] > 0.05:
        raise WalkError(f"there is no face in the middle of the picture: {colors}")


def close_windows(blender: WalkedBlender) -> None:
    """Close the render's window."""
    blender.run(
        "for other in list(bpy.context.window_manager.windows)[1:]:\n"
        "    with bpy.context.temp_override(window=other):\n        bpy.ops.wm.window_close()"
    )


def _f12(blender: WalkedBlender) -> float:
    """Press F12 over the viewport, wait for the picture, and return the seconds."""
    blender.run(_BEFORE_F12)
    blender.move(*MIDDLE)
    begin = time.monotonic()
    blender.key("F12")
    while not blender.run(_DRAWN, RENDER_SECONDS):
        if time.monotonic() - begin > RENDER_SECONDS:
            raise WalkError("F12 gives no picture")
        time.sleep(0.1)
    return time.monotonic() - begin


def panels(blender: WalkedBlender) -> None:
    """Look at the head from the front, with the sidebar's GRMM tab open."""
    open_panels(blender, *_LOOK_PANELS, "GRMM_PT_fit", "GRMM_PT_recording")
    blender.run(SELECT_RIG + "bpy.ops.view3d.view_axis(type='FRONT')\nbpy.ops.view3d.view_selected()")
    blender.run("area.spaces.active.region_3d.view_distance *= 1.5\narea.spaces.active.show_region_ui = True")
    blender.picture("sidebar", 3)
    blender.run("next(part for part in area.regions if part.type == 'UI').active_panel_category = 'GRMM'\narea.tag_redraw()")
    blender.picture("panels", 3)


def look(blender: WalkedBlender) -> None:
    """Choose hair of strands and change it by sliders, let the scene's lamp light the head, press F12."""
    blender.run(HEAD + STRANDS)
    blender.picture("hair", 10)
    blender.run(HEAD + LAMP)
    blender.run("area.spaces.active.shading.type = 'RENDERED'")
    blender.picture("light", 15)
    blender.run("area.spaces.active.shading.type = 'SOLID'")
    scroll_sidebar(blender)
    blender.picture("look_panels", 3)
    _f12(blender)
    blender.picture("look_render", 2)
    close_windows(blender)
    blender.run(HEAD + STUDIO)


def open_panels(blender: WalkedBlender, *names: str) -> None:
    """Have panels, *Hair* and *Light* if none are named, stand open; before they are drawn for the first time."""
    blender.run(_OPEN_PANELS.format(names=names or _LOOK_PANELS))


def scroll_sidebar(blender: WalkedBlender) -> None:
    """Turn the wheel over the sidebar until its last panel is seen, and take the mouse away."""
    left, top, right, bottom = place(blender, "UI")
    for _ in range(SCROLLS):
        blender.click((left + right) // 2, (top + bottom) // 2, 5)
    blender.move(*MIDDLE)


def place(blender: WalkedBlender, kind: str) -> tuple[int, int, int, int]:
    """Left, top, right and bottom edge of a region of the viewport, pixels of the screen."""
    left, top, right, bottom = blender.run(_PLACE.format(kind=kind))
    return left, top, right, bottom


def sliders(blender: WalkedBlender) -> None:
    """Set sliders, as dragging them does."""
    blender.run(HEAD + "head['jawOpen'] = 0.6; head['mouthSmileLeft'] = 0.8; head.update_tag(); area.tag_redraw()")
    blender.picture("sliders", 5)


def random_and_reset(blender: WalkedBlender) -> None:
    """Press Random, then Reset: the viewport must follow by itself."""
    for name in ("random_expression", "reset"):
        blender.run(f"bpy.ops.grmm.{name}('INVOKE_DEFAULT', True)")
        blender.picture(name, 5)


def poses(blender: WalkedBlender) -> None:
    """Make the pose library beside Blender, then apply a pose."""
    blender.run("bpy.ops.grmm.create_pose_library('INVOKE_DEFAULT', True)")
    blender.picture("poses_being_made", 4, settled=False)
    deadline = time.monotonic() + POSES_SECONDS
    while blender.run("result = any(o.bl_idname == 'GRMM_OT_create_pose_library' for o in window.modal_operators)"):
        if time.monotonic() > deadline:
            blender.key("Escape")
            raise WalkError("the pose library is not finished")
        time.sleep(1.0)
    blender.run(
        "bpy.ops.grmm.apply_pose('EXEC_DEFAULT', True, pose='Laugh')\narea.spaces.active.show_region_asset_shelf = True"
    )
    blender.picture("pose_laugh", 5)
    blender.run("area.spaces.active.show_region_asset_shelf = False\nbpy.ops.grmm.reset('INVOKE_DEFAULT', True)")


def views(blender: WalkedBlender) -> None:
    """Orthographic view, pose mode, rendered view."""
    blender.run("area.spaces.active.region_3d.view_perspective = 'ORTHO'")
    blender.picture("orthographic", 4)
    blender.run("area.spaces.active.region_3d.view_perspective = 'PERSP'\nbpy.ops.object.mode_set(mode='POSE')")
    blender.picture("pose_mode", 4)
    blender.run("bpy.ops.object.mode_set(mode='OBJECT')\narea.spaces.active.shading.type = 'RENDERED'")
    blender.picture("rendered_view", 6)
    blender.run("area.spaces.active.shading.type = 'SOLID'")


def performance(blender: WalkedBlender) -> None:
    """Drop a recording on the viewport, and play it."""
    path = blender.shared / "performance.json"
    write_performance(path)
    blender.run(SELECT_RIG)
    blender.drop(blender.inner(path), *MIDDLE)
    blender.picture("performance_dropped", 2, settled=False)
    deadline = time.monotonic() + DROP_SECONDS
    while not blender.run(HEAD + _KEYED)[1]:
        if time.monotonic() > deadline:
            raise WalkError("a recording that is dropped does nothing")
        time.sleep(0.5)
    blender.run("bpy.context.scene.frame_set(26)")
    blender.picture("performance", 4)
    blender.run("bpy.ops.screen.animation_play()")
    blender.picture("playing", 12, settled=False)
    blender.run("bpy.ops.screen.animation_cancel(restore_frame=False)")
    blender.picture("stopped", 4)


def escape(blender: WalkedBlender) -> None:
    """Ctrl-F12, then Escape: the render stops and the last picture stays."""
    folder = blender.inner(blender.shared / "frames_")
    blender.run(f"bpy.context.scene.render.filepath = {folder!r}\nbpy.context.scene.render.resolution_percentage = 50")
    blender.move(*MIDDLE)
    blender.key("ctrl", "F12")
    blender.picture("animation", 8, settled=False)
    begin = time.monotonic()
    blender.key("Escape")
    while blender.run("result = bpy.app.is_job_running('RENDER')"):
        if time.monotonic() - begin > ESCAPE_SECONDS:
            raise WalkError("Escape does not stop the render")
        time.sleep(0.2)
    blender.note(f"from Escape to the end of the render: {time.monotonic() - begin:.1f} s")
    blender.picture("escaped", 2)
    close_windows(blender)


def photos(blender: WalkedBlender) -> None:
    """Choose a photo: without torch one sentence says what is needed."""
    path = blender.inner(blender.bring(PHOTO, PHOTO.name))
    blender.run(f"bpy.ops.grmm.fit_add_photos(filepath={path!r})")
    try:
        blender.run("bpy.ops.grmm.fit_photos('EXEC_DEFAULT')")
    except WalkError as error:
        blender.note(f"Make Avatar says: {str(error).strip().splitlines()[-1]}")
    blender.picture("photos", 3)
    (blender.shared / "person.grmm").write_bytes(b"")
    made = blender.inner(blender.shared / "person.grmm")
    blender.run(f"bpy.context.window_manager.grmm_fit.output = {made!r}\nbpy.ops.grmm.fit_photos('INVOKE_DEFAULT', True)")
    blender.move(MIDDLE[0] + 20, MIDDLE[1])  # a question that no click called is drawn once the mouse moves
    blender.picture("replace_avatar", 3, settled=False)  # asked before an avatar that is there is replaced
    blender.key("Escape")
    blender.run("bpy.context.window_manager.grmm_fit.output = ''")


def undo(blender: WalkedBlender) -> None:
    """Ctrl-Z, which takes the recording back, then Ctrl-Shift-Z; the head is there all through."""
    blender.move(*MIDDLE)
    blender.key("ctrl", "z")
    blender.picture("undone", 4)
    has_head, has_keys = blender.run(HEAD + _KEYED)
    blender.key("ctrl", "shift", "z")
    blender.picture("redone", 4)
    again = blender.run(HEAD + _KEYED)
    if not has_head or has_keys or again != [True, True]:
        raise WalkError(f"head and keys after undo are {has_head} and {has_keys}, after redo {again}")


def save_and_reopen(blender: WalkedBlender) -> None:
    """Save, open again: the head is there and drawn."""
    path = blender.inner(blender.shared / "walk.blend")
    blender.run(f"bpy.ops.wm.save_as_mainfile(filepath={path!r})", FILE_SECONDS)
    blender.run(f"bpy.ops.wm.open_mainfile(filepath={path!r})", FILE_SECONDS)
    blender.picture("reopened", 8)


def eevee(blender: WalkedBlender) -> None:
    """Another engine: the painted mesh, and a word about it."""
    close_windows(blender)
    blender.run("bpy.context.scene.render.engine = 'BLENDER_EEVEE'\narea.spaces.active.shading.type = 'RENDERED'")
    blender.picture("eevee", 60)
    blender.run("bpy.context.scene.render.engine = 'GRMM'\narea.spaces.active.shading.type = 'SOLID'")


def drop(blender: WalkedBlender) -> None:
    """Drop another avatar's file into the viewport."""
    path = blender.run("import importlib, sys\nname = next(n for n in sys.modules if n.endswith('grmm_core.avatar.library'))\n"
                       "result = str(sys.modules[name].library_path('beard'))")  # fmt: skip
    blender.run(
        "bpy.data.objects['Cube'].hide_set(True)\n"
        "bpy.context.scene.cursor.location = (0.4, 0.0, 1.0)\nbpy.ops.object.select_all(action='DESELECT')"
    )
    rigs = blender.run(RIGS)
    blender.drop(path, *MIDDLE)
    deadline = time.monotonic() + DROP_SECONDS
    while blender.run(RIGS) == rigs:
        if time.monotonic() > deadline:
            raise WalkError("an avatar's file that is dropped does nothing")
        time.sleep(0.5)
    blender.run("bpy.ops.view3d.view_selected()\narea.spaces.active.region_3d.view_distance *= 3.0")
    blender.picture("dropped", 8)


def delete(blender: WalkedBlender) -> None:
    """Delete the head that was added last: its rig goes with it."""
    blender.move(*MIDDLE)
    blender.key("Delete")
    blender.picture("deleted", 4)
    left = blender.run("result = [o.name for o in bpy.context.scene.objects if o.type in ('ARMATURE', 'MESH')]")
    if any("Bearded" in name for name in left):
        raise WalkError(f"after deleting these are left: {left}")


def disable_and_enable(blender: WalkedBlender) -> None:
    """Disable the extension and enable it again."""
    name = blender.run("result = next(name for name in bpy.context.preferences.addons.keys() if name.endswith('grmm'))")
    blender.run(f"bpy.ops.preferences.addon_disable(module={name!r})")
    blender.picture("disabled", 2)
    blender.run(f"bpy.ops.preferences.addon_enable(module={name!r})")
    blender.picture("enabled", 8)
    said = blender.run(_STATUSES)
    if said:
        raise WalkError(f"after disabling and enabling the viewport says: {said}")
