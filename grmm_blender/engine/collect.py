"""Avatars of a depsgraph, as the engine sees them."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ..avatar import avatars_in, instances_in
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
    """Return the avatars that the view layer shows, sorted by name, so that pictures do not depend on the order of creation.

    An instanced avatar is there once for each instance.
    """
    view_layer = depsgraph.view_layer
    found = []
    for avatar, model_to_world in instances_in(depsgraph):
        head = avatar.object
        if not head.visible_camera or head.indirect_only_get(view_layer=view_layer):
            continue
        holdout = head.is_holdout or head.holdout_get(view_layer=view_layer)
        shot = AvatarShot(head.name, avatar.source, avatar.controls(depsgraph), model_to_world, holdout)
        found.append(Collected(shot, (head.name,)))
    return sorted(found, key=lambda item: item.shot.name)


def avatar_names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of all avatars in a scene, visible or not, sorted: the order of their mask passes."""
    return [avatar.name for avatar in avatars_in(scene)]
