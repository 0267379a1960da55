"""Blender's events that avatars follow: frame changes, edits, undo, loading, the end of playback.

Each handler walks the avatars of its scene and delegates to `rig.live`. All are persistent: they stay when a file is loaded.
The model is only waited for where waiting is right: in renders, and in background Blender, where the next frame is rendered
from this state. In a window the first use starts the model in the background, and so it is left where another thread's
picture keeps it; a timer catches up.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterable

import bpy
from bpy.app.handlers import persistent

from ..grmm_core.errors import GrmmError, RuntimeMissingError
from . import events, session_host
from .engine.settings import ENGINE
from .hair import curve_sliders, display
from .rig import live, repaint
from .rig.avatar import Avatar, avatar_of
from .rig.channel_groups import group_channels
from .rig.left_rigs import LeftRigs
from .scene.avatars import avatars_in

CLASSES = ()

_CATCH_UP_SECONDS = 0.3
_SETTLE_SECONDS = 0.2
_left_rigs = LeftRigs()
_rendering = False  # between the start and the end of a render
_busy = False  # a handler of ours is writing; its own changes call the handlers again


@persistent
def _before_frame(scene: bpy.types.Scene, *_: object) -> None:
    depsgraph = _window_depsgraph(scene)
    for avatar in avatars_in(scene):
        live.predict(avatar, scene.frame_current_final, depsgraph)


@persistent
def _on_frame(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    playing = _is_playing()
    for avatar in avatars_in(scene):
        _left_rigs.note_place(avatar)
        wrote = _update(avatar, depsgraph, not playing or avatar.object.grmm.detail_in_playback, brief=True)
        if wrote and depsgraph.mode == "RENDER":
            _animate_again(avatar)
        if not (playing or bpy.app.background):
            events.later(_settle, _SETTLE_SECONDS)


@persistent
def _on_edit(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    if _busy or _is_playing():
        return
    if _left_rigs.notice_deleted() and not bpy.app.background:
        events.later(_remove_left_rigs, 0.0)  # not while the edit is being reported
    if any(isinstance(update.id, (bpy.types.Collection, bpy.types.Scene)) for update in depsgraph.updates):
        _drop_deleted_hair(scene)
    if any(isinstance(update.id, bpy.types.Action) for update in depsgraph.updates):
        for avatar in avatars_in(scene):
            group_channels(avatar)
    for avatar in _touched(depsgraph.updates):
        _left_rigs.note_place(avatar)
        _update(avatar, depsgraph)
    hair = _hair_of(scene, depsgraph.updates)
    for obj in hair:
        display.follow_mode(obj)
    if hair and bpy.app.background:
        _claim_hair()
    elif hair:
        events.later(_claim_hair, 0.0)


@persistent
def _on_other_state(*_: object) -> None:
    """Another file, point of the undo history, or runtime: what was written last says nothing about it."""
    for scene in bpy.data.scenes:
        _drop_deleted_hair(scene)
    live.forget()
    display.forget()
    _left_rigs.forget()
    _left_rigs.notice_deleted()
    if not bpy.app.background:
        events.later(_catch_up, _CATCH_UP_SECONDS)
    repaint.look_soon()


@persistent
def _on_playback_end(scene: bpy.types.Scene, depsgraph: bpy.types.Depsgraph) -> None:
    for avatar in avatars_in(scene):
        _update(avatar, depsgraph)


def _remove_left_rigs() -> None:
    _left_rigs.remove()


def _claim_hair() -> None:
    """Let the hair of heads that were duplicated follow their own sliders."""
    for avatar in avatars_in(bpy.context.scene):
        curves = avatar.object.grmm.hair.curves
        if curves is not None and curves.type == "CURVES" and curve_sliders.claim(curves, avatar.object):
            avatar.tag_edited()


def _window_depsgraph(scene: bpy.types.Scene) -> bpy.types.Depsgraph | None:
    """The evaluated scene that a frame change is for, as far as it is known: Blender does not say, and renders have another."""
    if _rendering or bpy.app.is_job_running("RENDER") or bpy.context.scene != scene:
        return None
    return bpy.context.view_layer.depsgraph


@persistent
def _on_render_start(*_: object) -> None:
    global _rendering
    _rendering = True
    _settle()


@persistent
def _on_render_end(*_: object) -> None:
    global _rendering
    _rendering = False


@persistent
def _settle(*_: object) -> None:
    """What only the evaluated scene has goes into the data: before files and renders, and a moment after a frame change."""
    for scene in bpy.data.scenes:
        _drop_deleted_hair(scene)
        for avatar in avatars_in(scene):
            live.settle(avatar)


def _drop_deleted_hair(scene: bpy.types.Scene) -> None:
    """Have heads whose curves were deleted wear the panel's groom; Blender keeps what a property names, in no collection."""
    for avatar in avatars_in(scene):
        hair = avatar.object.grmm.hair
        if hair.curves is not None and hair.curves.library is None and not hair.curves.users_collection:
            hair.curves = None
            avatar.tag_edited()


