"""Blender's properties and operators, declared so that they read like a table.

What a user sees of a property comes first and cannot be left out: ``use_mask: flag("Mask", "Coverage of all avatars")``. What
differs from the usual is passed to `bpy.props` as it is.
"""

from __future__ import annotations

from typing import Any, ClassVar

import bpy
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


def choice(name: str, description: str, *items: tuple[Any, ...], **options: Any) -> Any:
    """One of several, each with identifier, name and description, perhaps icon and number; the first one at first."""
    return EnumProperty(name=name, description=description, items=items, **options)


class Operator(bpy.types.Operator):
    """Base of operators: what they are called comes from the name of the class, the tooltip from its docstring.

    A tooltip that is longer than a line stands in `bl_description`. What does not change the file says so in `bl_options`.
    """

    bl_idname: str
    bl_description: str
    bl_options: ClassVar[set[str]] = {"REGISTER", "UNDO"}

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        cls.bl_idname = f"grmm.{cls.__name__.removeprefix('GRMM_OT_')}"
        if "bl_description" not in vars(cls):
            cls.bl_description = (cls.__doc__ or "").removesuffix(".")
