"""The Blender half of the extension: registration only; every topic lives in a module of its own.

=================  ======================================================================================
``compat``         differences between Blender versions, found by feature
``session_host``   the one model session of this process (in-process, or a worker interpreter)
``preferences``    the extension's preferences: runtime, diagnostics
``properties``     properties of avatars and scenes
``avatar`` ``rig``  the avatar as a Python object; armature, shape keys, drivers
``splats``         splat clouds: imported splat files and other projects' avatars
``handlers``       frame change, load and save
``panels``         user interface
``engine``         the GRMM render engine
``production``     composites, pose library, turntables, contact sheets, presets, menus, translations
``viewport``       drawing splats in the 3D viewport
``newest``         work on a thread for the newest of many requests
``fitting``        avatars from photos: job, panel
``..operators``    operators, one topic a file
=================  ======================================================================================

A module in `MODULES` exports `CLASSES` (Blender classes in registration order) and may have `register()` and
`unregister()` for everything else. Nothing here imports torch or numba; `grmm_core` is reached by relative import only.
"""

from __future__ import annotations

import atexit
import importlib
from types import ModuleType

import bpy

# Order of registration: what others refer to comes first.
MODULES = (
    ".preferences",
    ".properties",
    ".splats.properties",
    "..operators",
    ".panels",
    ".engine",
    ".viewport",
    ".fitting",
    ".production",
    ".handlers",
    ".session_host",
)

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
    """Unregister what is registered, last first; harmless when nothing is."""
    atexit.unregister(unregister)
    while _registered:
        module, classes = _registered.pop()
        if hasattr(module, "unregister"):
            module.unregister()
        for cls in reversed(classes):
            bpy.utils.unregister_class(cls)


def _register_module(module: ModuleType) -> None:
    done: list[type] = []
    try:
        for cls in module.CLASSES:
            bpy.utils.register_class(cls)
            done.append(cls)
        if hasattr(module, "register"):
            module.register()
    except BaseException:
        for cls in reversed(done):
            bpy.utils.unregister_class(cls)
        raise
    _registered.append((module, tuple(done)))
