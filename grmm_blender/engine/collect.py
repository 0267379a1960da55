"""Avatars and splat clouds of a depsgraph, as the engine sees them."""

from __future__ import annotations

from dataclasses import dataclass

import bpy

from ...grmm_core.controls.frame import Controls
from ..scene.avatars import avatars_in, instances_in
from ..splats.cloud import carries_splats, cloud_instances, clouds_in
from .snapshot import AvatarShot


@dataclass(frozen=True)
class Collected:
    """An avatar or splat cloud and the objects that its Gaussians replace.

    Attributes:
        shot: Values of the avatar or cloud.
        object_names: Original mesh objects that are not drawn and do not occlude.
    """

    shot: AvatarShot
    object_names: tuple[str, ...]


def avatars(depsgraph: bpy.types.Depsgraph) -> list[Collected]:
    """Return the avatars and splat clouds that the view layer shows.

    Sorted by name, so that pictures do not depend on the order of creation. What is instanced is there once for each instance.

    Raises:
        FileFormatError: A cloud was damaged by edits.
    """
    view_layer = depsgraph.view_layer
    found = []
    for avatar, model_to_world in instances_in(depsgraph):
        head = avatar.object
        if carries_splats(head) or not avatar.has_network or not _is_shown(head, view_layer):
            continue
        shot = AvatarShot(head.name, avatar.source, avatar.controls(depsgraph), model_to_world, _is_holdout(head, view_layer))
        found.append(Collected(shot, (head.name,)))
    shots = {}
    for cloud, model_to_world in cloud_instances(depsgraph):
        obj = cloud.object
        if not _is_shown(obj, view_layer):
            continue
        if cloud not in shots:
            shots[cloud] = cloud.shot(depsgraph)
        shot = AvatarShot(obj.name, "", Controls(), model_to_world, _is_holdout(obj, view_layer), shots[cloud])
        replaced = (obj.name,) if cloud.carrier is None else (obj.name, cloud.carrier.name)
        found.append(Collected(shot, replaced))
    return sorted(found, key=lambda item: item.shot.name)


def avatar_names(scene: bpy.types.Scene) -> list[str]:
    """Return the names of all avatars and clouds in a scene, visible or not, sorted: the order of their mask passes."""
    heads = [avatar.name for avatar in avatars_in(scene) if avatar.has_network and not carries_splats(avatar.object)]
    return sorted(heads + [cloud.name for cloud in clouds_in(scene)])


def _is_shown(obj: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> bool:
    # A composite hides from other engines what this one draws.
    return (obj.visible_camera or obj.grmm_handed_over) and not obj.indirect_only_get(view_layer=view_layer)


def _is_holdout(obj: bpy.types.Object, view_layer: bpy.types.ViewLayer) -> bool:
    return obj.is_holdout or obj.holdout_get(view_layer=view_layer)
