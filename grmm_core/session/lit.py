"""Avatars in a scene's light: what a session keeps of it, and the channels that ride along with the Gaussians.

What changes seldom is kept: a head's transfer and the rig's light for an identity, which part of a lamp is seen for a mesh and
the lamp. A moved camera costs highlights alone. The numbers are numpy's and become the engine's at the end. `compose` calls.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from collections.abc import Hashable

import numpy as np

from ..errors import ShapeError
from ..geometry.boxes import box_around
from ..geometry.libraries import present, to_numpy
from ..light.bounce import nearest_points
from ..light.cornea import bulged, on_eyes
from ..light.expressed import brightness, rig_in_colors, shut_eyes
from ..light.hair_shading import CELL, HairCloud, LightGrid, Reaching, strand_light
from ..light.lamps import STUDIO, Lamp, Lighting
from ..light.materials import Materials, materials_of
from ..light.mesh_light import NOT_SOFTENED, LitSurface, TexelGrid
from ..light.posture import Posture
from ..light.resting import RestLight, Texels, casting_faces, even_mouth, mouth_rows, texel_grid
from ..light.shading import FADING, Learned, Response, facing, relative, shade
from ..light.shadows import Casters, Maps, Receivers, compiled_kernels, maps_of
from ..light.skin_relief import VALUES, lying
from ..light.surroundings import coefficients_of, mean_irradiance
from ..light.texel_shadows import TexelShadows
from ..light.transfer import vertex_normals
from ..splat.types import Gaussians
from .evaluator import FRONT as FROM_FRONT
from .evaluator import Evaluator, Inputs, OpenAvatar, at_rest
from .shading_hair import Hair

RATIO, HIGHLIGHTS, FRONT, SHADOW = slice(0, 3), slice(3, 6), 6, slice(7, 8)  # of `shading.relative`
LIGHT_CHANNELS = 8
UNLIT = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0, 1.0], np.float32)  # what changes nothing
_VIEWS, _VIEW_DISTANCE = 16.0, 1.1  # steps of a direction's coordinates; metres
_AROUND = 0.08  # metres around a head at rest within which the rig's light in hair is known
_BOWL = 0.5  # of light from all around that reaches the inner side of an open bust


class LitAvatar:
    """One avatar in one light, in head space.

    Args:
        evaluator: Of the session.
        target: Who.
        inputs: Of the frame.
        lighting: In head space.
        response: How the avatar takes it.
        lod: Level of detail of the skin's Gaussians.
        hair: What throws shadows on the skin besides the mesh.
        softened: How much of skin's relief stands in irradiance (`skin_relief.softened`), [3] or [0].
    """

    def __init__(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, lighting: Lighting, response: Response, lod: int = 0,
        hair: Hair | None = None, softened: np.ndarray = NOT_SOFTENED,
    ) -> None:  # fmt: skip
        self._evaluator, self._target, self._inputs = evaluator, target, inputs
        self._lighting, self._response, self._lod = lighting, response, lod
        self._hair, self._softened = hair, softened if response.detail and not response.even_mouth else NOT_SOFTENED
        self._head = target.model.head_model
        self._vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
        if len(lighting.local) not in (0, len(self._vertices)):
            raise ShapeError("A photo's light lies on another head than this one; use the light of the avatar's own photos.")
        self._box = box_around(self._vertices)
        self._centre = 0.5 * (self._box[0] + self._box[1])
        self.lamps = lighting.shaded(tuple(self._centre))

    def channels(self, eye: np.ndarray, strands: Gaussians | None) -> list[np.ndarray]:
        """What rides along with the Gaussians of the skin and then of the strands.

        Args:
            eye: The viewer's place in head space, [3].
            strands: Drawn behind the skin's, or None (`Wardrobe.gaussians`).

        Returns:
            [N, LIGHT_CHANNELS] float32 of the skin and of the strands, if any, as of `shading.relative`.
        """
        around = self._lighting.surroundings
        light = repr(self.lamps), b"" if around is None else around.coefficients.tobytes(), self._occluders_key, self._local_key
        worn = () if self._hair is None else self._hair.key
        key = (eye.tobytes(), self._response, len(self._softened), *light, worn, *self._inputs.mesh_key)
        cache, owner = self._evaluator.cache, self._target.id
        skin, self._tilts = cache.get((owner, "lit", self._lod, *key), lambda: self._skin(eye))
        if strands is None:
            return [skin]
        points, quats, share = (to_numpy(part) for part in (strands.means, strands.quats, present(strands.features)))
        these = hash(np.ascontiguousarray(points).tobytes())  # combed, swinging, thinned out
        lit_hair = owner, "lit hair", these, hash(np.ascontiguousarray(share).tobytes()), *key
        hair = cache.get(lit_hair, lambda: (self._strands(points, quats, share, eye, these),))[0]
        return [skin, hair]

    def surface(self, light: np.ndarray) -> LitSurface | None:
        """The mesh with light of `channels`; None where a Gaussian stands for several texels."""
        if self._lod:
            return None

        def make() -> tuple[np.ndarray, ...]:
            layout = self._target.model.layout
            found = texel_grid(self._head, layout.uv, layout.grid, layout.texel)
            return *found[:3], np.array(found.closed)

        faces, places, rows, closed = self._evaluator.cache.get((self._target.id, "texel grid"), make)
        grid, detail = TexelGrid(faces, places, rows, int(closed)), self._response.detail
        return LitSurface(grid, self._vertices, light, self._tilts, self._lying() if detail else None, detail, self._softened)

    def _skin(self, eye: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        rest = self._rest
        turn = self._posture.turn
        seen = self._all_seen(self._asked(eye))
        light = self.lamps, self._receivers, seen, self._materials(), rest.transfer[self._rows], eye
        tilts = np.empty((0 if self._lod else len(self._drawn.corners), VALUES + len(self._softened)), np.float32)
        around = coefficients_of(self._lighting.surroundings, turn.T)
        scene = shade(*light, around, self._response, turn, tilts)
        if self._response.gloss:
            self._glints(scene.highlights, seen, eye, around, turn)
        learned = Learned(self._rig(), self._learned((eye - self._centre) @ turn))
        bounced = rest.exchange.bounced(scene.irradiance[self._at_vertices], rest.albedo)
        corners = self._drawn.corners
        inside = mean_irradiance(self._lighting.surroundings) * (_BOWL * self._response.intensity)
        found = relative(scene, bounced, corners, self._drawn.barycentric, learned, self._response.gloss, inside)
        fine = self._lighting.fine
        if len(self._lighting.local) or len(fine):
            at_rows = fine[self._rows] if len(fine) == len(self._texels.corners) else None
            found[:, RATIO] *= self._drawn.factor(self._lighting.local, at_rows)
        rows = self._evaluator.cache.get((self._target.id, "mouth", self._lod), lambda: mouth_rows(self._head, corners))
        even_mouth(*rows, found, FRONT, bound=not self._response.even_mouth)
        return found, tilts

    def _glints(self, highlights: np.ndarray, seen: np.ndarray, eye: np.ndarray, around: np.ndarray, turn: np.ndarray) -> None:
        """Put highlights of corneas where those of eyeballs are, [N, 3]."""
        held, corners = self._receivers, self._drawn.corners
        rows = self._evaluator.cache.get((self._target.id, "eyes", self._lod), lambda: (on_eyes(self._head, corners),))[0]
        normals = bulged(self._head, self._vertices, corners[rows], held.normals[rows]).astype(np.float32)
        there = dataclasses.replace(held, points=held.points[rows], normals=normals)
        light = self.lamps, there, seen[:, rows], self._materials().taken(rows), self._rest.transfer[self._rows][rows], eye
        highlights[rows] = shade(*light, around, self._response, turn).highlights

    def _asked(self, eye: np.ndarray) -> np.ndarray:
        """Numbers of Gaussians whose shadows are needed: what faces the eye (`Arrived.front`), and what lies at vertices."""
        held = self._receivers
        farthest = float(np.linalg.norm(eye - held.centre)) + held.radius
        asked = facing(held, eye, -farthest / FADING)
        asked[self._at_vertices] = True
        return np.flatnonzero(asked).astype(np.int32)

    def _strands(self, points: np.ndarray, quats: np.ndarray, share: np.ndarray, eye: np.ndarray, these: int) -> np.ndarray:
        """What lights strands, `these`, as `channels` has it, less what their colors hold of the rig's."""
        grid, centre = self._grid, self._posture.middle
        coordinates = grid.coordinates(np.eye(3), np.zeros(3))
        asked = grid.around_points(points, coordinates)
        parts = [self._reaching(lamp, asked) for lamp in self.lamps]
        here = Reaching(np.stack(parts, -1) if parts else np.zeros((*grid.size, 0)), coordinates)
        scene = strand_light(
            self.lamps, points, quats, here, centre, eye, coefficients_of(self._lighting.surroundings), self._response
        )  # fmt: skip
        nowhere = np.zeros((0, 3), np.int32)  # no skin lights hair

        def make() -> Learned:
            within, around = self._rig_in_hair(), coefficients_of(STUDIO.surroundings)
            return Learned.of(strand_light(STUDIO.lamps, points, quats, within, centre, eye, around))

        key = (self._target.id, "rig on hair", these, eye.tobytes(), self._posture.to_rest.tobytes())
        learned = Learned(*self._evaluator.cache.get((*key, *self._inputs.identity_key, *self._inputs.shape_key), make))
        light = relative(scene, nowhere, nowhere, nowhere, learned, self._response.gloss)
        light[:, HIGHLIGHTS] *= share  # which their colors hold already
        return light

    # --- what is kept ----------------------------------------------------------------------------------------------

    def _materials(self) -> Materials:
        def make() -> tuple[np.ndarray, ...]:
            return tuple(vars(materials_of(self._head, *self._texels[:2]).taken(self._rows)).values())

        return Materials(*self._evaluator.cache.get((self._target.id, "materials", self._lod), make))

    def _lying(self) -> np.ndarray:
        def make() -> tuple[np.ndarray]:
            layout = self._target.model.layout
            return (lying(self._head, self._rest.vertices, layout.uv, layout.grid, layout.face),)

        key = (self._target.id, "relief", *self._inputs.identity_key, *self._inputs.shape_key)
        return self._evaluator.cache.get(key, make)[0]

    def _rig(self) -> np.ndarray:
        """The rig's irradiance that colors hold in this expression, [N, 3]."""
        evaluator, target, inputs, texels = self._evaluator, self._target, self._inputs, self._texels
        tint, rig = to_numpy(evaluator.tint(target, inputs)), self._rest.rig
        if self._response.rig_at_rest or len(tint) != len(rig):
            return rig[self._rows]

        def bright(tint: np.ndarray) -> np.ndarray:
            colors = to_numpy(evaluator.appearance(target, inputs, FROM_FRONT)[0])
            return brightness(texels, colors, tint, len(self._vertices))

        def still() -> tuple[np.ndarray]:
            return (bright(to_numpy(evaluator.tint(target, at_rest(target, inputs)))),)

        def make() -> tuple[np.ndarray]:
            rest = evaluator.cache.get((target.id, "bright at rest", *inputs.identity_key), still)[0]
            return (rig_in_colors(rig, self._head, texels, rest, bright(tint), shut, self._rest.turned_out)[self._rows],)

        back = self._posture.to_rest
        shut = shut_eyes(self._rest, self._vertices @ back[:3, :3].T + back[:3, 3])
        key = (target.id, "rig in colors", self._lod, shut.tobytes(), *inputs.code_key, *inputs.shape_key)
        return evaluator.cache.get(key, make)[0]

    def _learned(self, towards: np.ndarray) -> np.ndarray:
        """Highlights of the rig that colors hold already, seen from a direction [3] in the axes of the head at rest, [N, 3].

        Kept for directions some degrees apart: colors hold them as they look from everywhere in the mean.
        """
        direction = np.round(towards / max(float(np.linalg.norm(towards)), 1e-9) * _VIEWS) / _VIEWS

        def make() -> tuple[np.ndarray]:
            return (self._rest.learned(direction * _VIEW_DISTANCE, self._texels, self._materials(), self._rows),)

        person = (*self._inputs.identity_key, *self._inputs.shape_key)
        return self._evaluator.cache.get((self._target.id, "learned", direction.tobytes(), self._lod, *person), make)[0]

    def _all_seen(self, asked: np.ndarray) -> np.ndarray:
        """Which part of each lamp the skin sees at `asked` numbers of Gaussians, [L, N]: lamps side by side on all threads."""
        split = (asked, asked[:0]) if self._lod else self._texel_shadows.split(asked)
        distinct = list(dict.fromkeys(self.lamps))  # two threads must not write what is known of one
        found: dict[Lamp, np.ndarray] = {}
        # what lamps share is made once, and not by each of their threads
        _ = self._rest, self._receivers, self._casters, self._grid, self._cloud, self._occluders_key

        def look(number: int) -> None:
            found[distinct[number]] = self._seen(distinct[number], asked, split)

        if compiled_kernels() is None:
            for number in range(len(distinct)):
                look(number)
        else:
            from ..compute.threads import for_each

            for_each(len(distinct), look)
        parts = np.empty((len(self.lamps), len(self._drawn.corners)), np.float32)
        for row, lamp in zip(parts, self.lamps, strict=True):
            row[:] = found[lamp]
        return parts

    def _seen(self, lamp: Lamp, asked: np.ndarray, split: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
        """Which part of a lamp the skin sees at `asked` numbers of Gaussians, [N]; not to be written to.

        At others it may be below 0. `split` is what `TexelShadows.split` makes of them.
        """
        known, _, *maps = self._shadow(lamp)
        fresh = self._lod == 0 and bool((known < 0.0).all())
        new = asked if fresh else asked[known[asked] < 0.0]
        if fresh:
            self._texel_shadows.seen(Maps(*maps), self._receivers, split, known, self._vertices)
        elif len(new):
            Maps(*maps).seen(self._receivers, new, known)
        if len(new) and self._cloud is not None:
            self._drawn.dim(known, new, self._through(lamp, self._cloud))
        return known

    def _reaching(self, lamp: Lamp, asked: np.ndarray) -> np.ndarray:
        """Which part of a lamp reaches hair at places `asked` [K] of `_grid`, [X, Y, Z]; at others it may be below 0."""
        _, known, *maps = self._shadow(lamp)
        flat = known.reshape(-1)
        new = asked[flat[asked] < 0.0]
        if len(new):
            flat[new] = Maps(*maps).reaching(self._grid.points[new]) * self._between(lamp, self._grid, self._to_cloud).flat[new]
        return known

    def _shadow(self, lamp: Lamp) -> tuple[np.ndarray, ...]:
        """What is known of a lamp's shadow.

        Returns:
            Which part of it the skin sees, [N], below 0 where that is not known yet; the same at the places of `_grid`,
            [X, Y, Z], empty where no hair is worn; and `Maps`.
        """

        def make() -> tuple[np.ndarray, ...]:
            count, grid, held = len(self._receivers.points), self._grid, self._receivers
            if not lamp.shadow or not len(self._casters.faces):
                return np.ones(count, np.float32), np.ones(grid.size, np.float32)
            if self._hair is not None and len(self._lighting.occluders):  # beside the head only these throw shadows
                held = Receivers.around(grid.points, grid.points)
            maps = maps_of(lamp, held, self._casters, self._response.softness)
            return np.full(count, -1.0, np.float32), np.full(grid.size, -1.0, np.float32), *maps

        mesh = (self._lod, () if self._hair is None else self._hair.key, *self._inputs.mesh_key)
        key = (self._target.id, "seen", repr(lamp), self._response.softness, self._occluders_key, *mesh)
        return self._evaluator.cache.get(key, make)

    def _through(self, lamp: Lamp, cloud: HairCloud) -> np.ndarray:
        """What hair leaves of a lamp's light at each vertex, [V]; its cells are no finer than the mesh.

        Hair that stays as on the head at rest is followed to vertices at rest: an expression that does not turn the head finds
        the last one's.
        """
        assert self._hair is not None
        if self._hair.moves:
            return cloud.through(lamp, self._vertices)
        there = self._posture.moved(lamp, self._posture.to_rest)
        key = (self._target.id, "through", self._hair.key, repr(there), *self._inputs.identity_key, *self._inputs.shape_key)
        return self._evaluator.cache.get(key, lambda: (cloud.through(there, self._rest.vertices),))[0]

    def _between(self, lamp: Lamp, grid: LightGrid, to_cloud: np.ndarray) -> np.ndarray:
        """What hair leaves of a lamp's light at places of a grid in axes from which `to_cloud` [4, 4] leads, [X, Y, Z].

        Like `_through` it is found again while hair and head do not turn.
        """
        cloud = self._cloud
        if cloud is None or not lamp.shadow:
            return np.ones(grid.size, np.float32)
        there = self._posture.moved(lamp, to_cloud)

        def make() -> tuple[np.ndarray]:
            return (cloud.through_to_hair(there, grid.points @ to_cloud[:3, :3].T + to_cloud[:3, 3]).reshape(grid.size),)

        where = to_cloud.tobytes(), grid.low.tobytes(), grid.size
        return self._evaluator.cache.get((self._target.id, "in hair", repr(there), *where, *self._hair_key), make)[0]

    @property
    def _hair_key(self) -> tuple[Hashable, ...]:
        """What identifies `_cloud`."""
        if self._hair is None:
            return ()
        person = self._inputs.mesh_key if self._hair.moves else (*self._inputs.identity_key, *self._inputs.shape_key)
        return self._hair.key, self._hair.moves, *person

    def _rig_in_hair(self) -> Reaching:
        """Which part of the rig's lamps reaches hair on the head at rest, carried along by the head's turn."""
        rest, back = self._rest, self._posture.to_rest
        low, high = self._posture.rest_box
        grid = LightGrid.around(low - _AROUND, high + _AROUND)
        person = (*self._inputs.identity_key, *self._inputs.shape_key)

        def bald() -> tuple[np.ndarray]:
            receivers = self._texels.receivers(rest.vertices, rest.normals)
            casters = self._casting(rest.vertices)
            parts = [maps_of(lamp, receivers, casters).reaching(grid.points).reshape(grid.size) for lamp in STUDIO.lamps]
            return (np.stack(parts, -1),)

        def make() -> tuple[np.ndarray]:
            parts = self._evaluator.cache.get((self._target.id, "rig on bald", *person), bald)[0]
            return (parts * np.stack([self._between(lamp, grid, onward) for lamp in STUDIO.lamps], -1),)

        onward = self._to_cloud @ np.linalg.inv(back) if self._hair is not None and self._hair.moves else np.eye(4)
        key = (self._target.id, "rig in hair", onward.tobytes(), *person, *self._hair_key)
        return Reaching(self._evaluator.cache.get(key, make)[0], grid.coordinates(back[:3, :3], back[:3, 3]))

    @functools.cached_property
    def _occluders_key(self) -> bytes:
        return hashlib.blake2b(self._lighting.occluders.tobytes(), digest_size=16).digest()

    # --- geometry --------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _rest(self) -> RestLight:
        def make() -> RestLight:
            inputs = at_rest(self._target, self._inputs)
            vertices = to_numpy(self._evaluator.mesh(self._target, inputs).vertices).astype(np.float64)
            colors = to_numpy(self._evaluator.appearance(self._target, inputs, FROM_FRONT)[0])
            materials = materials_of(self._head, *self._texels[:2])
            return RestLight.of(self._head, self._texels, materials, vertices, colors, self._texel_shadows)

        key = (self._target.id, "lit rest", *self._inputs.identity_key, *self._inputs.shape_key)
        return self._evaluator.cache.get(key, make)

    @functools.cached_property
    def _rows(self) -> np.ndarray | slice:
        """Texels that have a Gaussian at the level of detail."""
        return slice(None) if self._lod == 0 else np.asarray(self._evaluator.blocks(self._target, self._lod).middle)

    @property
    def _texels(self) -> Texels:
        return self._evaluator.texels(self._target)

    @functools.cached_property
    def _texel_shadows(self) -> TexelShadows:
        def make() -> tuple[np.ndarray, ...]:
            layout = self._target.model.layout
            return self._texels.shadows(self._head, layout.uv, layout.grid, layout.texel)

        return TexelShadows(*self._evaluator.cache.get((self._target.id, "texel shadows"), make))

    @functools.cached_property
    def _at_vertices(self) -> np.ndarray:
        """Number of a texel, of those with a Gaussian, that is nearest to each vertex, [V]."""

        def make() -> tuple[np.ndarray]:
            return (nearest_points(self._drawn.corners, self._drawn.barycentric, len(self._vertices)),)

        return self._evaluator.cache.get((self._target.id, "texels at vertices", self._lod), make)[0]

    @functools.cached_property
    def _drawn(self) -> Texels:
        """Texels that have a Gaussian at the level of detail."""
        return self._texels if self._lod == 0 else Texels(*(array[self._rows] for array in self._texels))

    @functools.cached_property
    def _receivers(self) -> Receivers:
        def make() -> tuple[np.ndarray, np.ndarray]:
            found = self._drawn.receivers(self._vertices, vertex_normals(self._vertices, self._head.faces))
            return found.points, found.normals

        key = (self._target.id, "receivers", self._lod, *self._inputs.mesh_key)
        return Receivers.around(*self._evaluator.cache.get(key, make), self._vertices)

    @functools.cached_property
    def _cloud(self) -> HairCloud | None:
        if self._hair is None:
            return None
        pieces = self._hair.pieces

        def make() -> tuple[np.ndarray, ...]:
            points, covers = pieces()
            return tuple(HairCloud.of(points, covers)) if len(points) else (np.zeros((0, 0, 0)), np.zeros(0), np.zeros(3))

        cloud = HairCloud(*self._evaluator.cache.get((self._target.id, "hair cloud", *self._hair_key), make))
        return cloud if cloud.extinction.size else None

    @functools.cached_property
    def _posture(self) -> Posture:
        inputs = self._inputs
        return Posture(self._head, inputs.shape, self._target.still.pose, inputs.pose, self._rest.vertices)

    @property
    def _to_cloud(self) -> np.ndarray:
        """From head space to the axes of `_cloud`, [4, 4]."""
        return np.eye(4) if self._hair is None or self._hair.moves else self._posture.to_rest

    @functools.cached_property
    def _grid(self) -> LightGrid:
        """Places all over head and hair; none where no hair is worn."""
        if self._hair is None:
            return LightGrid(np.zeros(3), (0, 0, 0))
        low, high = self._box
        if self._cloud is not None:
            corners = self._cloud.low + CELL * np.array(list(np.ndindex(2, 2, 2))) * self._cloud.extinction.shape
            corners = (corners - self._to_cloud[:3, 3]) @ self._to_cloud[:3, :3]
            low, high = np.minimum(low, corners.min(0)), np.maximum(high, corners.max(0))
        return LightGrid.around(low, high)

    @functools.cached_property
    def _local_key(self) -> bytes:
        on_skin = self._lighting.local.tobytes() + self._lighting.fine.tobytes()
        return hashlib.blake2b(on_skin, digest_size=16).digest()

    @functools.cached_property
    def _casters(self) -> Casters:
        return self._casting(self._vertices).and_triangles(self._lighting.occluders)

    def _casting(self, vertices: np.ndarray) -> Casters:
        make = functools.partial(casting_faces, self._head)
        faces, closed = self._evaluator.cache.get((self._target.id, "casting faces"), make)
        return Casters(vertices, faces, int(closed))