def _animate_again(avatar: Avatar) -> None:
    """Have the frame's animation evaluated once more after something was written.

    What was written is copied into the evaluated scene, and with it the original's controls. In the depsgraph of a render
    these are not those of the frame: only the window's own depsgraph hands animated values back to the originals.
    """
    for data in (avatar.object, avatar.object.data.shape_keys, avatar.armature):
        if data is not None:
            data.update_tag(refresh={"TIME"})


def _update(
    avatar: Avatar, depsgraph: bpy.types.Depsgraph | None, allow_detail: bool = True, brief: bool = False, patient: bool = True
) -> bool:
    global _busy
    problem = ""
    _busy = True
    try:
        with contextlib.ExitStack() as stack:
            detail = allow_detail
            if allow_detail and avatar.object.grmm.live_detail and not _may_wait(depsgraph):
                try:
                    detail = stack.enter_context(session_host.answering(avatar.source, patient))
                except RuntimeMissingError:
                    pass  # `live.update` meets it at once, and knows what to do
                except GrmmError as error:
                    detail, problem = False, str(error)
            wrote = live.update(avatar, depsgraph, detail, brief)
    finally:
        _busy = False
    if problem:
        live.note(avatar, problem)
    elif allow_detail and not detail and live.state_of(avatar).stale:
        events.later(_catch_up, _CATCH_UP_SECONDS)
    return wrote


def _touched(updates: Iterable[bpy.types.DepsgraphUpdate]) -> list[Avatar]:
    """Avatars whose head or armature was evaluated again."""
    found: dict[int, Avatar] = {}
    for update in updates:
        if isinstance(update.id, bpy.types.Object):
            avatar = avatar_of(update.id.original)
            if avatar is not None:
                found[avatar.key] = avatar
    return list(found.values())


def _hair_of(scene: bpy.types.Scene, updates: Iterable[bpy.types.DepsgraphUpdate]) -> list[bpy.types.Object]:
    """Curves that were evaluated again and are the hair of an avatar."""
    found = [update.id.original for update in updates if isinstance(update.id, bpy.types.Object) and update.id.type == "CURVES"]
    worn = {avatar.object.grmm.hair.curves for avatar in avatars_in(scene)} if found else set()
    return [obj for obj in found if obj in worn]


def _is_playing() -> bool:
    manager = bpy.context.window_manager
    return manager is not None and any(window.screen.is_animation_playing for window in manager.windows)


def _may_wait(depsgraph: bpy.types.Depsgraph | None) -> bool:
    """Whether the next picture is rendered from what is written now. A render in a window has a thread of its own.

    Nothing can end such a wait, and a model that has to be loaded and compiled takes long. So the first picture of our own
    engine, which draws Gaussians and not this mesh, does not wait here but in `engine.pipeline`, where Escape ends it.
    """
    if bpy.app.background:
        return True
    if not bpy.app.is_job_running("RENDER") or threading.current_thread() is threading.main_thread():
        return False
    return session_host.has_drawn() or depsgraph is None or depsgraph.scene.render.engine != ENGINE


def _catch_up() -> float | None:
    """Timer: update everything, again and again until the model has answered."""
    avatars = avatars_in(bpy.context.scene)
    for avatar in avatars:
        _update(avatar, None, patient=False)  # it comes again
    return _CATCH_UP_SECONDS if any(live.state_of(avatar).stale for avatar in avatars) else None


_EVENTS = (
    (bpy.app.handlers.frame_change_pre, _before_frame),
    (bpy.app.handlers.frame_change_post, _on_frame),
    (bpy.app.handlers.depsgraph_update_post, _on_edit),
    (bpy.app.handlers.load_post, _on_other_state),
    (bpy.app.handlers.save_pre, _settle),
    (bpy.app.handlers.render_init, _on_render_start),
    (bpy.app.handlers.render_complete, _on_render_end),
    (bpy.app.handlers.render_cancel, _on_render_end),
    (bpy.app.handlers.undo_post, _on_other_state),
    (bpy.app.handlers.redo_post, _on_other_state),
    (session_host.changed, _on_other_state),
    (bpy.app.handlers.animation_playback_post, _on_playback_end),
)


def register() -> None:
    """Follow Blender's events."""
    events.follow(_EVENTS)


def unregister() -> None:
    """Stop following them."""
    events.stop(_EVENTS, [_catch_up, _settle, _remove_left_rigs, _claim_hair])
    repaint.stop()
    live.forget()
