"""What light does on a head at rest, made once for a person: transfer, the rig that colors were learned under, bounces.

`session.lit` draws with it, and `fitting.photo_light` takes a photo's light out with it. Needs numpy; numba makes it faster.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..compute.recent import Recent
from ..controls.frame import resolve
from ..controls.table import Controls
from .bounce import Exchange, albedo_of, nearest_points
from .lamps import STUDIO
from .materials import Materials, materials_of
from .mesh_light import TexelGrid
from .shading import reached, shade
from .shadows import Casters, Receivers, compiled_kernels, maps_of, visible
from .surroundings import coefficients_of
from .texel_shadows import TexelShadows
from .transfer import openness, transfer, vertex_normals

if TYPE_CHECKING:
    from ..head import HeadModel

_LOOSE = ("neck",)  # regions that light can reach from inside
_SHEER = ("lashes",)  # cards that stand for a few hairs: they keep no light off
MOUTH = ("upper_teeth", "lower_teeth", "tongue", "mouth_interior")
_SKIN = "face"  # region whose color is the skin's
_OPENED = 1.25  # times as much is seen of what is hidden at rest: less is what maps of depth, and skin that moves, differ by
_GLOW = 0.4  # of light that leaves the lips, what arrives everywhere in the mouth: about the glow of the studio's mouths
_TEETH = 1.25  # light on seen teeth over that on the lips, as it is in photos of smiles
_LIT = 0.75  # quantile of lips that says what light on them is where it comes from a side
_WAYS = 24  # directions of `rig_at_vertices`
_STILL = 1e-8  # square metres: what moves by less than 0.1 mm stays where it is
_SHUT = {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0}
_OPENING = {
    "jawOpen": 0.5, "mouthUpperUpLeft": 0.5, "mouthUpperUpRight": 0.5, "mouthLowerDownLeft": 0.5, "mouthLowerDownRight": 0.5,
    **_SHUT,
}  # fmt: skip
"""An expression that shows most of what lips and lids hide at rest."""


class Texels(NamedTuple):
    """Points on a head's faces.

    Attributes:
        face: Of each, [N].
        barycentric: [N, 3] float32.
        corners: Vertices of the faces, [N, 3] int32.
    """

    face: np.ndarray
    barycentric: np.ndarray
    corners: np.ndarray

    @staticmethod
    def of(head: HeadModel, face: np.ndarray, barycentric: np.ndarray) -> Texels:
        """On faces [N] of a head."""
        return Texels(face, barycentric, head.faces[face].astype(np.int32))

    @staticmethod
    def of_vertices(head: HeadModel) -> Texels:
        """At the vertices, each on one of the faces around it."""
        corner = np.zeros(len(head.v_template), np.int64)
        corner[head.faces.ravel()] = np.arange(head.faces.size)
        face, at = np.divmod(corner, 3)
        return Texels.of(head, face, np.eye(3, dtype=np.float32)[at])

    def at(self, values: np.ndarray, as_unit: bool = False) -> np.ndarray:
        """Values of vertices [V, C] at the points, [N, C] float32; `as_unit`: of length 1."""
        kernels = compiled_kernels()
        if kernels is None:
            here = np.einsum("nk,nkc->nc", self.barycentric, values[self.corners])
            return (unit(here) if as_unit else here).astype(np.float32)
        from ..compute.threads import for_rows

        out = np.empty((len(self.corners), values.shape[1]), np.float32)
        given = np.ascontiguousarray(values, np.float32), self.corners, self.barycentric, as_unit
        for_rows(kernels.interpolate, len(out), *given, out)
        return out

    def factor(self, local: np.ndarray, fine: np.ndarray | None = None) -> np.ndarray:
        """`Lighting.local` at the points, times `Lighting.fine` there, [N, 3], or [1, 3] of ones where there is neither.

        A fine factor of other points than these is of other weights than the avatar's, and does not count.
        """
        found = self.at(local) if len(local) else np.ones((1, 3), np.float32)
        return found if fine is None or len(fine) != len(self.corners) else found * fine

    def dim(self, seen: np.ndarray, rows: np.ndarray, through: np.ndarray) -> None:
        """Multiply what is seen at rows [M] of the points, [N], by what comes through to vertices, [V]; `seen` is changed."""
        kernels = compiled_kernels()
        if kernels is None:
            seen[rows] *= np.einsum("nk,nk->n", self.barycentric[rows], through[self.corners[rows]])
            return
        from ..compute.threads import for_rows

        given = rows, self.corners, self.barycentric, np.ascontiguousarray(through, np.float32)
        for_rows(kernels.dim, len(rows), seen, *given)

    def receivers(self, vertices: np.ndarray, normals: np.ndarray) -> Receivers:
        """The points on a mesh with unit normals, [V, 3] each.

        They are lifted half of the way to the planes at the corners of their faces, where these lie above (after Hanika 2021),
        as on a ball: a face is flat, what it stands for is not, and its neighbours would shade it where light grazes it.
        """
        kernels = compiled_kernels()
        if kernels is None:
            points, around = self.at(vertices), vertices[self.corners]
            below = np.einsum("nkc,nkc->nk", normals[self.corners], around - points[:, None]).clip(0.0, None)
            lift = 0.5 * np.einsum("nk,nkc->nc", below * self.barycentric, normals[self.corners])
            return Receivers.around((points + lift).astype(np.float32), self.at(normals, as_unit=True), vertices)
        from ..compute.threads import for_rows

        out = np.empty((2, len(self.corners), 3), np.float32)
        given = (np.ascontiguousarray(array, np.float32) for array in (vertices, normals))
        for_rows(kernels.on_surface, len(self.corners), *given, self.corners, self.barycentric, *out)
        return Receivers.around(out[0], out[1], vertices)

    def shadows(self, head: HeadModel, uv: np.ndarray, grid: int, texel: np.ndarray) -> TexelShadows:
        """How the points lie, which are texels [N] of a grid that the UV map `uv` [U, 2] of a head lies on."""

        def make() -> TexelShadows:
            places = uv[head.uv_faces[self.face]] * grid
            return TexelShadows.of(grid, texel, self.corners, places, head.v_template, self.at(head.v_template))

        return _LYING.get((head, *self, uv, grid, texel), make)


_LYING: Recent[TexelShadows] = Recent(2)
"""Of `Texels.shadows`."""


def texel_grid(head: HeadModel, uv: np.ndarray, grid: int, texel: np.ndarray) -> TexelGrid:
    """Where the faces of a head that keep light off lie on a grid; arguments as of `Texels.shadows`."""
    number, closed = casting_numbers(head)
    return TexelGrid.of(head.faces[number], uv, head.uv_faces[number], grid, texel, int(closed))


class RestLight(NamedTuple):
    """What light does on a head at rest.

    Attributes:
        transfer: At texels, [N, 9].
        rig: Irradiance of the studio's rig at texels, as `reached` has it, [N, 3].
        albedo: Of its skin, linear RGB, [3].
        patch, area, givers, shares: Of `Exchange`.
        seen: Which part of the rig's lamps texels see, [L, N].
        vertices: [V, 3].
        normals: [V, 3].
        shutting: How vertices move where the left eye shuts, and the right one, [2, V, 3] metres.
        turned_out: How many times as much of the rig as at rest they then get, [V].
    """

    transfer: np.ndarray
    rig: np.ndarray
    albedo: np.ndarray
    patch: np.ndarray
    area: np.ndarray
    givers: np.ndarray
    shares: np.ndarray
    seen: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    shutting: np.ndarray
    turned_out: np.ndarray

    @staticmethod
    def of(
        head: HeadModel, texels: Texels, materials: Materials, vertices: np.ndarray, colors: np.ndarray,
        lying: TexelShadows | None = None,
    ) -> RestLight:  # fmt: skip
        """Work it out.

        Args:
            head: Head model.
            texels: All of an avatar.
            materials: Of them.
            vertices: Of the person at rest, [V, 3] metres.
            colors: Of the texels under the rig, display sRGB, [N, 3]; those of the face say what skin throws back.
            lying: How the texels lie, where a scene's shadows are looked for by it.
        """
        still = _STANDING.get((head, *texels, vertices, lying), lambda: _Standing.of(head, texels, vertices, lying))
        opened, exchange, seen, at_vertices = still.opened, still.exchange, still.seen.copy(), still.at_vertices
        eye, around = np.array([0.0, 0.0, 1.0]), coefficients_of(STUDIO.surroundings)
        straight = shade(STUDIO.lamps, still.receivers, seen, materials, still.rows, eye, around).irradiance
        skin = np.isin(texels.corners[:, 0], head.regions.get(_SKIN, np.arange(len(vertices))))
        albedo = albedo_of(colors[skin], straight[skin])
        rig = straight + texels.at(exchange.bounced(straight[at_vertices], albedo))
        light = opened.put_into(rig, seen, texels, materials.taken(at_vertices), exchange, albedo)
        rig = reached(rig)
        turned_out = (light.mean(1) / rig[at_vertices].mean(1)).astype(np.float32)
        shutting = np.stack([_moves(head, {name: value}) for name, value in _SHUT.items()])
        return RestLight(still.rows, rig, albedo, *exchange, seen, vertices, still.normals, shutting, turned_out)

    @property
    def exchange(self) -> Exchange:
        """What skin throws on skin."""
        return Exchange(self.patch, self.area, self.givers, self.shares)

    def learned(
        self, eye: np.ndarray, texels: Texels, materials: Materials, rows: np.ndarray | slice = slice(None)
    ) -> np.ndarray:
        """Highlights of the rig as they look from a place [3], axes of the head at rest, at rows of the texels, [N, 3].

        The materials are those of these rows.
        """
        receivers = Receivers.around(texels.at(self.vertices)[rows], texels.at(self.normals, as_unit=True)[rows])
        around = coefficients_of(STUDIO.surroundings)
        light = STUDIO.lamps, receivers, self.seen[:, rows], materials, self.transfer[rows], eye, around
        return np.ascontiguousarray(shade(*light).highlights)


def rig_at_vertices(head: HeadModel, vertices: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """Irradiance of the studio's rig at the vertices of a head, a few percent near, [V, 3].

    For what wants no more of a person than that: `RestLight` takes five times as long.

    Args:
        head: Head model.
        vertices: [V, 3] metres.
        colors: Of its skin under the rig, display sRGB, [K, 3].
    """
    vertices = np.asarray(vertices, np.float64)

    def make() -> tuple[np.ndarray, Exchange]:
        normals, casters = vertex_normals(vertices, head.faces), casters_of(head, vertices)
        receivers, texels = Receivers.around(vertices, normals), Texels.of_vertices(head)
        rows = transfer(vertices, normals, casters.faces, _WAYS)
        seen = np.stack([visible(lamp, receivers, casters) for lamp in STUDIO.lamps])
        eye, around = np.array([0.0, 0.0, 1.0]), coefficients_of(STUDIO.surroundings)
        straight = shade(STUDIO.lamps, receivers, seen, materials_of(head, *texels[:2]), rows, eye, around).irradiance
        return straight, Exchange.of(vertices, normals, head.faces, rows)

    straight, exchange = _ROUGHLY.get((head, vertices), make)
    skin = head.marked(_SKIN) if _SKIN in head.regions else np.ones(len(vertices), bool)
    return reached(straight + exchange.bounced(straight, albedo_of(colors, straight[skin])))


_ROUGHLY: Recent[tuple[np.ndarray, Exchange]] = Recent(3)
"""What of `rig_at_vertices` does not depend on colors: the same person is often added again."""


class _Standing(NamedTuple):
    """What of the light on a head at rest does not depend on colors: it takes nearly all of the time, and is kept.

    Attributes:
        rows, seen, normals: Of `RestLight`, `seen` without what an open mouth shows.
        receivers: The texels.
        exchange: What skin throws on skin.
        opened: The head with an open mouth.
        at_vertices: Number of the texel that is nearest to each vertex, [V].
    """

    rows: np.ndarray
    seen: np.ndarray
    normals: np.ndarray
    receivers: Receivers
    exchange: Exchange
    opened: _Opened
    at_vertices: np.ndarray

    @staticmethod
    def of(head: HeadModel, texels: Texels, vertices: np.ndarray, lying: TexelShadows | None) -> _Standing:
        """Work it out; arguments as of `RestLight.of`."""
        normals = vertex_normals(vertices, head.faces)
        opened = _Opened.of(head, vertices, transfer(vertices, normals, casting_faces(head)[0]))
        exchange = Exchange.of(vertices, normals, head.faces, opened.rows)
        mouth = head.marked(*MOUTH) & ~head.marked(_SKIN)  # lips are seen when it is closed
        exchange.light(mouth, head.marked("lips") & ~mouth, _GLOW)
        receivers, casters = texels.receivers(vertices, normals), casters_of(head, vertices)
        if lying is None:
            seen = np.stack([visible(lamp, receivers, casters) for lamp in STUDIO.lamps])
        else:
            seen = np.stack([lying.all_seen(maps_of(lamp, receivers, casters), receivers, vertices) for lamp in STUDIO.lamps])
        at_vertices = nearest_points(texels.corners, texels.barycentric, len(vertices))
        return _Standing(texels.at(opened.rows), seen, normals, receivers, exchange, opened, at_vertices)


_STANDING: Recent[_Standing] = Recent(3)
"""Of `RestLight.of`: a photo's person as tracked, and as a session has it."""


