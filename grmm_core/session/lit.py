"""Avatars in a scene's light: what a session keeps of it, and the channels that ride along with the Gaussians.

What changes seldom is kept: a head's transfer and the rig's light for an identity, which part of a lamp is seen for a mesh and
the lamp. A moved camera costs highlights alone. The numbers are numpy's and become the engine's at the end. `compose` calls.
"""

from __future__ import annotations

import dataclasses
import functools
import hashlib
from typing import NamedTuple

import numpy as np

from ..controls.frame import Controls
from ..geometry.libraries import to_numpy
from ..geometry.rotations import quaternion_to_matrix
from ..light.hair_shading import strand_transport
from ..light.lamps import STUDIO, Lamp, Lighting
from ..light.materials import Materials, materials_of
from ..light.shading import Response, Transport, ratio, transport
from ..light.shadows import Receivers, visible
from ..light.surroundings import TERMS
from ..light.transfer import transfer, turn_between, vertex_normals
from ..splat.types import Gaussians
from .evaluator import Evaluator, Inputs, OpenAvatar

RATIO, HIGHLIGHTS, SHADOW = slice(0, 3), slice(3, 6), slice(6, 7)
LIGHT_CHANNELS = 7
UNLIT = np.array([1.0, 1.0, 1.0, 0.0, 0.0, 0.0, 1.0], np.float32)  # what changes nothing
_VIEWS, _VIEW_DISTANCE = 16.0, 1.1  # steps of a direction's coordinates; metres
_RIGID = "scalp"  # region whose turn is the head's


class _Rest(NamedTuple):
    """What light does on a head at rest.

    Attributes:
        transfer: At vertices, [V, 9].
        rig: Irradiance of the studio's rig at texels, [N, 3].
        seen: Which part of the rig's lamps texels see, [L, N].
        vertices: [V, 3].
        normals: [V, 3].
    """

    transfer: np.ndarray
    rig: np.ndarray
    seen: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray


