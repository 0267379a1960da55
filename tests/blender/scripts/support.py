"""Helpers for scripts that run inside Blender: enable the extension, reach its modules, report results, clean scenes."""

from __future__ import annotations

import importlib
import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import bpy

MODULE = "bl_ext.user_default.grmm"

_results: dict[str, Any] = {}


def enable() -> ModuleType:
    """Enable the installed extension as Blender's preferences do; errors are raised, not printed."""
    import addon_utils

    def fail(error: BaseException) -> None:
        raise error

    module = addon_utils.enable(MODULE, default_set=True, handle_error=fail)
    if module is None:
        raise RuntimeError(f"{MODULE} could not be enabled; is it installed?")
    return module


def module(name: str) -> ModuleType:
    """Import a module of the installed extension, such as `grmm_core.session`."""
    return importlib.import_module(f"{MODULE}.{name}")


def report(**values: Any) -> None:
    """Hand JSON values back to the test (`BlenderRun.result`); later calls add to earlier ones."""
    _results.update(values)
    Path(os.environ["GRMM_TEST_RESULT"]).write_text(json.dumps(_results), "utf-8")


def empty_scene() -> bpy.types.Scene:
    """Start an empty file. Factory settings would disable the extension; a home file does not."""
    bpy.ops.wm.read_homefile(use_empty=True)
    return bpy.context.scene


def set_multilayer_exr(settings: bpy.types.ImageFormatSettings) -> None:
    """Choose 32-bit multilayer OpenEXR; 5.x wants the kind of media first."""
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    settings.color_depth = "32"


def heavy_modules() -> list[str]:
    """Modules that must not be loaded by registering."""
    return [name for name in ("torch", "numba", "scipy", "PIL") if name in sys.modules]
