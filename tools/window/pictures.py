"""Inside Blender: `blender --python tools/window/pictures.py -- FOLDER`. Writes FOLDER/*.png, then quits."""

from __future__ import annotations

import faulthandler
import os
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import bpy
import gpu

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.window import shims

faulthandler.enable()
FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
VIEW_SHARE = 0.52  # of the window's width, beside the panels
HIDDEN: dict[str, Any] = {}  # panels put away by `show_panels`
PAUSE = 1.0  # seconds between steps, in which Blender draws


def note(text: str) -> None:
    """Say where this stands."""
    print(f"pictures: {text}", flush=True)


def main() -> None:
    """Register the extension and run the steps by a timer, so that the window is drawn in between."""
    shims.install(Path(tempfile.mkdtemp(prefix="grmm-window-"))).register()
    if not hasattr(gpu.types.GPUShaderCreateInfo, "depth_write"):
        sys.modules[f"{shims.PACKAGE}.grmm_blender.viewport.overlay"].unregister()
    bpy.context.preferences.view.show_splash = False
    steps = scenario()

    def advance() -> float | None:
        try:
            return next(steps)
        except StopIteration:
            pass
        except Exception:  # noqa: BLE001 - the window must close whatever happens
            traceback.print_exc()
        bpy.ops.wm.quit_blender()
        return None

    bpy.app.timers.register(advance, first_interval=3.0)


def scenario() -> Iterator[float]:
    """Arrange, look, save; each yield lets Blender draw for that many seconds."""
    window = bpy.context.window_manager.windows[0]
    area = max((a for a in window.screen.areas if a.type == "VIEW_3D"), key=lambda a: a.width * a.height)
    region = next(r for r in area.regions if r.type == "WINDOW")
    space = area.spaces.active

    def inside(call: Callable[[], object], where: bpy.types.Area = area) -> None:
        with bpy.context.temp_override(window=window, area=where, region=region if where == area else where.regions[0]):
            call()

    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    hide_other_panels()
    # The sidebar opens at its first tab. With no object selected that is ours; a second tab makes Blender show tabs at all.
    bpy.utils.register_class(_Last)
    space.show_region_ui = True
    yield 2 * PAUSE
    inside(lambda: bpy.ops.grmm.add_head())
    note("head added")
    avatar = bpy.context.view_layer.objects.active
    head = avatar if avatar.type == "MESH" else next(c for c in avatar.children if c.type == "MESH")
    bpy.context.view_layer.objects.active = head
    for name, value in (("mouthSmileLeft", 0.8), ("mouthSmileRight", 0.8), ("browInnerUp", 0.4), ("jawOpen", 0.15)):
        head[name] = value
    head.update_tag()
    head.parent.show_in_front = False
    inside(lambda: bpy.ops.view3d.view_axis(type="FRONT"))
    inside(lambda: bpy.ops.view3d.view_orbit(angle=0.4, type="ORBITRIGHT"))
    inside(lambda: bpy.ops.view3d.view_selected())
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
    note("arranged")
    yield PAUSE
    bpy.utils.unregister_class(_Last)
    yield 2 * PAUSE
    shot("window.png")

    space.show_region_ui = False
    for other in [a for a in window.screen.areas if a != area]:
        inside(bpy.ops.screen.area_close, other)
    yield PAUSE
    inside(lambda: bpy.ops.screen.area_split(direction="VERTICAL", factor=VIEW_SHARE))
    properties = next(a for a in window.screen.areas if a != area)
    area, properties = sorted((area, properties), key=lambda a: a.x)
    area.type, properties.type = "VIEW_3D", "PROPERTIES"
    yield PAUSE
    properties.spaces.active.context = "DATA"
    show_panels("GRMM_PT_data_avatar", "GRMM_PT_data_expression")
    yield 2 * PAUSE
    shot("panel_expression.png")
    show_panels("GRMM_PT_data_residual", "GRMM_PT_data_pose")
    yield 2 * PAUSE
    shot("panel_detail.png")
    photos = bpy.context.window_manager.grmm_fit.photos
    for name in ("front.jpg", "left.jpg"):
        photo = photos.add()
        photo.path, photo.faces = f"/photos/{name}", 1
    show_panels("GRMM_PT_fit")
    yield 2 * PAUSE
    shot("panel_fit.png")
    yield PAUSE


class _Last(bpy.types.Panel):
    """A second tab for as long as ours must be the first."""

    bl_label = "Last"
    bl_idname = "VIEW3D_PT_last"
    bl_space_type = "VIEW_3D"
    bl_region_type = "UI"
    bl_category = "Last"

    def draw(self, context: bpy.types.Context) -> None:
        """Draw nothing."""


def is_in(panel: type, *where: str) -> bool:
    """Whether a panel stands in a space, region and tab."""
    found = (getattr(panel, "bl_space_type", ""), getattr(panel, "bl_region_type", ""))
    return found == where[:2] and (where[2:] == () or getattr(panel, "bl_context", "") == where[2])


def hide_other_panels() -> None:
    """Take Blender's and other add-ons' tabs out of the sidebar, and Blender's own panels out of the object data tab."""
    for panel in list(bpy.types.Panel.__subclasses__()):
        ours = "GRMM" in panel.__name__ or not panel.is_registered
        if not ours and (is_in(panel, "VIEW_3D", "UI") or is_in(panel, "PROPERTIES", "WINDOW", "data")):
            bpy.utils.unregister_class(panel)


def show_panels(*names: str) -> None:
    """Show these panels in the object data tab, open, and no others of ours."""
    for panel in list(bpy.types.Panel.__subclasses__()):
        if panel.is_registered and "GRMM" in panel.__name__ and is_in(panel, "PROPERTIES", "WINDOW", "data"):
            HIDDEN[panel.__name__] = panel
            bpy.utils.unregister_class(panel)
    for name in names:
        panel = HIDDEN.pop(name, None) or getattr(bpy.types, name)
        if panel.is_registered:
            bpy.utils.unregister_class(panel)
        panel.bl_space_type, panel.bl_region_type, panel.bl_context = "PROPERTIES", "WINDOW", "data"
        panel.bl_options = set(getattr(panel, "bl_options", ())) - {"DEFAULT_CLOSED"}
        bpy.utils.register_class(panel)


def shot(name: str) -> None:
    """Save the window as a PNG of this name in `FOLDER`."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window):
        bpy.ops.screen.screenshot(filepath=str(FOLDER / name))


try:
    main()
except Exception:  # noqa: BLE001 - a window without pictures must not stay open
    traceback.print_exc()
    sys.stderr.flush()
    os._exit(1)
