"""Python objects that stand for one object of Blender's: what avatars and splat clouds have in common."""

from __future__ import annotations

import bpy


class ObjectWrapper:
    """Stands for an object of Blender's; two that stand for the same one are equal.

    Attributes:
        object: Original data (not evaluated).
    """

    def __init__(self, obj: bpy.types.Object) -> None:
        """Wrap an object; an evaluated one is replaced by its original."""
        self.object: bpy.types.Object = obj.original

    def __eq__(self, other: object) -> bool:
        return type(other) is type(self) and other.object == self.object

    def __hash__(self) -> int:
        return hash(self.object)

    @property
    def name(self) -> str:
        """Name of the object."""
        return self.object.name
