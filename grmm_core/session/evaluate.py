"""From an avatar and its controls to a mesh and Gaussians, computing only what changed.

What each step depends on, and so what its cache key holds (the owner is the avatar):

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

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..avatar import Avatar
from ..controls.frame import Controls, resolve
from ..errors import ShapeError
from ..head.skinning import euler_matrices, posed_vertices
from ..model.grmm import GRMM, JAW, NECK, euler_to_rotvec
from ..model.texels import rotate
from ..splat import Gaussians
from .cache import TensorCache
from .models import LoadedModel
from .sources import SourceKey

_OUTWARD = (0.0, 0.0, 1.0)  # the normal's axis in a texel's frame


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


@dataclass(frozen=True)
class Inputs:
    """Model inputs of one frame: avatar and controls added up.

    Attributes:
        z_id: [Z]. z_exp: [Y], times strength. shape: [S]. expression: [E]. pose: Euler angles, [5, 3] radians.
        strength: Factor of the learned displacement.
    """

    z_id: np.ndarray
    z_exp: np.ndarray
    shape: np.ndarray
    expression: np.ndarray
    pose: np.ndarray
    strength: float

    @property
    def identity_key(self) -> bytes:
        """What opacity depends on."""
        return self.z_id.tobytes()

    @property
    def code_key(self) -> tuple[bytes, bytes]:
        """What the offsets depend on."""
        return self.identity_key, self.z_exp.tobytes()

    @property
    def mesh_key(self) -> tuple[object, ...]:
        """What the mesh depends on."""
        return (*self.code_key, self.shape.tobytes(), self.expression.tobytes(), self.pose.tobytes(), self.strength)


class Evaluator:
    """Computes meshes and Gaussians of open avatars through one bounded cache. Call under `torch.inference_mode`."""

    def __init__(self, cache_bytes: int) -> None:
        self.cache = TensorCache(cache_bytes)

    def inputs(self, target: OpenAvatar, controls: Controls) -> Inputs:
        """Add the avatar's own codes to the controls.

        Raises:
            ControlError, ShapeError: A control is not finite, or has more components than this model.
        """
        model, avatar = target.model, target.avatar
        clean = controls.validate()
        head = model.head_model
        resolved = resolve(clean, head)
        expression = _sum("expression", resolved.expression.size, resolved.expression, avatar.expression)
        # The avatar's resting expression turns joints as the same coefficients in the controls would.
        extra = _sum("expression", resolved.expression.size, avatar.expression)
        pose = resolved.pose + np.einsum("e,ejk->jk", extra, np.asarray(head.expression_pose, np.float32))
        shape = _sum("shape", head.shape_dirs.shape[-1], avatar.shape, clean.shape)
        strength = clean.residual_strength
        if model.config.residuals:
            z_id = _sum("z_id", model.z_id_size, avatar.z_id, clean.z_id)
            codes = model.aligned_codes.detach().float().cpu().numpy()  # [60, Y]
            z_exp = _sum("z_exp", model.z_exp_size, avatar.z_exp, clean.z_exp, resolved.aligned @ codes) * np.float32(strength)
        else:  # eq. 21
            z_id, z_exp = shape, expression
        return Inputs(z_id, z_exp, shape, expression, pose.astype(np.float32), strength)

    def mesh(self, target: OpenAvatar, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Return posed vertices and the learned displacement, both [V, 3] metres."""

        def make() -> tuple[Tensor, Tensor]:
            model, head = target.model, target.model.head
            z_id, z_exp, expression, pose = (
                self._tensor(model, array)[None] for array in (inputs.z_id, inputs.z_exp, inputs.expression, inputs.pose)
            )
            turns = euler_to_rotvec(pose[0, [NECK, JAW]])
            displacement = model.displacement(z_id, z_exp, turns[:1], turns[1:], expression)[0] * inputs.strength
            shaped, joints = self.rest(target, inputs)
            used = int(np.flatnonzero(inputs.expression)[-1]) + 1 if inputs.expression.any() else 0
            unposed = shaped + head.expression_dirs[:, :, :used] @ expression[0, :used] + displacement
            rotations = euler_matrices(pose[0])
            return posed_vertices(unposed, rotations, joints, head.weights, head.parents, head.posedirs), displacement

        return self.cache.get((target.id, "mesh", *inputs.mesh_key), make)

    def rest(self, target: OpenAvatar, inputs: Inputs) -> tuple[Tensor, Tensor]:
        """Return the shaped head without expression [V, 3] and its rest joints [5, 3]: most of the arithmetic of a mesh."""

        def make() -> tuple[Tensor, Tensor]:
            shape = self._tensor(target.model, inputs.shape)
            return target.model.head.shaped(shape), target.model.head.joints(shape)

        return self.cache.get((target.id, "rest", inputs.shape.tobytes()), make)

    def geometry(self, target: OpenAvatar, inputs: Inputs) -> tuple[Tensor, Tensor, Tensor]:
        """Return means [N, 3], quaternions [N, 4] and scales [N, 3] in head space."""

        def make() -> tuple[Tensor, Tensor, Tensor]:
            model = target.model
            vertices, _ = self.mesh(target, inputs)
            placed = model.geometry(vertices, self.offsets(target, inputs))
            return placed.means, placed.quats, placed.scales

        return self.cache.get((target.id, "geometry", *inputs.mesh_key), make)

    def offsets(self, target: OpenAvatar, inputs: Inputs) -> Tensor:
        """Return Phi_T's offsets, [N, 10]."""

        def make() -> tuple[Tensor, ...]:
            return self._decoded(target, "offsets", inputs, inputs.z_exp)

        return self.cache.get((target.id, "offsets", *inputs.code_key), make)[0]

    def tint(self, target: OpenAvatar, inputs: Inputs) -> Tensor:
        """Return what the expression adds to the colors, [N, 3] or one row of zeros."""

        def make() -> tuple[Tensor, ...]:
            return self._decoded(target, "tint", inputs, inputs.z_exp)

        return self.cache.get((target.id, "tint", *inputs.code_key), make)[0]

    def opacity(self, target: OpenAvatar, inputs: Inputs) -> Tensor:
        """Return Phi_alpha's opacities, [N]."""
        return self.cache.get((target.id, "opacity", inputs.identity_key), lambda: self._decoded(target, "opacity", inputs))[0]

    def appearance(self, target: OpenAvatar, inputs: Inputs, direction: np.ndarray) -> tuple[Tensor, Tensor]:
        """Return Phi_app's colors [N, 3] and features [N, F] for a unit view direction [3] in head space."""
        direction = np.asarray(direction, np.float32)

        def make() -> tuple[Tensor, ...]:
            return self._decoded(target, "appearance", inputs, direction)

        colors, features = self.cache.get((target.id, "appearance", inputs.identity_key, direction.tobytes()), make)
        return colors, features

    def gaussians(self, target: OpenAvatar, inputs: Inputs, direction: np.ndarray, lod: int = 0) -> Gaussians:
        """Return all Gaussians in head space; features are [N, F], also where F is 0."""
        means, quats, scales = self.geometry(target, inputs)
        colors, features = self.appearance(target, inputs, direction)
        colors = colors + self.tint(target, inputs)
        full = Gaussians(means, quats, scales, self.opacity(target, inputs), colors, features)
        return full if lod == 0 else thin_out(full, self.blocks(target, lod), lod)

    def normals(self, target: OpenAvatar, inputs: Inputs, lod: int = 0) -> Tensor:
        """Return the outward mesh normal at each Gaussian, head space, [N, 3]."""

        def make() -> tuple[Tensor]:
            frames = target.model.anchor(self.mesh(target, inputs)[0])
            return (rotate(frames.quats, frames.quats.new_tensor(_OUTWARD).expand(len(frames.quats), 3)),)

        normals = self.cache.get((target.id, "normals", *inputs.mesh_key), make)[0]
        return normals if lod == 0 else normals[self.blocks(target, lod)[0]]

    def blocks(self, target: OpenAvatar, lod: int) -> tuple[Tensor, Tensor, Tensor]:
        """Return the blocks of texels that `thin_out` merges."""
        return self.cache.get((target.id, "blocks", lod), lambda: _blocks(target.model, lod))

    def _decoded(self, target: OpenAvatar, name: str, inputs: Inputs, *further: np.ndarray) -> tuple[Tensor, ...]:
        """Decode attributes; what an avatar's own changes add fades as its identity code moves to another person's.

        A beard that was trained for one face has no place on the face that another code gives.
        """
        loaded = target.loaded
        arguments = [self._tensor(target.model, array) for array in (inputs.z_id, *further)]
        own: tuple[Tensor, ...] = getattr(loaded, name)(*arguments)
        if loaded.shared is None or not target.model.config.residuals:
            return own
        share = 1.0 - float(np.linalg.norm(inputs.z_id - target.avatar.z_id)) / loaded.reach
        if share == 1.0:
            return own
        plain: tuple[Tensor, ...] = getattr(loaded.shared, name)(*arguments)
        return tuple(a.lerp(b, max(0.0, share)) for a, b in zip(plain, own, strict=True))

    @staticmethod
    def _tensor(model: GRMM, array: np.ndarray) -> Tensor:
        return torch.as_tensor(array, dtype=model.dtype, device=model.device)


