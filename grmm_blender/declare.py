"""Blender's properties as annotations that read like a table: a name, a description, and what differs from the usual.

What a user sees of a property comes first and cannot be left out; everything else is passed to `bpy.props` as it is.
"""

from __future__ import annotations

from typing import Any

from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, StringProperty


def flag(name: str, description: str, **options: Any) -> Any:
    """Something to switch on, off at first."""
    return BoolProperty(name=name, description=description, **options)


def number(name: str, description: str, **options: Any) -> Any:
    """A real number, 0 at first."""
    return FloatProperty(name=name, description=description, **options)


def whole(name: str, description: str, **options: Any) -> Any:
    """A whole number, 0 at first."""
    return IntProperty(name=name, description=description, **options)


def text(name: str, description: str, **options: Any) -> Any:
    """A text, or the path of a file or folder; empty at first."""
    return StringProperty(name=name, description=description, **options)


def choice(name: str, description: str, *items: tuple[str, str, str], **options: Any) -> Any:
    """One of several, each with identifier, name and description; the first one at first."""
    return EnumProperty(name=name, description=description, items=items, **options)
