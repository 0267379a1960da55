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
    request = job_module.FitRequest((photo,), folder / "person.grmm", preset="fast", device="cpu")
    job, seen, begin = job_module.FitJob.start(host.job_python(), request), [], time.monotonic()
    while job.running and time.monotonic() - begin < LONGEST:
        now = job.status
        seen.append(now.fraction)
        if now.stage == stage and now.fraction > job_module.STAGE_SHARES[stage][0]:
            job.cancel()
        time.sleep(POLL_SECONDS)
    ended = job.wait(60.0)
    return {
        "state": ended.state, "message": ended.message, "growing": seen == sorted(seen), "faces": [n for _, n in ended.faces],
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
    head = bpy.context.object
    avatar = module("grmm_blender.rig.avatar").avatar_of(head)
    camera = scene.camera
    background = camera.data.background_images[0]
    report(
        seconds=time.monotonic() - begin, note=watch.note(), rigged=avatar.armature is not None,
        origin=module("grmm_blender.fitting.origin").origin_of(avatar.source), preview=list(head.preview_ensure().image_size),
        background=Path(bpy.path.abspath(background.image.filepath)).name, preview_seen=watch.status().preview,
        seconds_left=watch.status().seconds_left, left=sorted(path.name for path in folder.iterdir()),
    )  # fmt: skip
    bpy.ops.grmm.fit_photo_expression()
    scene.render.engine = "GRMM"
    scene.render.resolution_x, scene.render.resolution_y = background.image.size
    scene.render.film_transparent = True
    exact_colors(scene)
    render(folder / "through_the_camera.png")


main()
