"""Rows of controls, drawn as the core's table has them: a name, then the subject's right and left side, or one slider."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

import bpy

from ...grmm_core.controls.control import Control
from ...grmm_core.controls.table import CONTROLS, SLIDERS
from ..rig.avatar import Avatar
from ..rig.custom_properties import property_path
from . import favourites

if TYPE_CHECKING:
    from ..splats.rigged import Puppet

_NAME_SHARE = 0.45  # of a row's width, for the name


def rows(names: Iterable[str]) -> Iterator[tuple[str, ...]]:
    """Yield the controls of each row: both sides in one, the subject's right first, as on the face that looks at one."""
    drawn: set[str] = set()
    for name in names:
        if name not in drawn:
            pair = (CONTROLS[name].partner, name) if name.endswith("Left") else (name, CONTROLS[name].partner)
            row = tuple(dict.fromkeys(pair)) if CONTROLS[name].source == "property" else (name,)
            drawn.update(row)
            yield row


def draw_controls(
    layout: bpy.types.UILayout, performer: Avatar | Puppet | None, names: Iterable[str], context: bpy.types.Context
) -> None:
    """Draw the controls of these names that an avatar has, those of both sides beside each other.

    Args:
        layout: Gets the rows.
        performer: Whose controls they are; nothing is drawn for None.
        names: Of the core's table: single numbers, and joints.
        context: Tells whether the rows have stars.
    """
    if performer is None:
        return
    head, bones = performer.object, performer.bones
    layout.use_property_split = False
    column = layout.column(align=True)
    found = [row for row in rows(names) if row[0] in head or row[0] in bones]
    if any(len(row) > 1 for row in found):
        _, cells = _split(column, "")
        for side in ("Right", "Left"):
            cells.label(text=side)
    for members in found:
        control = CONTROLS[members[0]]
        if control.source == "bone":
            for axis, angle in enumerate(control.axes):
                draw_named(column, f"{control.label} {angle}", bones[control.name], "rotation_euler", axis)
            continue
        row, cells = _split(column, control.both or control.label)
        for name in members:
            cells.prop(head, property_path(name), text="", slider=True)
        if context.window_manager.grmm_panels.show_stars:
            icon = "SOLO_ON" if members[0] in favourites.names() else "SOLO_OFF"
            row.operator("grmm.favourite", text="", icon=icon, emboss=False).control = members[0]


def draw_named(column: bpy.types.UILayout, text: str, owner: bpy.types.bpy_struct, path: str, index: int) -> None:
    """Draw one value of an array behind its name."""
    _, cells = _split(column, text)
    cells.prop(owner, path, index=index, text="", slider=True)


def draw_sliders(layout: bpy.types.UILayout, avatar: Avatar, section: str, context: bpy.types.Context) -> None:
    """Draw the single sliders of a section."""
    draw_controls(layout, avatar, [control.name for control in SLIDERS if control.section == section], context)


def matches(control: Control, text: str) -> bool:
    """Whether a control is meant by a search: each word is in its label, its name or its region."""
    found = f"{control.label} {control.name} {control.region}".lower()
    return all(word in found for word in text.lower().split())


def _split(column: bpy.types.UILayout, text: str) -> tuple[bpy.types.UILayout, bpy.types.UILayout]:
    """A row that begins with a name; returns the row and its cells."""
    row = column.row(align=True)
    split = row.split(factor=_NAME_SHARE, align=True)
    split.label(text=text)
    return row, split.row(align=True)
