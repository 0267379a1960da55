"""The areas of Blender's windows, and drawing them again."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import bpy


def areas(*kinds: str) -> Iterator[bpy.types.Area]:
    """Yield the areas of all windows that show an editor of one of these kinds, such as "VIEW_3D"; none in background."""
    manager = bpy.context.window_manager
    for window in manager.windows if manager is not None else ():
        yield from (area for area in window.screen.areas if area.type in kinds)


def in_viewport(action: Callable[[bpy.types.Context], object]) -> None:
    """Do what a timer has to do as somebody in a 3D viewport would: timers have no window of their own."""
    area = next(areas("VIEW_3D"), None)
    with bpy.context.temp_override(window=bpy.context.window_manager.windows[0], area=area):
        action(bpy.context)


def redraw(*kinds: str) -> None:
    """Have all editors of these kinds drawn again."""
    for area in areas(*kinds):
        area.tag_redraw()


def redraw_viewports(*shadings: str) -> None:
    """Have all 3D viewports with one of these kinds of shading drawn again."""
    for area in areas("VIEW_3D"):
        if area.spaces.active.shading.type in shadings:
            area.tag_redraw()


def redraw_sidebars() -> None:
    """Have the sidebars of all 3D viewports drawn again, and not what is beside them: drawing a scene takes from who waits."""
    for area in areas("VIEW_3D"):
        for region in area.regions:
            if region.type == "UI":
                region.tag_redraw()
