"""Gaussians from elsewhere (splat files, other projects' avatars) drawn beside the model's avatars.

A cloud has no networks: its color comes from spherical harmonics, it has no features and no normals, and refinement leaves it
alone. `compose` treats it as one more instance. Called by `local` and `compose`; its arrays are the engine's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.camera import Camera
from ..geometry.libraries import Array, as_like, library_of, to_numpy, zeros
from ..splat.types import Gaussians
from .engines import Engine
from .harmonics import harmonic_basis
from .values import CloudArrays

_SEED = 20  # of the order in which a cloud is thinned out; any constant
_CONSTANT_TERM = float(harmonic_basis(np.array([[0.0, 0.0, 1.0]]), 0)[0, 0])
_CHUNK = 1 << 17  # Gaussians whose harmonics are evaluated at once: bounds memory


@dataclass(frozen=True)
class OpenCloud:
    """A cloud kept by a session.

    Attributes:
        id: Handle in the session.
        name, version: What `Session.put_cloud` was given.
        gaussians: In head axes, without colors, on the session's device; zeros [N, 3] stand for the colors.
        harmonics: [N, K, 3].
    """

    id: int
    name: str
    version: str
    gaussians: Gaussians
    harmonics: Any

    @staticmethod
    def make(number: int, name: str, version: str, cloud: CloudArrays, engine: Engine) -> OpenCloud:
        """Copy a cloud to where an engine computes."""
        parts = (cloud.means, cloud.quats, cloud.scales, cloud.opacities)
        means, quats, scales, opacities = (engine.array(part.copy()) for part in parts)
        gaussians = Gaussians(means, quats, scales, opacities, zeros(cloud.means.shape, means))
        return OpenCloud(number, name, version, gaussians, engine.array(cloud.harmonics.copy()))

    def seen_from(self, camera: Camera, lod: int = 0) -> Gaussians:
        """Return the Gaussians with the colors that a camera sees.

        Args:
            camera: In the cloud's own axes.
            lod: Level of detail: each keeps a quarter of the Gaussians, chosen evenly at random, at twice the size.
        """
        own, harmonics = self.gaussians, self.harmonics
        if lod:
            kept = self._kept(lod)
            scales = own.scales[kept] * (1 << lod)
            own = Gaussians(own.means[kept], own.quats[kept], scales, own.opacities[kept], own.colors[kept])
            harmonics = harmonics[kept]
        colors = library_of(harmonics).clip(0.5 + _CONSTANT_TERM * harmonics[:, 0], 0.0, None)
        if harmonics.shape[1] > 1:
            colors = zeros(tuple(own.means.shape), own.means)
            for start in range(0, len(own), _CHUNK):
                part = slice(start, start + _CHUNK)
                colors[part] = _shade(own.means[part], harmonics[part], camera)
        return Gaussians(own.means, own.quats, own.scales, own.opacities, colors)

    def _kept(self, lod: int) -> np.ndarray:
        order = np.random.default_rng(_SEED).permutation(len(self.gaussians))
        return np.sort(order[: max(1, len(self.gaussians) >> (2 * lod))])


def _shade(means: Array, harmonics: Array, camera: Camera) -> Array:
    """Colors [N, 3] of Gaussians as a camera sees them: 0.5 + sum_k basis_k(direction) coefficient_k, not below 0."""
    places = to_numpy(means)
    directions: np.ndarray = places - camera.position.astype(np.float32)
    if camera.orthographic:
        directions = np.broadcast_to(camera.forward.astype(np.float32), places.shape)
    directions = directions / np.maximum(np.linalg.norm(directions, axis=-1, keepdims=True), 1e-12)
    degree = round(harmonics.shape[1] ** 0.5) - 1
    basis = as_like(harmonic_basis(directions, degree), means)  # [N, K]
    library = library_of(means)
    colors: Array = library.clip(library.einsum("nk,nkc->nc", basis, harmonics) + 0.5, 0.0, None)
    return colors
