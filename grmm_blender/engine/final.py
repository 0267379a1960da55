"""Final renders: stills, animations, background. `RenderEngine.render` ends here.

One call renders one view layer of one frame: the scene is copied into plain values (`scene.walk`), the session
draws, `picture` turns its buffers into Blender's passes. A border renders the full picture and keeps its part, because the
refinement network and its depth range look at the whole avatar: a region then equals the same region of a full render.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...grmm_core.errors import CancelledError, GrmmError
from .. import events, session_host
from ..hair import read
from ..scene.cameras import Eye, render_region, scene_camera
from ..scene.meshes import MeshCache
from ..scene.shot import Frame, Occluders, Region
from ..scene.walk import begin_frame, drawn_objects
from . import output, passes, picture, pipeline
from .occlusion import OccluderDepths
from .passes import COMBINED
from .pipeline import DrawSettings

_log = logging.getLogger(__name__)

_meshes = MeshCache()
_depths = OccluderDepths()
_has_window = not bpy.app.background
_before: dict[tuple[str, str], np.ndarray] = {}  # the last picture by view layer and view, in a window

FAILED = np.array([1.0, 0.0, 1.0, 1.0], np.float32)  # scene-linear color of a composite's picture that could not be made
NO_AVATARS = "The scene has no visible GRMM avatar; add one with Add > GRMM."


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
        _fail(engine, depsgraph, str(error))
    except KeyboardInterrupt:
        # A farm that stops its job, or Ctrl-C in a script: the frame must not count as done.
        _fail(engine, depsgraph, "The render was interrupted.")
    except Exception as error:  # noqa: BLE001 - see above: not even a defect of ours may leave here
        _log.exception("The GRMM engine failed.")
        _fail(engine, depsgraph, describe_defect(error))


def _fail(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph, message: str) -> None:
    """Say what is wrong, and have a composite, which Blender saves all the same, be of one color that nobody overlooks.

    Without its avatars it would pass for a good picture.
    """
    engine.report({"ERROR"}, message)
    scene = depsgraph.scene_eval
    if scene.grmm_composite.main is None:
        return
    region = render_region(scene.render, engine.resolution_x, engine.resolution_y)
    values = {COMBINED: np.broadcast_to(FAILED, (region.height, region.width, 4))}
    with _Result(engine, region, depsgraph.view_layer.name) as result:
        for view in _views(scene):
            result.write(values, view)


def _views(scene: bpy.types.Scene) -> list[str]:
    return [view.name for view in scene.render.views if view.use] if scene.render.use_multiview else [""]


def describe_defect(error: Exception) -> str:
    """Return one sentence about an exception that should not have happened."""
    if isinstance(error, MemoryError):
        return "Not enough memory for this picture; choose a smaller size."
    return f"The GRMM engine failed ({type(error).__name__}: {error}); the system console shows where."


def _render(engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph) -> None:
    scene = depsgraph.scene_eval
    view_layer = depsgraph.view_layer
    settings = DrawSettings.final(
        scene.grmm_render.use_refine, int(scene.grmm_render.detail), scene.grmm_render.occlusion_samples
    )
    width, height = engine.resolution_x, engine.resolution_y
    region = render_region(scene.render, width, height)
    if bpy.app.background:  # in a window, F12 saves nothing, and a full disk is reported where it is noticed
        output.check_space(scene, region.width, region.height)
    items = passes.layer_passes(view_layer, [obj.name for obj in drawn_objects(scene, instanced=True)])

    engine.update_stats("", "GRMM: reading the scene")
    views = _views(scene)
    if _has_window:
        _show_before(engine, region, view_layer.name, views)
    values: dict[str, dict[str, np.ndarray]] = {}  # by view, then pass
    with _Result(engine, region, view_layer.name) as result:
        for index, view in enumerate(views):
            if view:
                engine.active_view_set(view)
            report = _Progress(engine, index / len(views), 1.0 / len(views))
            beside = None if view else result.begin
            values[view] = _view_values(engine, depsgraph, settings, items, region, report, beside)
        for view, passes_of in values.items():
            result.write(passes_of, view)
    if _has_window:
        _before.update({(view_layer.name, view): passes_of[COMBINED] for view, passes_of in values.items()})


def _view_values(
    engine: bpy.types.RenderEngine,
    depsgraph: bpy.types.Depsgraph,
    settings: DrawSettings,
    items: list[passes.RenderPass],
    region: Region,
    progress: _Progress,
    beside: Callable[[], object] | None = None,
) -> dict[str, np.ndarray]:
    """Return the passes of one eye, each [H, W, C] of the region; `beside` may be called while a worker draws."""
    scene = depsgraph.scene_eval
    if not scene.render.use_motion_blur:
        frame, meshes = _begin_frame(engine, depsgraph)
        _report_notes(engine, frame)
        if meshes is not None and beside is not None:
            meshes = _after(beside, meshes)
        return pipeline.frame_values(frame, settings, items, region, engine.test_break, progress, _depths, meshes)
    # Blur: the mean of pictures spread evenly over the shutter time. Positions and codes cannot be averaged, so depth and
    # normals are those of the middle of the shutter.
    steps = scene.grmm_render.motion_steps
    start = scene.frame_current_final
    total: dict[str, np.ndarray] = {}
    offsets = _shutter_offsets(scene.render.motion_blur_position, scene.render.motion_blur_shutter, steps)
    try:
        for step, offset in enumerate(offsets):
            _set_time(engine, start + offset)
            part = progress.part(step / steps, 1.0 / steps)
            frame, meshes = _begin_frame(engine, depsgraph)
            if step == 0:
                _report_notes(engine, frame)
            found = pipeline.frame_values(frame, settings, items, region, engine.test_break, part, _depths, meshes)
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


def _report_notes(engine: bpy.types.RenderEngine, frame: Frame) -> None:
    if not frame.scene.has_avatars:
        engine.report({"WARNING"}, NO_AVATARS)
    for note in dict.fromkeys(shot.note for shot in frame.scene.avatars if shot.note):
        engine.report({"WARNING"}, note)


def _begin_frame(
    engine: bpy.types.RenderEngine, depsgraph: bpy.types.Depsgraph
) -> tuple[Frame, Callable[[], Occluders] | None]:
    """Copy what a picture of the depsgraph's moment needs, as the eye that is being rendered sees it. See `begin_frame`."""
    scene = depsgraph.scene_eval
    camera = scene_camera(depsgraph, engine.camera_override)
    # Off-axis stereo shifts the lens of each eye; a camera by itself knows of its own shift only.
    stereo = camera.type == "CAMERA" and scene.render.use_multiview
    shift = engine.camera_shift_x(camera) - camera.data.shift_x if stereo else 0.0
    eye = Eye(np.array(engine.camera_model_matrix(camera), np.float64), shift)
    _meshes.doubt()  # the depsgraph may be another one: nothing says what has changed
    size = engine.resolution_x, engine.resolution_y
    return begin_frame(depsgraph, size, camera, eye, scene.grmm_render.use_occlusion, _meshes)


