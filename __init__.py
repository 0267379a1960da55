"""GRMM for Blender: the extension's entry point, and the table of what it registers.

Blender imports this module from the installed extension. Everything else is imported inside the functions, because Python
tools that walk the repository import this file where there is no bpy.

A module of the table exports `CLASSES` (Blender's classes in registration order). For everything else it may have `register()`
and `unregister()`; a package names its modules that have them in `PARTS`, in the order of registration.
"""

from __future__ import annotations

import atexit
import importlib
from types import ModuleType

MODULES = (
    ".grmm_blender.preferences",
    ".grmm_blender.properties",
    ".grmm_blender.splats.properties",
    ".grmm_blender.motion",
    ".grmm_blender.composite",
    ".operators",
    ".grmm_blender.engine",
    ".grmm_blender.viewport",
    ".grmm_blender.preset_menus",
    ".grmm_blender.panels",
    ".grmm_blender.fitting",
    ".grmm_blender.recordings",
    ".grmm_blender.menus",
    ".grmm_blender.translations",
    ".grmm_blender.moved_files",
    ".grmm_blender.handlers",
    ".grmm_blender.session_host",
)
"""In the order of registration: what others refer to comes first."""

_registered: list[tuple[ModuleType, tuple[type, ...]]] = []


def register() -> None:
    """Register all modules; when one fails, take back those before it and let the error out.

    Everything also goes when the process ends: Blender 4.5 hangs at exit with a render engine registered, and a worker
    process must not stay behind.
    """
    atexit.register(unregister)
    try:
        for name in MODULES:
            _register_module(importlib.import_module(name, __package__))
    except BaseException:
        unregister()
        raise


def unregister() -> None:
    """Unregister what is registered, last first, and close the model's session; harmless when nothing is."""
    import bpy

    atexit.unregister(unregister)
    while _registered:
        module, classes = _registered.pop()
        for part in reversed(_parts(module)):
            if hasattr(part, "unregister"):
                part.unregister()
        for cls in reversed(classes):
            bpy.utils.unregister_class(cls)


def _parts(module: ModuleType) -> tuple[ModuleType, ...]:
    return getattr(module, "PARTS", (module,))


def _register_module(module: ModuleType) -> None:
    import bpy

    done: list[type] = []
    try:
        for cls in module.CLASSES:
            bpy.utils.register_class(cls)
            done.append(cls)
        for part in _parts(module):
            if hasattr(part, "register"):
                part.register()
    except BaseException:
        for cls in reversed(done):
            bpy.utils.unregister_class(cls)
        raise
    _registered.append((module, tuple(done)))
