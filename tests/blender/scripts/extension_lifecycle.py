"""Register, disable and remove the extension, and report what a user would notice: extension_lifecycle.py."""

from __future__ import annotations

from pathlib import Path

import addon_utils
import bpy
from support import MODULE, enable, heavy_modules, module, report


def ours() -> list[str]:
    """Names of registered classes, properties and handlers of the extension."""
    found = [
        name
        for base in (bpy.types.Operator, bpy.types.Panel, bpy.types.PropertyGroup, bpy.types.RenderEngine,
                     bpy.types.AddonPreferences, bpy.types.Menu, bpy.types.UIList)
        for name in (cls.__name__ for cls in base.__subclasses__() if MODULE in cls.__module__ and cls.is_registered)
    ]  # fmt: skip
    for owner in (bpy.types.Scene, bpy.types.Object, bpy.types.WindowManager, bpy.types.ViewLayer, bpy.types.Armature):
        found += [f"{owner.__name__}.{name}" for name in dir(owner) if name.startswith("grmm")]
    for name in dir(bpy.app.handlers):
        handlers = getattr(bpy.app.handlers, name)
        if isinstance(handlers, list):
            found += [f"{name}:{h.__name__}" for h in handlers if MODULE in (getattr(h, "__module__", "") or "")]
    return found


def session() -> str:
    """What is said where a thread asks for the model."""
    try:
        module("grmm_blender.session_host").get_session()
    except Exception as error:  # noqa: BLE001 - of either copy of the core
        return str(error)
    return ""


enable()
report(
    heavy=heavy_modules(),
    registered=ours(),
    warnings=dict(addon_utils._extensions_warnings_get()),
)
addon_utils.disable(MODULE, default_set=True)
# A thread that is still at work must not start a worker whose libraries Blender takes away in this moment.
report(after_disable=ours(), session_while_off=session())
temporary = addon_utils.enable(MODULE)  # for this process only, as `blender --addons` does
report(temporary=ours(), device=module("grmm_blender.preferences").get().device if temporary else "")
addon_utils.disable(MODULE)
enable()
report(after_enable=ours(), session_while_on=session())
repo_index = next(i for i, r in enumerate(bpy.context.preferences.extensions.repos) if r.module == "user_default")
folder = Path(bpy.context.preferences.extensions.repos[repo_index].directory) / "grmm"
bpy.ops.extensions.package_uninstall(repo_index=repo_index, pkg_id="grmm")
report(after_uninstall=ours(), folder_left=folder.exists(), enabled=MODULE in bpy.context.preferences.addons)
