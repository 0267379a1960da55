"""Final renders: stills, animations, background. `RenderEngine.render` ends here.

One call renders one view layer of one frame: the scene is copied into plain values (`snapshot`, `occluders`), the session
draws, `picture` turns its buffers into Blender's passes. A border renders the full picture and keeps its part, because the
refinement network and its depth range look at the whole avatar: a region then equals the same region of a full render.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.camera import Camera
from ...grmm_core.errors import CancelledError, GrmmError, ShapeError
from ...grmm_core.session import Instance, RenderOptions
from .. import session_host
from . import collect, occluders, passes, picture, snapshot
from .snapshot import AvatarShot, Region

_log = logging.getLogger(__name__)

NO_AVATARS = "The scene has no visible GRMM avatar; add one with Add > GRMM Head."


@dataclass(frozen=True)
class Frame:
    """Everything of one moment that a picture is made from.

    Attributes:
        avatars: Avatars to draw.
        camera: Camera of the full picture.
        occluders: Meshes that hide.
        clip: Nearest and farthest distance that the camera sees, metres.
    """

    avatars: list[AvatarShot]
    camera: Camera
    occluders: snapshot.Occluders
    clip: tuple[float, float]


def render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    """Render the depsgraph's view layer into the engine's result.

    Every failure ends as one error report and an ended result: an exception that left `RenderEngine.render` would write a
    blank picture and call it a success.
    """
    try:
        _render(engine, depsgraph)
    except CancelledError as error:
        # Blender stops by itself when it asked for this; else a blank picture would count as done.
        if not engine.test_break():
            engine.report({"ERROR"}, str(error))
    except GrmmError as error:
        engine.report({"ERROR"}, str(error))
    except Exception as error:  # noqa: BLE001 - see above: not even a defect of ours may leave here
        _log.exception("The GRMM engine failed.")
        engine.report({"ERROR"}, describe_defect(error))


def describe_defect(error: Exception) -> str:
    """Return one sentence about an exception that should not have happened."""
    if isinstance(error, MemoryError):
        return "Not enough memory for this picture; choose a smaller size."
    return f"The GRMM engine failed ({type(error).__name__}: {error}); the system console shows where."


def _render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    scene = depsgraph.scene_eval
    view_layer = depsgraph.view_layer
    settings = scene.grmm_render
    width, height = engine.resolution_x, engine.resolution_y
    region = snapshot.render_region(scene.render, width, height)
    items = passes.layer_passes(view_layer, collect.avatar_names(scene))
    world = None if scene.render.film_transparent else snapshot.world_color(scene)

    engine.update_stats("", "GRMM: reading the scene")
    views = [view.name for view in scene.render.views if view.use] if scene.render.use_multiview else [""]
    values: dict[str, dict[str, np.ndarray]] = {}  # by view, then pass
    for index, view in enumerate(views):
        if view:
            engine.active_view_set(view)
        report = _Progress(engine, index / len(views), 1.0 / len(views))
        values[view] = _view_values(engine, depsgraph, settings, items, world, region, report)
    _write(engine, region, view_layer.name, values)


def _view_values(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    settings: bpy.types.PropertyGroup,
    items: list[passes.RenderPass],
    world: np.ndarray | None,
    region: Region,
    progress: _Progress,
) -> dict[str, np.ndarray]:
    """Return the passes of one eye, each [H, W, C] of the region."""
    scene = depsgraph.scene_eval
    if not (scene.render.use_motion_blur and settings.motion_steps > 1):
        frame = take_frame(engine, depsgraph)
        if not frame.avatars:
            engine.report({"WARNING"}, NO_AVATARS)
        return _frame_values(engine, frame, settings, items, world, region, progress)
    # Blur: the mean of pictures spread evenly over the shutter time. Positions and codes cannot be averaged, so depth and
    # normals are those of the middle of the shutter.
    steps = settings.motion_steps
    start = scene.frame_current_final
    total: dict[str, np.ndarray] = {}
    offsets = _shutter_offsets(scene.render.motion_blur_position, scene.render.motion_blur_shutter, steps)
    try:
        for step, offset in enumerate(offsets):
            _set_time(engine, start + offset)
            part = progress.part(step / steps, 1.0 / steps)
            found = _frame_values(engine, take_frame(engine, depsgraph), settings, items, world, region, part)
            for item in items:
                if item.kind in ("depth", "normal"):
                    if step == steps // 2:
                        total[item.name] = found[item.name]
                elif item.name in total:
                    total[item.name] += found[item.name] / steps
                else:
                    total[item.name] = found[item.name] / steps
    finally:
        _set_time(engine, start)
    return total


def take_frame(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> Frame:
    """Copy what a picture of the depsgraph's moment needs."""
    scene = depsgraph.scene_eval
    camera = snapshot.full_camera(engine, depsgraph, engine.resolution_x, engine.resolution_y)
    avatars = collect.avatars(depsgraph)
    found = snapshot.Occluders()
    if scene.grmm_render.use_occlusion or any(a.shot.holdout for a in avatars):
        found = occluders.collect(
            depsgraph,
            camera,
            {name for a in avatars for name in a.object_names},
            {name for a in avatars if a.shot.holdout for name in a.object_names},
        )
    shots = [a.shot for a in avatars if not a.shot.holdout]
    return Frame(shots, camera, found, snapshot.clip_range(engine, depsgraph))


