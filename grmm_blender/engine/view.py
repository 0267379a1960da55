"""The rendered viewport: `RenderEngine.view_update` and `view_draw` end here.

On Blender's main thread: copy the scene when it changes, ask `view_jobs` for pictures when scene or view change, and draw the
newest picture as a texture. A timer redraws the viewport when a picture has come. What cannot be drawn is said in a line of
text in the viewport's corner.
"""

from __future__ import annotations

import time
import weakref
from dataclasses import dataclass, replace

import bpy
import gpu
import numpy as np
from bpy.app.handlers import persistent
from gpu_extras.presets import draw_texture_2d

from ...grmm_core.errors import GrmmError
from ...grmm_core.geometry.camera import Camera
from .. import events, session_host
from ..scene.cameras import same_camera, view_camera
from ..scene.meshes import MeshCache
from ..scene.shot import Frame, SceneShot
from ..scene.walk import read_scene
from ..windows import redraw_viewports
from . import overlays, view_jobs
from .pipeline import PLAYED_STRANDS, DrawSettings
from .settings import ENGINE
from .view_jobs import ViewJobs, ViewPicture, ViewRequest

_POLL_SECONDS = 0.01  # Blender hears of nothing from threads; looking so often costs it microseconds
_EDGE_SAMPLES = 2
_GAP_SHARE, _LONGEST_GAP = 0.5, 2.0  # of the time between frames, which pictures may take; seconds


@dataclass(frozen=True)
class _Scene:
    """The scene as of the last change."""

    shot: SceneShot
    preview: DrawSettings
    final: DrawSettings
    playing: DrawSettings


