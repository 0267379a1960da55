"""What one 3D region needs between two draws: its scene, its Gaussians, its picture. Main thread only."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import replace

import bpy
import gpu
import numpy as np

from ...grmm_core.geometry.camera import Camera
from .. import session_host
from ..engine.settings import DETAIL_ITEMS
from ..pace import PICTURE
from ..scene.cameras import same_camera, view_camera
from .changes import CHANGES
from .drawing import SplatPicture
from .jobs import Drawable, SplatJobs, SplatRequest, same_shot
from .settings import FULL, HOLD_RATE, MESH
from .sources import DrawnScene, ViewportShot, moved_since
from .studio_light import light_key

EDIT_SECONDS = 0.1  # that an edit may take before a lower level of detail is used
MEASURED_FIRST, MEASURED_EVERY = 4, 16  # frames of playback in one way: waiting for the card in all of them would slow it down
WAIT_SECONDS = 0.5  # that a frame of playback waits for its own splats, so that they, bones and mesh are of one frame


class Viewport:
    """What one 3D region needs between two draws."""

    def __init__(self, jobs: SplatJobs | None = None, clock: Callable[[], float] = time.perf_counter) -> None:
        """Prepare; `jobs` makes the Gaussians (its own when None), `clock` tells seconds."""
        self.jobs = jobs or SplatJobs()
        self._clock = clock
        self._ended: float | None = None  # when the last frame of playback was drawn, where that was waited for
        self._shown_as: tuple[int | None, int] = None, 0  # how frames of playback are shown, and how many were
        self._picture = SplatPicture()
        self._scene = ViewportShot()
        self._version: tuple[object, ...] = ()  # of the scene, whether its meshes were read, and what lights the viewport
        self._asked: SplatRequest | None = None
        self._drawable: Drawable | None = None
        self._failure = ""
        self._failed_with = CHANGES.settings
        self._mesh_only = False
        self._playing = False
        self._finest = 0

    def draw(
        self,
        context: bpy.types.Context,
        depsgraph: bpy.types.Depsgraph,
        playing: bool,
    ) -> None:
        """Draw the newest splats, and ask for newer ones where something changed; a frame of playback shows its own or none."""
        self._failure = ""
        region, view = context.region, context.region_data
        projection = np.array(view.window_matrix, np.float64)
        camera = view_camera(region, view)
        settings = context.scene.grmm_viewport
        measured = playing and self._is_measured()
        if measured:
            self._picture.finish()  # what Blender has drawn until here is not the splats' time
        started = self._clock()
        if playing != self._playing:
            self._playing = playing
            self._ended, self._shown_as = None, (None, 0)
            self.jobs.pace.forget()
        self._finest = int(settings.detail)
        level = self._level(settings, context.scene, playing)
        self._mesh_only = level is None
        if level is None:
            self.jobs.request(None)
            self._note_frame(None, started, measured)
            return
        version = CHANGES.scene, level != PICTURE, light_key(context.space_data.shading)
        if self._version != version:
            self._version = version
            found_scene = _drawn_scene(depsgraph).in_viewport(context.space_data, use_meshes=level != PICTURE)
            self._scene = _kept_shots(found_scene, self._scene)
        self._ask(camera, level, level if playing else self._finest, playing)
        waits = playing and self._drawable is not None and self.jobs.pace.is_begun(level)
        self._drawable = self._newest(waits) or self._drawable
        found = self._drawable
        if found is None or not self._scene.shots:
            return
        if found.request.scene.shots and not found.messages:
            session_host.note_drawn()
        if found.request is self._asked or not playing or settings.playback == FULL:
            self._show(found, camera, projection)
        if playing:
            self._note_frame(level, started, measured and waits)

    def _is_measured(self) -> bool:
        """Whether the time of the next frame of playback is taken: of the first ones shown in some way, then now and then."""
        count = self._shown_as[1]
        return count < MEASURED_FIRST or count % MEASURED_EVERY < 2

    def _note_frame(self, way: int | None, started: float, measured: bool) -> None:
        """Note a frame of playback that ends now, and its time if it is measured and the one before was, too."""
        ended = None
        if measured:
            if way is not None:
                self._picture.finish()
            ended = self._clock()
            if self._ended is not None:
                self.jobs.pace.record_frame(way, ended - started, started - self._ended)
        self._ended = ended
        self._shown_as = way, self._shown_as[1] + 1 if way == self._shown_as[0] else 1

    def _show(self, found: Drawable, camera: Camera, projection: np.ndarray) -> None:
        # Own meshes are those of now: Blender has drawn them in the present pose. Splats of a moment ago go along.
        if found.picture is None:
            moved = moved_since(found.request.scene, self._scene)
            self._picture.draw(found.packed, found.order, camera, projection, self._scene.meshes, moved)
        else:
            self._picture.draw_picture(found.picture, camera, projection)

    def status(self) -> list[str]:
        """Return what the viewport's corner says: nothing while the full detail is shown."""
        lines = [self._failure] if self._failure else []
        if self._mesh_only:
            return [*lines, "Mesh only during playback"]
        if not self._scene.shots and not self._scene.message:
            return lines
        found = self._drawable
        if found is None or not {shot.name for shot in self._scene.shots} <= {shot.name for shot in found.request.scene.shots}:
            return [*lines, session_host.loading("Loading splats")]
        lines += dict.fromkeys(found.messages)
        if found.level == PICTURE:
            lines.append("Small picture during playback")
        elif found.level > self._finest:
            lines.append(f"{DETAIL_ITEMS[found.level][1]} detail")
        return lines

    def fail(self, message: str) -> None:
        """Draw nothing any more and say why: the graphics card refused."""
        self._failure, self._failed_with = message, CHANGES.settings
        self.jobs.request(None)

    @property
    def failed(self) -> bool:
        """Whether drawing was given up; it is tried again with other settings."""
        return bool(self._failure) and self._failed_with == CHANGES.settings

    def _level(self, settings: bpy.types.PropertyGroup, scene: bpy.types.Scene, playing: bool) -> int | None:
        if not playing:
            level = self.jobs.pace.level(self._finest, EDIT_SECONDS)
            return int(DETAIL_ITEMS[-1][0]) if level is None else level
        if settings.playback == MESH:
            return None
        if settings.playback == HOLD_RATE:
            finest = max(self._finest, PICTURE) if _is_software() else self._finest
            return self.jobs.pace.way(finest, scene.render.fps_base / scene.render.fps)
        return self._finest

    def _newest(self, waits: bool) -> Drawable | None:
        """What has come; frames of playback wait for what was asked for last, once the model is loaded and compiled."""
        if not waits or self._asked is None or self._drawable is None or self._drawable.request is self._asked:
            return self.jobs.take()
        return self.jobs.of(self._asked, WAIT_SECONDS)

    def _ask(self, camera: Camera, level: int, finest: int, playing: bool) -> None:
        asked = self._asked
        if (
            asked is not None
            and asked.scene is self._scene
            and (asked.finest, asked.playing) == (finest, playing)
            and same_camera(asked.camera, camera)
        ):
            return
        # During a final render the model is busy; the viewport keeps its splats.
        if bpy.app.is_job_running("RENDER"):
            return
        self._asked = SplatRequest(self._scene, camera, level, finest, playing)
        self.jobs.request(self._asked)


@functools.cache
def _is_software() -> bool:
    """Whether there is no graphics card: trying Gaussians would cost seconds, for nothing."""
    return str(gpu.platform.device_type_get()) == "SOFTWARE"


_walked: tuple[int, int, DrawnScene] | None = None  # number of the change, address of the depsgraph, what it shows


def _drawn_scene(depsgraph: bpy.types.Depsgraph) -> DrawnScene:
    """Walk over a scene after a change; all viewports share what is found."""
    global _walked
    if _walked is None or _walked[:2] != (CHANGES.scene, depsgraph.as_pointer()):
        _walked = CHANGES.scene, depsgraph.as_pointer(), DrawnScene(depsgraph)
    return _walked[2]


def forget() -> None:
    """Drop what is kept of the scene; another file is opened."""
    global _walked
    _walked = None


def _kept_shots(shot: ViewportShot, before: ViewportShot) -> ViewportShot:
    """Return what was found, with the shots of before where these say the same: then there is nothing to make."""
    same = len(shot.shots) == len(before.shots) and all(map(same_shot, shot.shots, before.shots))
    return replace(shot, shots=before.shots) if same else shot
