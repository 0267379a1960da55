"""Blender's drawing callbacks and events: one `Viewport` for each 3D region, redraws when its thread has something new."""

from __future__ import annotations

import logging

import blf
import bpy
from bpy.app.handlers import persistent

from .. import events, session_host
from ..engine.settings import MESH_ALONE, shows_mesh_alone
from ..rig.avatar import locked_to_rig
from ..windows import redraw_viewports
from . import shaders, splat_view
from .bones import draw_bones
from .changes import CHANGES
from .settings import SHADINGS
from .splat_view import Viewport

_POLL_SECONDS = 0.01  # Blender hears of nothing from threads; looking so often costs it microseconds
_KEPT = 16  # viewports; those of closed windows are dropped beyond
_TEXT_SIZE, _TEXT_PLACE, _LINE_HEIGHT = 12, 20, 18  # pixels at interface scale 1
_LOWER_REGIONS = ("HUD", "ASSET_SHELF", "ASSET_SHELF_HEADER")
_TEXT_OPACITY = 0.85
_TRANSFORMS = "TRANSFORM_OT_"

_log = logging.getLogger(__name__)


_viewports: dict[int, Viewport] = {}


def statuses() -> list[str]:
    """Return what all viewports have to say, each sentence once; for the panel."""
    return list(dict.fromkeys(line for viewport in _viewports.values() for line in viewport.status()))


def _shown_viewport() -> Viewport | None:
    """Return the viewport of the region that Blender draws now, or None where splats are off."""
    context = bpy.context
    space = context.space_data
    if space is None or space.type != "VIEW_3D" or space.shading.type not in SHADINGS or context.region_data is None:
        return None
    settings = context.scene.grmm_viewport
    if not settings.use_splats or (space.shading.show_xray and space.shading.type == "SOLID"):
        return None
    key = context.region.as_pointer()
    if key not in _viewports:
        if len(_viewports) >= _KEPT:
            _drop_closed()
        _viewports[key] = Viewport()
    return _viewports[key]


def _drop_closed() -> None:
    manager = bpy.context.window_manager
    living = {region.as_pointer() for w in manager.windows for area in w.screen.areas for region in area.regions}
    for key in set(_viewports) - living:
        _viewports.pop(key).jobs.request(None)


def _draw_splats() -> None:
    viewport = _shown_viewport()
    if viewport is None or viewport.failed:
        return
    context = bpy.context
    try:
        viewport.draw(context, context.evaluated_depsgraph_get(), context.screen.is_animation_playing)
    except Exception as error:  # noqa: BLE001 - a card's shader compiler can refuse in many ways; say so once, not every draw
        _log.exception("The splat viewport failed.")
        viewport.fail(f"Splats cannot be drawn here ({type(error).__name__}: {error}).")
    if viewport.jobs.busy:
        events.later(_poll, _POLL_SECONDS)


def _draw_bones() -> None:
    if bpy.context.space_data.shading.type != "WIREFRAME":
        draw_bones(bpy.context, bpy.context.evaluated_depsgraph_get())


def _draw_status() -> None:
    context = bpy.context
    if not context.scene.grmm_viewport.use_status:
        return
    scale = context.preferences.system.ui_scale
    floor = _covered_height(context.area, context.region)
    blf.size(0, _TEXT_SIZE * scale)
    blf.color(0, *context.preferences.themes[0].view_3d.space.text_hi, _TEXT_OPACITY)  # as Blender's own words above
    for index, line in enumerate(_status(context)):
        blf.position(0, _TEXT_PLACE * scale, floor + (_TEXT_PLACE + _LINE_HEIGHT * index) * scale, 0)
        blf.draw(0, f"GRMM: {line}")


def _status(context: bpy.types.Context) -> list[str]:
    """What the corner of the present viewport says."""
    lines = _why_it_stays(context)
    if context.space_data.shading.type == "RENDERED":
        return [*lines, MESH_ALONE] if shows_mesh_alone(context.scene) else lines
    viewport = _shown_viewport()
    return lines if viewport is None else [*lines, *viewport.status()]


def _why_it_stays(context: bpy.types.Context) -> list[str]:
    """A sentence while heads are dragged whose channels are locked, for Blender says nothing then."""
    if not any(running.bl_idname.startswith(_TRANSFORMS) for running in context.window.modal_operators):
        return []
    rig = locked_to_rig(context.selected_objects)
    return [] if rig is None else [f'A head moves with its rig: select "{rig.name}"']


def _covered_height(area: bpy.types.Area, shown: bpy.types.Region) -> int:
    """Pixels at the lower edge of a viewport that other regions cover: the operator's options, the shelf of assets."""
    tops = [other.y + other.height - shown.y for other in area.regions if other.type in _LOWER_REGIONS and other.height > 1]
    return max([0, *tops])


def _poll() -> float | None:
    viewports = list(_viewports.values())
    more = any(viewport.jobs.busy for viewport in viewports)  # asked first, so that nothing that ends meanwhile goes unseen
    if any(viewport.jobs.has_news for viewport in viewports):
        redraw_viewports(*SHADINGS)
    return _POLL_SECONDS if more else None


@persistent
def _on_change(*_: object) -> None:
    CHANGES.scene += 1


@persistent
def _on_load(*_: object) -> None:
    _on_change()
    for viewport in _viewports.values():
        viewport.jobs.request(None)
    _viewports.clear()
    splat_view.forget()


def _on_runtime() -> None:
    """Another runtime: all that was asked of the one before is asked again."""
    _on_load()
    redraw_viewports(*SHADINGS)


_EVENTS = (
    (bpy.app.handlers.depsgraph_update_post, _on_change),
    (bpy.app.handlers.frame_change_post, _on_change),
    (bpy.app.handlers.undo_post, _on_change),
    (bpy.app.handlers.redo_post, _on_change),
    (bpy.app.handlers.load_post, _on_load),
    (session_host.changed, _on_runtime),
)
_DRAWING = ((_draw_splats, "POST_VIEW"), (_draw_bones, "POST_VIEW"), (_draw_status, "POST_PIXEL"))


def register() -> None:
    """Start drawing; without windows there is nothing to draw."""
    events.follow(_EVENTS, _DRAWING)


def unregister() -> None:
    """Take back `register`."""
    events.stop(_EVENTS, [_poll], _DRAWING)
    _on_load()
    shaders.forget()
