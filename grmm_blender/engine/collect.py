"""Avatars of a depsgraph, as the engine sees them."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from .snapshot import AvatarShot


@dataclass(frozen=True)
class Collected:
    """An avatar and the objects that its Gaussians replace.

    Attributes:
        shot: Values of the avatar.
        object_names: Original mesh objects that are not drawn and do not occlude.
    """

    shot: AvatarShot
    object_names: tuple[str, ...]


def avatars(depsgraph: bpy.types.Depsgraph) -> list[Collected]:
    """Return the visible avatars, sorted by name, so that pictures do not depend on the order of creation."""
    from .. import avatar as avatar_module

    view_layer = depsgraph.view_layer
    found = []
    for avatar in avatar_module.avatars_in(depsgraph):
        head = avatar.object.original
        if head.indirect_only_get(view_layer=view_layer) or not head.visible_camera:
            continue
        shot = AvatarShot(
            head.name,
            avatar.source,
            avatar.controls(depsgraph),
            avatar.model_to_world(depsgraph),
            holdout=head.is_holdout or head.holdout_get(view_layer=view_layer),
        )
        found.append(Collected(shot, (head.name,)))
    return sorted(found, key=lambda item: item.shot.name)


def avatar_names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of all avatars in a scene, visible or not, sorted: the order of their mask passes."""
    from .. import avatar as avatar_module

    return sorted(avatar.object.name for avatar in avatar_module.avatars_of(scene))
