"""A photo to an avatar in the scene, as a user does it: cancel, resume, look at it through the photo's camera.

Arguments: photo, folder for the avatar and the picture.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import bpy
from render_support import exact_colors, render
from support import empty_scene, enable, module, report

photo, folder = Path(sys.argv[-2]), Path(sys.argv[-1])
POLL_SECONDS, LONGEST = 0.2, 900.0


def cancel_in(stage: str) -> dict[str, object]:
    """Start the fit as a window would, follow it, and cancel it in a stage."""
    job_module, host = module("grmm_blender.fitting.job"), module("grmm_blender.session_host")
    request = module("grmm_core.fitting.request").FitRequest((photo,), folder / "person.grmm", preset="fast", device="cpu")
    job, seen, begin = job_module.FitJob.start(host.job_python(), request), [], time.monotonic()
    while job.running and time.monotonic() - begin < LONGEST:
        seen.append(job.status.progress)
        if seen[-1].stage == stage and seen[-1].fraction > next(one.fraction for one in seen if one.stage == stage):
            job.cancel()
        time.sleep(POLL_SECONDS)
    ended = job.wait(60.0)
    fractions = [one.fraction for one in seen]
    return {
        "state": ended.state, "message": ended.message, "growing": fractions == sorted(fractions),
        "stages": list(dict.fromkeys(one.stage for one in seen if one.stage)), "faces": [one.count for one in ended.faces],
        "first_estimate": next((one.seconds_left for one in seen if one.stage), None),
        "left": sorted(path.name for path in folder.iterdir()),
    }  # fmt: skip


def main() -> None:
    enable()
    scene = empty_scene()
    chosen = bpy.context.window_manager.grmm_fit
    bpy.ops.grmm.fit_add_photos(filepath=str(photo))
    chosen.output, chosen.preset = str(folder / "person.grmm"), "fast"
    settings = module("grmm_blender.fitting.settings")
    report(before=settings.can_go_on(chosen), cancelled=cancel_in("codes"), resumable=settings.can_go_on(chosen))
    begin = time.monotonic()
    bpy.ops.grmm.fit_photos(resume=True)
    watch = module("grmm_blender.fitting.watch")
    avatar = module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
    camera = scene.camera
    background = camera.data.background_images[0]
    report(
        seconds=time.monotonic() - begin, note=watch.note(), rigged=avatar.armature is not None,
        origin=module("grmm_blender.fitting.provenance").provenance_sentence(avatar.source),
        preview=list(avatar.object.preview_ensure().image_size),
        background=Path(bpy.path.abspath(background.image.filepath)).name, preview_seen=watch.job().status.progress.picture,
        seconds_left=watch.job().status.progress.seconds_left, left=sorted(path.name for path in folder.iterdir()),
    )  # fmt: skip
    bpy.ops.grmm.fit_photo_expression()
    scene.render.engine = "GRMM"
    scene.render.resolution_x, scene.render.resolution_y = background.image.size
    scene.render.film_transparent = True
    exact_colors(scene)
    render(folder / "through_the_camera.png")


main()
