"""The walk: what an animator does first, each step a picture. `STEPS` is their order.

A step takes the driven Blender; it raises where something is wrong that a program can see (no face in the render, a traceback
in the console), and leaves the rest to whoever looks at the pictures.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from .blender import WalkedBlender, WalkError

Step = Callable[[WalkedBlender], None]
PERFORMANCE_FRAMES = 48
SPLASH_CLOSE = (40, 700)  # pixels: outside the splash, over the timeline's left end
_SNIPPETS = {
    "view head": """
rig = next(o for o in bpy.context.scene.objects if o.type == "ARMATURE")
bpy.ops.object.select_all(action="DESELECT")
rig.select_set(True)
bpy.context.view_layer.objects.active = rig
bpy.ops.view3d.view_axis(type="FRONT")
bpy.ops.view3d.view_selected()
result = rig.name
""",
    "sidebar": """
area.spaces.active.show_region_ui = True
panel = next(part for part in area.regions if part.type == "UI")
try:
    panel.active_panel_category = "GRMM"
except (AttributeError, TypeError):
    pass
result = panel.width
""",
}


def start(blender: WalkedBlender) -> None:
    """Close the splash as a newcomer does."""
    blender.key("Escape")
    blender.click(*SPLASH_CLOSE)
    blender.picture("start")


def install(blender: WalkedBlender) -> None:
    """Install the zip from disk."""
    path = blender.inner(blender.shared / "grmm.zip")
    install = f"bpy.ops.extensions.package_install_files(filepath={path!r}, repo='user_default', enable_on_install=True)"
    found = blender.run(
        f"{install}\nresult = [name for name in bpy.context.preferences.addons.keys() if name.endswith('grmm')]", 300
    )
    if not found:
        raise WalkError("the extension is not enabled after installing")


def clear(blender: WalkedBlender) -> None:
    """Delete the default cube, as nearly everybody does."""
    blender.run("bpy.data.objects.remove(bpy.data.objects['Cube'])")


def add_head(blender: WalkedBlender) -> None:
    """Add the default head into the scene."""
    blender.run("bpy.ops.grmm.add_head('INVOKE_DEFAULT')", 120)
    blender.picture("added", 6)


def front_view(blender: WalkedBlender) -> None:
    """Look at it from the front, and open the sidebar."""
    blender.run(_SNIPPETS["view head"])
    blender.run(_SNIPPETS["sidebar"])
    blender.picture("front", 6)


def sliders(blender: WalkedBlender) -> None:
    """Set sliders, as dragging them does."""
    blender.run(
        "head = next(o for o in bpy.context.scene.objects if 'jawOpen' in o.keys())\n"
        "head['jawOpen'] = 0.6; head['mouthSmileLeft'] = 0.8; head.update_tag(); area.tag_redraw()"
    )
    blender.picture("sliders", 5)


def random_expression(blender: WalkedBlender) -> None:
    """Press Random: the viewport must follow by itself."""
    blender.run("bpy.ops.grmm.random_expression('INVOKE_DEFAULT')")
    blender.picture("random", 5)


def reset(blender: WalkedBlender) -> None:
    """Press Reset."""
    blender.run("bpy.ops.grmm.reset('INVOKE_DEFAULT')")
    blender.picture("reset", 5)


def orthographic(blender: WalkedBlender) -> None:
    """Orthographic view: no mesh through the splats."""
    blender.run("area.spaces.active.region_3d.view_perspective = 'ORTHO'")
    blender.picture("orthographic", 4)
    blender.run("area.spaces.active.region_3d.view_perspective = 'PERSP'")


def pose_mode(blender: WalkedBlender) -> None:
    """Pose mode: the bones must be seen."""
    blender.run("bpy.ops.object.mode_set(mode='POSE')")
    blender.picture("pose_mode", 4)
    blender.run("bpy.ops.object.mode_set(mode='OBJECT')")


def render(blender: WalkedBlender) -> None:
    """F12 with the engine GRMM: a face must be in the picture."""
    blender.run("bpy.ops.view3d.camera_to_view()")
    blender.run("bpy.context.scene.render.engine = 'GRMM'; bpy.context.scene.render.resolution_percentage = 50")
    blender.move(500, 400)
    blender.key("F12")
    blender.picture("render", 25)
    saved = blender.shared / "render.png"
    blender.run(
        f"image = bpy.data.images['Render Result']\nimage.save_render({blender.inner(saved)!r})\nresult = list(image.size)"
    )
    blender.keep(saved, "render_result")
    blender.key("Escape")


def undo(blender: WalkedBlender) -> None:
    """Ctrl-Z twice, then Ctrl-Shift-Z."""
    blender.move(500, 400)
    blender.key("ctrl", "z")
    blender.key("ctrl", "z")
    blender.picture("undone", 4)
    blender.key("ctrl", "shift", "z")
    blender.picture("redone", 4)


def save_and_reopen(blender: WalkedBlender) -> None:
    """Save, open again: the head is there and drawn."""
    path = blender.inner(blender.shared / "walk.blend")
    blender.run(f"bpy.ops.wm.save_as_mainfile(filepath={path!r})")
    blender.run(f"bpy.ops.wm.open_mainfile(filepath={path!r})")
    blender.run("bpy.context.scene.frame_set(bpy.context.scene.frame_current)")
    blender.picture("reopened", 6)


def disable_and_enable(blender: WalkedBlender) -> None:
    """Disable the extension and enable it again."""
    name = blender.run("result = next(name for name in bpy.context.preferences.addons.keys() if name.endswith('grmm'))")
    blender.run(f"bpy.ops.preferences.addon_disable(module={name!r})")
    blender.picture("disabled", 2)
    blender.run(f"bpy.ops.preferences.addon_enable(module={name!r})")
    blender.picture("enabled", 5)


STEPS: tuple[Step, ...] = (
    start, install, clear, add_head, front_view, sliders, random_expression, reset, orthographic, pose_mode, render, undo,
    save_and_reopen, disable_and_enable,
)  # fmt: skip


def check_console(text: str) -> list[str]:
    """Return the lines of Blender's console that a user should never see."""
    return [line for line in text.splitlines() if "Traceback" in line or line.startswith(("Error:", "Warning: class"))]


def walk(blender: WalkedBlender, extension: Path) -> list[str]:
    """Take every step; return what went wrong, by step."""
    problems = []
    blender.bring(extension, "grmm.zip")
    for step in STEPS:
        before = len(blender.console)
        try:
            step(blender)
        except WalkError as error:
            problems.append(f"{step.__name__}: {error}")
        problems += [f"{step.__name__}: {line}" for line in check_console(blender.console[before:])]
    return problems
