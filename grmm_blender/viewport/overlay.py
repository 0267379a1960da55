"""Blender's drawing callbacks and events: one `Viewport` for each 3D region, redraws when its thread has something new."""

from __future__ import annotations

import logging
from dataclasses import replace

import blf
import bpy
import numpy as np
from bpy.app.handlers import persistent

from ...grmm_core.geometry.camera import Camera
from ..engine.settings import DETAIL_ITEMS
from . import shaders
from .drawing import SplatPicture
from .jobs import Drawable, SplatJobs, SplatRequest, same_shot
from .settings import HOLD_RATE, MESH
from .sources import SceneShots, shots_in

SHADINGS = ("SOLID", "MATERIAL")
EDIT_SECONDS = 0.1  # that an edit may take before a lower level of detail is used
_POLL_SECONDS = 0.03
_KEPT = 16  # viewports; those of closed windows are dropped beyond
_TEXT_SIZE = 12
_TEXT_COLOR = (1.0, 1.0, 1.0, 0.85)

_log = logging.getLogger(__name__)


class Viewport:
    """What one 3D region needs between two draws."""

    def __init__(self, jobs: SplatJobs | None = None) -> None:
        """Prepare; `jobs` makes the Gaussians (its own when None)."""
        self.jobs = jobs or SplatJobs()
        self._picture = SplatPicture()
        self._scene = SceneShots()
        self._version = -1
        self._asked: SplatRequest | None = None
        self._drawable: Drawable | None = None
        self._failure = ""
        self._mesh_only = False
        self._playing = False

    def draw(
        self,
        context: bpy.types.Context,
        depsgraph: bpy.types.Depsgraph,
        playing: bool,
    ) -> None:
        """Draw the newest splats, and ask for newer ones where something changed."""
        region, view = context.region, context.region_data
        projection = np.array(view.window_matrix, np.float64)
        camera = Camera.from_opengl(np.array(view.view_matrix, np.float64), projection, region.width, region.height)
        settings = context.scene.grmm_viewport
        if playing != self._playing:
            self._playing = playing
            self.jobs.pace.forget()
        level = self._level(settings, context.scene, playing)
        self._mesh_only = level is None
        if level is None:
            self.jobs.request(None)
            return
        if self._version != _version:
            self._version = _version
            self._scene = _kept_shots(shots_in(depsgraph, context.space_data), self._scene)
        self._ask(camera, level, int(settings.detail))
        self._drawable = self.jobs.take() or self._drawable
        found = self._drawable
        if found is None or not self._scene.shots:
            return
        # Own meshes are those of now: Blender has drawn them in the present pose.
        self._picture.draw(found.packed, found.order, camera, projection, self._scene.meshes)

    def status(self) -> list[str]:
        """Return what the viewport's corner says: nothing while the full detail is shown."""
        lines = [self._failure] if self._failure else []
        if self._mesh_only:
            return [*lines, "Mesh only during playback"]
        if not self._scene.shots and not self._scene.message:
            return lines
        if self._drawable is None:
            return [*lines, "Loading splats"]
        lines += dict.fromkeys(self._drawable.messages)
        if self._drawable.level > self._drawable.request.finest:
            lines.append(f"{DETAIL_ITEMS[self._drawable.level][1]} detail")
        return lines

    def fail(self, message: str) -> None:
        """Draw nothing any more and say why: the graphics card refused."""
        self._failure = message
        self.jobs.request(None)

    @property
    def failed(self) -> bool:
        """Whether drawing was given up."""
        return bool(self._failure)

    def _level(self, settings: bpy.types.PropertyGroup, scene: bpy.types.Scene, playing: bool) -> int | None:
        finest = int(settings.detail)
        if not playing:
            level = self.jobs.pace.level(finest, EDIT_SECONDS)
            return int(DETAIL_ITEMS[-1][0]) if level is None else level
        if settings.playback == MESH:
            return None
        if settings.playback == HOLD_RATE:
            return self.jobs.pace.level(finest, scene.render.fps_base / scene.render.fps)
        return finest

    def _ask(self, camera: Camera, level: int, finest: int) -> None:
        asked = self._asked
        if asked is not None and asked.scene is self._scene and asked.finest == finest and _same_view(asked.camera, camera):
            return
        # During a final render the model is busy; the viewport keeps its splats.
        if bpy.app.is_job_running("RENDER"):
            return
        self._asked = SplatRequest(self._scene, camera, level, finest)
        self.jobs.request(self._asked)


_viewports: dict[int, Viewport] = {}
_version = 0  # of all scenes; rises with every change
_callbacks: list[object] = []


