"""Following Blender's events, and stopping."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import bpy

Events = Iterable[tuple[list[Callable[..., object]], Callable[..., object]]]
"""Lists of `bpy.app.handlers`, each with the function that it is to call."""


def follow(events: Events) -> None:
    """Have the functions called."""
    for handlers, function in events:
        handlers.append(function)


def stop(events: Events = (), timers: Iterable[Callable[[], float | None]] = ()) -> None:
    """Have the functions called no more, nor these timers."""
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
