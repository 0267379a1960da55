"""The avatars of a scene, and where an evaluated scene shows them."""

from __future__ import annotations

from collections.abc import Iterator

import bpy
import numpy as np

from ..rig.avatar import Avatar, is_avatar


def avatars_in(where: bpy.types.Scene | bpy.types.Depsgraph) -> list[Avatar]:
    """Return the avatars of a scene, or those that an evaluated scene shows; each once, in the order of their names."""
    objects = where.objects
    found = {Avatar(obj) for obj in objects if is_avatar(obj)}
    return sorted(found, key=lambda avatar: avatar.name)


def instances_in(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[Avatar, np.ndarray]]:
    """Yield every visible avatar with its placement, [4, 4]; several times where collections are instanced."""
    for instance in depsgraph.object_instances:
        if not is_avatar(instance.object):
            continue
        avatar = Avatar(instance.object)
        if instance.is_instance:
            yield avatar, avatar.instance_to_world(instance.matrix_world, depsgraph)
        else:
            yield avatar, avatar.model_to_world(depsgraph)
