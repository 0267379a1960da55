"""How much room a panel has: the sidebar is narrow until somebody widens it. Used by what draws panels and preferences."""

from __future__ import annotations

import textwrap

import bpy

NARROW = 400.0  # below this width, at interface scale 1, two named sliders beside each other would lose their names
_CHARACTER = 6.2  # mean width of a character at interface scale 1
_MARGIN = 70.0  # tabs, icon and padding beside a text
_SHORTEST = 16  # characters; a region that is being opened has almost no width


def room(context: bpy.types.Context) -> float:
    """Return the width of the region in pixels at interface scale 1; without a region there is room for everything."""
    if context.region is None:
        return 2.0 * NARROW
    scale = context.preferences.system.ui_scale or 1.0  # 0 in background
    return context.region.width / scale


def is_narrow(context: bpy.types.Context) -> bool:
    """Whether names and values have to share one column."""
    return room(context) < NARROW


def draw_text(layout: bpy.types.UILayout, text: str, context: bpy.types.Context, icon: str = "NONE") -> None:
    """Draw a sentence in lines that fit; labels do not wrap by themselves.

    Args:
        layout: Gets a column of labels.
        text: The sentence, in English; it is translated before it is cut into lines.
        context: Tells the region.
        icon: Stands before the first line.
    """
    column = layout.column(align=True)
    text = bpy.app.translations.pgettext_iface(text)
    lines = textwrap.wrap(text, max(_SHORTEST, int((room(context) - _MARGIN) / _CHARACTER)))
    for index, line in enumerate(lines):
        column.label(text=line, icon=icon if index == 0 or icon == "NONE" else "BLANK1", translate=False)
