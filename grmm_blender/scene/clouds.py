"""The splat clouds of a scene, and as an evaluated scene shows them."""

from __future__ import annotations

from dataclasses import dataclass

import bpy
import numpy as np

from ...grmm_core.controls.frame import Controls
from ..splats.cloud import Cloud, CloudShot, is_cloud
from .shot import AvatarShot
from .visibility import is_holdout


@dataclass(frozen=True, eq=False)
class DrawnCloud:
    """A splat cloud in one place of an evaluated scene.

    Attributes:
        cloud: The cloud.
        model_to_world: Head axes to Blender's world, [4, 4].
        copies: Gaussians that were copied for other places of the same cloud.
    """

    cloud: Cloud
    model_to_world: np.ndarray
    copies: dict[Cloud, CloudShot]

    @property
    def object(self) -> bpy.types.Object:
        """The cloud object."""
        return self.cloud.object

    @property
    def meshes(self) -> tuple[bpy.types.Object, ...]:
        """Mesh objects in whose place Gaussians are drawn: the points, and what carries them."""
        carrier = self.cloud.carrier
        return (self.object,) if carrier is None else (self.object, carrier)

    def shot(self, depsgraph: bpy.types.Depsgraph) -> AvatarShot:
        """Copy the cloud as it is in the depsgraph's moment.

        Raises:
            FileFormatError: It was damaged by edits.
        """
        if self.cloud not in self.copies:
            self.copies[self.cloud] = self.cloud.shot(depsgraph)
        cuts = is_holdout(self.object, depsgraph.view_layer)
        return AvatarShot(self.cloud.name, "", Controls(), self.model_to_world, cuts, self.copies[self.cloud])


def clouds_in(where: bpy.types.Scene | bpy.types.Depsgraph) -> list[Cloud]:
    """Return the clouds of a scene, or those of an evaluated scene; each once, in the order of their names."""
    found = {Cloud(obj) for obj in where.objects if is_cloud(obj)}
    return sorted(found, key=lambda cloud: cloud.name)


def drawn_cloud(instance: bpy.types.DepsgraphObjectInstance, copies: dict[Cloud, CloudShot]) -> DrawnCloud | None:
    """Return the cloud that an instance is, None where it is something else; one pass shares `copies`."""
    if not is_cloud(instance.object):
        return None
    cloud = Cloud(instance.object)
    return DrawnCloud(cloud, cloud.placement(np.array(instance.matrix_world, np.float64)), copies)