def _frame_values(
    engine: bpy.types.RenderEngine,
    frame: Frame,
    settings: bpy.types.PropertyGroup,
    items: list[passes.RenderPass],
    world: np.ndarray | None,
    region: Region,
    progress: _Progress,
) -> dict[str, np.ndarray]:
    if engine.test_break():
        raise CancelledError("The render was cancelled.")
    progress(0.0, "opening avatars")
    instances = open_instances(frame.avatars)
    progress(0.1, f"drawing {len(instances)} avatar{'s' if len(instances) != 1 else ''}")
    wanted = passes.session_passes(items)
    options = RenderOptions(
        refine=settings.use_refine,
        passes=tuple(dict.fromkeys((*wanted, "alpha", "depth"))),  # depth for what stands in front
        lod=int(settings.detail),
    )
    buffers = session_host.get_session().render(instances, frame.camera, options, engine.test_break)
    progress(0.8, "putting the scene in front")
    rows = slice(frame.camera.height - region.y - region.height, frame.camera.height - region.y)
    columns = slice(region.x, region.x + region.width)
    buffers = {name: buffer[rows, columns] for name, buffer in buffers.items()}
    camera = snapshot.crop_camera(frame.camera, region)
    visible = picture.visibility(
        frame.occluders, buffers["depth"][..., 0], camera, settings.occlusion_samples, frame.clip, film=world is not None
    )
    names = [shot.name for shot in frame.avatars]
    values = {item.name: picture.pass_values(item, buffers, visible, world, names) for item in items}
    progress(1.0, "done")
    return values


def open_instances(shots: list[AvatarShot]) -> list[Instance]:
    """Open the avatars in the session and place them. Errors name the avatar."""
    instances = []
    for shot in shots:
        try:
            info = session_host.open_avatar(shot.source)
            instances.append(Instance(info.id, shot.controls.validate(), shot.model_to_world))
        except (ShapeError, GrmmError) as error:
            raise type(error)(f"{shot.name}: {error}") from error
    return instances


def _write(
    engine: bpy.types.RenderEngine, region: Region, layer: str, values: dict[str, dict[str, np.ndarray]]
) -> None:
    """Hand finished passes to Blender; nothing before this point can leave a half result behind."""
    for view, view_values in values.items():
        result = engine.begin_result(0, 0, region.width, region.height, layer=layer, view=view)
        cancelled = True
        try:
            for target in result.layers[0].passes:
                if target.name in view_values:
                    target.rect.foreach_set(picture.blender_rows(view_values[target.name]))
            cancelled = False
        finally:
            engine.end_result(result, cancel=cancelled)


def _shutter_offsets(position: str, shutter: float, steps: int) -> list[float]:
    """Return frame offsets of the middles of `steps` equal parts of the shutter time."""
    begin = {"START": 0.0, "CENTER": -shutter / 2.0, "END": -shutter}.get(position, -shutter / 2.0)
    return [begin + shutter * (step + 0.5) / steps for step in range(steps)]


def _set_time(engine: bpy.types.RenderEngine, time: float) -> None:
    whole = int(np.floor(time))
    engine.frame_set(whole, float(time - whole))


class _Progress:
    """Maps 0..1 of a part of the work to Blender's progress bar and status text."""

    def __init__(self, engine: bpy.types.RenderEngine, start: float = 0.0, length: float = 1.0) -> None:
        self._engine, self._start, self._length = engine, start, length

    def __call__(self, fraction: float, text: str) -> None:
        self._engine.update_progress(self._start + self._length * fraction)
        status = session_host.memory_megabytes()
        if status:
            self._engine.update_memory_stats(memory_used=status, memory_peak=status)
        self._engine.update_stats("", f"GRMM: {text}")

    def part(self, start: float, length: float) -> _Progress:
        """Return the progress of a part of this part."""
        return _Progress(self._engine, self._start + self._length * start, self._length * length)
