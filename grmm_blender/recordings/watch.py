"""Follows the one recording that this Blender works on: a timer redraws the panel, and keys the head when it is done.

In background mode there are no timers: the operator waits and calls `finish` itself.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from textwrap import shorten

import bpy
from bpy.app.handlers import persistent

from ...grmm_core.errors import GrmmError
from ...grmm_core.formats import format_to_read
from .. import events, windows
from ..compat import heard_from, show_in_sequencers, strip_start, trim_strip
from ..exporting import performer_of
from ..performance import ImportedRange, ImportOptions, apply_performance
from .job import RecordingJob, RecordingStatus, Request

_POLL_SECONDS = 0.3
_SOUND_CHANNEL = 1
_SHOWN_WORDS = 200  # characters
_EVERY_FRAME, _WITH_SOUND = "NONE", "AUDIO_SYNC"  # how a scene is played
_SOUND_KEY = "grmm_sound"  # of an action: names of the strips that are heard with it, a line each
_REPLACES = ("KEEP", "WRITE_INTO")  # what becomes of old keys where they are not played any more, or not all of them
_log = logging.getLogger(__name__)


@dataclass
class _Watched:
    """The running or last job.

    Attributes:
        job: Itself.
        request: What it was asked.
        target: `session_uid` of the head that takes it: it outlives undo, and names nothing where the head is gone.
        options: How it becomes keys.
        set_range: Let the scene start and end with it.
        sound: Put the recording's sound into the sequencer.
        message: Of the step of undo.
        note: One sentence about it once it has ended, or "".
        is_from_another_file: Whether another .blend file was opened since.
    """

    job: RecordingJob
    request: Request
    target: int
    options: ImportOptions
    set_range: bool
    sound: bool
    message: str
    note: str = ""
    is_from_another_file: bool = False


_watched: _Watched | None = None


def start(
    job: RecordingJob, request: Request, head: bpy.types.Object, options: ImportOptions, *, set_range: bool, sound: bool,
    message: str,
) -> None:  # fmt: skip
    """Follow a job for a head. There is one at a time."""
    global _watched
    _watched = _Watched(job, request, head.session_uid, options, set_range, sound, message)
    if not bpy.app.background and not bpy.app.timers.is_registered(_poll):
        bpy.app.timers.register(_poll, first_interval=_POLL_SECONDS, persistent=True)


def current() -> RecordingJob | None:
    """The running or last job."""
    return None if _watched is None else _watched.job


def is_running() -> bool:
    """Whether one runs."""
    return _watched is not None and _watched.job.running


def note() -> str:
    """One sentence about the last one, or ""."""
    return "" if _watched is None else _watched.note


def finish(context: bpy.types.Context) -> str:
    """Key the head with what an ended job made, as one step to undo; returns a sentence about it or raises a `GrmmError`."""
    if _watched is None:
        raise GrmmError("There is no performance; import a video or a voice.")
    try:
        _watched.note = _keyed(context, _watched)
    except GrmmError as error:
        _watched.note = str(error)
        raise
    return _watched.note


def _keyed(context: bpy.types.Context, watched: _Watched) -> str:
    ended, name = watched.job.status, watched.request.recording.name
    if watched.is_from_another_file:
        raise GrmmError(f"The work on {name} was cancelled, for another file was opened; import it there again.")
    if ended.state != "done":
        raise GrmmError(ended.message)
    path = Path(ended.performance)
    head = next((obj for obj in bpy.data.objects if obj.session_uid == watched.target), None)
    performer = performer_of(head)
    scenes = () if head is None else head.users_scene
    if performer is None or not scenes:
        raise GrmmError(f"The head is in no scene any more; its performance is kept in {path} until Blender is closed.")
    performance = format_to_read(path, "performance").read(path)
    before = _action_of(head)
    written = apply_performance(performer, performance, watched.options, watched.request.recording.stem)
    scene = context.scene if context.scene in scenes else scenes[0]  # the window may show another one by now
    if watched.set_range:
        written.set_range(scene)
    put_aside = before if before is not None and watched.options.present == "KEEP" else None
    old = before.get(_SOUND_KEY, "").split("\n") if before is not None and watched.options.present in _REPLACES else []
    sounds = watched.sound and _add_sound(scene, watched, written, head, old)
    scene.frame_set(scene.frame_current, subframe=scene.frame_subframe)
    if bpy.ops.ed.undo_push.poll():
        bpy.ops.ed.undo_push(message=watched.message)
    return _said(written, ended, sounds, put_aside)


def _action_of(obj: bpy.types.Object) -> bpy.types.Action | None:
    return None if obj.animation_data is None else obj.animation_data.action


def _said(written: ImportedRange, ended: RecordingStatus, sounds: bool, put_aside: bpy.types.Action | None) -> str:
    sound = ", with its sound in the sequencer" if sounds else ""
    words = f" Heard: {shorten(ended.heard, _SHOWN_WORDS)}." if ended.heard else ""
    kept = f' What was keyed before is kept in the action "{put_aside.name}".' if put_aside is not None else ""
    return f"Frames {written.first:g} to {written.last:g} are keyed{sound}.{words}{kept} {ended.message}".rstrip()


def _add_sound(
    scene: bpy.types.Scene, watched: _Watched, written: ImportedRange, head: bpy.types.Object, old: list[str]
) -> bool:
    """Put the sound where the performance starts, on a channel that is free; returns whether there is any.

    What is replaced is not heard any more, for two voices at once are nobody's, and another try with a recording plays the
    sound that is there.

    Args:
        scene: Of the head.
        watched: The job.
        written: What was keyed.
        head: It.
        old: Names of the strips that were heard with what it was keyed with before.
    """
    options, request = watched.options, watched.request
    strips = scene.sequence_editor_create().strips
    skipped = round(request.start * options.fps)
    start = round(options.start) - skipped
    before = [strips[name] for name in old if name in strips]
    strip = next((one for one in before if _plays(one, request.recording, start)), None)
    if strip is None:
        channel = max((one.channel for one in strips), default=_SOUND_CHANNEL - 1) + 1
        try:
            strip = strips.new_sound(request.recording.stem, str(request.recording), channel, start)
        except RuntimeError:  # a video without sound
            return False
    trim_strip(strip, skipped, None if request.end is None else round(request.end * options.fps))
    replaces_all = options.present == "KEEP"
    for other in before:
        if other != strip and (replaces_all or written.first <= heard_from(other) < written.last):
            other.mute = True
    kept = [] if replaces_all else old
    action = _action_of(head)
    if action is not None:
        action[_SOUND_KEY] = "\n".join(dict.fromkeys([*kept, strip.name]))
    show_in_sequencers(scene)
    if scene.sync_mode == _EVERY_FRAME:  # lips fall behind the sound where frames take their time
        scene.sync_mode = _WITH_SOUND
    return True


def _plays(strip: bpy.types.Strip, recording: Path, start: int) -> bool:
    """Whether a strip plays the sound of a recording that begins at a frame."""
    sound = getattr(strip, "sound", None)
    return sound is not None and Path(bpy.path.abspath(sound.filepath)) == recording and strip_start(strip) == start


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
        _log.warning("recording: %s", error)
    windows.redraw_sidebars()
    return None


_EVENTS = ((bpy.app.handlers.load_post, _on_load),)
