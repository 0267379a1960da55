"""Gaussians anchored to the UV map of a mesh (paper section 3.3, "Gaussian Primitive Initialisation", and eq. 12).

`TexelAnchor` turns the vertices of the current mesh into a tangent frame and a base size for each texel of a `layout`,
differentiably: both follow from dP/du and dP/dv, so that Gaussians follow identity, expression and pose by themselves.
`place_gaussians` applies the decoded offsets in these frames. Used by `grmm` only.
"""

from __future__ import annotations

import functools
import importlib.util
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor, nn

from ..geometry.rotations import multiply_quaternions
from ..geometry.tensor_rotations import matrix_to_quaternion, rotate, unit
from .layout import TexelLayout, anchor_tables
from .sparse import FixedSparse
from .steps import Geometry

_TINY = 1e-9  # metres per unit of UV; keeps frames of degenerate triangles defined


class TexelFrames(NamedTuple):
    """Where each active texel is on the current mesh.

    Attributes:
        positions: [..., N, 3] metres.
        quats: [..., N, 4] unit quaternions wxyz; axes: along dP/du, across it in the surface, outward normal.
        sizes: [..., N, 2] metres: a texel's sides along and across dP/du.
    """

    positions: Tensor
    quats: Tensor
    sizes: Tensor

    @property
    def normals(self) -> Tensor:
        """Outward unit normals, [..., N, 3]."""
        return rotate(self.quats, self.quats.new_tensor([0.0, 0.0, 1.0]).expand_as(self.positions))


class TexelAnchor(nn.Module):
    """Tangent frames of the active texels of a mesh.

    Args:
        layout: Active texels.
        faces: Vertex indices, [F, 3].
        uv_faces: [F, 3].
        vertex_count: V.
        own_uv: Whether the layout's UV map is not the head's, and has to be saved with the weights.
    """

    texel: Tensor
    face: Tensor
    barycentric: Tensor
    outward: Tensor
    corner_vertex: Tensor
    texel_corners: Tensor
    used_corners: Tensor

    def __init__(
        self, layout: TexelLayout, faces: np.ndarray, uv_faces: np.ndarray, vertex_count: int, own_uv: bool = False
    ) -> None:
        super().__init__()
        self.grid = layout.grid
        self.count = len(layout)
        tables = anchor_tables(layout, faces, uv_faces)
        # Saved with the weights: trained maps belong to exactly these texels.
        self.register_buffer("texel", torch.from_numpy(layout.texel.copy()))
        self.register_buffer("face", torch.from_numpy(layout.face.copy()))
        self.register_buffer("barycentric", torch.from_numpy(layout.barycentric.copy()))
        if own_uv:
            self.register_buffer("uv", torch.from_numpy(np.array(layout.uv, np.float32)))
        self.jacobian = FixedSparse(tables.jacobian, (2 * len(layout.uv), vertex_count))
        self.register_buffer("outward", torch.from_numpy(tables.outward), persistent=False)
        self.register_buffer("corner_vertex", torch.from_numpy(tables.corner_vertex), persistent=False)
        self.register_buffer("texel_corners", torch.from_numpy(tables.texel_corners), persistent=False)
        used, local = np.unique(layout.face, return_inverse=True)
        self.register_buffer("used_corners", torch.from_numpy(uv_faces[used].reshape(-1).astype(np.int64)), persistent=False)
        texel_rows = np.repeat(np.arange(self.count), 3)
        texel_columns = (local.reshape(-1)[:, None] * 3 + np.arange(3)).reshape(-1)
        entries = (texel_rows, texel_columns, layout.barycentric.reshape(-1))
        self.interpolate = FixedSparse(entries, (self.count, 3 * len(used)))

    def corners(self, vertices: Tensor) -> Tensor:
        """Position, texel-free width and height |dP/du| and |dP/dv across|, and quaternion at the UV corners: [..., T, 9]."""
        slopes = self.jacobian(vertices)  # [..., 2T, 3]
        along, across = slopes.chunk(2, -2)  # dP/du, dP/dv at the UV corners, [..., T, 3]
        x_axis, y_axis = vertices.new_tensor([_TINY, 0.0, 0.0]), vertices.new_tensor([0.0, _TINY, 0.0])
        along, across = along + x_axis, across + y_axis
        normal = unit(torch.linalg.cross(along, across)) * self.outward
        tangent = unit(along)
        bitangent = torch.linalg.cross(normal, tangent)
        quats = matrix_to_quaternion(torch.stack([tangent, bitangent, normal], -1))  # [..., T, 4]
        width = along.square().sum(-1, keepdim=True).sqrt()
        height = (across * bitangent).sum(-1, keepdim=True).abs()
        return torch.cat([vertices[..., self.corner_vertex, :], width, height, quats], -1)

    def forward(self, vertices: Tensor) -> TexelFrames:
        """Return the frames of the texels on a mesh with `vertices` [..., V, 3], metres."""
        corners = self.corners(vertices)[..., self.used_corners, :]  # [..., 3U, 9]
        # Quaternions q and -q are one rotation: bring each face's three into one half of the sphere before blending.
        by_face = corners[..., 5:].unflatten(-2, (-1, 3))  # [..., U, 3, 4]
        sign = torch.where((by_face * by_face[..., :1, :]).sum(-1, keepdim=True) < 0, -1.0, 1.0)  # [..., U, 3, 1]
        corners = torch.cat([corners[..., :5], (by_face * sign).flatten(-3, -2)], -1)
        texels = self.interpolate(corners)  # [..., N, 9]
        return TexelFrames(texels[..., :3], unit(texels[..., 5:]), texels[..., 3:5] / self.grid)

    def place(
        self, vertices: Tensor, offsets: Tensor, position_unit: float, position_limit: float, scale_log_limit: float | None,
        texel_scale: float, normal_scale: float,
    ) -> Geometry:  # fmt: skip
        """Place the Gaussians on a mesh: `forward` and `place_gaussians`, compiled where that is possible.

        Args:
            vertices: [..., V, 3] metres.
            offsets: [..., N, 10]; this and the other arguments as for `place_gaussians`.
            position_unit: Metres.
            position_limit: Metres.
            scale_log_limit: Soft limit of the log scale, or None.
            texel_scale: Relative to the texel's sides.
            normal_scale: Relative to the texel's smaller side.
        """
        settings = (position_unit, position_limit, scale_log_limit, texel_scale, normal_scale)
        compiled = vertices.device.type == "cpu" and vertices.dtype == offsets.dtype == torch.float32 and has_numba()
        if not compiled:
            return place_gaussians(self(vertices), offsets, *settings)
        limits = (position_unit, position_limit, scale_log_limit or 0.0, texel_scale / self.grid, normal_scale / self.grid)
        packed = tuple(map(np.float32, limits))
        layout = (self.texel_corners.numpy(), self.barycentric.numpy())
        corners = self.corners(vertices)
        if corners.ndim == 2 == offsets.ndim:
            return Geometry(*_Place.apply(corners, offsets, layout, packed))
        lead, pairs = offsets.shape[:-2], zip(corners.flatten(0, -3), offsets.flatten(0, -3), strict=True)
        heads = [_Place.apply(*pair, layout, packed) for pair in pairs]
        return Geometry(*(torch.stack(parts).unflatten(0, lead) for parts in zip(*heads, strict=True)))


