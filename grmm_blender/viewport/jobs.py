"""Gaussians and their order for one viewport, made on a thread so that Blender never waits for them.

The newest request wins. While something changes, Gaussians come in the level of detail that the request allows; when the view
rests they come once more in full, with the colors of the present view. A moved camera costs a new order only. The thread ends
when there is nothing left to do. Touches none of Blender's data.
"""

from __future__ import annotations

import dataclasses
import logging
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ...grmm_core.errors import GrmmError
from ...grmm_core.geometry.camera import Camera
from ..latest_request import LatestRequestThread, WaitForRest
from ..pace import PICTURE, Pace
from ..scene.shot import AvatarShot
from . import arrays, sources
from .arrays import Packed, Picture
from .sources import ViewportShot

REST_SECONDS = 0.2  # without a newer request before full detail is made
MOVING_DEGREES = 8.0  # that an avatar may have turned before its colors are made anew while the view moves
RESTING_DEGREES = 0.5  # the same when it rests
MOVING_SPREAD, RESTING_SPREAD = 1.0, 0.02  # the same of what close-ups widen Gaussians by, as a share of the most

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class SplatRequest:
    """What a viewport shows.

    Attributes:
        scene: Avatars and clouds; its `shots` are the same object as long as nothing changed.
        camera: Of the viewport.
        level: Level of detail while something changes, or `pace.PICTURE`.
        finest: Level of detail when nothing does.
        playing: The scene is a frame of playback: nothing better is made of it, the next frame follows.
    """

    scene: ViewportShot
    camera: Camera
    level: int
    finest: int
    playing: bool = False


@dataclass(frozen=True)
class Drawable:
    """What can be drawn.

    Attributes:
        packed: Gaussians.
        order: Their order for the camera, see `arrays.depth_order`.
        request: What was asked for.
        level: Level of detail.
        messages: What cannot be shown, a sentence each.
        picture: What is drawn in the place of Gaussians, if anything.
    """

    packed: Packed
    order: np.ndarray
    request: SplatRequest
    level: int
    messages: tuple[str, ...]
    picture: Picture | None = None


@dataclass(frozen=True)
class _Made:
    """Packed Gaussians and what they were made for."""

    scene: ViewportShot
    level: int
    seen: tuple[sources.Seen, ...]
    packed: Packed
    messages: tuple[str, ...]


