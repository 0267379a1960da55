"""Steps of the walk beyond the first look: moving the rig, choosing a runtime, options, turntable, motion, a photo's avatar."""

from __future__ import annotations

import shutil
import time

from grmm_core.formats import format_to_read, format_to_write
from tools.demo.performance import write_performance

from .blender import WalkedBlender, WalkError
from .steps import HEAD, MIDDLE, PHOTO, SELECT_RIG, close_windows, scroll_sidebar

FIT_SECONDS, WRITE_SECONDS, BROWSER_SECONDS = 1200.0, 300.0, 60.0
_RIG_PLACE = SELECT_RIG + "result = list(rig.location)"
_STARTED_ON = """
cube = bpy.data.objects["Cube"]
result = min((rig.children[0].matrix_world @ v.co).z for v in rig.children[0].data.vertices) - cube.dimensions.z / 2
"""
_PREFERENCES = """
name = next(name for name in bpy.context.preferences.addons.keys() if name.endswith("grmm"))
chosen = bpy.context.preferences.addons[name].preferences
"""
_STATUS = """
import sys
host = next(module for name, module in sys.modules.items() if name.endswith("grmm_blender.session_host"))
status = host.runtime_status()
result = [status.available, status.message]
"""
_PLAYED = "scene = bpy.context.scene\nresult = [scene.frame_start, scene.frame_end, scene.camera.name]"
_EYE = SELECT_RIG + "result = [list(rig.pose.bones[name].matrix.col[1]) for name in ('left_eye', 'right_eye')]"
_TARGET = "target = next(o for o in bpy.data.objects if o.name.endswith('Look At'))\n"
_CAMERAS = "result = sorted(o.name for o in bpy.context.scene.objects if o.type == 'CAMERA' and o.name.endswith('photo'))"
_FIT = """
import sys
watch = next(module for name, module in sys.modules.items() if name.endswith("fitting.watch"))
done = watch.job().status.progress if watch.is_running() else None
result = [done is not None, *((done.picture, done.fraction, done.seconds_left) if done else ("", 1.0, 0.0))]
"""


_AT_WORK = "result = any(o.bl_idname.startswith('GRMM_OT_') for o in window.modal_operators)"
_WRITTEN = (  # operator, file or folder, options
    ("contact_sheet", "sheet.png", "content='VIEWS', count=2"), ("export_splats", "splats_####.ply", "pose='SEQUENCE'"),
    ("export_performance", "take.csv", ""), ("export_gaussian_avatar", "", ""), ("save_avatar", "saved.grmm", ""),
)  # fmt: skip
_BROWSER = """
result = any(area.type == "FILE_BROWSER" and area.spaces.active.params is not None
             for other in bpy.context.window_manager.windows for area in other.screen.areas)
"""
CHOOSE = """
for other in bpy.context.window_manager.windows:
    for space in (area for area in other.screen.areas if area.type == "FILE_BROWSER"):
        space.spaces.active.params.directory = {folder!r}.encode()
        if {name!r}:
            space.spaces.active.params.filename = {name!r}
"""


def drag_rig(blender: WalkedBlender) -> None:
    """Press G right after adding, move the mouse, and look: rig, mesh and splats go along, and Escape puts them back."""
    if blender.run(SELECT_RIG + _STARTED_ON) < -1e-3:
        raise WalkError("the new head stands inside the default cube")
    blender.run("bpy.context.view_layer.objects.active.select_set(True)")
    before = blender.run(_RIG_PLACE)
    blender.move(*MIDDLE)
    blender.key("g")
    for step in range(1, 7):
        blender.move(MIDDLE[0] + 40 * step, MIDDLE[1])
    blender.picture("dragged_at_once", 0.2, settled=False)
    blender.picture("dragged", 1.5, settled=False)
    moved = blender.run(_RIG_PLACE)
    blender.key("Escape")
    if moved == before:
        raise WalkError("G does not move the new head")


def choose_runtime(blender: WalkedBlender) -> None:
    """Choose a path that does not exist, then Blender's own Python: both are said at once, and splats come back."""
    blender.run("bpy.ops.screen.userpref_show(section='ADDONS')\nbpy.context.window_manager.addon_search = 'GRMM'")
    blender.run(_PREFERENCES + "bpy.ops.preferences.addon_expand(module=name)\nchosen.worker_python = '/nowhere/python'")
    blender.picture("no_such_python", 3)
    if blender.run(_STATUS)[0]:
        raise WalkError("a Python that does not exist counts as one")
    blender.run(_PREFERENCES + "import sys\nchosen.worker_python = sys.executable")
    blender.picture("python_chosen", 3)
    available, message = blender.run(_STATUS)
    if not available or "worker" not in message:
        raise WalkError(f"the Python that was chosen is not used: {message}")
    blender.run(_PREFERENCES + "chosen.worker_python = ''")
    close_windows(blender)
    blender.picture("runtime_as_before", 3)


