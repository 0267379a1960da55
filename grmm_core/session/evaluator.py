"""The model's forward chain behind a cache: an avatar and its controls to mesh and Gaussians, computing only what changed.

The steps are those of `model.grmm`. What each depends on, and so what its cache key holds (the owner is the avatar):

=============  ==============================================
opacity        identity code
appearance     identity code, view direction (to the last bit)
offsets        identity code, expression code
tint           identity code, expression code
rest           shape
mesh           identity code, expression code, shape, expression, pose, strength
geometry       what mesh and offsets depend on
=============  ==============================================

So a moving camera decodes appearance alone, an animated expression everything but opacity and appearance, and a still of the
same frame nothing. Called by `local` and `compose`. Imports torch.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..avatar import Avatar
from ..controls.frame import Controls
from ..model.detail import texel_blocks, thin_out
from ..model.grmm import GRMM, Mesh, Rest
from ..model.inputs import ModelInputs
from ..model.store import LoadedModel
from ..model.texels import Geometry
from ..splat import Gaussians
from .cache import ArrayCache
from .sources import SourceKey

Inputs = ModelInputs[np.ndarray]


@dataclass(frozen=True)
class OpenAvatar:
    """An avatar together with the model that draws it.

    Attributes:
        id: Handle in the session; owner of its cache entries.
        avatar: Codes and shape.
        loaded: Model (with the avatar's own weight changes, if it has any).
        source: What it was opened from.
    """

    id: int
    avatar: Avatar
    loaded: LoadedModel
    source: SourceKey

    @property
    def model(self) -> GRMM:
        """The network."""
        return self.loaded.model


class Evaluator:
    """Computes meshes and Gaussians of open avatars through one bounded cache. Call under `torch.inference_mode`."""

    def __init__(self, cache_bytes: int) -> None:
        self.cache = ArrayCache(cache_bytes)

    def inputs(self, target: OpenAvatar, controls: Controls) -> Inputs:
        """Add the avatar's own codes to the controls. Raises as `InputSpace.inputs`."""
        return target.loaded.space.inputs(target.avatar, controls)

    def mesh(self, target: OpenAvatar, inputs: Inputs) -> Mesh:
        """Return posed vertices and the learned displacement, both [V, 3] metres."""

        def make() -> Mesh:
            # Most expressions are zero from some component on: what they would add is not computed.
            used = int(np.flatnonzero(inputs.expression)[-1]) + 1 if inputs.expression.any() else 0
            short = dataclasses.replace(inputs, expression=inputs.expression[:used])
            return target.model.mesh(target.model.tensors(short), self.rest(target, inputs))

        return self.cache.get((target.id, "mesh", *inputs.mesh_key), make)

    def rest(self, target: OpenAvatar, inputs: Inputs) -> Rest:
        """Return the shaped head without expression."""

        def make() -> Rest:
            return target.model.rest(_tensor(target.model, inputs.shape))

        return self.cache.get((target.id, "rest", *inputs.shape_key), make)

    def geometry(self, target: OpenAvatar, inputs: Inputs) -> Geometry:
        """Return the placed Gaussians in head space."""

        def make() -> Geometry:
            return target.model.geometry(self.mesh(target, inputs).vertices, self.offsets(target, inputs))

        return self.cache.get((target.id, "geometry", *inputs.mesh_key), make)

    def offsets(self, target: OpenAvatar, inputs: Inputs) -> Tensor:
        """Return Phi_T's offsets, [N, 10]."""
        return self._decoded(target, "offsets", inputs, inputs.code_key, inputs.z_exp)[0]

    def tint(self, target: OpenAvatar, inputs: Inputs) -> Tensor:
        """Return what the expression adds to the colors, [N, 3] or one row of zeros."""
        return self._decoded(target, "tint", inputs, inputs.code_key, inputs.z_exp)[0]

    def opacity(self, target: OpenAvatar, inputs: Inputs) -> Tensor:
        """Return Phi_alpha's opacities, [N]."""
        return self._decoded(target, "opacity", inputs, inputs.identity_key)[0]

    def appearance(self, target: OpenAvatar, inputs: Inputs, direction: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return Phi_app's colors [N, 3] and features [N, F] for a unit view direction [3] in head space."""
        direction = np.asarray(direction, np.float32)
        key = (*inputs.identity_key, direction.tobytes())
        colors, features = self._decoded(target, "appearance", inputs, key, direction)
        return colors, features

    def gaussians(self, target: OpenAvatar, inputs: Inputs, direction: np.ndarray, lod: int = 0) -> Gaussians:
        """Return all Gaussians in head space; features are [N, F], also where F is 0."""
        colors, features = self.appearance(target, inputs, direction)
        colors = colors + self.tint(target, inputs)
        full = Gaussians(*self.geometry(target, inputs), self.opacity(target, inputs), colors, features)
        return full if lod == 0 else thin_out(full, self.blocks(target, lod), lod)

    def normals(self, target: OpenAvatar, inputs: Inputs, lod: int = 0) -> Tensor:
        """Return the outward mesh normal at each Gaussian, head space, [N, 3]."""

        def make() -> tuple[Tensor]:
            return (target.model.anchor(self.mesh(target, inputs).vertices).normals,)

        normals = self.cache.get((target.id, "normals", *inputs.mesh_key), make)[0]
        return normals if lod == 0 else normals[self.blocks(target, lod)[0]]

    def blocks(self, target: OpenAvatar, lod: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return the blocks of texels that `thin_out` merges."""

        def make() -> tuple[Tensor, Tensor, Tensor]:
            anchor = target.model.anchor
            middle, block, counts = texel_blocks(anchor.texel.cpu().numpy(), anchor.grid, lod)
            where = target.model.device
            return torch.from_numpy(middle).to(where), torch.from_numpy(block).to(where), _tensor(target.model, counts)

        return self.cache.get((target.id, "blocks", lod), make)

    def _decoded(
        self, target: OpenAvatar, name: str, inputs: Inputs, key: tuple[bytes, ...], *further: np.ndarray
    ) -> tuple[Tensor, ...]:
        """Decode attributes; what an avatar's own changes add fades as its identity code moves to another person's.

        A beard that was trained for one face has no place on the face that another code gives.
        """

        def make() -> tuple[Tensor, ...]:
            loaded = target.loaded
            arguments = [_tensor(target.model, array) for array in (inputs.z_id, *further)]
            own: tuple[Tensor, ...] = getattr(loaded, name)(*arguments)
            if loaded.shared is None or not target.model.config.residuals:
                return own
            share = 1.0 - float(np.linalg.norm(inputs.z_id - target.avatar.z_id)) / loaded.reach
            if share == 1.0:
                return own
            plain: tuple[Tensor, ...] = getattr(loaded.shared, name)(*arguments)
            return tuple(a.lerp(b, max(0.0, share)) for a, b in zip(plain, own, strict=True))

        return self.cache.get((target.id, name, *key), make)


def _tensor(model: GRMM, array: np.ndarray) -> Tensor:
    return torch.as_tensor(array, dtype=model.dtype, device=model.device)
