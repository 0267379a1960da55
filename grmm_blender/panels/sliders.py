"""Sliders of controls, drawn as the core's table has them; those of both sides of the face stand beside each other."""

from __future__ import annotations

from collections.abc import Callable

import bpy

from ...grmm_core.controls.table import CONTROLS, REGIONS, SLIDERS
from ..rig.custom_properties import property_path

SHORT_NAME = 15  # characters that a slider shows beside its value while the sidebar has its first width
LETTERS = {"Right": "R", "Left": "L"}


def draw_expressions(
    layout: bpy.types.UILayout,
    obj: bpy.types.Object,
    narrow: bool,
    draw_heading: Callable[[bpy.types.UILayout, str], None] | None = None,
) -> None:
    """Draw the named expressions that an object has, one box for each region.

    Args:
        layout: Gets the boxes.
        obj: Carries the properties.
        narrow: There is no room for two sliders in a row.
        draw_heading: Adds to the heading of a region, which it is told.
    """
    for region, names in REGIONS.items():
        present = [name for name in names if name in obj]
        if not present:
            continue
        box = layout.box().column(align=True)
        heading = box.row(align=True)
        heading.label(text=region)
        if draw_heading is not None:
            draw_heading(heading, region)
        drawn: set[str] = set()
        for name in present:
            if name in drawn:
                continue
            # The subject's right side stands on the left, as it does on the face that looks at the animator.
            pair = (CONTROLS[name].partner, name) if name.endswith("Left") else (name,)
            row = box.column(align=True) if narrow else box.row(align=True)
            for member in dict.fromkeys(pair):
                if member in present:
                    label = CONTROLS[member].label
                    row.prop(obj, property_path(member), text=_short(label, region) if narrow else label, slider=True)
            drawn.update(pair)


def draw_sliders(layout: bpy.types.UILayout, obj: bpy.types.Object, section: str) -> None:
    """Draw the single sliders of a section that a head has."""
    column = layout.column(align=True)
    for control in SLIDERS:
        if control.section == section and control.name in obj:
            column.prop(obj, property_path(control.name), text=control.label, slider=True)


def _short(text: str, region: str) -> str:
    """Shorten the sides, and leave out the region where even then the end, which tells the sides apart, would be cut off."""
    for word, letter in LETTERS.items():
        if text.endswith(f" {word}"):
            text = text[: -len(word)] + letter
    first, _, rest = text.partition(" ")
    return rest if len(text) > SHORT_NAME and region.startswith(first) else text
