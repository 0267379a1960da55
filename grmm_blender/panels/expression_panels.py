"""The panel of the named expressions: search, edits, favourites, and a sub-panel for each region of the core's table.

It stands for avatars, and for imported ones that have ARKit shapes.
"""

from __future__ import annotations

from typing import Any

import bpy

from ...grmm_core.controls.control import is_sideways, side_of
from ...grmm_core.controls.table import CONTROLS, EXPRESSIONS, JOINTS, REGIONS
from ..declare import flag, text
from ..exporting import performer_of
from ..rig.avatar import avatar_of
from . import favourites
from .sliders import draw_controls, matches
from .twins import Content, twins

ALL = "ALL"  # of the operators' regions
_NAME = "expression"
_OPEN = ("Jaw", "Mouth")  # at first
_SEARCHED = tuple(control.name for control in (*EXPRESSIONS, *JOINTS) if not control.size or control.axes)


class GRMM_PG_panels(bpy.types.PropertyGroup):
    """What the panels show."""

    search: text(
        "Search", "Show the controls whose name, ARKit name or region has these words", options={"TEXTEDIT_UPDATE", "SKIP_SAVE"}
    )
    show_stars: flag("Stars", "Show stars beside the controls, to choose the favourites")


class _Controls(Content):
    """Content that imported avatars with ARKit shapes have too."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """With something selected that has named expressions."""
        return performer_of(context.object) is not None


class _Expression(_Controls):
    """Search, edits of the whole face; the regions are panels in it."""

    bl_label = "Expression"

    def draw(self, context: bpy.types.Context) -> None:
        """What is searched for, and buttons for the whole face."""
        layout, performer = self.layout, performer_of(context.object)
        shown = context.window_manager.grmm_panels
        row = layout.row(align=True)
        row.prop(shown, "search", text="", icon="VIEWZOOM")
        row.prop(shown, "show_stars", text="", icon="SOLO_ON" if shown.show_stars else "SOLO_OFF")
        row.prop(context.scene.grmm_viewport, "use_handles", text="", icon="PIVOT_CURSOR")
        if shown.search:
            found = [name for name in _SEARCHED if matches(CONTROLS[name], shown.search)]
            draw_controls(layout, performer, found, context)
            if not found:
                layout.label(text="No control has this name", icon="INFO")
        elif avatar_of(context.object) is not None:
            column = layout.column(align=True)
            for edits in (("grmm.random_expression", "grmm.reset", "SWAP"), ("LEFT", "RIGHT")):
                grid = column.grid_flow(row_major=True, columns=len(edits), even_columns=True, align=True)
                _draw_edits(grid, ALL, edits)
            column.operator("grmm.select_controls", icon="RESTRICT_SELECT_OFF")


class _Favourites(_Controls):
    """The controls with a star."""

    bl_label = "Favourites"

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where any control has a star, and nothing is searched for."""
        return super().poll(context) and not context.window_manager.grmm_panels.search and bool(favourites.names())

    def draw(self, context: bpy.types.Context) -> None:
        """Draw them."""
        draw_controls(self.layout, performer_of(context.object), favourites.names(), context)


class _Region(_Controls):
    """The expressions of one region."""

    @classmethod
    def poll(cls, context: bpy.types.Context) -> bool:
        """Where there are any, and nothing is searched for."""
        performer = performer_of(context.object)
        if context.window_manager.grmm_panels.search or performer is None:
            return False
        return any(name in performer.object for name in REGIONS[cls.bl_label])

    def draw_header_preset(self, context: bpy.types.Context) -> None:
        """Edits of this region alone."""
        if avatar_of(context.object) is None:
            return
        controls = [CONTROLS[name] for name in REGIONS[self.bl_label]]
        edits = ["grmm.random_expression", "grmm.reset"]
        edits += ["SWAP"] * any(control.partner != control.name for control in controls)
        edits += ["LEFT", "RIGHT"] * any(side_of(control.name) and not is_sideways(control.name) for control in controls)
        row = self.layout.row(align=True)
        row.emboss = "NONE"
        _draw_edits(row, self.bl_label, edits)

    def draw(self, context: bpy.types.Context) -> None:
        """Draw the sliders."""
        draw_controls(self.layout, performer_of(context.object), REGIONS[self.bl_label], context)


_EDITS = {  # operator, or direction of `grmm.mirror`, to label and icon
    "grmm.random_expression": ("Random", "MOD_NOISE"),
    "grmm.reset": ("Reset", "LOOP_BACK"),
    "SWAP": ("Flip", "MOD_MIRROR"),
    "LEFT": ("Left to Right", "TRIA_LEFT"),  # the subject's left is on the right of the picture
    "RIGHT": ("Right to Left", "TRIA_RIGHT"),
}


def _draw_edits(row: bpy.types.UILayout, region: str, edits: Any) -> None:
    """Buttons for the expressions of a region; words for all, icons for one, whose tooltips name the region."""
    for edit in edits:
        words, icon = _EDITS[edit]
        options = row.operator(edit if "." in edit else "grmm.mirror", text=words if region == ALL else "", icon=icon)
        options.region = region
        if "." not in edit:
            options.direction = edit
        elif edit == "grmm.reset":
            options.what = "EXPRESSION"


def _panels() -> tuple[type, ...]:
    made = [*twins(_Expression, _NAME, False), *twins(_Favourites, "favourites", False, _NAME)]
    for region in REGIONS:
        content = type("_Region", (_Region,), {"bl_label": region, "__doc__": _Region.__doc__})
        made += twins(content, f"region_{region.lower()}", region not in _OPEN, _NAME)
    return tuple(made)


CLASSES = (GRMM_PG_panels, favourites.GRMM_OT_favourite, *_panels())


def register() -> None:
    """Attach what the panels show to the session."""
    bpy.types.WindowManager.grmm_panels = bpy.props.PointerProperty(type=GRMM_PG_panels)


def unregister() -> None:
    """Take that back."""
    del bpy.types.WindowManager.grmm_panels