def import_options(blender: WalkedBlender) -> None:
    """Open the file browser of *Import Performance* and look at its options."""
    blender.run(SELECT_RIG + "bpy.ops.grmm.import_performance('INVOKE_DEFAULT')")
    wait_for_browser(blender)
    blender.picture("import_options", 10, settled=False)  # software draws the viewport first
    blender.key("Escape")
    wait_for_browser(blender, there=False)


def recordings(blender: WalkedBlender) -> None:
    """Choose a video, a sound and a Live Link Face file in the browser of *File > Import*: two sentences, then keys."""
    source = blender.shared / "recording.json"
    write_performance(source)
    table = blender.shared / "live_link.csv"
    format_to_write(table, "performance").write(table, format_to_read(source, "performance").read(source))
    for name, content in (("video.mp4", b"\0\0\0\x18ftypmp42"), ("speech.wav", b"RIFF\x24\0\0\0WAVEfmt ")):
        (blender.shared / name).write_bytes(content)
    for name in ("video.mp4", "speech.wav", table.name):
        blender.run(SELECT_RIG + "bpy.ops.grmm.import_performance('INVOKE_DEFAULT', True)")
        wait_for_browser(blender)
        blender.run(CHOOSE.format(folder=blender.inner(blender.shared), name=name))
        blender.move(*MIDDLE)
        blender.key("Return")
        wait_for_browser(blender, there=False)
        blender.picture(f"import_{name.partition('.')[2]}", 8, settled=False)
        blender.key("Escape")
    action = blender.run(HEAD + "result = head.animation_data.action.name")
    if not action.startswith(table.stem):
        raise WalkError(f"the action is called {action} after {table.name} is read")


def written(blender: WalkedBlender) -> None:
    """Write files through their browsers (GaussianAvatars need a FLAME file), draw a person, make curves of hair."""
    folder = blender.shared / "written"
    folder.mkdir()
    blender.run("bpy.context.scene.frame_start, bpy.context.scene.frame_end = 1, 3")
    for operator, name, options in _WRITTEN:
        _write(blender, operator, options, blender.inner(folder), name)
        if not name:  # a folder is asked for
            blender.picture(operator, 1, settled=False)
        _wait_for_operators(blender)
        found = sorted(path.name for path in folder.rglob("*") if path.is_file())
        if not found and name:
            raise WalkError(f"{operator} writes nothing")
        blender.note(f"{operator} writes {', '.join(found) or 'nothing'}")
        if "SEQUENCE" in options:  # no browser knows these files: it must be asked before they are replaced
            before = [(folder / each).stat().st_mtime_ns for each in found]
            _write(blender, operator, options, blender.inner(folder), name)
            blender.picture("replace_files", 5, settled=False)
            blender.key("Escape")
            _wait_for_operators(blender)
            if [(folder / each).stat().st_mtime_ns for each in found] != before:
                raise WalkError("a sequence is replaced unasked")
        shutil.rmtree(folder)
        folder.mkdir()
    blender.run(SELECT_RIG + "bpy.ops.grmm.random_identity('INVOKE_DEFAULT', True)")
    blender.picture("random_identity", 3)
    blender.run(SELECT_RIG + "bpy.ops.grmm.hair_as_curves('INVOKE_DEFAULT', True)")
    _wait_for_operators(blender)
    blender.picture("hair_as_curves", 3)
    if blender.run("result = bpy.context.mode") != "SCULPT_CURVES":
        raise WalkError("Edit as Curves does not end in sculpt mode")
    blender.run("bpy.ops.object.mode_set(mode='OBJECT')")
    for _ in range(2):
        blender.run("bpy.ops.ed.undo()")


def _write(blender: WalkedBlender, operator: str, options: str, folder: str, name: str) -> None:
    """Start an operator that writes, and answer its browser."""
    blender.run(SELECT_RIG + f"bpy.ops.grmm.{operator}('INVOKE_DEFAULT', True, {options})")
    answer_browser(blender, folder, name)
    time.sleep(1.0)


def answer_browser(blender: WalkedBlender, folder: str, name: str) -> None:
    """Choose a file in the browser that is opening."""
    wait_for_browser(blender)
    blender.run(CHOOSE.format(folder=folder, name=name))
    time.sleep(1.0)
    blender.move(*MIDDLE)
    blender.key("Return")
    wait_for_browser(blender, there=False)


def wait_for_browser(blender: WalkedBlender, there: bool = True) -> None:
    """Wait until a file browser is open, or no longer."""
    deadline = time.monotonic() + BROWSER_SECONDS
    while blender.run(_BROWSER) != there:
        if time.monotonic() > deadline:
            raise WalkError(f"a file browser does not {'open' if there else 'close'}")
        time.sleep(0.2)
    time.sleep(1.0)