def _show_before(engine: bpy.types.RenderEngine, region: Region, layer: str, views: list[str]) -> None:
    """Show the picture of the frame before until there is a new one; Blender empties its window with every frame."""
    known = [(view, _before[layer, view]) for view in views if (layer, view) in _before]
    fitting = [(view, picture.stretched(last, region.width, region.height)) for view, last in known]
    with _Result(engine, region, layer) as result:
        for view, last in fitting:
            if last is not None:
                result.write({COMBINED: last}, view)


class _Result:
    """Blender's result of a view layer; whatever happens, what was begun is ended, and nothing half is left behind."""

    def __init__(self, engine: bpy.types.RenderEngine, region: Region, layer: str) -> None:
        self._engine, self._region, self._layer = engine, region, layer
        self._begun: bpy.types.RenderResult | None = None

    def __enter__(self) -> _Result:
        return self

    def __exit__(self, *_: object) -> None:
        self._end(cancel=True)

    def begin(self, view: str = "") -> bpy.types.RenderResult:
        """Have Blender make room for the passes of a view, which takes a millisecond; harmless when done twice."""
        if self._begun is None:
            width, height = self._region.width, self._region.height
            self._begun = self._engine.begin_result(0, 0, width, height, layer=self._layer, view=view)
        return self._begun

    def write(self, values: dict[str, np.ndarray], view: str = "") -> None:
        """Hand the finished passes of a view to Blender."""
        for target in self.begin(view).layers[0].passes:
            if target.name in values:
                target.rect.foreach_set(picture.blender_rows(values[target.name]))
        self._end(cancel=False)

    def _end(self, cancel: bool) -> None:
        begun, self._begun = self._begun, None
        if begun is not None:
            self._engine.end_result(begun, cancel=cancel)


def _after(first: Callable[[], object], then: Callable[[], Occluders]) -> Callable[[], Occluders]:
    def both() -> Occluders:
        first()
        return then()

    return both


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

    def __call__(self, share: float, message: str = "") -> None:
        self._engine.update_progress(self._start + self._length * share)
        used = session_host.memory_megabytes() if share == pipeline.DRAWN else 0.0
        if used:
            self._engine.update_memory_stats(memory_used=used, memory_peak=used)
        self._engine.update_stats("", f"GRMM: {message}")

    def part(self, start: float, length: float) -> _Progress:
        """Return the progress of a part of this part."""
        return _Progress(self._engine, self._start + self._length * start, self._length * length)


@persistent
def _forget(*_: object) -> None:
    """Another file: what is kept of the scene is of no use any more."""
    _meshes.forget()
    _depths.clear()
    read.forget()
    _before.clear()


_EVENTS = ((bpy.app.handlers.load_pre, _forget),)


def register() -> None:
    """Follow Blender's events."""
    events.follow(_EVENTS)


def unregister() -> None:
    """Take back `register`, and free what is kept."""
    events.stop(_EVENTS)
    _forget()
