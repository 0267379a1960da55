"""The GRMM render engine (`bl_idname` "GRMM"): stills, animations, the rendered viewport.

``render_engine``  the RenderEngine class; every method delegates
``settings``       scene and view-layer settings of the engine, and its panels in the render properties
"""

from __future__ import annotations

import atexit

from . import render_engine

CLASSES = (*render_engine.CLASSES,)


def register() -> None:
    """Arrange for the engine to go before Blender's Python does: Blender 4.5 hangs at exit with an engine registered."""
    atexit.unregister(render_engine.unregister_at_exit)
    atexit.register(render_engine.unregister_at_exit)


def unregister() -> None:
    """Take back `register`."""
    atexit.unregister(render_engine.unregister_at_exit)
