"""Pictures for the rendered viewport, drawn on a thread: a cheap one at once, a good one when the view rests.

A frame of playback is one picture in between, refined, and drawn while Blender makes the next frame; a smaller one where that
takes longer than a frame may, and a cheap one where that does, too. Larger ones are tried again now and then: a slow moment
must not leave the rest of a playback blurry.

One `ViewJobs` a viewport. The newest request wins: a preview that has begun is finished, so that playback shows something, but
a good picture is given up as soon as there is a newer request, or as soon as Blender's main thread needs the model for the
rig (`give_way`). The thread ends when there is nothing left to do. Touches none of Blender's data.
"""

from __future__ import annotations

import dataclasses
import logging
import time
import weakref
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ...grmm_core.errors import CancelledError, GrmmError
from ..latest_request import LatestRequestThread, WaitForRest
from ..pace import Pace
from ..scene.shot import Frame, Region
from . import picture, pipeline
from .occlusion import OccluderDepths
from .passes import RenderPass
from .pipeline import DrawSettings

REST_SECONDS = 0.15  # without a newer request before the good picture is begun
PREVIEW_PIXELS = 320 * 240  # what a preview is scaled down to
PLAYING_PIXELS = 512 * 512  # what a frame of playback is scaled down to
FEWER_PIXELS = 384 * 384  # likewise where that is too slow
_PASSES = [
    RenderPass("combined", "Combined", "RGBA", "COLOR"),
    RenderPass("mask", "Mask", "X", "VALUE"),
    RenderPass("depth", "Depth", "Z", "VALUE"),
]

_log = logging.getLogger(__name__)

Level = Literal["preview", "playing", "final"]
_WAYS: tuple[tuple[Level, int], ...] = (  # to draw a frame of playback, with its pixels, by the numbers of `Pace`
    ("playing", PLAYING_PIXELS), ("playing", FEWER_PIXELS), ("preview", PREVIEW_PIXELS),
)  # fmt: skip


@dataclass(frozen=True)
class ViewRequest:
    """What a viewport shows.

    Attributes:
        frame: Scene and camera; the camera has the size of the viewport.
        preview: How the cheap picture is drawn.
        final: How the good picture is drawn.
        setback: How much farther back than the viewport's the camera of `frame` stands, metres.
        playing: How a frame of playback is drawn.
        seconds: What a frame of playback may take; None where the scene is not played.
    """

    frame: Frame
    preview: DrawSettings
    final: DrawSettings
    setback: float = 0.0
    playing: DrawSettings = dataclasses.field(default_factory=DrawSettings)
    seconds: float | None = None

    def smaller(self, pixels: int) -> Frame:
        """The frame with a picture of at most so many pixels."""
        camera = self.frame.camera
        scale = min(1.0, (pixels / (camera.width * camera.height)) ** 0.5)
        size = max(1, round(camera.width * scale)), max(1, round(camera.height * scale))
        return dataclasses.replace(self.frame, camera=camera.resized(*size))


@dataclass(frozen=True)
class ViewPicture:
    """A finished picture.

    Attributes:
        values: Scene-linear premultiplied RGBA, [H, W, 4] float32, bottom row first.
        avatars: Visible cover of the avatars, and their depth in metres, [H, W, 2] float32, bottom row first.
        level: How good it is.
        request: What it shows.
    """

    values: np.ndarray
    avatars: np.ndarray
    level: Level
    request: ViewRequest


