"""Performances from videos inside Blender: video_import.py FOLDER, with speech.mp4 (with sound) and text.mp4.

The first capture is whole; those after it are stand-ins for processes that have ended in other ways.
"""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import bpy
from rig_support import fresh_head, without_detail
from support import module, report

folder = Path(sys.argv[1])
actions = module("grmm_blender.rig.actions")
watch = module("grmm_blender.video.watch")
SAYS = "import json, sys; print(json.dumps({event})); sys.exit({code})"


def curves_of(obj) -> dict:
    return {(curve.data_path, curve.array_index): curve for curve in actions.action_curves(obj)}


def handles(strip) -> list[int]:
    """Where a strip is heard from, and where its file begins."""
    names = ("left_handle", "content_start") if hasattr(strip, "left_handle") else ("frame_final_start", "frame_start")
    return [round(getattr(strip, name)) for name in names]


def said_by(operator) -> str:
    try:
        operator()
    except (RuntimeError, module("grmm_core.errors").GrmmError) as error:
        return str(error)
    return ""


def imported() -> dict:
    poll_without = bpy.ops.grmm.import_video.poll()
    avatar = without_detail(fresh_head())
    scene = bpy.context.scene
    scene.render.fps = 15
    bpy.ops.grmm.import_video(
        filepath=str(folder / "speech.mp4"), start=11, first=0.2, keys="FRAMES", smoothing=0.0, neutral="NONE"
    )
    head, rig = curves_of(avatar.object), curves_of(avatar.armature)
    jaw = next(curve for (path, _), curve in head.items() if "jawOpen" in path)
    turn = rig['pose.bones["neck"].rotation_euler', 1]
    strips = scene.sequence_editor.strips
    return {
        "poll_without": poll_without,
        "jaw": [jaw.evaluate(11 + frame) for frame in range(12)],
        "turn": [turn.evaluate(11 + frame) for frame in range(12)],
        "range": [scene.frame_start, scene.frame_end],
        "action": avatar.object.animation_data.action.name,
        "note": watch.note(),
        "sound": [[strip.name, *handles(strip)] for strip in strips],
    }


def job_that_says(event: dict, code: int = 0):
    """A job that follows a process which writes one event."""
    process = subprocess.Popen(
        [sys.executable, "-c", SAYS.format(event=event, code=code)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    job = module("grmm_blender.video.job").TrackJob(process)
    job.wait(60)
    return job


def ended(event: dict, code: int = 0, before=None) -> dict:
    """What is said of a capture that ended with an event; `before` happens while it runs."""
    avatar = fresh_head()
    request = module("grmm_core.video.request").TrackRequest(folder / "speech.mp4", folder / "take.json")
    options = module("grmm_blender.performance").ImportOptions()
    watch.start(job_that_says(event, code), request, avatar.object, options, set_range=True, sound=False)
    said = {}
    if before is not None:
        said["before"] = before(avatar)
    said["message"] = said_by(lambda: watch.finish(bpy.context))
    said["note"] = watch.note()
    return said


def remove(avatar) -> str:
    for obj in (avatar.object, avatar.armature):
        bpy.data.objects.remove(obj)
    return "removed"


def open_another(_avatar) -> str:
    bpy.ops.wm.read_homefile(use_empty=True)
    return "opened"


def errors() -> dict:
    avatar = fresh_head()
    missing = said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "none.mp4")))
    text = said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "text.mp4")))
    backwards = said_by(lambda: bpy.ops.grmm.import_video(filepath=str(folder / "speech.mp4"), first=3.0, last=1.0))
    return {"missing": missing, "text": text, "backwards": backwards, "keyed": len(curves_of(avatar.object))}


done = {"event": "done", "performance": str(folder / "take.json")}
report(
    imported=imported(),
    errors=errors(),
    gone=ended(done, before=remove),
    another=ended(done, before=open_another),
    nameless=ended({"event": "done"}),
    failed=ended({"event": "error", "message": "No face was found in speech.mp4."}, 1),
)