class LitAvatar:
    """One avatar in one light, in head space.

    Args:
        evaluator: Of the session.
        target: Who.
        inputs: Of the frame.
        lighting: In head space.
        response: How the avatar takes it.
        lod: Level of detail of the skin's Gaussians.
    """

    def __init__(
        self, evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, lighting: Lighting, response: Response, lod: int = 0
    ) -> None:
        self._evaluator, self._target, self._inputs = evaluator, target, inputs
        self._lighting, self._response, self._lod = lighting, response, lod
        self._head = target.model.head_model
        self._vertices = to_numpy(evaluator.mesh(target, inputs).vertices)
        self._centre = 0.5 * (self._vertices.min(0) + self._vertices.max(0))
        self.lamps = lighting.strongest(tuple(self._centre))

    def channels(self, eye: np.ndarray, strands: Gaussians | None) -> np.ndarray:
        """What rides along with the Gaussians of the skin and then of the strands.

        Args:
            eye: The viewer's place in head space, [3].
            strands: Drawn behind the skin's, or None.

        Returns:
            [N, LIGHT_CHANNELS] float32: irradiance relative to the rig's, highlights, share of the lamps' light that arrives.
        """

        def make() -> tuple[np.ndarray]:
            return (self._skin(eye).astype(np.float32),)

        around = self._lighting.surroundings
        light = repr(self.lamps), b"" if around is None else around.coefficients.tobytes(), self._occluders_key
        key = (self._target.id, "lit", eye.tobytes(), self._response, self._lod, *light, *self._inputs.mesh_key)
        skin = self._evaluator.cache.get(key, make)[0]
        parts = [skin] + ([] if strands is None else [self._strands(strands, eye)])
        return np.concatenate(parts).astype(np.float32)

    def _skin(self, eye: np.ndarray) -> np.ndarray:
        rest, materials = self._rest(), self._materials()
        turn = turn_between(rest.vertices[self._rigid()], self._vertices[self._rigid()])
        seen = [self._seen(lamp) for lamp in self.lamps]
        transfers = self._at_texels(rest.transfer)
        scene = transport(self.lamps, self._receivers, seen, materials, transfers, eye, self._response)
        irradiance, shine = scene.light(*self._colors(self._lighting, self.lamps, turn.T))
        relative = ratio(irradiance, rest.rig[self._rows])
        learned = self._learned((eye - self._centre) @ turn) * self._response.gloss
        return np.concatenate([relative, shine - learned * relative, self._share(scene, seen)], 1)

    def _strands(self, strands: Gaussians, eye: np.ndarray) -> np.ndarray:
        points = to_numpy(strands.means).astype(np.float64)
        tangents = quaternion_to_matrix(to_numpy(strands.quats))[..., 0]
        outward = points - self._centre
        outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
        receivers = Receivers.around(points, outward)
        triangles = self._triangles
        seen = [visible(lamp, receivers, triangles, 0.0) for lamp in self.lamps]  # a strand's own shadow has no width
        scene = strand_transport(self.lamps, points, tangents, seen, self._centre, eye, self._response)
        irradiance, shine = scene.light(*self._colors(self._lighting, self.lamps, np.eye(3)))
        whole = [np.ones(len(points))] * len(STUDIO.lamps)
        rig = strand_transport(STUDIO.lamps, points, tangents, whole, self._centre, eye)
        relative = ratio(irradiance, rig.light(*self._colors(STUDIO, STUDIO.lamps, np.eye(3)))[0])
        return np.concatenate([relative, shine, self._share(scene, seen)], 1)

    def _share(self, scene: Transport[np.ndarray], seen: list[np.ndarray]) -> np.ndarray:
        """Share of the light that would arrive from the lamps without anything in its way, [N, 1]."""
        count = scene.ambient.shape[0]
        arrives = np.full(count, 1e-6)
        whole = np.full(count, 1e-6)
        for lamp, amount, part in zip(self.lamps, scene.diffuse, seen, strict=True):
            light = amount.mean(1) * float(np.mean(lamp.color))
            arrives += light
            whole += light / np.maximum(part, 0.02)
        return (arrives / whole)[:, None]

    @staticmethod
    def _colors(lighting: Lighting, lamps: tuple[Lamp, ...], turn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        colors = np.array([lamp.color for lamp in lamps], np.float32).reshape(-1, 3)
        around = lighting.surroundings
        harmonics = np.zeros((TERMS, 3)) if around is None else around.turned(turn).coefficients
        return colors, harmonics.astype(np.float32)

    # --- what is kept ----------------------------------------------------------------------------------------------

    def _materials(self) -> Materials:
        def make() -> tuple[np.ndarray, ...]:
            layout = self._target.model.layout
            return tuple(vars(materials_of(self._head, layout.face, layout.barycentric)).values())

        return Materials(*self._evaluator.cache.get((self._target.id, "materials"), make)).taken(self._rows)

    def _rest(self) -> _Rest:
        def make() -> _Rest:
            still = self._evaluator.inputs(self._target, Controls())
            inputs = dataclasses.replace(
                self._inputs, z_exp=still.z_exp, expression=still.expression, pose=still.pose, strength=still.strength
            )
            vertices = to_numpy(self._evaluator.mesh(self._target, inputs).vertices).astype(np.float64)
            normals = vertex_normals(vertices, self._head.faces)
            rows = transfer(vertices, normals, self._head.faces)
            receivers = Receivers.around(self._all_texels(vertices), _unit(self._all_texels(normals)))
            seen = [visible(lamp, receivers, vertices[self._head.faces]) for lamp in STUDIO.lamps]
            layout = self._target.model.layout
            materials = materials_of(self._head, layout.face, layout.barycentric)
            scene = transport(STUDIO.lamps, receivers, seen, materials, self._all_texels(rows), np.array([0.0, 0.0, 1.0]))
            rig = scene.light(*self._colors(STUDIO, STUDIO.lamps, np.eye(3)))[0]
            return _Rest(rows, rig, np.stack(seen), vertices, normals)

        key = (self._target.id, "lit rest", *self._inputs.identity_key, *self._inputs.shape_key)
        return self._evaluator.cache.get(key, make)

    def _learned(self, towards: np.ndarray) -> np.ndarray:
        """Highlights of the rig that colors hold already, seen from a direction [3] in the axes of the head at rest, [N, 3].

        Kept for directions some degrees apart: colors hold them as they look from everywhere in the mean.
        """
        direction = np.round(towards / max(float(np.linalg.norm(towards)), 1e-9) * _VIEWS) / _VIEWS
        rest = self._rest()

        def make() -> tuple[np.ndarray]:
            eye = direction * _VIEW_DISTANCE
            transfers = self._at_texels(rest.transfer)
            seen = list(rest.seen[:, self._rows])
            rig = transport(STUDIO.lamps, self._resting(rest), seen, self._materials(), transfers, eye)
            return (rig.light(*self._colors(STUDIO, STUDIO.lamps, np.eye(3)))[1],)

        person = (*self._inputs.identity_key, *self._inputs.shape_key)
        return self._evaluator.cache.get((self._target.id, "learned", direction.tobytes(), self._lod, *person), make)[0]

    def _seen(self, lamp: Lamp) -> np.ndarray:
        def make() -> tuple[np.ndarray]:
            return (visible(lamp, self._receivers, self._triangles, self._response.softness),)

        mesh = (self._lod, *self._inputs.mesh_key)
        key = (self._target.id, "seen", repr(lamp), self._response.softness, self._occluders_key, *mesh)
        return self._evaluator.cache.get(key, make)[0]

    @functools.cached_property
    def _occluders_key(self) -> bytes:
        return hashlib.blake2b(self._lighting.occluders.tobytes(), digest_size=16).digest()

    # --- geometry --------------------------------------------------------------------------------------------------

    @functools.cached_property
    def _rows(self) -> np.ndarray:
        if self._lod == 0:
            return np.arange(len(self._target.model.layout))
        return self._evaluator.blocks(self._target, self._lod).middle

    def _rigid(self) -> np.ndarray:
        return np.asarray(self._head.regions.get(_RIGID, np.arange(len(self._vertices))))

    def _all_texels(self, values: np.ndarray) -> np.ndarray:
        layout = self._target.model.layout
        return np.einsum("nk,nkc->nc", layout.barycentric, values[self._head.faces[layout.face]])

    def _at_texels(self, values: np.ndarray) -> np.ndarray:
        return self._all_texels(values)[self._rows]

    @functools.cached_property
    def _receivers(self) -> Receivers:
        normals = vertex_normals(self._vertices, self._head.faces)
        return Receivers.around(self._at_texels(self._vertices), _unit(self._at_texels(normals)))

    def _resting(self, rest: _Rest) -> Receivers:
        return Receivers.around(self._at_texels(rest.vertices), _unit(self._at_texels(rest.normals)))

    @functools.cached_property
    def _triangles(self) -> np.ndarray:
        return np.concatenate([self._vertices[self._head.faces], self._lighting.occluders])


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-20)
