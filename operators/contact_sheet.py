"""A contact sheet: expressions, views or frames of the scene in one picture file."""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import replace
from functools import partial
from typing import ClassVar

import bpy
import numpy as np

from ..grmm_blender.declare import Operator, choice, flag, text, whole
from ..grmm_blender.engine import passes, pipeline
from ..grmm_blender.portraits import portrait, with_expression
from ..grmm_blender.scene.cameras import face_camera
from ..grmm_blender.scene.shot import Region
from ..grmm_blender.scene.walk import take_frame
from ..grmm_blender.sheet import grid
from ..grmm_core.controls.table import CONTROLS, EXPRESSION_NAMES, REGIONS
from ..grmm_core.errors import ConfigError
from ..grmm_core.model.portrait import portrait_camera
from ..grmm_core.pictures.color import linear_to_srgb
from ..grmm_core.pictures.images import quantize, write_png
from .common import Result, active_avatar, add_suffix, output_path, polls
from .steps import CancelCheck, Step, SteppedOperator, Steps

ALL = "ALL"
_MAX_PIXELS = 1 << 27

Tiles = Generator[tuple[str, Step], None, None]
"""Caption and step of each tile."""


class GRMM_OT_contact_sheet(SteppedOperator, Operator):
    """Draw expressions or views of the active avatar, or frames of the scene, in a grid into one PNG file."""

    bl_label = "Contact Sheet"
    bl_options: ClassVar[set[str]] = {"REGISTER"}

    filepath: text("File", "PNG file to write", subtype="FILE_PATH", options={"SKIP_SAVE"})
    filter_glob: bpy.props.StringProperty(default="*.png", options={"HIDDEN"})
    check_existing: bpy.props.BoolProperty(default=True, options={"HIDDEN"})
    content: choice(
        "Content",
        "What the tiles show",
        ("EXPRESSIONS", "Expressions", "The named expressions, each at full strength"),
        ("VIEWS", "Views", "The avatar as it is, from all around"),
        ("FRAMES", "Frames", "Frames of the scene, spread over its range, through its camera"),
    )
    region: choice(
        "Region",
        "Expressions of one region only",
        (ALL, "All", "Every region"),
        *((name, name, f"The region {name.lower()}") for name in REGIONS),
    )
    count: whole("Tiles", "How many views or frames", default=12, min=1, max=1000)
    columns: whole("Columns", "Tiles in a row", default=6, min=1, max=100)
    size: whole("Tile Size", "Width of a tile", default=256, min=16, max=4096, subtype="PIXEL")
    captions: flag("Captions", "Write what a tile shows above it", default=True)
    background: bpy.props.FloatVectorProperty(
        name="Background", description="Color behind the avatar", subtype="COLOR_GAMMA", size=3, min=0.0, max=1.0,
        default=(0.94, 0.94, 0.94),
    )  # fmt: skip

    poll = polls(active_avatar)

    def invoke(self, context: bpy.types.Context, event: bpy.types.Event) -> Result:
        """Ask for the file, or begin once there is one."""
        if self.running:
            return self.begin(context, event)
        if not self.filepath:
            self.filepath = "contact_sheet.png"
        return self.ask(context, event)

    def check(self, context: bpy.types.Context) -> bool:
        """Show the whole name."""
        return add_suffix(self, (".png",), ".png")

    def draw(self, context: bpy.types.Context) -> None:
        """Options that matter for the content."""
        layout = self.layout
        layout.use_property_split = True
        layout.prop(self, "content")
        layout.prop(self, "region" if self.content == "EXPRESSIONS" else "count")
        for name in ("columns", "size", "captions", "background"):
            layout.prop(self, name)

    def _tile_count(self) -> int:
        return len(EXPRESSION_NAMES if self.region == ALL else REGIONS[self.region]) if self._is_expressions() else self.count

    def _is_expressions(self) -> bool:
        return self.content == "EXPRESSIONS"

    def steps(self, context: bpy.types.Context) -> Steps:
        """One tile a step."""
        path = output_path(self.filepath, (".png",), ".png")
        if self._tile_count() * self.size**2 > _MAX_PIXELS:
            raise ConfigError("The contact sheet would be too large; choose fewer or smaller tiles.")
        tiles: list[tuple[str, np.ndarray]] = []
        source = self._frame_steps(context) if self.content == "FRAMES" else self._avatar_steps(context)
        try:
            for title, step in source:
                picture = yield step
                tiles.append((title, picture[..., :3]))
        finally:
            source.close()
        write_png(path, quantize(grid(tiles, self.columns, self.captions)))
        return f"{path} shows {len(tiles)} pictures"

    def _avatar_steps(self, context: bpy.types.Context) -> Tiles:
        avatar = active_avatar(context)
        controls, color = avatar.controls(), tuple(self.background)
        if self._is_expressions():
            names = EXPRESSION_NAMES if self.region == ALL else REGIONS[self.region]
            for index, name in enumerate(names):
                shown = with_expression(controls, {name: 1.0})
                work = portrait(avatar.source, shown, face_camera, self.size, color)
                label = CONTROLS[name].label
                yield label, Step(index / len(names), label, work)
            return
        for index in range(self.count):
            angle = 360.0 * index / self.count
            work = portrait(avatar.source, controls, partial(portrait_camera, yaw=angle), self.size, color)
            yield f"{angle:.0f}°", Step(index / self.count, f"view {index + 1} of {self.count}", work)

    def _frame_steps(self, context: bpy.types.Context) -> Tiles:
        """The scene is put on each frame in turn, and back at the end."""
        scene, before = context.scene, context.scene.frame_current_final
        color = np.array(self.background, np.float32)
        wanted = np.unique(np.linspace(scene.frame_start, scene.frame_end, self.count).round().astype(int))
        try:
            for index, frame in enumerate(wanted.tolist()):
                scene.frame_set(frame)
                work = _scene_picture(context, self.size, color)
                yield f"{frame}", Step(index / len(wanted), f"frame {frame}", work)
        finally:
            scene.frame_set(int(before), subframe=before - int(before))


def _scene_picture(context: bpy.types.Context, width: int, background: np.ndarray) -> Callable[[CancelCheck], np.ndarray]:
    render = context.scene.render
    aspect = render.resolution_y * render.pixel_aspect_y / (render.resolution_x * render.pixel_aspect_x)
    height = max(1, round(width * aspect))
    settings = context.scene.grmm_render
    frame = take_frame(context.evaluated_depsgraph_get(), (width, height), use_meshes=settings.use_occlusion)
    frame = replace(frame, scene=replace(frame.scene, world=None))
    how = pipeline.DrawSettings.final(settings.use_refine, int(settings.detail), settings.occlusion_samples)
    items = [passes.RenderPass("combined", "Combined", "RGBA", "COLOR")]
    region = Region(0, 0, width, height)

    def draw(should_cancel: CancelCheck) -> np.ndarray:
        values = pipeline.frame_values(frame, how, items, region, should_cancel)["Combined"]
        alpha = values[..., 3:]
        straight = linear_to_srgb(values[..., :3] / np.maximum(alpha, 1e-6))
        return straight * alpha + background * (1.0 - alpha)

    return draw


CLASSES = (GRMM_OT_contact_sheet,)
