"""Follows the one fit of this Blender: a timer redraws the panel, and puts the finished avatar into the scene.

In background mode there are no timers: the operator waits and calls `finish` itself.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import bpy
import bpy.utils.previews
from bpy.app.handlers import persistent

from ...grmm_core.avatar import read_avatar_header
from ...grmm_core.errors import GrmmError
from ...grmm_core.fitting.request import FacesRequest, FitRequest
from ...grmm_core.jobs.stages import FIND_FACES, FIT, JobStages
from .. import events, staging, windows
from ..rig.avatar import Avatar, stored_path
from ..rig.build import build_avatar
from ..rig.identity import read_identity
from ..scene.avatars import avatars_in
from .job import FitJob, FitStatus
from .photo_camera import add_photo_camera
from .settings import settings

_POLL_SECONDS = 0.3
_BESIDE = 0.4  # metres between heads that stand beside each other

_log = logging.getLogger(__name__)


@dataclass
class _Watched:
    """The running or last job.

    Attributes:
        job: Itself.
        request: What it was asked.
        note: One sentence about it once it has ended, or "".
        is_added: Whether the finished avatar is in the scene.
        is_from_another_file: Whether another .blend file was opened since.
    """

    job: FitJob
    request: FitRequest | FacesRequest
    note: str = ""
    is_added: bool = False
    is_from_another_file: bool = False


_watched: _Watched | None = None
_pictures: bpy.utils.previews.ImagePreviewCollection | None = None
_shown: dict[str, float] = {}  # pictures in the collection by path, with their file's time


def start(job: FitJob, request: FitRequest | FacesRequest) -> None:
    """Follow a job. There is one at a time."""
    global _watched
    _watched = _Watched(job, request)
    if not bpy.app.background and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=_POLL_SECONDS, persistent=True)


def _current() -> _Watched:
    if _watched is None:
        raise GrmmError("There is no fit; choose photos and make an avatar.")
    return _watched


def job() -> FitJob:
    """The running or last job. Raises `GrmmError` where there is none."""
    return _current().job


def is_running() -> bool:
    """Whether a job runs."""
    return _watched is not None and _watched.job.running


def stages() -> JobStages:
    """Of the running or last job. Raises `GrmmError` where there is none."""
    return FIND_FACES if isinstance(_current().request, FacesRequest) else FIT


def note() -> str:
    """One sentence about the last job, or ""."""
    return "" if _watched is None else _watched.note


def finish(context: bpy.types.Context) -> str:
    """Use the result of an ended job; returns one sentence about it, and raises `GrmmError` where there is none."""
    watched, ended = _current(), job().status
    only_faces = isinstance(watched.request, FacesRequest)
    if only_faces:
        _take_faces(context, ended)  # of a wrong choice, too: the picture shows which faces there are
    if ended.state != "done":
        watched.note = ended.message
        raise GrmmError(ended.message)
    if only_faces:
        watched.note = "Check the faces and the outline, then fit."
        return watched.note
    if watched.is_from_another_file:
        watched.note = f"{Path(ended.avatar).name}, begun in another file, is finished; press Add to Scene to have it here."
        return watched.note
    return add_to_scene(context)


def waits_to_be_added() -> bool:
    """Whether there is a finished avatar that is not in the scene."""
    return _watched is not None and bool(_watched.job.status.avatar) and not _watched.is_added


def add_to_scene(context: bpy.types.Context) -> str:
    """Put the finished avatar into the scene, as one step to undo; returns one sentence about it. Raises `GrmmError`."""
    watched = _current()
    path = watched.job.status.avatar
    try:
        if context.mode != "OBJECT":
            raise GrmmError("go to object mode first")
        header = read_avatar_header(path)
        others, fresh = avatars_in(context.scene), staging.is_as_started(context.scene)
        avatar = build_avatar(context, stored_path(path), read_identity(path))
    except GrmmError as error:
        reason = str(error).rstrip(".")
        watched.note = f"The avatar is written, but it cannot be added to the scene ({reason}); press Add to Scene then."
        raise GrmmError(watched.note) from error
    watched.is_added = True
    if not (others or bpy.app.background):  # as *Add* does for somebody who watches
        staging.stand_up(avatar)
        if fresh:
            staging.set_up(context, avatar, fresh)
    moved = _stand_beside(avatar, others)
    if header.camera is not None:
        add_photo_camera(context, avatar.object, watched.request.photos[0], header.camera)
    _keep_thumbnail(avatar.object, Path(path), header.thumbnail)
    if bpy.ops.ed.undo_push.poll():  # of everything at once: a step from before the camera would take it away
        bpy.ops.ed.undo_push(message="Add Avatar from Photos")
    beside = ", beside the head that was there" if moved else ""
    left_out = watched.job.status.message
    watched.note = f"{header.name} is in the scene{beside}, with a camera that shows the photo. {left_out}".rstrip()
    return watched.note


def icon_of(path: str) -> int:
    """Icon of a picture file for `UILayout.template_icon`; read again when the file has changed. 0 where there is none."""
    global _pictures
    try:
        changed = Path(path).stat().st_mtime if path else 0.0
    except OSError:
        return 0
    if not path or bpy.app.background:
        return 0
    if _pictures is None:
        _pictures = bpy.utils.previews.new()
    if _shown.get(path) != changed:
        if path in _pictures:
            del _pictures[path]
        loaded = _pictures.load(path, path, "IMAGE")
        _shown[path] = changed
        _ = tuple(loaded.image_size)  # asked for, it is read now; else a spinner stands there until the next picture
    return _pictures[path].icon_id


def register() -> None:
    """Hear of other files."""
    events.follow(_EVENTS)


def unregister() -> None:
    """End the job and forget the pictures."""
    global _watched, _pictures
    events.stop(_EVENTS, (_poll,))
    if _watched is not None:
        _watched.job.cancel()
        _watched.job.wait(1.0)
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
    _watched = _pictures = None
    _shown.clear()


@persistent
def _on_load(*_: object) -> None:
    """Another file: what was said about the last job belongs to the file before; a running one goes on."""
    global _watched
    if is_running():
        _current().is_from_another_file = True
    else:
        _watched = None


def _stand_beside(avatar: Avatar, others: list[Avatar]) -> bool:
    """Move a new avatar to the side, level with the others, until none is over or under it; returns whether it moved."""
    places = [other.root.matrix_world.translation for other in others]
    moved, location = False, avatar.root.location
    while near := [place for place in places if (place - location).xy.length < _BESIDE / 2]:
        location.x += _BESIDE
        location.z = near[0].z
        moved = True
    return moved


def _take_faces(context: bpy.types.Context, ended: FitStatus) -> None:
    photos = [photo for photo in settings(context).photos if photo.path]
    for photo, faces in zip(photos, ended.faces, strict=False):
        photo.faces, photo.faces_picture = faces.count, faces.picture


def _keep_thumbnail(head: bpy.types.Object, path: Path, png: bytes) -> None:
    """Show the avatar's picture on its object in the outliner and asset browser."""
    if not png:
        return
    temporary = Path(bpy.app.tempdir) / f"{path.stem}.thumbnail.png"
    try:
        temporary.write_bytes(png)
    except OSError as error:
        _log.warning("no thumbnail: %s", error)
        return
    with bpy.context.temp_override(id=head):
        if bpy.ops.ed.lib_id_load_custom_preview.poll():
            bpy.ops.ed.lib_id_load_custom_preview(filepath=str(temporary))


def _poll() -> float | None:
    """Timer while a job runs."""
    windows.redraw_sidebars()
    if _watched is None or _watched.job.running:
        return _POLL_SECONDS if _watched is not None else None
    try:
        windows.in_viewport(finish)
    except GrmmError as error:
        _log.warning("fit: %s", error)
    windows.redraw_sidebars()
    return None


_EVENTS = ((bpy.app.handlers.load_post, _on_load),)
