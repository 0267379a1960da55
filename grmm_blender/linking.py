"""Where new objects go."""

from __future__ import annotations

import bpy


def link_beside(obj: bpy.types.Object, other: bpy.types.Object) -> None:
    """Link a new object where another one is, or into the scene: collections of a library, also overridden, take nothing in."""
    own = [one for one in other.users_collection if one.library is None and one.override_library is None]
    for collection in own or [bpy.context.scene.collection]:
        collection.objects.link(obj)
