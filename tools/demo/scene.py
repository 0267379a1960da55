"""The Blender part of the demonstration: what a user would do in a fresh Blender, through the installed extension.

Starts bpy in this process. The extension is built, installed into an empty user folder and enabled, so that the pictures
come out of what a user would install.
"""

from __future__ import annotations

import math
import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

SIZE = 512  # pixels
MAX_FRAMES = 96  # of a long performance; the demonstration has a time limit
FOCAL_LENGTH = 85.0  # millimetres
DISTANCE = 0.95  # metres
SWING = 22.0  # degrees that the camera walks to either side
BACKDROP = (0.72, 0.75, 0.80)


def render_sequence(extension: Path, performance: Path, folder: Path, progress: Callable[[str], None]) -> list[Path]:
    """Add a head, play a performance on it, render every frame with the GRMM engine and write an MP4.

    Args:
        extension: The built extension's zip.
        performance: ARKit JSON or Live Link Face CSV.
        folder: Receives `frames/NNNN.png`, `performance.mp4` and `demo.blend`.
        progress: Called with one line for each step.

    Returns:
        The frames in order.
    """
    os.environ["BLENDER_USER_RESOURCES"] = tempfile.mkdtemp(prefix="grmm-demo-")
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.extensions.package_install_files(filepath=str(extension), repo="user_default", enable_on_install=True)
    progress("extension installed and enabled in an empty Blender")
    bpy.ops.grmm.add_head()
    bpy.ops.grmm.import_performance(filepath=str(performance))
    scene = bpy.context.scene
    _set_frames(scene)
    _set_camera(scene)
    _set_output(scene, folder / "frames" / "####.png")
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "demo.blend"), check_existing=False)
    progress(f"rendering frames {scene.frame_start} to {scene.frame_end} with the GRMM engine")
    bpy.ops.render.render(animation=True)
    frames = sorted((folder / "frames").glob("*.png"))
    _write_movie(frames, folder / "performance.mp4", scene.render.fps)
    progress("movie written")
    return frames


def _set_frames(scene: Any) -> None:
    """Render the imported action's range."""
    import bpy

    ranges = [action.frame_range for action in bpy.data.actions]
    scene.frame_start = math.floor(min(r[0] for r in ranges))
    scene.frame_end = min(math.ceil(max(r[1] for r in ranges)), scene.frame_start + MAX_FRAMES - 1)


def _set_camera(scene: Any) -> None:
    """A portrait lens that walks from one side of the face to the other."""
    import bpy

    target = bpy.data.objects.new("Target", None)
    target.location = (0.0, -0.02, 0.0)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    camera.data.lens = FOCAL_LENGTH
    for item in (target, camera):
        scene.collection.objects.link(item)
    constraint = camera.constraints.new("TRACK_TO")
    constraint.target, constraint.track_axis, constraint.up_axis = target, "TRACK_NEGATIVE_Z", "UP_Y"
    scene.camera = camera
    for frame in range(scene.frame_start, scene.frame_end + 1):
        phase = (frame - scene.frame_start) / max(1, scene.frame_end - scene.frame_start)
        angle = math.radians(SWING) * math.sin(2.0 * math.pi * phase)
        camera.location = (DISTANCE * math.sin(angle), -DISTANCE * math.cos(angle), 0.04)
        camera.keyframe_insert("location", frame=frame)


def _set_output(scene: Any, pattern: Path) -> None:
    """Engine, size, a plain backdrop and the Standard view, under which the saved picture is the network's."""
    import bpy

    scene.render.engine = "GRMM"
    scene.render.resolution_x = scene.render.resolution_y = SIZE
    scene.render.resolution_percentage = 100
    scene.render.filepath = str(pattern)
    scene.render.image_settings.file_format = "PNG"
    scene.view_settings.view_transform = "Standard"
    scene.render.dither_intensity = 0.0
    scene.world = bpy.data.worlds.new("Backdrop")
    scene.world.color = BACKDROP


def _write_movie(frames: list[Path], path: Path, fps: int) -> None:
    """Encode the frames with Blender's own FFmpeg through the sequencer of a second scene."""
    import bpy

    scene = bpy.data.scenes.new("Movie")
    editor = scene.sequence_editor_create()
    strips = editor.strips if hasattr(editor, "strips") else editor.sequences
    strip = strips.new_image("frames", str(frames[0]), channel=1, frame_start=1)
    for frame in frames[1:]:
        strip.elements.append(frame.name)
    scene.frame_start, scene.frame_end = 1, len(frames)
    render = scene.render
    render.resolution_x = render.resolution_y = SIZE
    render.resolution_percentage, render.fps = 100, fps
    render.filepath = str(path)
    render.use_file_extension = False
    scene.view_settings.view_transform = "Standard"
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "VIDEO"
    render.image_settings.file_format = "FFMPEG"
    render.ffmpeg.format, render.ffmpeg.codec = "MPEG4", "H264"
    render.ffmpeg.constant_rate_factor = "HIGH"
    bpy.ops.render.render(animation=True, scene=scene.name)