class SplatJobs(LatestRequestThread[SplatRequest, Drawable]):
    """Makes what the newest request needs; see the module."""

    thread_name = "GRMM splats"

    def __init__(
        self,
        clock: Callable[[], float] = time.perf_counter,
        wait_for_rest: WaitForRest | None = None,
    ) -> None:
        """Prepare; nothing runs before the first request.

        Args:
            clock: Seconds.
            wait_for_rest: Called before full detail is made with a function that says whether there is something newer;
                returns when the view has rested or there is. None waits `REST_SECONDS`.
        """
        super().__init__(REST_SECONDS, wait_for_rest)
        self.pace = Pace()
        self._clock = clock
        self._made: _Made | None = None  # of the thread
        self._parts: dict[int, tuple[AvatarShot, int, sources.Seen, arrays.WorldGaussians]] = {}  # of the thread

    def of(self, request: SplatRequest, seconds: float) -> Drawable | None:
        """Take the newest, after waiting for what a request asks for; that may be another's where it does not come in time."""
        with self._changed:
            self._changed.wait_for(
                lambda: self._thread is None or (self._result is not None and self._result.request is request), seconds
            )
        return self.take()

    def _failed(self, request: SplatRequest, error: Exception) -> None:
        _log.error("The viewport's splats failed.", exc_info=error)
        self._put(_nothing(request, f"Splats cannot be shown ({type(error).__name__}: {error})."))

    def _serve(self, request: SplatRequest) -> bool:
        if request.level == PICTURE:
            self._put(self._picture(request))
            return True
        made = self._made
        if made is not None and self._goes_along(made, request):
            made = None  # the viewport moves what it has: coarser ones would be no better
        else:
            if made is None or not self._serves(made, request, request.level):
                made = self._make(request, request.level)
            self._show(made, request)
        if request.playing:
            return True
        self._wait_for_rest(lambda: self._wanted is not request)
        if self._wanted is request and (made is None or not self._serves(made, request, request.finest, resting=True)):
            self._show(self._make(request, request.finest), request)
        return True

    def _goes_along(self, made: _Made, request: SplatRequest) -> bool:
        """Whether Gaussians show a request by a rigid movement, as of a rig that is dragged, finer than it asks for."""
        if request.playing or made.level > request.level or sources.moved_since(made.scene, request.scene) is None:
            return False
        pairs = zip(made.scene.shots, request.scene.shots, strict=True)
        placed = all(same_shot(dataclasses.replace(one, model_to_world=other.model_to_world), other) for one, other in pairs)
        return placed and self._seen_alike(made, request)

    def _serves(self, made: _Made, request: SplatRequest, level: int, resting: bool = False) -> bool:
        """Whether Gaussians fit a request; finer ones than needed do while the view moves."""
        if made.scene.shots is not request.scene.shots or made.level > level or (resting and made.level != level):
            return False
        return self._seen_alike(made, request, resting)

    def _seen_alike(self, made: _Made, request: SplatRequest, resting: bool = False) -> bool:
        """Whether colors and close-up are those of the request's view, or nearly."""
        limits = (RESTING_DEGREES, RESTING_SPREAD) if resting else (MOVING_DEGREES, MOVING_SPREAD)
        pairs = zip(made.seen, request.scene.shots, strict=True)
        return all(seen.near(sources.seen_by(shot, request.camera), *limits) for seen, shot in pairs)

    def _make(self, request: SplatRequest, level: int) -> _Made:
        started = self._clock()
        found, messages = [], [request.scene.message] if request.scene.message else []
        views = tuple(sources.seen_by(shot, request.camera) for shot in request.scene.shots)
        parts = {}
        for index, (shot, seen) in enumerate(zip(request.scene.shots, views, strict=True)):
            known = self._parts.get(index)
            if known is not None and known[1] == level and same_shot(known[0], shot) and known[2].near(seen, 0.0, 0.0):
                part = known[3]
            else:
                try:
                    part = sources.world_gaussians(shot, request.camera, level)
                except GrmmError as error:
                    messages.append(str(error) if shot.name in str(error) else f"{shot.name}: {error}")
                    continue
            parts[index] = (shot, level, seen, part)
            found.append(part)
        self._parts = parts
        packed = arrays.pack(arrays.WorldGaussians.concatenate(found))
        self.pace.record(level, self._clock() - started)
        self._made = _Made(request.scene, level, views, packed, tuple(messages))
        return self._made

    def _picture(self, request: SplatRequest) -> Drawable:
        started = self._clock()
        try:
            picture = sources.small_picture(request.scene.shots, request.camera)
        except GrmmError as error:
            return _nothing(request, str(error))
        self.pace.record(PICTURE, self._clock() - started)
        return dataclasses.replace(_nothing(request, request.scene.message), picture=picture)

    def _show(self, made: _Made, request: SplatRequest) -> None:
        order = arrays.depth_order(made.packed, request.camera)
        self._put(Drawable(made.packed, order, request, made.level, made.messages))


def _nothing(request: SplatRequest, message: str) -> Drawable:
    """What is drawn where there are no Gaussians."""
    empty = arrays.pack(arrays.WorldGaussians.concatenate([]))
    messages = (message,) if message else ()
    return Drawable(empty, arrays.depth_order(empty, request.camera), request, request.level, messages)


def same_shot(one: AvatarShot, other: AvatarShot) -> bool:
    """Whether two shots have the same Gaussians in the world."""
    if (one.source, one.cloud and (one.cloud.key, one.cloud.version)) != (
        other.source,
        other.cloud and (other.cloud.key, other.cloud.version),
    ) or not np.array_equal(one.model_to_world, other.model_to_world):
        return False
    if one.hair is not other.hair or one.strands is not other.strands or one.note != other.note:
        return False
    return _light_key(one) == _light_key(other) and one.controls.key() == other.controls.key()


def _light_key(shot: AvatarShot) -> tuple[object, ...]:
    """What light a shot's colors depend on."""
    if shot.lighting is None:
        return ()
    around = shot.lighting.surroundings
    return repr(shot.lighting.lamps), shot.lit_by_view, shot.response, b"" if around is None else around.coefficients.tobytes()
