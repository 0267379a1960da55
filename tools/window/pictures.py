"""Inside Blender: `blender --python tools/window/pictures.py -- FOLDER`. Writes FOLDER/*.png, then quits."""

from __future__ import annotations

import faulthandler
import os
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path

import bpy
import gpu

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tools.window import shims

faulthandler.enable()
FOLDER = Path(sys.argv[sys.argv.index("--") + 1])
TAB = (1226, 155)  # where the GRMM tab stands in a window of 1500 x 950 at the screen's upper left corner
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

    def inside(call: Callable[[], object]) -> None:
        with bpy.context.temp_override(window=window, area=area, region=region):
            call()

    for obj in list(bpy.data.objects):
        bpy.data.objects.remove(obj)
    hide_other_tabs()
    inside(lambda: bpy.ops.grmm.add_head())
    note("head added")
    space.show_region_ui = True
    yield PAUSE
    avatar = bpy.context.view_layer.objects.active
    head = avatar if avatar.type == "MESH" else next(c for c in avatar.children if c.type == "MESH")
    for name, value in (("mouthSmileLeft", 0.8), ("mouthSmileRight", 0.8), ("browInnerUp", 0.4), ("jawOpen", 0.15)):
        head[name] = value
    head.update_tag()
    head.parent.show_in_front = False
    inside(lambda: bpy.ops.view3d.view_axis(type="FRONT"))
    inside(lambda: bpy.ops.view3d.view_orbit(angle=0.4, type="ORBITRIGHT"))
    inside(lambda: bpy.ops.view3d.view_selected())
    space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
    area.tag_redraw()
    note("arranged")
    properties = max((a for a in window.screen.areas if a.type == "PROPERTIES"), key=lambda a: a.height)
    properties.spaces.active.context = "DATA"
    open_panels("GRMM_PT_data_avatar", "GRMM_PT_data_expression")
    yield 2 * PAUSE
    shot("window_data.png")
    click(*TAB)
    yield 8 * PAUSE
    shot("window.png")
    open_panels("GRMM_PT_pose", "GRMM_PT_poses", "GRMM_PT_production", close="GRMM_PT_expression")
    area.tag_redraw()
    yield 2 * PAUSE
    shot("window_more.png")
    yield PAUSE


def click(x: int, y: int) -> None:
    """Click as a user does: which tab is shown cannot be set from Python here."""
    subprocess.Popen(["xdotool", "mousemove", str(x), str(y), "sleep", "2", "click", "1"])


def hide_other_tabs() -> None:
    """Leave our tab and Blender's own first one in the sidebar."""
    for panel in list(bpy.types.Panel.__subclasses__()):
        place = getattr(panel, "bl_space_type", ""), getattr(panel, "bl_region_type", "")
        if place == ("VIEW_3D", "UI") and getattr(panel, "bl_category", "") not in ("", "GRMM") and panel.is_registered:
            bpy.utils.unregister_class(panel)


def open_panels(*names: str, close: str = "") -> None:
    """Open panels that start closed, and take one away."""
    if close:
        bpy.utils.unregister_class(getattr(bpy.types, close))
    for name in names:
        panel = getattr(bpy.types, name, None)
        if panel is not None:
            bpy.utils.unregister_class(panel)
            panel.bl_options = set(panel.bl_options) - {"DEFAULT_CLOSED"}
            bpy.utils.register_class(panel)


def shot(name: str) -> None:
    """Save the window."""
    window = bpy.context.window_manager.windows[0]
    with bpy.context.temp_override(window=window):
        bpy.ops.screen.screenshot(filepath=str(FOLDER / name))


try:
    main()
except Exception:  # noqa: BLE001 - a window without pictures must not stay open
    traceback.print_exc()
    sys.stderr.flush()
    os._exit(1)
