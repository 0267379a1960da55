"""Painting people of whom no file has a painting, once the model can draw them, and taking the studio's light off paintings.

Random people and avatars of earlier versions get a plain face when they are added, which waits for nothing. In a window a
thread then draws the person, after the viewport has its splats, and a timer puts the picture in the place of the plain one.
Taking the light off a file's painting compiles for seconds the first time, so the thread does that, too. Background Blender
does both at once, because what comes next is a render. Where nothing runs the model the plain face stays, marked, until a
Blender that can opens the file.
"""

from __future__ import annotations

import contextlib
import dataclasses
import logging

import bpy
import numpy as np

from ...grmm_core.avatar import AssetReference
from ...grmm_core.errors import GrmmError
from ...grmm_core.session.painter import painted
from .. import events, session_host
from ..latest_request import LatestRequestThread
from .avatar import Avatar
from .identity import load_head, read_identity
from .materials import add_materials, albedo, is_lit, is_plain, take_light_off

LOOK_SECONDS = 1.0
_PATIENCE = 10  # looks after which the model is started for the painting alone, where no viewport draws splats
_log = logging.getLogger(__name__)
_looks = 0
_failed: set[str] = set()  # sources that the model could not draw


class _Painter(LatestRequestThread[str, tuple[str, np.ndarray | None, np.ndarray | None]]):
    """Paints the person of a source, and takes the light off the painting."""

    thread_name = "GRMM painting"

    def _serve(self, request: str) -> bool:
        identity = read_identity(request)
        if identity.painting is None:
            identity = dataclasses.replace(identity, painting=_painting(request))
        self._put((request, identity.painting, albedo(identity)))
        return True

    def _failed(self, request: str, error: Exception) -> None:
        if not isinstance(error, GrmmError):
            _log.error("The mesh of %s could not be painted.", request, exc_info=error)
        self._put((request, None, None))


_painter = _Painter(LOOK_SECONDS)


def ask(avatar: Avatar) -> None:
    """Have an avatar painted that has just been given its materials, where its face is a plain one and a network knows it."""
    if not _waits(avatar):
        return
    if not bpy.app.background:
        look_soon()
        return
    try:
        _apply(avatar, _painting(avatar.source))
    except GrmmError:
        return  # the plain face stays; panels and renders say what is missing


def look_soon() -> None:
    """Look for unpainted avatars in a moment, unless that is going to happen already."""
    global _looks
    _looks = 0
    _failed.clear()
    if not bpy.app.background:
        events.later(_look, LOOK_SECONDS)
        return
    for avatar in map(Avatar, _heads()):
        if is_lit(avatar.object.data):  # saved in a window before the thread was done
            with contextlib.suppress(GrmmError):  # without its file the painting stays as it is
                take_light_off(avatar.object.data, albedo(read_identity(avatar.source)))


def stop() -> None:
    """Look no more."""
    _painter.request(None)
    events.stop(timers=[_look])


def _look() -> float | None:
    """Timer: put a painting in its place, or have one made when the model draws already."""
    global _looks
    if bpy.app.is_job_running("RENDER"):
        return LOOK_SECONDS  # not under a render that reads the materials
    found = _painter.take()
    waiting = list(filter(_waits, map(Avatar, _heads())))
    if found is not None:
        source, painting, flat = found
        for avatar in waiting:
            if painting is not None and avatar.source == source:
                _apply(avatar, painting, flat)
        _failed.update([source] if painting is None else [])
    left = [avatar for avatar in filter(_waits, waiting) if avatar.source not in _failed]
    lit = [avatar for avatar in left if is_lit(avatar.object.data)]  # wait for no model
    if not lit and not (left and session_host.runtime_status().available):
        return None
    _looks += 1
    if not _painter.busy and (lit or session_host.has_drawn() or _looks > _PATIENCE):
        _painter.request((lit or left)[0].source)
    return LOOK_SECONDS


def _waits(avatar: Avatar) -> bool:
    """Whether an avatar's mesh is still to be painted, or its painting to lose its light."""
    return is_lit(avatar.object.data) or (avatar.has_network and is_plain(avatar.object.data))


def _heads() -> list[bpy.types.Object]:
    heads = (obj for obj in bpy.data.objects if obj.type == "MESH" and obj.grmm.is_avatar)
    return [obj for obj in heads if obj.is_editable and obj.data.is_editable and obj.mode == "OBJECT"]


def _painting(source: str) -> np.ndarray:
    info = session_host.open_avatar(source)
    return painted(session_host.get_session(), info.id, load_head(AssetReference(info.head_name)))


def _apply(avatar: Avatar, painting: np.ndarray, flat: np.ndarray | None = None) -> None:
    if is_lit(avatar.object.data) and flat is not None:
        take_light_off(avatar.object.data, flat)
    else:
        add_materials(avatar.object.data, dataclasses.replace(read_identity(avatar.source), painting=painting), flat)
