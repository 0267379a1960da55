"""Following Blender's events, and stopping."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import bpy

Events = Iterable[tuple[list[Callable[..., object]], Callable[..., object]]]
"""Lists of `bpy.app.handlers`, each with the function that it is to call."""

Drawing = Iterable[tuple[Callable[[], None], str]]
"""What draws in 3D viewports, each with its turn: "POST_VIEW" or "POST_PIXEL"."""

_drawing: dict[Callable[[], None], object] = {}  # to what it is taken away by


def follow(events: Events, drawing: Drawing = ()) -> None:
    """Have the functions called; without windows there is nothing to draw."""
    for handlers, function in events:
        handlers.append(function)
    for draw, turn in () if bpy.app.background else drawing:
        _drawing[draw] = bpy.types.SpaceView3D.draw_handler_add(draw, (), "WINDOW", turn)


def stop(events: Events = (), timers: Iterable[Callable[[], float | None]] = (), drawing: Drawing = ()) -> None:
    """Have the functions called no more, nor these timers."""
    for draw, _ in drawing:
        if draw in _drawing:
            bpy.types.SpaceView3D.draw_handler_remove(_drawing.pop(draw), "WINDOW")
    for handlers, function in events:
        if function in handlers:
            handlers.remove(function)
    for timer in timers:
        if bpy.app.timers.is_registered(timer):
            bpy.app.timers.unregister(timer)


def later(function: Callable[[], float | None], seconds: float) -> None:
    """Have a function called by a timer, unless it waits for that already."""
    if not bpy.app.timers.is_registered(function):
        bpy.app.timers.register(function, first_interval=seconds)
