"""Gaussians from elsewhere (splat files, other projects' avatars) drawn beside the model's avatars.

A cloud has no networks: its color comes from spherical harmonics, it has no features and no normals, and refinement leaves it
alone. `compose` treats it as one more instance. Called by `local` and `compose`. Imports torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..geometry.camera import Camera
from ..splat import Gaussians
from .api import CloudArrays
from .harmonics import harmonic_basis

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
    harmonics: Tensor

    @staticmethod
    def make(number: int, name: str, version: str, cloud: CloudArrays, device: torch.device) -> OpenCloud:
        """Copy a cloud to a device."""

        def tensor(values: np.ndarray) -> Tensor:
            return torch.tensor(values, dtype=torch.float32, device=device)

        means = tensor(cloud.means)
        parts = Gaussians(means, tensor(cloud.quats), tensor(cloud.scales), tensor(cloud.opacities), torch.zeros_like(means))
        return OpenCloud(number, name, version, parts, tensor(cloud.harmonics))

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
        colors = (0.5 + _CONSTANT_TERM * harmonics[:, 0]).clamp(min=0.0)
        if harmonics.shape[1] > 1:
            colors = torch.empty_like(own.means)
            for start in range(0, len(own), _CHUNK):
                part = slice(start, start + _CHUNK)
                colors[part] = _shade(own.means[part], harmonics[part], camera)
        return Gaussians(own.means, own.quats, own.scales, own.opacities, colors)

    def _kept(self, lod: int) -> Tensor:
        order = torch.randperm(len(self.gaussians), generator=torch.Generator().manual_seed(_SEED))
        count = max(1, len(self.gaussians) >> (2 * lod))
        return order[:count].sort().values.to(self.gaussians.means.device)


def _shade(means: Tensor, harmonics: Tensor, camera: Camera) -> Tensor:
    """Colors [N, 3] of Gaussians as a camera sees them: 0.5 + sum_k basis_k(direction) coefficient_k, not below 0."""
    if camera.orthographic:
        directions = means.new_tensor(camera.forward).expand(len(means), 3)
    else:
        directions = means - means.new_tensor(camera.position)
        directions = directions / directions.norm(dim=-1, keepdim=True).clamp(min=1e-12)
    degree = round(harmonics.shape[1] ** 0.5) - 1
    basis = harmonic_basis(directions.cpu().numpy(), degree)  # [N, K]
    colors = torch.einsum("nk,nkc->nc", torch.as_tensor(basis, dtype=means.dtype, device=means.device), harmonics)
    return (colors + 0.5).clamp(min=0.0)