class ViewRenderer:
    """What one viewport needs between two draws."""

    def __init__(self, jobs: ViewJobs | None = None) -> None:
        """Prepare; `jobs` draws the pictures (its own when None)."""
        self._jobs = jobs or ViewJobs()
        self._meshes = MeshCache()
        self._scene: _Scene | None = None
        self._shown: tuple[_Scene, Camera, bool] | None = None
        self._picture: ViewPicture | None = None
        self._texture: gpu.types.GPUTexture | None = None
        self._avatars: gpu.types.GPUTexture | None = None  # of the picture, made when it is needed
        self._region = 0
        self._error = ""
        self._asked = 0.0  # when the last frame of playback was asked for; 0 at rest
        self._gap = 0.0  # seconds between two of them
        _viewports.add(self)

    def update(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Copy the scene after a change."""
        self._meshes.forget_changed(depsgraph)
        try:
            self._scene, self._error = self._copy(depsgraph), ""
        except GrmmError as error:
            self._error = str(error)

    def draw(self, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw the newest picture, and ask for a newer one if the view is another by now."""
        if self._scene is None and not self._error:
            self.update(depsgraph)
        width, height = context.region.width, context.region.height
        if self._scene is not None:
            self._request(context, self._scene)
        found = self._jobs.take()
        if found is not None:
            self._picture, self._texture, self._avatars = found, _texture(found.values, "RGBA16F"), None
        self._region = context.region.as_pointer()
        if self._texture is not None:
            gpu.state.blend_set("ALPHA_PREMULT")
            engine.bind_display_space_shader(depsgraph.scene)
            draw_texture_2d(self._texture, (0, 0), width, height)
            engine.unbind_display_space_shader()
            gpu.state.blend_set("NONE")
        engine.update_stats("GRMM", self.status())
        if self._jobs.busy:
            events.later(_poll, _POLL_SECONDS)

    def hide_overlays(self, region: bpy.types.Region, region_data: bpy.types.RegionView3D) -> None:
        """Clear overlays that avatars hide, in the buffer that is bound, where this viewport is that of the region."""
        if self._picture is None or self._region != region.as_pointer():
            return
        if self._avatars is None:
            self._avatars = _texture(self._picture.avatars, "RG32F")
        projection = np.array(region_data.window_matrix, np.float64)
        overlays.hide_overlays(self._avatars, projection, self._picture.request.setback)

    def status(self) -> str:
        """Return what the viewport shows, for its corner: an error, or how far the picture is."""
        error = self._error or self._jobs.error
        if error:
            return error
        if self._scene is not None and not self._scene.shot.avatars:
            return "No visible avatar"
        if self._picture is None:
            return session_host.loading("Loading the model")
        note = "" if self._scene is None else next((shot.note for shot in self._scene.shot.avatars if shot.note), "")
        if note:
            return note
        return "Preview" if self._picture.level == "preview" else ""

    def start_again(self) -> None:
        """Copy the scene and ask for its picture anew with the next draw."""
        self._scene = self._shown = None
        self._error = ""

    @property
    def has_news(self) -> bool:
        """Whether it should be drawn again."""
        return self._jobs.has_news

    @property
    def busy(self) -> bool:
        """Whether a picture is on its way."""
        return self._jobs.busy

    def close(self) -> None:
        """Stop drawing; the viewport is gone."""
        self._jobs.close()

    def __del__(self) -> None:
        self._jobs.close()

    def _copy(self, depsgraph: bpy.types.Depsgraph) -> _Scene:
        settings = depsgraph.scene_eval.grmm_render
        return _Scene(
            read_scene(depsgraph, use_meshes=settings.use_occlusion, kept=self._meshes),
            DrawSettings(refine=False, lod=int(settings.viewport_detail), samples=1),
            DrawSettings(refine=settings.use_viewport_refine, samples=_EDGE_SAMPLES),
            DrawSettings(refine=settings.use_viewport_refine, samples=1, strands=PLAYED_STRANDS, coarse=True),
        )

    def _request(self, context: bpy.types.Context, scene: _Scene) -> None:
        camera = view_camera(context.region, context.region_data)
        # During a final render the model is busy; the viewport keeps its picture.
        playing = context.screen.is_animation_playing
        if self._is_shown(camera, playing) or bpy.app.is_job_running("RENDER"):
            return
        self._shown = (scene, camera, playing)
        space = context.space_data
        clip, setback = (space.clip_start, space.clip_end), 0.0
        if camera.orthographic:
            # Such a view shows what is behind its plane too: draw it from farther back.
            matrix = camera.world_to_camera.copy()
            setback = space.clip_end
            matrix[2, 3] += setback
            camera, clip = replace(camera, world_to_camera=matrix), (clip[0], 2.0 * clip[1])
        frame = Frame(scene.shot, camera, clip)
        seconds = self._seconds(context.scene.render) if playing else None
        self._asked = time.perf_counter() if playing else 0.0
        self._jobs.request(ViewRequest(frame, scene.preview, scene.final, setback, scene.playing, seconds))

    def _seconds(self, render: bpy.types.RenderSettings) -> float:
        """What a frame of playback may take: where Blender itself does not keep the rate, a share of what it takes."""
        gap = min(time.perf_counter() - self._asked, _LONGEST_GAP) if self._asked else 0.0
        self._gap = 0.5 * (self._gap + gap) if self._gap and self._asked else gap
        return max(render.fps_base / render.fps, _GAP_SHARE * self._gap)

    def _is_shown(self, camera: Camera, playing: bool) -> bool:
        if self._shown is None or self._shown[0] is not self._scene or self._shown[2] != playing:
            return False
        return same_camera(self._shown[1], camera)


_viewports: weakref.WeakSet[ViewRenderer] = weakref.WeakSet()


def _poll() -> float | None:
    """Timer: draw the rendered viewports again as soon as one of them has something new."""
    viewports = list(_viewports)
    more = any(viewport.busy for viewport in viewports)  # asked first, so that nothing that ends meanwhile goes unseen
    if any(viewport.has_news for viewport in viewports):
        redraw_viewports("RENDERED")
    return _POLL_SECONDS if more else None


def _texture(values: np.ndarray, texture_format: str) -> gpu.types.GPUTexture:
    """Return a picture [H, W, C], bottom row first, as a texture."""
    height, width = values.shape[:2]
    buffer = gpu.types.Buffer("FLOAT", values.size, np.ascontiguousarray(values, np.float32).reshape(-1))
    return gpu.types.GPUTexture((width, height), format=texture_format, data=buffer)


def _hide_overlays() -> None:
    """Blender's callback after its overlays were drawn."""
    context = bpy.context
    space = context.space_data
    if space.shading.type == "RENDERED" and context.scene.render.engine == ENGINE and space.overlay.show_overlays:
        for viewport in list(_viewports):
            viewport.hide_overlays(context.region, context.region_data)


@persistent
def _give_way(*_: object) -> None:
    """The rig's handlers, or a final render, need the model next."""
    view_jobs.give_way()


def _on_runtime() -> None:
    """Another runtime: what the one before could not draw is tried again."""
    for viewport in _viewports:
        viewport.start_again()
    redraw_viewports("RENDERED")


_EVENTS = (
    (bpy.app.handlers.frame_change_pre, _give_way),
    (bpy.app.handlers.depsgraph_update_pre, _give_way),
    (bpy.app.handlers.render_pre, _give_way),
    (session_host.changed, _on_runtime),
)
_DRAWING = ((_hide_overlays, "POST_VIEW"),)


def register() -> None:
    """Follow Blender's events; without windows there are no overlays."""
    events.follow(_EVENTS, _DRAWING)


def unregister() -> None:
    """Take back `register`, and end what is being drawn."""
    events.stop(_EVENTS, [_poll], _DRAWING)
    view_jobs.close_all()
    overlays.forget()