def _wait_for_operators(blender: WalkedBlender) -> None:
    deadline = time.monotonic() + WRITE_SECONDS
    while blender.run(_AT_WORK):
        if time.monotonic() > deadline:
            raise WalkError("an operator does not end")
        time.sleep(0.5)


def turntable(blender: WalkedBlender) -> None:
    """Add a turntable to a scene that plays a performance: range and camera stay."""
    before = blender.run(_PLAYED)
    blender.run(SELECT_RIG + "bpy.ops.grmm.turntable('INVOKE_DEFAULT', True)")
    blender.picture("turntable", 3)
    if blender.run(_PLAYED) != before:
        raise WalkError(f"a turntable changes the scene of a performance: {before} became {blender.run(_PLAYED)}")
    blender.run("for obj in [o for o in bpy.data.objects if 'grmm_turntable' in o]:\n    bpy.data.objects.remove(obj)")


def motion(blender: WalkedBlender) -> None:
    """Give the rig a target to look at, blinks, breath and bones on the face; select all controls; take them away again."""
    kinds = ("look", "blink", "breath", "control")
    for kind in kinds:
        blender.run(SELECT_RIG + f"bpy.ops.grmm.add_motion('INVOKE_DEFAULT', True, feature={kind!r})")
    before = blender.run(_EYE)
    blender.run(_TARGET + "target.location.x += 0.5")
    blender.picture("look_at", 3)
    if blender.run(_EYE) == before:
        raise WalkError("the eyes do not follow their target")
    chosen = "result = bpy.context.scene.keying_sets_all.active.bl_idname"
    if blender.run(SELECT_RIG + f"bpy.ops.grmm.select_controls('INVOKE_DEFAULT', True)\n{chosen}") != "GRMM_KSI_controls":
        raise WalkError("Select All Controls chooses no keying set")
    blender.run(SELECT_RIG + "bpy.ops.object.mode_set(mode='POSE')")
    blender.picture("all_controls", 3)
    blender.run("bpy.ops.object.mode_set(mode='OBJECT')")
    for kind in kinds:
        blender.run(SELECT_RIG + f"bpy.ops.grmm.remove_motion('INVOKE_DEFAULT', True, feature={kind!r})")


def bare_mesh(blender: WalkedBlender) -> None:
    """Switch splats off: what a Blender without any runtime shows."""
    blender.run("bpy.context.scene.grmm_viewport.use_splats = False")
    blender.picture("bare_mesh", 2)
    blender.run("bpy.context.scene.grmm_viewport.use_splats = True")


def fit(blender: WalkedBlender) -> None:
    """Make an avatar of a photo where a Python with torch is given: its picture while it runs, and the camera after undo."""
    if not blender.torch_python:
        return
    blender.run(SELECT_RIG)
    blender.run(_PREFERENCES + f"chosen.worker_python = {blender.torch_python!r}")
    path = blender.inner(blender.bring(PHOTO, PHOTO.name))
    blender.run(f"bpy.ops.grmm.fit_add_photos(filepath={path!r})")
    blender.run("bpy.context.window_manager.grmm_fit.preset = 'fast'\nbpy.ops.grmm.fit_photos('EXEC_DEFAULT')")
    begin, shown, told = time.monotonic(), False, []
    while (state := blender.run(_FIT))[0]:
        spent, left = time.monotonic() - begin, state[3]
        if left == left:  # a number
            told.append((spent, state[2], left))
        if state[1] and not shown:
            shown = True
            scroll_sidebar(blender)
            blender.picture("fit_preview", 2, settled=False)
        if spent > FIT_SECONDS:
            raise WalkError("the photo does not become an avatar")
        time.sleep(2.0)
    blender.note(f"the photo became an avatar in {time.monotonic() - begin:.0f} s")
    for spent, share, left in told[:: max(1, len(told) // 8)]:
        blender.note(f"after {spent:.0f} s ({share:.0%} done) it said {left:.0f} s more: {spent + left:.0f} s in all")
    blender.picture("fitted", 5)
    blender.run("bpy.ops.grmm.fit_photos('INVOKE_DEFAULT', True)")
    blender.move(MIDDLE[0] + 20, MIDDLE[1])
    blender.picture("fit_again", 3, settled=False)  # asked, for the avatar of a moment ago is there
    blender.key("Escape")
    if blender.run(_FIT)[0]:
        raise WalkError("a second Make Avatar does not ask before it replaces the first one's file")
    cameras = blender.run(_CAMERAS)
    blender.run(HEAD + "bpy.ops.ed.undo_push(message='walk')\nhead['jawOpen'] = 0.5\nbpy.ops.ed.undo_push(message='walk')")
    blender.move(*MIDDLE)
    blender.key("ctrl", "z")
    blender.picture("fit_undone", 4)
    if not cameras or blender.run(_CAMERAS) != cameras:
        raise WalkError(f"the photo's camera does not survive undo: {cameras} became {blender.run(_CAMERAS)}")
    blender.run(_PREFERENCES + "chosen.worker_python = ''")
