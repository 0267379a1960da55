"""Strands in a session: which groom an avatar wears, its Gaussians, and what becomes of the hair that it was trained with.

Grooms are made ready once (`hair.strands`), posed once for each mesh, and turned into Gaussians for each picture. Called by
`local` and `compose`; the numbers are numpy's, for every engine, and become the engine's at the end.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from ..avatar import Hair
from ..controls.frame import Controls
from ..errors import ShapeError
from ..geometry.camera import Camera
from ..geometry.libraries import to_numpy, zeros
from ..hair.drawing import Hiding, StrandGaussians, level_share, strand_gaussians
from ..hair.groom import Groom
from ..hair.packaged import library_groom
from ..hair.ribbons import Eye
from ..hair.settings import HairSettings
from ..hair.strands import StrandBlock, blocks_of
from ..head import HeadModel
from ..splat.types import Gaussians
from .cap import Cap
from .engines import Engine
from .evaluator import Evaluator, Inputs, OpenAvatar
from .scalp import Skin, bare_skin, cap_color
from .wearing import GROOM_PREFIX, NO_HAIR, OWN_HAIR, PUT_PREFIX, HairUse

EXPORT_DENSITY = 1000.0  # pixels per metre for which Gaussians are made where there is no picture
_READY = 6  # grooms that are kept ready
_HIDING_ISLAND = 0  # of the UV map: the skin hides hair, eyes and teeth are behind it


@dataclass(frozen=True)
class Worn:
    """A groom on an avatar.

    Attributes:
        key: What identifies the groom and its version; () where there are no strands.
        groom: The strands, or None.
        settings: To draw with.
        points: See `api.HairUse`.
    """

    key: tuple[str, ...]
    groom: Groom | None
    settings: HairSettings
    points: np.ndarray | None = None


class Wardrobe:
    """The grooms of a session."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._put: dict[str, tuple[str, Groom]] = {}
        self._ready: dict[tuple[str, ...], tuple[StrandBlock, ...]] = {}

    def put(self, name: str, version: str, groom: Groom) -> str:
        """See `api.Session.put_groom`."""
        if name not in self._put or self._put[name][0] != version:
            self._put[name] = (version, groom)
        return PUT_PREFIX + name

    def worn(self, target: OpenAvatar, use: HairUse) -> Worn | None:
        """What an avatar wears; None where its hair is the trained one. Raises `ShapeError` for a groom that there is not."""
        own = target.avatar.hair
        if use.groom == OWN_HAIR:
            if own is None:
                return None
            return self._fit(Worn((OWN_HAIR, str(target.id)), own.groom, use.settings or own.settings, use.points))
        if use.groom == NO_HAIR:
            return Worn((), None, use.settings or HairSettings())
        if use.groom.startswith(PUT_PREFIX):
            known = self._put.get(use.groom.removeprefix(PUT_PREFIX))
            if known is None:
                raise ShapeError(f"There is no groom {use.groom!r} in this session; put it there first.")
            return self._fit(Worn((use.groom, known[0]), known[1], use.settings or HairSettings(), use.points))
        if not use.groom.startswith(GROOM_PREFIX):
            raise ShapeError(f"There is no hair {use.groom[:60]!r}; use own, none, groom:NAME or a groom that was put here.")
        found = library_groom(use.groom.removeprefix(GROOM_PREFIX), target.model.head_model.name)
        return self._fit(Worn((use.groom,), found, use.settings or HairSettings(), use.points))

    @staticmethod
    def _fit(worn: Worn) -> Worn:
        groom = worn.groom
        if worn.points is not None and groom is not None and len(worn.points) != len(groom.points):
            raise ShapeError(f"{len(worn.points)} moved points were given for a groom of {len(groom.points)}; give it anew.")
        return worn

    def blocks(self, worn: Worn, head: HeadModel) -> tuple[StrandBlock, ...]:
        """The strands made ready for a head; () for none."""
        if worn.groom is None:
            return ()
        key = (*worn.key, head.name)
        if key not in self._ready:
            while len(self._ready) >= _READY:
                self._ready.pop(next(iter(self._ready)))
            self._ready[key] = blocks_of(worn.groom, head.v_template, head.faces)
        return self._ready[key]

    def cap(self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn) -> Cap:
        """What lays the trained hair flat; see `scalp`."""

        def bare() -> Skin:
            return bare_skin(evaluator, target, _at_rest(evaluator, target, inputs))

        def make() -> Cap:
            skin = evaluator.cache.get((target.id, "skin", *inputs.identity_key), bare)
            color = cap_color(evaluator, target, skin, self.blocks(worn, target.model.head_model), worn.settings)
            return Cap(self._engine.array(skin.share), self._engine.array(color))

        return evaluator.cache.get((target.id, "cap", *worn.key, *inputs.identity_key, *worn.settings.color_key), make)

    def gaussians(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn, camera: Camera | None, lod: int = 0,
        direction: np.ndarray | None = None,
    ) -> Gaussians | None:  # fmt: skip
        """Return the strands' Gaussians in head space as the engine's arrays; None where there are no strands.

        Args:
            evaluator: Of the session.
            target: Who wears them.
            inputs: Of the frame.
            worn: What.
            camera: In head space; None for exports, which have no picture: all around, opacities as they are.
            lod: See `api.RenderOptions.lod`.
            direction: Without a camera, the unit vector towards the eye that colors are for, [3].
        """
        head = target.model.head_model
        blocks = self.blocks(worn, head)
        if not blocks:
            return None
        eye = None if camera is None else Eye.of(camera)
        share = level_share(blocks, EXPORT_DENSITY if eye is None else eye.pixels_per_metre()) / 4**lod
        vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
        hiding = None
        if camera is not None:
            hiding = Hiding.of(vertices, np.asarray(head.faces)[np.asarray(head.uv_islands) == _HIDING_ISLAND], camera)
        parts = []
        for number, block in enumerate(blocks):
            points, axes = self._posed(evaluator, target, inputs, worn, vertices, number, block)
            parts.append(strand_gaussians(block, points, axes, worn.settings, share, eye, hiding, direction))
        joined = StrandGaussians(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))
        drawn = joined.opacities > 0
        return Gaussians(*(self._engine.array(array[drawn]) for array in joined))

    def dressed(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn | None, direction: np.ndarray, lod: int
    ) -> Gaussians:
        """All Gaussians for a view direction in head space, those of strands last and without features."""
        cap = None if worn is None else self.cap(evaluator, target, inputs, worn)
        own = evaluator.gaussians(target, inputs, direction, lod, cap)
        strands = None if worn is None else self.gaussians(evaluator, target, inputs, worn, None, lod, direction)
        if strands is None or own.features is None:
            return own
        return Gaussians.concatenate([own, with_channels(strands, own.features.shape[1])])

    def kept(self, target: OpenAvatar, use: HairUse) -> Hair | None:
        """What an avatar's file holds of the hair that it wears."""
        worn = self.worn(target, use)
        return None if worn is None else Hair(worn.groom, worn.settings)

    def _posed(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn, vertices: np.ndarray, number: int,
        block: StrandBlock,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Parents' points in head space and their roots' axes."""

        def styled() -> tuple[np.ndarray]:
            return (block.styled(worn.settings),)

        def make() -> tuple[np.ndarray, np.ndarray]:
            origin, axes = (part.astype(np.float32) for part in block.frames.at(vertices))
            if worn.points is not None and worn.groom is not None:
                return block.resampled(worn.groom, worn.points), axes
            key = (target.id, "styled", number, *worn.key, *worn.settings.shape_key)
            local = evaluator.cache.get(key, styled)[0]
            return np.matmul(local, axes) + origin[:, None], axes

        if worn.points is not None:
            return make()
        return evaluator.cache.get((target.id, "strands", number, *worn.key, *worn.settings.shape_key, *inputs.mesh_key), make)


def with_channels(strands: Gaussians, count: int) -> Gaussians:
    """Strands with `count` feature channels of zeros."""
    return dataclasses.replace(strands, features=zeros((len(strands), count), strands.means))


def _at_rest(evaluator: Evaluator, target: OpenAvatar, inputs: Inputs) -> Inputs:
    """The inputs of the person at rest."""
    rest = evaluator.inputs(target, Controls())
    return dataclasses.replace(inputs, z_exp=rest.z_exp, expression=rest.expression, pose=rest.pose, strength=rest.strength)