def thin_out(gaussians: Gaussians, blocks: tuple[Tensor, Tensor, Tensor], lod: int) -> Gaussians:
    """Replace each block of 2^lod x 2^lod texels by one Gaussian.

    It takes the place and frame of the block's middle texel, the mean of what can be averaged, and 2^lod times the size in the
    surface, so that the skin stays closed.

    Args:
        gaussians: All Gaussians, [N].
        blocks: Of `Evaluator.blocks`: middle texel [M], block of each texel [N], texels in each block [M].
        lod: Level of detail, at least 1.
    """
    middle, block, counts = blocks

    def mean(values: Tensor) -> Tensor:
        total = values.new_zeros((len(middle), *values.shape[1:])).index_add_(0, block, values)
        return total / counts.view(-1, *[1] * (values.ndim - 1))

    grow = gaussians.scales.new_tensor([1 << lod, 1 << lod, 1])
    return Gaussians(
        means=gaussians.means[middle],
        quats=gaussians.quats[middle],
        scales=mean(gaussians.scales) * grow,
        opacities=mean(gaussians.opacities),
        colors=mean(gaussians.colors),
        features=None if gaussians.features is None else mean(gaussians.features),
    )


def _blocks(model: GRMM, lod: int) -> tuple[Tensor, Tensor, Tensor]:
    """Return, for blocks of texels, the middle texel [M], each texel's block [N] and the texels in each block [M]."""
    grid, side = model.anchor.grid, 1 << lod
    texel = model.anchor.texel.long()
    row, column = texel // grid, texel % grid
    _, block = torch.unique((row // side) * grid + column // side, return_inverse=True)
    count = int(block.max()) + 1
    distance = (row % side - side // 2).abs() + (column % side - side // 2).abs()
    # the smallest key of a block is its middle texel; the first one where several are as near
    key = distance * len(texel) + torch.arange(len(texel), device=texel.device)
    middle = key.new_full((count,), torch.iinfo(key.dtype).max).scatter_reduce_(0, block, key, "amin") % len(texel)
    counts = torch.bincount(block, minlength=count).to(model.dtype)
    return middle, block, counts


def _sum(name: str, size: int, *parts: np.ndarray) -> np.ndarray:
    """Add rows of up to `size` values. Raises `ShapeError` for a longer one."""
    total = np.zeros(size, np.float32)
    for part in parts:
        if part.size > size:
            raise ShapeError(f"{name} has {part.size} values; this model takes {size}.")
        total[: part.size] += part
    return total
