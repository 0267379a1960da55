"""The walk's step of a video: dropped on a head, followed beside Blender, keyed, undone, and cancelled."""

from __future__ import annotations

import time

from tools.video_figures import FPS, filmed, played, write_video

from .blender import WalkedBlender, WalkError
from .steps import HEAD, MIDDLE, SELECT_RIG, scroll_sidebar

SECONDS, FOLLOW_SECONDS = 2.0, 600.0
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
    path = blender.shared / "speaking.mp4"
    performance = played()
    write_video(path, filmed("library:bun", performance)[: round(SECONDS * FPS)], FPS)
    inner = blender.inner(path)
    blender.run(SELECT_RIG)
    if not blender.torch_python:
        blender.run(f"bpy.ops.grmm.import_video('EXEC_DEFAULT', filepath={inner!r})")
        blender.picture("video_without_torch", 3)
        return
    blender.run(_PREFERENCES.format(blender.torch_python))
    before = blender.run(_ACTION)
    blender.drop(inner, *MIDDLE)
    blender.picture("video_dropped", 2, settled=False)
    if not blender.run(_STATE)[0]:  # Blender asks which of its own imports or ours is meant
        blender.key("Escape")
        blender.run(SELECT_RIG + f"bpy.ops.grmm.import_video('EXEC_DEFAULT', filepath={inner!r})")
    begin = time.monotonic()
    scroll_sidebar(blender)
    blender.picture("video_followed", 3, settled=False)
    while (state := blender.run(_STATE))[0]:
        if time.monotonic() - begin > FOLLOW_SECONDS:
            raise WalkError("the video is not followed")
        time.sleep(1.0)
    blender.note(f"{SECONDS:g} s of video were followed in {time.monotonic() - begin:.0f} s: {state[1]}")
    if blender.run(_ACTION) != path.stem:
        raise WalkError(f"the head has the action {blender.run(_ACTION)!r}: {state[1]}")
    blender.run("bpy.context.scene.frame_set(20)")
    blender.picture("video_keyed", 4)
    blender.move(*MIDDLE)
    blender.key("ctrl", "z")
    if blender.run(_ACTION) != before:
        raise WalkError(f"undo leaves the action {blender.run(_ACTION)!r}, not {before!r}")
    blender.run(SELECT_RIG + f"bpy.ops.grmm.import_video('EXEC_DEFAULT', filepath={inner!r})\nbpy.ops.grmm.cancel_recording()")
    while blender.run(_STATE)[0]:
        time.sleep(0.5)
    blender.picture("video_cancelled", 3)
    note = blender.run(_STATE)[1]
    if "cancelled" not in note:
        raise WalkError(f"a cancelled capture says {note!r}")
    blender.run(_PREFERENCES.format(""))
