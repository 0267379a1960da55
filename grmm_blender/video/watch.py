"""Follows the one capture of this Blender: a timer redraws the panel, and keys the head when it is done.

In background mode there are no timers: the operator waits and calls `finish` itself.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import bpy
from bpy.app.handlers import persistent

from ...grmm_core.errors import GrmmError
from ...grmm_core.formats import format_to_read
from ...grmm_core.video.request import TrackRequest
from .. import events, windows
from ..compat import trim_strip
from ..exporting import performer_of
from ..performance import ImportedRange, ImportOptions, apply_performance
from .job import TrackJob

_POLL_SECONDS = 0.3
_SOUND_CHANNEL = 1
_log = logging.getLogger(__name__)


@dataclass
class _Watched:
    """The running or last capture.

    Attributes:
        job: Itself.
        request: What it was asked.
        target: `session_uid` of the head that takes it: it outlives undo, and names nothing where the head is gone.
        options: How it becomes keys.
        set_range: Let the scene start and end with it.
        sound: Put the video's sound into the sequencer.
        note: One sentence about it once it has ended, or "".
        is_from_another_file: Whether another .blend file was opened since.
    """

    job: TrackJob
    request: TrackRequest
    target: int
    options: ImportOptions
    set_range: bool
    sound: bool
    note: str = ""
    is_from_another_file: bool = False


_watched: _Watched | None = None


def start(
    job: TrackJob, request: TrackRequest, head: bpy.types.Object, options: ImportOptions, *, set_range: bool, sound: bool
) -> None:
    """Follow a capture for a head. There is one at a time."""
    global _watched
    _watched = _Watched(job, request, head.session_uid, options, set_range, sound)
    if not bpy.app.background and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=_POLL_SECONDS, persistent=True)


def current() -> TrackJob | None:
    """The running or last capture."""
    return None if _watched is None else _watched.job


def is_running() -> bool:
    """Whether a capture runs."""
    return _watched is not None and _watched.job.running


def note() -> str:
    """One sentence about the last capture, or ""."""
    return "" if _watched is None else _watched.note


def finish(context: bpy.types.Context) -> str:
    """Key the head with an ended capture, as one step to undo; returns a sentence about it, or raises it as a `GrmmError`."""
    if _watched is None:
        raise GrmmError("There is no capture; import a video.")
    try:
        _watched.note = _keyed(context, _watched)
    except GrmmError as error:
        _watched.note = str(error)
        raise
    return _watched.note


def _keyed(context: bpy.types.Context, watched: _Watched) -> str:
    ended, name = watched.job.status, watched.request.video.name
    if watched.is_from_another_file:
        raise GrmmError(f"The capture of {name} was cancelled, for another file was opened; import the video there again.")
    if ended.state != "done":
        raise GrmmError(ended.message)
    path = Path(ended.performance)
    head = next((obj for obj in bpy.data.objects if obj.session_uid == watched.target), None)
    performer = performer_of(head)
    scenes = () if head is None else head.users_scene
    if performer is None or not scenes:
        raise GrmmError(f"The head is in no scene any more; its performance is kept in {path} until Blender is closed.")
    performance = format_to_read(path, "performance").read(path)
    written = apply_performance(performer, performance, watched.options, watched.request.video.stem)
    scene = context.scene if context.scene in scenes else scenes[0]  # the window may show another one by now
    if watched.set_range:
        written.set_range(scene)
    heard = watched.sound and _add_sound(scene, watched)
    scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    if bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message="Import Video")
    return _said(written, ended.message, heard)


def _said(written: ImportedRange, message: str, heard: bool) -> str:
    sound = ", with its sound in the sequencer" if heard else ""
    return f"Frames {written.first:g} to {written.last:g} are keyed{sound}. {message}".rstrip()


def _add_sound(scene: bpy.types.Scene, watched: _Watched) -> bool:
    """Put the sound where the performance starts, on a channel that is free; returns whether there is any."""
    options, video = watched.options, watched.request.video
    strips = scene.sequence_editor_create().strips
    channel = max((strip.channel for strip in strips), default=_SOUND_CHANNEL - 1) + 1
    skipped = round(watched.request.start * options.fps)
    try:
        strip = strips.new_sound(video.stem, str(video), channel, round(options.start) - skipped)
    except RuntimeError:  # a video without sound
        return False
    trim_strip(strip, skipped)
    return True


def register() -> None:
    """Hear of other files."""
    events.follow(_EVENTS)


def unregister() -> None:
    """End the job."""
    global _watched
    events.stop(_EVENTS, (_poll,))
    if _watched is not None:
        _watched.job.cancel()
        _watched.job.wait(1.0)
    _watched = None


@persistent
def _on_load(*_: object) -> None:
    """Another file, where no head waits: the capture ends. What was said of one that had ended belongs to the file before."""
    global _watched
    if _watched is None or _watched.note:
        _watched = None
        return
    _watched.is_from_another_file = True
    _watched.job.cancel()


def _poll() -> float | None:
    """Timer while a job runs."""
    windows.redraw_sidebars()
    if _watched is None:
        return None
    if _watched.job.running:
        return _POLL_SECONDS
    try:
        windows.in_viewport(finish)
    except GrmmError as error:
        _log.warning("capture: %s", error)
    windows.redraw_sidebars()
    return None


_EVENTS = ((bpy.app.handlers.load_post, _on_load),)