class ViewJobs(LatestRequestThread[ViewRequest, ViewPicture]):
    """Draws the newest request; see the module."""

    thread_name = "GRMM viewport"

    def __init__(self, wait_for_rest: WaitForRest | None = None) -> None:
        """Prepare; nothing runs before the first request.

        Args:
            wait_for_rest: Called between the cheap and the good picture with a function that says whether there is something
                newer; returns when the view has rested or there is. None waits `REST_SECONDS`.
        """
        super().__init__(REST_SECONDS, wait_for_rest)
        self._error = ""
        self._closed = False
        self._depths = OccluderDepths()
        self._pace = Pace()  # of playback
        self._played = False
        self._announced: ViewRequest | None = None  # the frame of playback that the session may have begun with
        self._in_the_way = False  # the good picture that is being drawn keeps the main thread from the model
        _live.add(self)

    def request(self, request: ViewRequest | None) -> None:
        """Ask for a picture; returns at once. None gives up."""
        with self._changed:
            if self._closed:
                return
            self._error = ""
            plays = self._thread is not None and request is not None and request.seconds is not None
            announced = plays and self._announced is None
            if announced or not plays:
                self._announced = request if plays else None
            super().request(request)
        if announced and request is not None:
            level, pixels = _WAYS[self._way(request)]
            if level == "playing":
                pipeline.announce(request.smaller(pixels), request.playing, _PASSES)

    @property
    def has_news(self) -> bool:
        """Whether a draw would show something else than the last one."""
        with self._changed:
            return self._result is not None or bool(self._error)

    @property
    def error(self) -> str:
        """One sentence if the newest request failed, else empty."""
        with self._changed:
            return self._error

    def give_way(self) -> None:
        """Let go of the model soon: a good picture is begun again later, a cheap one is nearly done anyway."""
        with self._changed:
            self._in_the_way = True
            self._changed.notify_all()

    def close(self) -> None:
        """Give up what is being drawn."""
        with self._changed:
            self._closed = True
            self._wanted = None
            self._changed.notify_all()

    def _serve(self, request: ViewRequest) -> bool:
        with self._changed:
            begun, self._announced = self._announced, None
        try:
            if begun is None or begun is request or request.seconds is None:
                return self._draw(request)
            self._draw(begun)  # half of it is made
        except CancelledError:
            pass
        return False

    def _failed(self, request: ViewRequest, error: Exception) -> None:
        message = str(error)
        if not isinstance(error, GrmmError):
            _log.error("The viewport's picture failed.", exc_info=error)
            message = f"The viewport's picture failed ({type(error).__name__}: {error})."
        with self._changed:
            if self._wanted is request:
                self._error = message

    def _draw(self, request: ViewRequest) -> bool:
        """Draw a frame of playback, or both pictures of a request; returns whether that was done."""
        played, self._played = self._played, request.seconds is not None
        if request.seconds is not None:
            if not played:
                self._pace.forget()
            self._play(request, played)
            return True
        self._publish(request, "preview", request.smaller(PREVIEW_PIXELS), request.preview)
        while True:
            with self._changed:
                self._in_the_way = False
            self._wait_for_rest(lambda: self._wanted is not request or self._in_the_way)
            if self._wanted is not request:
                return False
            try:
                self._publish(request, "final", request.frame, request.final)
            except CancelledError:
                if self._wanted is request:
                    continue  # it only gave way
                raise
            return True

    def _play(self, request: ViewRequest, known: bool) -> None:
        """Draw a frame of playback; how long the first one takes says little of those that follow."""
        way = self._way(request)
        level, pixels = _WAYS[way]
        started = time.perf_counter()
        self._publish(request, level, request.smaller(pixels), request.playing if level == "playing" else request.preview)
        if known:
            self._pace.record(way, time.perf_counter() - started)
            self._pace.doubt(way)

    def _way(self, request: ViewRequest) -> int:
        """How to draw a frame of playback, a number in `_WAYS`."""
        found = self._pace.level(0, request.seconds or 0.0)
        return len(_WAYS) - 1 if found is None else min(found, len(_WAYS) - 1)

    def _publish(self, request: ViewRequest, level: Level, frame: Frame, settings: DrawSettings) -> None:
        def given_up() -> bool:
            return self._closed or (level == "final" and (self._in_the_way or self._wanted is not request))

        region = Region(0, 0, frame.camera.width, frame.camera.height)
        values = pipeline.frame_values(frame, settings, _PASSES, region, given_up, depths=self._depths)
        avatars = np.concatenate([values["Mask"], values["Depth"]], -1)
        colors, cover = (picture.blender_rows(part).reshape(part.shape) for part in (values["Combined"], avatars))
        self._put(ViewPicture(colors, cover, level, request))


_live: weakref.WeakSet[ViewJobs] = weakref.WeakSet()


def give_way() -> None:
    """Have all viewports let go of the model; see `ViewJobs.give_way`."""
    for jobs in list(_live):
        jobs.give_way()


def close_all() -> None:
    """Give up all pictures; called when the engine is unregistered."""
    for jobs in list(_live):
        jobs.close()
