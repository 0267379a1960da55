"""Strands in a session: which groom an avatar wears, its Gaussians, and what becomes of the hair that it was trained with.

Grooms are made ready once (`hair.strands`), posed once for each mesh, and turned into Gaussians for each picture. Called by
`local` and `compose`; the numbers are numpy's, for every engine, and become the engine's at the end.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import TypeVar

import numpy as np

from ..avatar import Hair
from ..compute.recent import Recent
from ..errors import ShapeError
from ..geometry.camera import Camera
from ..geometry.libraries import to_numpy, zeros
from ..hair.body import on_person
from ..hair.brows import FULLEST_BROWS, at_height_of
from ..hair.contact import moved as displaced
from ..hair.drawing import Hiding, level_shares, nearer, raised_by, strand_gaussians
from ..hair.groom import Groom, join
from ..hair.lashes import Lashes
from ..hair.packaged import HEAD, library_groom
from ..hair.prior import random_groom
from ..hair.ready import ready, strands_of
from ..hair.ribbons import Eye
from ..hair.roots import BEARD, BROWS, GROUPS, LASHES, SCALP
from ..hair.settings import HairSettings
from ..hair.shoulders import Shoulders
from ..hair.strands import DENSE, StrandBlock, means_between
from ..head import HeadModel
from ..splat.types import Gaussians
from .cap import Cap
from .engines import Engine
from .evaluator import FRONT, Evaluator, Inputs, OpenAvatar, at_rest
from .hollow import SKIN_ISLAND, from_far, without_inside
from .photo_skin import as_found, plucked, still_there, untinted
from .scalp import SHADED, Covered, Skin, bare_skin, cap_color, covered, shade, shadow
from .wearing import GROOM_PREFIX, NO_HAIR, OWN_HAIR, PARTS, PUT_PREFIX, RANDOM_PREFIX, USUAL, HairUse

EXPORT_DENSITY = 1000.0  # pixels per metre for which Gaussians are made where there is no picture
FACE = BROWS, BEARD  # parts that a photo paints on the skin under them as well
READY = 12  # grooms that are kept ready
_COVERED: Recent[Covered] = Recent(3)  # by contents: a fit opens its person several times
Kept = TypeVar("Kept")


@dataclass(frozen=True)
class Layer:
    """Strands of one source.

    Attributes:
        key: What identifies the groom and its version.
        groom: The strands.
        points, swing: See `api.HairUse`.
    """

    key: tuple[str, ...]
    groom: Groom
    points: np.ndarray | None = None
    swing: np.ndarray | None = None

    def only(self, groups: tuple[int, ...]) -> Layer | None:
        """The strands of some parts; None where there are none."""
        wanted = np.isin(self.groom.groups, groups)
        if wanted.all():
            return self
        if not wanted.any():
            return None
        points = None if self.points is None else self.points[wanted[self.groom.strand_of_point]]
        swing = None if self.swing is None else self.swing[wanted]
        return Layer((*self.key, *map(str, groups)), self.groom.select(wanted), points, swing)


@dataclass(frozen=True)
class Worn:
    """What an avatar wears.

    Attributes:
        layers: The strands.
        settings: To draw them with, for each of `roots.GROUPS`.
        flat: The scalp is laid flat (`scalp`): the hair that the Gaussians were trained with does not show, or strands
            shade the skin.
        own: The hair is that of the avatar's file, or was made of it.
        photo: It is also that of a photo, which shows the skin under it.
        gone: Brows and beard of a photo that are not worn; it has painted the skin under them. None where there are none.
        tinted: The weights have a tint of brows on bare skin.
    """

    layers: tuple[Layer, ...]
    settings: tuple[HairSettings, ...]
    flat: bool
    own: bool
    photo: bool
    gone: Groom | None = None
    tinted: bool = False

    @property
    def key(self) -> tuple[str, ...]:
        """What identifies the strands."""
        return tuple(text for layer in self.layers for text in (*layer.key, "+"))


class Wardrobe:
    """The grooms of a session."""

    def __init__(self, engine: Engine) -> None:
        self._engine = engine
        self._put: dict[str, tuple[str, Groom]] = {}
        self._ready: dict[tuple[Hashable, ...], tuple[StrandBlock, ...]] = {}
        self._placed: dict[tuple[Hashable, ...], Groom] = {}
        self._lashes: dict[tuple[Hashable, ...], Lashes | None] = {}

    def put(self, name: str, version: str, groom: Groom) -> str:
        """See `api.Session.put_groom`."""
        if name not in self._put or self._put[name][0] != version:
            self._put[name] = (version, groom)
        return PUT_PREFIX + name

    def worn(self, target: OpenAvatar, use: HairUse) -> Worn | None:
        """What an avatar wears; None where that is in its Gaussians. Raises `ShapeError` for a groom that there is not."""
        own, head = target.avatar.hair, target.model.head_model.name
        hairless = target.model.config.hairless
        main = self._main(target, use)
        names = [OWN_HAIR, *(getattr(use, part) for part in PARTS)]  # in the order of the groups
        owned = tuple(group for group, name in enumerate(names) if name == OWN_HAIR)
        found = [None if main is None else main.only(owned)]
        recorded = None if own is None or own.groom is None or use.groom == OWN_HAIR else own.groom
        for group, part in enumerate(GROUPS):
            name = names[group]
            if group == SCALP or name == NO_HAIR:
                continue
            if name != OWN_HAIR:
                found.append(self._package(target, part, name.removeprefix(GROOM_PREFIX)))
            elif main is not None and (main.groom.groups == group).any():
                continue
            elif recorded is not None:
                found.append(Layer((OWN_HAIR, str(target.id)), recorded).only((group,)))
            elif hairless and own is None and part in USUAL and head == HEAD:  # the package has none for other heads
                found.append(Layer((part, USUAL[part]), library_groom(USUAL[part], head, part)))
        layers = tuple(layer for layer in found if layer is not None)
        instead = own is not None and own.scalp if use.groom == OWN_HAIR else True
        combed = any((layer.groom.groups == SCALP).any() for layer in layers)
        if not layers and not instead:
            return None
        settings = use.settings or (own.settings if own is not None and use.groom == OWN_HAIR else HairSettings())
        kept = {} if own is None else own.parts
        parts = [use.parts.get(part) or kept.get(part) or settings.for_part(group) for group, part in enumerate(GROUPS)]
        of_own, from_photos = use.groom == OWN_HAIR or use.of_own, target.avatar.provenance.from_photos
        bared = instead and (not hairless or (not of_own and from_photos))
        gone = None
        if from_photos and hairless and own is not None and own.groom is not None:
            others = [group for group in FACE if names[group] != OWN_HAIR]
            gone = own.groom.select(np.isin(own.groom.groups, others))
        gone = gone if gone is not None and len(gone) else None
        tinted = hairless and not from_photos and head == HEAD
        return Worn(layers, (settings, *parts[1:]), combed or bared, of_own, of_own and from_photos, gone, tinted)

    def _package(self, target: OpenAvatar, part: str, name: str) -> Layer:
        """A part of the package's; brows at the height of the person's own."""
        head, own = target.model.head_model, target.avatar.hair
        groom = library_groom(name, head.name, part)
        brows = None if own is None or own.groom is None else own.groom.select(own.groom.groups == BROWS)
        if part != GROUPS[BROWS] or brows is None or not len(brows):
            return Layer((part, name), groom)
        key = part, name, str(target.id)
        usual = library_groom(FULLEST_BROWS, head.name, part)
        return Layer(key, _kept(self._placed, key, lambda: at_height_of(groom, usual, brows, head)))

    def _main(self, target: OpenAvatar, use: HairUse) -> Layer | None:
        """The groom that is worn on the scalp, with what else is in it."""
        if use.groom == NO_HAIR:
            return None
        if use.groom == OWN_HAIR:
            own = target.avatar.hair
            layer = None if own is None or own.groom is None else Layer((OWN_HAIR, str(target.id)), own.groom)
        elif use.groom.startswith(PUT_PREFIX):
            known = self._put.get(use.groom.removeprefix(PUT_PREFIX))
            if known is None:
                raise ShapeError(f"There is no groom {use.groom!r} in this session; put it there first.")
            layer = Layer((use.groom, known[0]), known[1])
        elif use.groom.startswith(RANDOM_PREFIX):
            drawn = random_groom(use.groom.removeprefix(RANDOM_PREFIX), target.model.head_model.name)
            layer = Layer((use.groom,), drawn)
        elif use.groom.startswith(GROOM_PREFIX):
            found = library_groom(use.groom.removeprefix(GROOM_PREFIX), target.model.head_model.name)
            layer = Layer((use.groom,), found)
        else:
            raise ShapeError(f"There is no hair {use.groom[:60]!r}; use own, none, groom:NAME, random:SEED or one put here.")
        if layer is None:
            return None
        if use.points is not None and len(use.points) != len(layer.groom.points):
            count = len(layer.groom.points)
            raise ShapeError(f"{len(use.points)} moved points were given for a groom of {count}; give it anew.")
        if use.swing is not None and len(use.swing) != len(layer.groom):
            raise ShapeError(f"{len(use.swing)} strands swing where the groom has {len(layer.groom)}; simulate it anew.")
        return dataclasses.replace(layer, points=use.points, swing=use.swing)

    def blocks(self, layer: Layer, head: HeadModel) -> tuple[StrandBlock, ...]:
        """Strands made ready for a head."""
        return _kept(self._ready, (*layer.key, head.name), lambda: ready(layer.groom, head))

    def cap(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn, lit_later: bool = False
    ) -> Cap | None:  # fmt: skip
        """What lays the trained hair flat and darkens skin under strands; see `scalp`. None where neither is.

        Where a scene's light is to take the rig's place, its own shadows are those of hair beside the skin.
        """
        head, photo = target.model.head_model, target.avatar.provenance.from_photos
        on_face = any(np.isin(layer.groom.groups, FACE).any() for layer in worn.layers)
        if not (worn.flat or on_face or worn.tinted) and worn.gone is None:
            return None

        def bare(own: bool) -> Skin:
            def find() -> Skin:
                return bare_skin(evaluator, target, at_rest(target, inputs), own)

            return evaluator.cache.get((target.id, "skin", own, *inputs.identity_key), find)

        def find() -> Covered:
            blocks = [  # a photo shows how dark skin under its own brows and beard is
                block for layer in worn.layers for block in self.blocks(layer, head)
                if not (photo and layer.key[0] == OWN_HAIR and block.group in FACE)
            ]  # fmt: skip
            layout, grooms = target.model.layout, tuple(strands_of(layer.groom) for layer in worn.layers)
            return _COVERED.get((head, layout.face, layout.barycentric, photo, grooms), lambda: covered(target, blocks))

        def make() -> Cap:
            there = evaluator.cache.get((target.id, "covered", *worn.key), find)
            left, settings = shade(there, worn.settings), worn.settings[SCALP]
            if not lit_later:
                left = np.minimum(left, shadow(there, settings))
            skins = [(worn.own, np.ones((len(left), 1), np.float32))]
            if worn.photo:  # it shows how dark skin under its own hair is
                own, grooms = target.avatar.hair or Hair(None), [layer.groom for layer in worn.layers]
                stays = still_there(target, own.groom, grooms, settings)[:, None]
                left = left + stays * (1.0 - left)
                stays = stays * as_found(settings, own.settings)
                skins = [(True, stays), (False, 1.0 - stays)]
            share, color = np.zeros(len(left), np.float32), np.zeros((len(left), 3), np.float32)
            for own_skin, part in skins:
                if worn.flat and part.any():
                    skin, rig = bare(own_skin), not lit_later and not (own_skin and worn.photo)
                    share, color = share + part[:, 0] * skin.share, color + part * cap_color(skin, there, settings, rig)
            if worn.gone is not None:
                left = left * plucked(evaluator, target, at_rest(target, inputs), worn.gone)
            if worn.tinted:
                left = left * untinted(evaluator, target, at_rest(target, inputs))
            return Cap(*map(self._engine.array, (share, color, left)))

        scalp = worn.settings[SCALP]
        settings = *scalp.color_key, scalp.density, *(worn.settings[group].shading for group in SHADED)
        gone = () if worn.gone is None else tuple(np.unique(worn.gone.groups).tolist())
        look = worn.own, worn.flat, gone, *worn.key
        return evaluator.cache.get((target.id, "cap", lit_later, *look, *inputs.identity_key, *settings), make)

    def gaussians(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn, camera: Camera | None, lod: int = 0,
        detail: float = 1.0, direction: np.ndarray | None = None, hiding: Hiding | None = None,
    ) -> Gaussians | None:  # fmt: skip
        """Return the strands' Gaussians in head space as the engine's arrays; None where there are no strands.

        Their one feature is `StrandGaussians.share`.

        Args:
            evaluator: Of the session.
            target: Who wears them.
            inputs: Of the frame.
            worn: What.
            camera: In head space; None for exports, which have no picture: all around, opacities as they are.
            lod: See `api.RenderOptions.lod`.
            detail: See `api.RenderOptions.strands`.
            direction: Without a camera, the unit vector towards the eye that colors are for, [3].
            hiding: What the head hides, of `hiding`; None where it hides nothing.
        """
        head = target.model.head_model
        ready = [(layer, number, block) for layer in worn.layers for number, block in enumerate(self.blocks(layer, head))]
        if not ready:
            return None
        eye = None if camera is None else Eye.of(camera)
        density = EXPORT_DENSITY if eye is None else eye.pixels_per_metre()
        shares = level_shares([block for *_, block in ready], density, max(detail, 1.0), lod)
        vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
        parts = []
        for (layer, number, block), share in zip(ready, shares, strict=True):
            settings = worn.settings[block.group]
            fewer = min(detail, 1.0) if block.group in DENSE else 1.0
            count = block.parents(share, fewer)
            points, axes = self._posed(evaluator, target, inputs, layer, settings, vertices, number, block, count)
            if block.group == SCALP and layer.swing is not None:
                points = displaced(points, layer.swing[block.rows[: len(points)]])
            crowded = None
            if block.group in DENSE:
                crowded = self._crowded(evaluator, target, inputs, layer, number, block, fewer < 1.0)
            if fewer < 1.0:
                block, some = block.sparse
                points = points[:, some]
            if block.group == LASHES:  # also of curves: small triangles would twist them
                points = self._on_lids(head, layer, settings, vertices, block, points)
            how = settings, share, eye, hiding, direction, fewer
            made = strand_gaussians(block, points, axes, *how, crowded=crowded, evened=share)
            raised = raised_by(block, lod)
            if raised and eye is not None:
                made = nearer(made, eye, raised)
            parts.append(made)
        return Gaussians(*(self._engine.array(np.concatenate(arrays)) for arrays in zip(*parts, strict=True)))

    def hiding(self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, camera: Camera) -> Hiding:
        """What a head's skin hides from a camera in head space."""
        head = target.model.head_model
        skin = np.asarray(head.faces)[np.asarray(head.uv_islands) == SKIN_ISLAND]
        return Hiding.of(to_numpy(evaluator.mesh(target, inputs).vertices), skin, camera)

    def dressed(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn | None, view: np.ndarray | None, lod: int
    ) -> Gaussians:
        """All Gaussians as seen from a direction in head space, those of strands last and without features.

        From None they have the colors of the front, and none is left out, as other programs look at them from everywhere.
        """
        direction = FRONT if view is None else view
        cap = None if worn is None else self.cap(evaluator, target, inputs, worn)
        own = evaluator.gaussians(target, inputs, direction, lod, cap)
        if view is not None:
            own = without_inside(own, evaluator, target, inputs, lod, from_far(view))
        strands = None if worn is None else self.gaussians(evaluator, target, inputs, worn, None, lod, direction=direction)
        if strands is None or own.features is None:
            return own
        return Gaussians.concatenate([own, with_channels(strands, own.features.shape[1])])

    def kept(self, target: OpenAvatar, use: HairUse) -> Hair | None:
        """What an avatar's file holds of the hair that it wears."""
        worn = self.worn(target, use)
        if worn is None:
            return None
        grooms = [layer.groom for layer in worn.layers]
        parts = {part: worn.settings[group] for group, part in enumerate(GROUPS) if group != SCALP}
        own = target.avatar.hair
        scalp = use.groom != OWN_HAIR or (own is not None and own.scalp)
        return Hair(join(grooms) if grooms else None, worn.settings[SCALP], parts, scalp)

    def covering(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, worn: Worn
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Pieces of the scalp's hair in head space, each for a parent and its children.

        Returns:
            Middles, [P, 3] metres, and vectors along them as long as they cover seen from the side, [P, 3] square metres.
        """
        settings, head = worn.settings[SCALP], target.model.head_model
        vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
        middles, covers = [np.zeros((0, 3))], [np.zeros((0, 3))]
        for layer in worn.layers:
            for number, block in enumerate(self.blocks(layer, head)):
                if block.group != SCALP:
                    continue
                points = self._posed(evaluator, target, inputs, layer, settings, vertices, number, block)[0]
                radii, there = block.level(1.0, settings)
                widths = np.bincount(block.owner[: len(there)], 2.0 * radii.mean(1) * there, len(points))
                middles.append((0.5 * (points[:, 1:] + points[:, :-1])).reshape(-1, 3))
                covers.append((np.diff(points, axis=1) * widths[:, None, None]).reshape(-1, 3))
        return np.concatenate(middles), np.concatenate(covers)

    def _posed(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, layer: Layer, settings: HairSettings,
        vertices: np.ndarray, number: int, block: StrandBlock, count: int | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
        """Parents' points in head space and their roots' axes; of the first `count` where these are made anew."""

        def make() -> tuple[np.ndarray, np.ndarray]:
            origin, axes = block.frames.standing(vertices, some)
            if layer.points is not None:
                moved = block.resampled(layer.groom, layer.points)
                if not settings.keeps_shape:
                    local = np.einsum("mkj,mij->mki", moved - origin[:, None], axes)
                    moved = np.matmul(block.styled(settings, local), axes) + origin[:, None]
                return moved, axes
            local, shoulders = self._at_rest(evaluator, target, inputs, layer, settings, number, block)
            points = _stood(local, origin, axes)
            for one in shoulders if layer.swing is None else ():
                points = one.left(vertices, points)
            return points, axes

        some = None if layer.points is not None else count
        if layer.points is not None:
            return make()
        return evaluator.cache.get(
            (target.id, "strands", number, some, layer.swing is None, *layer.key, *settings.shape_key, *inputs.mesh_key), make
        )

    def _at_rest(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, layer: Layer, settings: HairSettings, number: int,
        block: StrandBlock,
    ) -> tuple[np.ndarray, tuple[Shoulders, ...]]:  # fmt: skip
        """Parents' points in the axes of their roots, on the person at rest, and how shoulders push them."""
        rest, head = at_rest(target, inputs), target.model.head_model

        def make() -> tuple[np.ndarray, tuple[Shoulders, ...]]:
            local = block.styled(settings)
            if block.group != SCALP:
                return local, ()
            still = to_numpy(evaluator.mesh(target, rest).vertices)
            local = on_person(head, still, block.frames, local, block.lock)
            return local, Shoulders.of(head, still, _stood(local, *block.frames.standing(still)), block.lock)

        return evaluator.cache.get((target.id, "styled", number, *layer.key, *settings.shape_key, *rest.mesh_key), make)

    def _crowded(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, layer: Layer, number: int, block: StrandBlock,
        sparse: bool,
    ) -> np.ndarray:  # fmt: skip
        """`StrandBlock.crowded` on the person at rest, of hair as it was put on: shape settings change too often."""
        rest = at_rest(target, inputs)
        key = (target.id, "crowded", number, *layer.key, *rest.mesh_key)

        def make() -> tuple[np.ndarray]:
            origin, axes = block.frames.standing(to_numpy(evaluator.mesh(target, rest).vertices))
            local, _ = self._at_rest(evaluator, target, inputs, layer, HairSettings(), number, block)
            return (block.crowded(_stood(local, origin, axes), axes),)

        def coarser() -> tuple[np.ndarray]:
            return (means_between(evaluator.cache.get(key, make)[0], block.sparse[1]),)

        return evaluator.cache.get((*key, "sparse"), coarser)[0] if sparse else evaluator.cache.get(key, make)[0]

    def _on_lids(
        self, head: HeadModel, layer: Layer, settings: HairSettings, vertices: np.ndarray, block: StrandBlock,
        points: np.ndarray,
    ) -> np.ndarray:  # fmt: skip
        """Lashes' points [M, K, 3] that go with the lids, instead of those given, which go with small triangles."""

        def make() -> Lashes | None:
            local = block.styled(settings).reshape(-1, 3)
            offsets = np.arange(len(block.rows) + 1) * (block.segments + 1)
            some = dataclasses.replace(layer.groom.select(block.rows), points=local, offsets=offsets)
            return Lashes.build(head, np.asarray(head.v_template, float), some)

        lashes = _kept(self._lashes, (*layer.key, head.name, *settings.shape_key), make)
        return points if lashes is None else lashes.drawn_points(vertices.astype(float)).astype(np.float32)


def _stood(local: np.ndarray, origin: np.ndarray, axes: np.ndarray) -> np.ndarray:
    """Points [M, K, 3] of strands in the axes [M, 3, 3] of their roots [M, 3], in head space."""
    from ..hair.strand_kernels import stand

    points = np.empty((len(origin), *local.shape[1:]), np.float32)
    stand(np.ascontiguousarray(local, np.float32), origin, axes, points)
    return points


def _kept(known: dict[tuple[Hashable, ...], Kept], key: tuple[Hashable, ...], make: Callable[[], Kept]) -> Kept:
    """What is known by a key, made where it is not; the oldest of many is forgotten."""
    if key not in known:
        while len(known) >= READY:
            known.pop(next(iter(known)))
        known[key] = make()
    return known[key]


def with_channels(strands: Gaussians, count: int) -> Gaussians:
    """Strands with `count` feature channels of zeros."""
    return dataclasses.replace(strands, features=zeros((len(strands), count), strands.means))
