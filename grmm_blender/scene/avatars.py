"""The avatars of a scene, and as an evaluated scene shows them."""

from __future__ import annotations

import functools
import math
from collections.abc import Iterable
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ...grmm_core.errors import GrmmError
from ...grmm_core.fitting.photo_light import MATT
from ...grmm_core.hair import SETTINGS, HairSettings
from ...grmm_core.light.lamps import Lighting
from ...grmm_core.light.shading import Response
from ...grmm_core.session import HairUse
from ...grmm_core.session.wearing import GROOM_PREFIX, RANDOM_PREFIX
from ..hair import StrandShot, read_strands
from ..hair.curve_sliders import NEUTRAL
from ..hair.grooms import NO_HAIR, OWN_HAIR, PARTS, RANDOM_HAIR
from ..hair.read import HELD, HELD_PREFIX, MADE_OF
from ..hair.swing import swung
from ..properties import PHOTO_LIGHT, SCENE_LIGHT
from ..rig.avatar import Avatar, is_avatar
from ..splats.cloud import carries_splats
from .photo_light import photo_lighting
from .shot import WEARS_ITS_OWN, AvatarShot
from .visibility import is_holdout

_LEAST_SIZE = 1e-6  # of a scale
_HEAD_RADIUS = 0.19  # metres around the head's origin that hold hair and neck
_CENTRE = Vector((0.0, -0.01, 0.0))  # of the head, in its own axes


def _light(settings: bpy.types.PropertyGroup, source: str) -> tuple[Response | None, Lighting | None]:
    """How a head takes light that is not the studio's, and that light where it is its photo's and not the scene's."""
    if settings.lighting == PHOTO_LIGHT:
        own = photo_lighting(source)
        return None if own is None else MATT, own
    if settings.lighting != SCENE_LIGHT:
        return None, None
    factors = settings.light_intensity, settings.skin_gloss, settings.skin_scattering, settings.shadow_softness
    return Response(*factors, detail=settings.skin_detail), None


@functools.lru_cache(maxsize=64)
def _hair_use(groom: str, parts: tuple[str, ...], values: tuple[float, ...], of_own: bool) -> HairUse:
    """What the panel's choice of hair and of its `PARTS` means to a session; `of_own`: it was made of the avatar's own."""
    near = np.allclose(values, [row.default for row in SETTINGS], atol=1e-6)
    settings = None if near else HairSettings(*values)
    if {groom, *parts} == {OWN_HAIR} and settings is None:
        return WEARS_ITS_OWN
    own = {OWN_HAIR: OWN_HAIR.lower(), NO_HAIR: NO_HAIR.lower()}
    named = own.get(groom) or (groom if groom.startswith(RANDOM_PREFIX) else GROOM_PREFIX + groom)
    brows, beard, lashes = (own.get(name, name) for name in parts)
    return HairUse(named, settings, None, brows, beard, lashes, of_own=of_own)


@dataclass(frozen=True)
class HeadPlace:
    """Where a head is in the world.

    Attributes:
        centre: Middle of the head with its hair, metres.
        radius: Of a ball around it that holds hair and neck.
        facing: Angle about the world's z axis by which it is turned, radians; 0 looks along -y.
    """

    centre: Vector
    radius: float
    facing: float