class _Opened(NamedTuple):
    """A head with an open mouth, beside the head at rest.

    Colors of what lips hide at rest are learned where other expressions show it, in the light that it gets there: divided by
    the little that reaches it at rest it would burn out in a scene's.

    Attributes:
        share: How far the head at rest hides each vertex, 0..1, [V, 1].
        rows: Of `transfer.transfer` at the vertices, as their colors are learned, [V, 9].
        receivers: The vertices.
        casters: The mesh.
    """

    share: np.ndarray
    rows: np.ndarray
    receivers: Receivers
    casters: Casters

    @staticmethod
    def of(head: HeadModel, vertices: np.ndarray, rows: np.ndarray) -> _Opened:
        """Open a head at rest, [V, 3] metres, with its rows of `transfer.transfer`, [V, 9]."""
        posed = vertices + _moves(head, _OPENING)
        normals, casters = vertex_normals(posed, head.faces), casters_of(head, posed)
        there = transfer(posed, normals, casters.faces)
        shown = openness(there)
        share = (1.0 - _OPENED * openness(rows) / np.maximum(shown, 1e-6)).clip(0.0, 1.0).astype(np.float32)[:, None]
        share[(_moves(head, _SHUT) ** 2).sum(1) > _STILL] = 0.0  # lids' colors do say what they are at rest (`expressed`)
        return _Opened(share, rows + share * (there - rows), Receivers.around(posed, normals), casters)

    def put_into(
        self, rig: np.ndarray, seen: np.ndarray, texels: Texels, materials: Materials, exchange: Exchange, albedo: np.ndarray
    ) -> np.ndarray:  # fmt: skip
        """Put the rig as it lights what is shown here into its irradiance at texels, [N, 3], and what they see of its lamps.

        The latter is `seen`, [L, N]; the materials are those of the vertices, the albedo [3] is the skin's. Returns the rig's
        irradiance at the vertices, [V, 3].
        """
        here, rows = np.array([visible(lamp, self.receivers, self.casters) for lamp in STUDIO.lamps]), self.rows
        eye, around = np.array([0.0, 0.0, 1.0]), coefficients_of(STUDIO.surroundings)
        light = shade(STUDIO.lamps, self.receivers, here, materials, rows, eye, around).irradiance
        light, share = light + exchange.bounced(light, albedo), texels.at(self.share)
        rig += share * (texels.at(light) - rig)
        seen += share.T * (texels.at(here.T).T - seen)
        return light