class _Place(torch.autograd.Function):
    """`placing` as a differentiable function of corner values [T, 9] and offsets [N, 10]."""

    @staticmethod
    def forward(
        ctx: Any, corners: Tensor, offsets: Tensor, layout: tuple[np.ndarray, np.ndarray], settings: tuple[np.float32, ...]
    ) -> tuple[Tensor, Tensor, Tensor]:
        from ..compute.threads import for_rows
        from .placing import place_forward

        corners, offsets = corners.detach().contiguous(), offsets.detach().contiguous()
        ctx.save_for_backward(corners, offsets)
        ctx.layout, ctx.settings = layout, settings
        means, quats, scales = (torch.empty((len(offsets), width)) for width in (3, 4, 3))
        placed = (means.numpy(), quats.numpy(), scales.numpy())
        for_rows(place_forward, len(offsets), corners.numpy(), *layout, offsets.numpy(), settings, *placed)
        return means, quats, scales

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        from ..compute.threads import for_rows
        from .placing import place_backward, scatter

        corners, offsets = (saved.numpy() for saved in ctx.saved_tensors)
        g_offsets, g_texels = torch.empty((len(offsets), 10)), np.empty((len(offsets), corners.shape[1]), np.float32)
        given = (gradient.contiguous().numpy() for gradient in gradients)
        found = (g_offsets.numpy(), g_texels)
        for_rows(place_backward, len(offsets), corners, *ctx.layout, offsets, ctx.settings, *given, *found)
        if not ctx.needs_input_grad[0]:
            return None, g_offsets, None, None
        g_corners = torch.zeros(corners.shape)
        scatter(corners, *ctx.layout, g_texels, g_corners.numpy())
        return g_corners, g_offsets, None, None


def place_gaussians(
    frames: TexelFrames,
    offsets: Tensor,
    position_unit: float,
    position_limit: float,
    scale_log_limit: float | None,
    texel_scale: float,
    normal_scale: float,
) -> Geometry:
    """Apply decoded offsets in the tangent frames (eq. 12).

    Args:
        frames: Texels on the current mesh.
        offsets: Position 3, rotation 4, log scale 3, [..., N, 10]. Zero leaves the Gaussian on its texel.
        position_unit: Metres moved by a position offset of 1.
        position_limit: Metres; soft limit of the movement.
        scale_log_limit: Soft limit of the log scale, or None.
        texel_scale: Base scales in the surface relative to the texel's sides.
        normal_scale: Base scale along the normal relative to the texel's smaller side.
    """
    position, rotation, log_scale = offsets.split((3, 4, 3), -1)
    moved = soft_limit(position * position_unit, position_limit)
    means = frames.positions + rotate(frames.quats, moved)
    # eq. 12 has r = delta_r; here it turns the texel's frame, and no offset is no rotation
    turn = torch.cat([rotation[..., :1] + 1.0, rotation[..., 1:]], -1)
    quats = unit(multiply_quaternions(frames.quats, turn))
    if scale_log_limit is not None:
        log_scale = soft_limit(log_scale, scale_log_limit)
    base = torch.cat([frames.sizes * texel_scale, frames.sizes.amin(-1, keepdim=True) * normal_scale], -1)
    return Geometry(means, quats, base * log_scale.exp())


def soft_limit(x: Tensor, limit: float) -> Tensor:
    """Bend x [...] as x / sqrt(1 + (x / limit)^2): the identity near zero, never beyond the limit, cheaper than a tanh."""
    return x * torch.rsqrt(1.0 + (x / limit).square())


@functools.lru_cache(maxsize=1)
def has_numba() -> bool:
    """Whether the compiled form of `TexelAnchor.place` can be used."""
    return importlib.util.find_spec("numba") is not None
