"""Avatars from photos inside Blender: the job's status, looking at photos, errors; with "fit" also a whole fit.

Arguments: folder with face.png and text.jpg, "look" or "fit".
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import bpy
from support import empty_scene, enable, module, report

EVENTS = """
import json, sys, time
for event in {events}:
    print(json.dumps(event) if isinstance(event, dict) else event, flush=True)
{ending}
"""
PROGRESS = {"event": "progress", "stage": "codes", "fraction": 0.35, "seconds_left": 12.0, "picture": "p.png"}


SAYS_MORE = """
import signal
def stop(*_):
    print(json.dumps({"event": "error", "message": "The fit was cancelled; it can be resumed."}), flush=True)
    sys.exit(1)
signal.signal(signal.SIGTERM, stop)
print(json.dumps({"event": "progress", "stage": "codes", "fraction": 0.4, "picture": "ready.png"}), flush=True)
time.sleep(60)
"""


def job_of(events: list, ending: str = ""):
    """A job that follows a process which writes these lines."""
    process = subprocess.Popen(
        [sys.executable, "-c", EVENTS.format(events=events, ending=ending)],
        stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    return module("grmm_blender.fitting.job").FitJob(process)


def statuses() -> dict[str, object]:
    faces = {"event": "faces", "photo": "a.jpg", "boxes": [[1, 2, 3, 4], [5, 6, 7, 8]], "picture": "f.png"}
    done = job_of([faces, "noise of a library", PROGRESS, {"event": "done", "avatar": "a.grmm"}]).wait(60)
    failed = job_of([{"event": "error", "message": "No face was found."}], "sys.exit(1)").wait(60)
    crashed = job_of([PROGRESS], "import os; os.abort()").wait(60)
    lacking = job_of([], "import nothing_of_this_name").wait(60)
    silent = job_of([]).wait(60)
    nameless = job_of([{"event": "done"}]).wait(60)
    garbage = job_of([
        "\\x00\\xff not json {", [1, 2], "null", {"event": "progress", "stage": 7, "fraction": "much", "seconds_left": "soon"},
        '{"event": "progress", "stage": "codes", "fraction": NaN}', {"event": "faces", "boxes": 3}, {"event": "error"},
        {}, {"event": "done", "avatar": "b.grmm"},
    ]).wait(60)  # fmt: skip
    stopped = job_of([], "print('Illegal instruction of some library', file=sys.stderr); sys.exit(3)").wait(60)
    slow = job_of([PROGRESS], "time.sleep(60)")
    slow.cancel()
    cancelled = slow.wait(60)
    polite = job_of([], SAYS_MORE)
    while polite.running and polite.status.progress.picture != "ready.png":
        time.sleep(0.01)
    polite.cancel()
    resumable = polite.wait(60)
    fell = job_of([PROGRESS, PROGRESS | {"fraction": 0.1}]).wait(60)
    return {
        "done": (done.state, done.avatar, done.progress.fraction, *found(done), done.progress.picture),
        "looked": job_of([faces, {"event": "done", "pictures": ["f.png"]}]).wait(60).state,
        "fell": fell.progress.fraction,
        "failed": (failed.state, failed.message),
        "crashed": (crashed.state, crashed.message, crashed.progress.fraction),
        "lacking": (lacking.state, lacking.message),
        "silent": (silent.state, silent.message),
        "nameless": (nameless.state, nameless.message),
        "garbage": (garbage.state, garbage.avatar, garbage.progress.fraction),
        "stopped": (stopped.state, stopped.message),
        "cancelled": (cancelled.state, cancelled.message),
        "resumable": (resumable.state, resumable.message),
    }


def found(status) -> list[list[object]]:
    return [[one.photo, one.count, one.picture] for one in status.faces]


def real_cancel(folder: Path) -> tuple[str, str]:
    """Cancel a fit that has hardly begun: the real command, whatever it is doing then."""
    jobs, host = module("grmm_blender.fitting.job"), module("grmm_blender.session_host")
    request = module("grmm_core.fitting.request").FitRequest((folder / "face.png",), folder / "never.grmm")
    job = jobs.FitJob.start(host.job_python(), request)
    time.sleep(1.0)
    job.cancel()
    ended = job.wait(60)
    return ended.state, ended.message


def look(folder: Path) -> dict[str, object]:
    chosen = bpy.context.window_manager.grmm_fit
    said = {"poll_without": bpy.ops.grmm.fit_find_faces.poll()}
    bpy.ops.grmm.fit_add_photos(filepath=str(folder / "face.png"))
    bpy.ops.grmm.fit_add_photos(filepath=str(folder / "face.png"))
    said["photos"] = len(chosen.photos)
    bpy.ops.grmm.fit_find_faces()
    photo = chosen.photos[0]
    said |= {"faces": photo.faces, "found": Path(photo.faces_picture).stat().st_size}
    photo.faces, photo.faces_picture, chosen.face = 0, "", 5
    said["wrong_face"] = message_of(bpy.ops.grmm.fit_find_faces)
    said |= {"faces_then": photo.faces, "found_then": Path(photo.faces_picture).stat().st_size}
    chosen.face = 1
    bpy.ops.grmm.fit_add_photos(filepath=str(folder / "text.jpg"))
    said["broken"] = message_of(bpy.ops.grmm.fit_find_faces)
    bpy.ops.grmm.fit_remove_photo()
    chosen.output = str(folder / "missing" / "a.grmm")
    said["no_folder"] = message_of(bpy.ops.grmm.fit_photos)
    return said


def message_of(operator) -> str:
    try:
        operator()
    except RuntimeError as error:
        return str(error)
    return ""


def fit(folder: Path) -> dict[str, object]:
    chosen = bpy.context.window_manager.grmm_fit
    chosen.output, chosen.preset = str(folder / "person.grmm"), "fast"
    bpy.ops.grmm.fit_photos()
    head = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).object
    camera = next(item for item in bpy.data.objects if item.type == "CAMERA")
    scene = bpy.context.scene
    # the camera must see the head where the photo shows it: the middle of the eyes in picture coordinates
    from bpy_extras.object_utils import world_to_camera_view

    bones = next(item for item in bpy.data.objects if item.type == "ARMATURE").pose.bones
    scene.render.resolution_x = scene.render.resolution_y = 512
    bpy.context.view_layer.update()
    eyes = [world_to_camera_view(scene, camera, bones[name].head) for name in ("left_eye", "right_eye")]
    return {
        "avatar": head is not None and head.grmm.is_avatar, "source": head.grmm.source,
        "background": camera.data.show_background_images,
        "eyes": [[p.x, 1.0 - p.y] for p in eyes], "note": module("grmm_blender.fitting.watch").note(),
    }  # fmt: skip


def main() -> None:
    folder, what = Path(sys.argv[-2]), sys.argv[-1]
    enable()
    empty_scene()
    report(statuses={**statuses(), "real": real_cancel(folder)})
    report(look=look(folder))
    if what == "fit":
        report(fit=fit(folder))


main()
