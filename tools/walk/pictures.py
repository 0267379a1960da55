"""The documents' pictures of a window: `python -m tools.walk ZIP --pictures docs/images`.

Installs, adds a head, lets it smile, and cuts what is shown out of the screen. Needs Pillow, as the development set-up has it.
"""

from __future__ import annotations

from pathlib import Path

from PIL import Image

from .blender import WalkedBlender
from .steps import HEAD, LAMP, STRANDS, STUDIO, add_head, install, open_panels, place, scroll_sidebar, start

_SMILE = """
head = next(o for o in bpy.context.scene.objects if "jawOpen" in o.keys())
for name, value in {"mouthSmile": 0.65, "cheekSquint": 0.4}.items():
    head[f"{name}Left"] = head[f"{name}Right"] = value
head.update_tag()
"""
_SIDEBAR = "next(part for part in area.regions if part.type == 'UI')"
_HANDLES = """
for obj in bpy.context.scene.objects:
    obj.hide_set(obj.name.startswith("Cube"))
    if obj.type == "ARMATURE":
        obj.select_set(True)
        bpy.context.view_layer.objects.active = obj
area.spaces.active.show_region_ui = True
bpy.context.scene.grmm_viewport.use_handles = True
bpy.ops.view3d.view_axis(type="FRONT")
space = area.spaces.active
space.region_3d.view_perspective = "PERSP"
space.overlay.show_floor = space.overlay.show_axis_x = space.overlay.show_axis_y = False
"""
_CUBES = """
from mathutils import Vector
area.spaces.active.region_3d.view_distance *= 0.8
cube, place = bpy.data.objects["Cube"], next(o.location for o in bpy.data.objects if o.type == "ARMATURE")
cube.dimensions = (0.1, 0.1, 0.1)
cube.location = place + Vector((-0.08, -0.2, -0.12))
other = cube.copy()
other.location = place + Vector((0.1, 0.3, 0.1))
bpy.context.collection.objects.link(other)
"""


def take(blender: WalkedBlender, extension: Path, output: Path) -> None:
    """Make all pictures of a built extension in a folder."""
    blender.bring(extension, "grmm.zip")
    start(blender)
    blender.run("bpy.ops.wm.window_fullscreen_toggle()")
    install(blender)
    add_head(blender)
    blender.run("bpy.context.scene.objects['Cube'].location.x = 9.0")
    blender.run(_SMILE)
    open_panels(blender)
    blender.run("area.spaces.active.show_region_ui = True")
    blender.picture("sidebar", 3)
    blender.run(f"{_SIDEBAR}.active_panel_category = 'GRMM'\narea.tag_redraw()")
    _cut(blender, output / "window_rig.png", None, 2)
    _cut(blender, output / "panel_expression.png", "UI", 2)
    blender.run(HEAD + STRANDS + LAMP)
    scroll_sidebar(blender)
    _cut(blender, output / "panel_detail.png", "UI", 5)
    blender.run(HEAD + STUDIO)
    blender.run("area.spaces.active.show_region_ui = False\nbpy.ops.object.select_all(action='DESELECT')\n" + _CUBES)
    _cut(blender, output / "viewport_solid.png", "WINDOW", 10)
    blender.run(_HANDLES)
    _cut(blender, output / "face_handles.png", "WINDOW", 10)


def _cut(blender: WalkedBlender, path: Path, kind: str | None, wait: float) -> None:
    """Save what a region of the viewport shows, or the whole window where it is None."""
    shot = Image.open(blender.picture(path.stem, wait)).convert("RGB")
    part = shot if kind is None else shot.crop(place(blender, kind))
    # by k-means: the red of lips is a small part of the screen
    part.quantize(256, kmeans=8, dither=Image.Dither.NONE).save(path, optimize=True)
