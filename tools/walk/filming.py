"""The walk's steps of recordings: dropped on a head, worked on beside Blender, keyed, undone, and cancelled."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

from tools.video_figures import FPS, filmed, played, write_video

from .blender import WalkedBlender, WalkError
from .steps import HEAD, MIDDLE, SELECT_RIG, scroll_sidebar

SECONDS, WORK_SECONDS = 2.0, 600.0
VOICE = Path(__file__).resolve().parents[2] / "tests" / "data" / "voice" / "voice.ogg"
_NEAR = """
bpy.ops.view3d.view_axis(type="FRONT")
bpy.ops.view3d.view_selected()
area.spaces.active.region_3d.view_distance *= 1.5
"""
_STATE = """
import sys
watch = next(module for name, module in sys.modules.items() if name.endswith("grmm_blender.recordings.watch"))
result = [watch.is_running(), watch.note()]
"""
_ACTION = HEAD + "data = head.animation_data\nresult = data.action.name if data is not None and data.action is not None else ''"
_PREFERENCES = """
name = next(name for name in bpy.context.preferences.addons.keys() if name.endswith("grmm"))
bpy.context.preferences.addons[name].preferences.worker_python = {!r}
"""


def video(blender: WalkedBlender) -> None:
    """Drop a video of an avatar on the head, where a Python with torch is given; else a sentence says what is needed."""
    path = blender.shared / "filmed.mp4"
    performance = played()
    write_video(path, filmed("library:bun", performance)[: round(SECONDS * FPS)], FPS)
    _take(blender, path, "import_video", "video")


def voice(blender: WalkedBlender) -> None:
    """Drop a recorded voice on the head, likewise."""
    path = blender.shared / "spoken.ogg"
    shutil.copy(VOICE, path)
    _take(blender, path, "import_voice", "voice")


def _take(blender: WalkedBlender, path: Path, operator: str, name: str) -> None:
    """Drop a recording, see the head keyed, undo that, and cancel another go."""
    inner = blender.inner(path)
    call = f"bpy.ops.grmm.{operator}('EXEC_DEFAULT', filepath={inner!r})\n"
    blender.run(SELECT_RIG)
    if not blender.torch_python:
        try:
            blender.run(call)
        except WalkError as error:
            blender.note(f"without torch {operator} says: {str(error).strip().splitlines()[-1]}")
        blender.picture(f"{name}_without_torch", 3)
        return
    blender.run(_PREFERENCES.format(blender.torch_python))
    blender.run(_NEAR)
    scroll_sidebar(blender)  # now: software draws for longer than a voice is worked on
    before = blender.run(_ACTION)
    blender.drop(inner, *MIDDLE)
    blender.picture(f"{name}_dropped", 2, settled=False)
    begin = time.monotonic()
    if blender.run(_ACTION) == before and not blender.run(_STATE)[0]:  # Blender asks which of its own imports or ours is meant
        blender.key("Escape")
        blender.run(SELECT_RIG + call)
        begin = time.monotonic()
    blender.picture(f"{name}_worked_on", 3, settled=False)
    note = _wait_for_note(blender, name)
    blender.note(f"the {name} was worked on for {time.monotonic() - begin:.0f} s: {note}")
    if blender.run(_ACTION) != path.stem:
        raise WalkError(f"the head has the action {blender.run(_ACTION)!r}: {note}")
    scroll_sidebar(blender)  # to what it says
    for frame in (20, 34):
        blender.run(f"bpy.context.scene.frame_set({frame})")
        blender.picture(f"{name}_keyed_{frame}", 4)
    blender.move(*MIDDLE)
    blender.key("ctrl", "z")
    if blender.run(_ACTION) != before:
        raise WalkError(f"undo leaves the action {blender.run(_ACTION)!r}, not {before!r}")
    blender.run(SELECT_RIG + call + "bpy.ops.grmm.cancel_recording()")
    note = _wait_for_note(blender, name)
    blender.picture(f"{name}_cancelled", 3)
    if "cancelled" not in note:
        raise WalkError(f"a cancelled {name} says {note!r}")
    blender.run(_PREFERENCES.format(""))


def _wait_for_note(blender: WalkedBlender, name: str) -> str:
    """Wait until a recording has been worked on and Blender's timer has seen it; returns what the panel says."""
    deadline = time.monotonic() + WORK_SECONDS
    while True:
        running, note = blender.run(_STATE)
        if note and not running:
            return str(note)
        if time.monotonic() > deadline:
            raise WalkError(f"the {name} is not finished")
        time.sleep(0.5)