def redraw_viewports() -> None:
    """Draw all solid and material preview viewports again."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager is not None else ():
        for area in window.screen.areas:
            if area.type == "VIEW_3D" and area.spaces.active.shading.type in SHADINGS:
                area.tag_redraw()


def forget_failures() -> None:
    """Let viewports in which drawing was given up try again."""
    for key in [key for key, viewport in _viewports.items() if viewport.failed]:
        del _viewports[key]


def statuses() -> list[str]:
    """Return what all viewports have to say, each sentence once; for the panel."""
    return list(dict.fromkeys(line for viewport in _viewports.values() for line in viewport.status()))


def _shown_viewport() -> Viewport | None:
    """Return the viewport of the region that Blender draws now, or None where splats are off."""
    context = bpy.context
    space = context.space_data
    if space is None or space.type != "VIEW_3D" or space.shading.type not in SHADINGS or context.region_data is None:
        return None
    settings = context.scene.grmm_viewport
    if not settings.use_splats or (space.shading.show_xray and space.shading.type == "SOLID"):
        return None
    key = context.region.as_pointer()
    if key not in _viewports:
        if len(_viewports) >= _KEPT:
            _drop_closed()
        _viewports[key] = Viewport()
    return _viewports[key]


def _drop_closed() -> None:
    manager = bpy.context.window_manager
    living = {region.as_pointer() for w in manager.windows for area in w.screen.areas for region in area.regions}
    for key in set(_viewports) - living:
        _viewports.pop(key).jobs.request(None)


def _draw_splats() -> None:
    viewport = _shown_viewport()
    if viewport is None or viewport.failed:
        return
    context = bpy.context
    try:
        viewport.draw(context, context.evaluated_depsgraph_get(), context.screen.is_animation_playing)
    except Exception as error:  # noqa: BLE001 - a card's shader compiler can refuse in many ways; say so once, not every draw
        _log.exception("The splat viewport failed.")
        viewport.fail(f"Splats cannot be drawn here ({type(error).__name__}: {error}).")
    if viewport.jobs.busy and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=_POLL_SECONDS)


def _draw_status() -> None:
    viewport = _shown_viewport()
    if viewport is None or not bpy.context.scene.grmm_viewport.use_status:
        return
    scale = bpy.context.preferences.system.ui_scale
    blf.size(0, _TEXT_SIZE * scale)
    blf.color(0, *_TEXT_COLOR)
    for index, line in enumerate(viewport.status()):
        blf.position(0, 20 * scale, (20 + 18 * index) * scale, 0)
        blf.draw(0, f"GRMM: {line}")


def _poll() -> float | None:
    viewports = list(_viewports.values())
    more = any(viewport.jobs.busy for viewport in viewports)  # asked first, so that nothing that ends meanwhile goes unseen
    if any(viewport.jobs.has_news for viewport in viewports):
        redraw_viewports()
    return _POLL_SECONDS if more else None


@persistent
def _on_change(*_: object) -> None:
    global _version
    _version += 1


@persistent
def _on_load(*_: object) -> None:
    _on_change()
    for viewport in _viewports.values():
        viewport.jobs.request(None)
    _viewports.clear()


def _kept_shots(found: SceneShots, before: SceneShots) -> SceneShots:
    """Return what was found, with the shots of before where these say the same: then there is nothing to make."""
    same = len(found.shots) == len(before.shots) and all(map(same_shot, found.shots, before.shots))
    return replace(found, shots=before.shots) if same else found


def _same_view(one: Camera, other: Camera) -> bool:
    names = ("fx", "fy", "cx", "cy", "width", "height", "orthographic")
    return all(getattr(one, name) == getattr(other, name) for name in names) and np.array_equal(
        one.world_to_camera, other.world_to_camera
    )


_HANDLERS = (
    (bpy.app.handlers.depsgraph_update_post, _on_change),
    (bpy.app.handlers.frame_change_post, _on_change),
    (bpy.app.handlers.undo_post, _on_change),
    (bpy.app.handlers.redo_post, _on_change),
    (bpy.app.handlers.load_post, _on_load),
)


def register() -> None:
    """Start drawing; without windows there is nothing to draw."""
    for handlers, function in _HANDLERS:
        handlers.append(function)
    if not bpy.app.background:
        add = bpy.types.SpaceView3D.draw_handler_add
        _callbacks.append(add(_draw_splats, (), "WINDOW", "POST_VIEW"))
        _callbacks.append(add(_draw_status, (), "WINDOW", "POST_PIXEL"))


def unregister() -> None:
    """Take back `register`."""
    while _callbacks:
        bpy.types.SpaceView3D.draw_handler_remove(_callbacks.pop(), "WINDOW")
    for handlers, function in _HANDLERS:
        if function in handlers:
            handlers.remove(function)
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    _on_load()
    shaders.forget()