def _moves(head: HeadModel, values: Mapping[str, float]) -> np.ndarray:
    """How far the vertices of a head move in an expression, [V, 3] metres."""
    still, moved = (
        head.vertices(np.zeros(1), controls.expression, controls.pose)
        for controls in (resolve(Controls().set_named(values), head) for values in ({}, values))
    )
    return moved - still


def mouth_rows(head: HeadModel, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the texels, with vertices around each [N, 3], that lie in the mouth [K] and on lips [L]."""
    inside, lips = (np.flatnonzero(head.marked(*names)[corners].all(1)) for names in (MOUTH, ("lips",)))
    return inside, lips


def even_mouth(inside: np.ndarray, lips: np.ndarray, light: np.ndarray, front: int, bound: bool = False) -> None:
    """Give the whole mouth the light of the lips, as photos are fitted, or no more than that.

    Lips are never tracked so closely that the edges of their shadows on the teeth are where a photo has them: taken out, they
    would be drawn on the teeth as bright and dark lines. In a scene, colors of teeth that a grin bares were learned in more of
    the rig than `_Opened` finds: without a bound they were up to nine times as bright as a dark cheek beside them.

    Args:
        inside: Numbers of its texels (`mouth_rows`), [K].
        lips: Likewise, [L].
        light: What arrives relative to the rig, times how much it counts: three colors first, [N, C]; changed in place.
        front: Column of how much it counts.
        bound: Leave what has less.
    """
    if not len(inside) or not len(lips):
        return
    level = _TEETH * np.quantile(light[lips, :3].mean(1) / light[lips, front], _LIT if bound else 0.5)
    most = level * light[inside, front, None]
    share = most / np.maximum(light[inside, :3].mean(1, keepdims=True), 1e-9)
    light[inside, :3] = light[inside, :3] * share.clip(0.0, 1.0) if bound else most


def casting_faces(head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Faces of a head's mesh as `Casters` has them, [T, 3] int32, and how many of them are closed, []."""
    number, closed = casting_numbers(head)
    return head.faces[number].astype(np.int32), closed


def casting_numbers(head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the faces of a head's mesh that keep light off, closed ones first, [T], and how many are closed, []."""
    number = np.flatnonzero(~head.marked(*_SHEER)[head.faces].all(1))
    loose = head.marked(*_LOOSE)
    alone = loose[head.faces[number]].any(1) if loose.any() else np.ones(len(number), bool)
    return number[np.argsort(alone, kind="stable")], np.array((~alone).sum())


def casters_of(head: HeadModel, vertices: np.ndarray) -> Casters:
    """A head's mesh, [V, 3] metres, as what throws shadows."""
    faces, closed = casting_faces(head)
    return Casters(vertices, faces, int(closed))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors [N, 3] of length 1."""
    return vectors / np.maximum(np.sqrt(np.einsum("nk,nk->n", vectors, vectors)), 1e-20)[:, None]
