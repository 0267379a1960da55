"""Follows the one fit of this Blender: a timer redraws the panel, and puts the finished avatar into the scene.

In background mode there are no timers: the operator waits and calls `finish` itself.
"""

from __future__ import annotations

import logging
from pathlib import Path

import bpy
import bpy.utils.previews

from ...grmm_core.avatar import read_avatar_header
from ...grmm_core.errors import GrmmError
from .job import FitJob, FitRequest, FitStatus
from .photo_camera import add_photo_camera
from .settings import settings

_POLL_SECONDS = 0.3
_POLL = ".poll()"  # stands before the reason why an operator cannot run now

_log = logging.getLogger(__name__)
_job: FitJob | None = None
_request: FitRequest | None = None
_note = ""  # what went wrong or right after the job
_added = False  # whether the finished avatar is in the scene
_pictures: bpy.utils.previews.ImagePreviewCollection | None = None
_shown: dict[str, float] = {}  # pictures in the collection by path, with their file's time


def start(job: FitJob, request: FitRequest) -> None:
    """Follow a job. There is one at a time."""
    global _job, _request, _note, _added
    _job, _request, _note, _added = job, request, "", False
    if not bpy.app.background and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=_POLL_SECONDS)


def job() -> FitJob | None:
    """The running or last job."""
    return _job


def request() -> FitRequest | None:
    """What it was asked."""
    return _request


def status() -> FitStatus | None:
    """Where the running or last job stands."""
    return None if _job is None else _job.status


def note() -> str:
    """One sentence about the last job, or ""."""
    return _note


def finish(context: bpy.types.Context) -> str:
    """Use the result of an ended job; returns one sentence about it, and raises `GrmmError` where there is none."""
    global _note
    ended = _job.status
    if _request.output is None:
        _take_found(context, ended)  # of a wrong choice, too: the picture shows which faces there are
    if ended.state != "done":
        _note = ended.message
        raise GrmmError(ended.message)
    if _request.output is None:
        _note = "Check the faces and the outline, then fit."
        return _note
    return add_finished(context)


def finished() -> bool:
    """Whether there is a finished avatar that is not in the scene."""
    return _job is not None and _job.status.state == "done" and _request.output is not None and not _added


def add_finished(context: bpy.types.Context) -> str:
    """Put the finished avatar into the scene; returns one sentence about it. Raises `GrmmError`."""
    global _note, _added
    avatar = _job.status.avatar
    try:
        header = read_avatar_header(avatar)
        bpy.ops.grmm.add_head("EXEC_DEFAULT", True, person="FILE", filepath=avatar)
    except (GrmmError, RuntimeError) as error:  # RuntimeError: what an operator reports, or that it cannot run now
        reason = " ".join(str(error).replace("Error:", "").rpartition(_POLL)[2].split()).rstrip(".")
        _note = f"The avatar is written, but it cannot be added to the scene ({reason}); press Add to Scene then."
        raise GrmmError(_note) from error
    _added = True
    head = context.object
    if header.camera is not None:
        add_photo_camera(context, head, _request.photos[0], header.camera)
    _keep_thumbnail(head, Path(avatar), header.thumbnail)
    _note = f"{header.name} is in the scene, with a camera that shows the photo."
    return _note


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
        _pictures.load(path, path, "IMAGE")
        _shown[path] = changed
    return _pictures[path].icon_id


def unregister() -> None:
    """End the job and forget the pictures."""
    global _job, _request, _note, _added, _pictures
    if bpy.app.timers.is_registered(_poll):
        bpy.app.timers.unregister(_poll)
    if _job is not None:
        _job.cancel()
        _job.wait(1.0)
    if _pictures is not None:
        bpy.utils.previews.remove(_pictures)
    _job, _request, _note, _added, _pictures = None, None, "", False, None
    _shown.clear()


def _take_found(context: bpy.types.Context, ended: FitStatus) -> None:
    chosen = [photo for photo in settings(context).photos if photo.path]
    for photo, (_, faces), picture in zip(chosen, ended.faces, ended.found, strict=False):
        photo.faces, photo.found = faces, picture


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
    global _note
    manager = bpy.context.window_manager
    windows = manager.windows if manager is not None else ()
    for window in windows:
        for area in window.screen.areas:
            if area.type == "VIEW_3D":
                area.tag_redraw()
    if _job is None or _job.running:
        return _POLL_SECONDS if _job is not None else None
    if not windows:
        return None
    area = next((a for a in windows[0].screen.areas if a.type == "VIEW_3D"), None)
    with bpy.context.temp_override(window=windows[0], area=area):
        try:
            finish(bpy.context)
        except GrmmError as error:
            _note = str(error)
            _log.warning("fit: %s", error)
    return None