@dataclass(frozen=True, eq=False)
class DrawnAvatar:
    """An avatar in one place of an evaluated scene.

    Attributes:
        avatar: The avatar.
        model_to_world: Head space to Blender's world, [4, 4].
    """

    avatar: Avatar
    model_to_world: np.ndarray

    @property
    def object(self) -> bpy.types.Object:
        """The head object."""
        return self.avatar.object

    @property
    def has_size(self) -> bool:
        """Whether there is anything to see: animators scale people to nothing."""
        return bool(np.linalg.norm(self.model_to_world[:3, :3]) > _LEAST_SIZE)

    @property
    def meshes(self) -> tuple[bpy.types.Object, ...]:
        """Mesh objects in whose place Gaussians are drawn."""
        return (self.object,)

    def shot(self, depsgraph: bpy.types.Depsgraph) -> AvatarShot:
        """Copy the avatar as it is in the depsgraph's moment."""
        controls, cuts = self.avatar.controls(depsgraph), is_holdout(self.object, depsgraph.view_layer)
        settings = self.object.evaluated_get(depsgraph).grmm
        hair, strands, note = self._hair(settings.hair, depsgraph)
        response, own_light = _light(settings, self.avatar.source)
        return AvatarShot(
            self.avatar.name, self.avatar.source, controls, self.model_to_world, cuts, hair=hair, strands=strands, note=note,
            response=response, own_light=own_light, wrinkles=settings.wrinkles,
        )  # fmt: skip

    def _hair(
        self, settings: bpy.types.PropertyGroup, depsgraph: bpy.types.Depsgraph
    ) -> tuple[HairUse, StrandShot | None, str]:
        """What the avatar wears, the strands of its curves, and what is wrong with them: then the groom is there instead."""
        groom, strands, note = settings.groom, None, ""
        if settings.curves is not None:
            try:
                strands = read_strands(self.object, settings.curves, depsgraph, self.avatar.model_to_world(depsgraph))
                groom = NO_HAIR
            except GrmmError as error:
                note = str(error)
        if groom == RANDOM_HAIR:
            groom = f"{RANDOM_PREFIX}{settings.seed}"
        parts, values = (tuple(getattr(settings, name) for name in names) for names in (PARTS, [row.name for row in SETTINGS]))
        if strands is not None:
            held, data = set(strands.groom.groups.tolist()), settings.curves.data
            given = {part: data.get(f"{HELD_PREFIX}{part}") for part in HELD}  # what they were made from, unless chosen anew
            parts = tuple(
                name if part not in HELD or given[part] != name else OWN_HAIR if HELD[part] in held else NO_HAIR
                for part, name in zip(PARTS, parts, strict=True)
            )
        if strands is not None and strands.shaped:
            values = tuple(NEUTRAL.get(row.name, value) for row, value in zip(SETTINGS, values, strict=True))
        use = _hair_use(groom, parts, values, strands is not None and settings.curves.data.get(MADE_OF) == OWN_HAIR)
        if settings.curves is None:
            use, note = swung(use, self.object.evaluated_get(depsgraph), depsgraph.scene.frame_current_final)
        return use, strands, note


def place_of(avatar: Avatar, depsgraph: bpy.types.Depsgraph) -> HeadPlace:
    """Return where an avatar's head is in the depsgraph's moment."""
    matrix = Matrix(avatar.model_to_world(depsgraph).tolist())
    turn = matrix.to_3x3()
    forward = turn @ Vector((0.0, 0.0, 1.0))
    radius = _HEAD_RADIUS * float(np.cbrt(abs(turn.determinant())))
    return HeadPlace(matrix @ _CENTRE, radius, math.atan2(forward.x, -forward.y))


def avatars_in(scene: bpy.types.Scene) -> list[Avatar]:
    """Return the avatars of a scene, each once, in the order of their names."""
    return _by_name(scene.objects)


def avatars_shown(depsgraph: bpy.types.Depsgraph) -> list[Avatar]:
    """Return the avatars that an evaluated scene shows, also as instances alone; each once, in the order of their names."""
    return _by_name(instance.object for instance in depsgraph.object_instances)


def avatars_with_instanced(scene: bpy.types.Scene) -> list[Avatar]:
    """As `avatars_in`, with those of collections that the scene shows as instances."""
    objects, waiting = dict.fromkeys(scene.objects), list(scene.objects)
    while waiting:
        instanced = waiting.pop().instance_collection
        fresh = [obj for obj in instanced.all_objects if obj not in objects] if instanced is not None else []
        objects |= dict.fromkeys(fresh)
        waiting += fresh
    return _by_name(objects)


def _by_name(objects: Iterable[bpy.types.Object]) -> list[Avatar]:
    return sorted({Avatar(obj) for obj in objects if is_avatar(obj)}, key=lambda avatar: avatar.name)


def is_drawn(avatar: Avatar) -> bool:
    """Whether Gaussians draw a head: not where it only carries imported splats, or no network belongs to it."""
    return avatar.has_network and not carries_splats(avatar.object)


def drawn_avatar(instance: bpy.types.DepsgraphObjectInstance, depsgraph: bpy.types.Depsgraph) -> DrawnAvatar | None:
    """Return the avatar that an instance is, None where it is something else or a mesh alone."""
    if not is_avatar(instance.object):
        return None
    avatar = Avatar(instance.object)
    if not is_drawn(avatar):
        return None
    if instance.is_instance:
        return DrawnAvatar(avatar, avatar.instance_to_world(instance.matrix_world, depsgraph))
    return DrawnAvatar(avatar, avatar.model_to_world(depsgraph))
