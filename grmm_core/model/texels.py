"""Gaussians anchored to the UV map of a mesh (paper section 3.3, "Gaussian Primitive Initialisation", and eq. 12).

`texel_layout` finds once, with numpy, which texels of an N_g x N_g grid lie on the mesh and where (face and barycentric
coordinates). `TexelAnchor` turns the vertices of the current mesh into a tangent frame and a base size for each texel,
differentiably: both follow from dP/du and dP/dv, so that Gaussians follow identity, expression and pose by themselves.
`place_gaussians` applies the decoded offsets in these frames.

The Jacobian is averaged at the corners of the UV mesh and interpolated, not taken per face: hair stands centimetres off the
skull, where the kinks between flat faces would open gaps.

Conventions: texel (row i, column j) has its centre at u = (j + 1/2) / N_g, v = (i + 1/2) / N_g. Used by `grmm` only.
"""

from __future__ import annotations

import functools
import importlib.util
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import ShapeError
from .sparse import FixedSparse

_INSIDE = -1e-7  # barycentric tolerance: a texel centre on an edge belongs to the first of its faces
_TINY = 1e-9  # metres per unit of UV; keeps frames of degenerate triangles defined
_TINY_NORM = 1e-20


@dataclass(frozen=True)
class TexelLayout:
    """The active texels of a grid.

    Attributes:
        grid: N_g.
        texel: Flat index row * grid + column of each active texel, ascending, [N] int32.
        face: Face that holds the texel's centre, [N] int32.
        barycentric: Coordinates in that face, [N, 3] float32, rows sum to 1.
    """

    grid: int
    texel: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray

    def __len__(self) -> int:
        return len(self.texel)


def texel_layout(uv: np.ndarray, uv_faces: np.ndarray, grid: int) -> TexelLayout:
    """Find the texels whose centres lie on the UV mesh.

    Args:
        uv: UV coordinates 0..1, [T, 2].
        uv_faces: Indices into `uv`, [F, 3].
        grid: Texels along a side.

    Returns:
        The layout. Where triangles overlap in UV the first face wins.

    Raises:
        ShapeError: No texel lies on the mesh.
    """
    corners = np.asarray(uv, np.float64)[uv_faces] * grid - 0.5  # [F, 3, 2] in texels, centres at whole numbers
    low = np.maximum(np.ceil(corners.min(1) - 1e-6), 0).astype(np.int64)  # [F, 2]
    high = np.minimum(np.floor(corners.max(1) + 1e-6), grid - 1).astype(np.int64)
    extent = np.maximum(high - low + 1, 0)
    counts = extent[:, 0] * extent[:, 1]
    face = np.repeat(np.arange(len(counts)), counts)  # candidates: every texel of every face's bounding box
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    column = low[face, 0] + within % np.maximum(extent[face, 0], 1)
    row = low[face, 1] + within // np.maximum(extent[face, 0], 1)

    a, b, c = (corners[face, k] for k in range(3))
    point = np.stack([column, row], -1).astype(np.float64)
    area = _cross(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        l1 = _cross(point - a, c - a) / area
        l2 = _cross(b - a, point - a) / area
        barycentric = np.stack([1.0 - l1 - l2, l1, l2], -1)
        inside = (barycentric >= _INSIDE).all(-1)  # NaN of degenerate faces compares false
    texel, face, barycentric = (row * grid + column)[inside], face[inside], barycentric[inside]
    texel, first = np.unique(texel, return_index=True)  # candidates are in order of faces: the first face wins
    if not len(texel):
        raise ShapeError(f"No texel of a {grid}x{grid} grid lies on the head's UV map; use a finer grid or another head model.")
    barycentric = np.clip(barycentric[first], 0.0, 1.0)
    barycentric /= barycentric.sum(-1, keepdims=True)
    return TexelLayout(grid, texel.astype(np.int32), face[first].astype(np.int32), barycentric.astype(np.float32))


@dataclass
class TexelFrames:
    """Where each active texel is on the current mesh.

    Attributes:
        positions: [N, 3] metres.
        quats: [N, 4] unit quaternions wxyz; axes: along dP/du, across it in the surface, outward normal.
        sizes: [N, 2] metres: a texel's sides along and across dP/du.
    """

    positions: Tensor
    quats: Tensor
    sizes: Tensor


class TexelAnchor(nn.Module):
    """Tangent frames of the active texels of a mesh.

    Args:
        layout: Active texels.
        faces: Vertex indices, [F, 3].
        uv: [T, 2].
        uv_faces: [F, 3].
        vertex_count: V.
    """

    def __init__(self, layout: TexelLayout, faces: np.ndarray, uv: np.ndarray, uv_faces: np.ndarray, vertex_count: int) -> None:
        super().__init__()
        self.grid = layout.grid
        self.count = len(layout)
        faces, uv_faces, uv = np.asarray(faces, np.int64), np.asarray(uv_faces, np.int64), np.asarray(uv, np.float64)
        # Saved with the weights: trained maps belong to exactly these texels.
        self.register_buffer("texel", torch.from_numpy(layout.texel.copy()))
        self.register_buffer("face", torch.from_numpy(layout.face.copy()))
        self.register_buffer("barycentric", torch.from_numpy(layout.barycentric.copy()))

        slopes, weights = _barycentric_slopes(uv, uv_faces)  # [F, 3, 2], [F]
        corner_count = len(uv)
        total = np.zeros(corner_count)
        np.add.at(total, uv_faces.reshape(-1), np.repeat(np.abs(weights), 3))
        share = np.abs(weights)[:, None] / np.maximum(total[uv_faces], 1e-300)  # [F, 3 corners]
        rows = np.broadcast_to(uv_faces[:, :, None], (len(faces), 3, 3)).reshape(-1)
        columns = np.broadcast_to(faces[:, None, :], (len(faces), 3, 3)).reshape(-1)
        values = (share[:, :, None, None] * slopes[:, None, :, :]).reshape(-1, 2)
        self.jacobian = FixedSparse(
            np.concatenate([rows, rows + corner_count]), np.concatenate([columns, columns]),
            np.concatenate([values[:, 0], values[:, 1]]), (2 * corner_count, vertex_count),
        )  # fmt: skip
        signed = np.zeros(corner_count)
        np.add.at(signed, uv_faces.reshape(-1), np.repeat(weights, 3))
        # mirrored UV islands would turn the normal inwards
        outward = np.where(signed < 0, -1.0, 1.0).astype(np.float32)[:, None]
        self.register_buffer("outward", torch.from_numpy(outward), persistent=False)
        corner_vertex = torch.from_numpy(_corner_vertices(uv_faces, faces, corner_count))
        self.register_buffer("corner_vertex", corner_vertex, persistent=False)

        texel_corners = torch.from_numpy(uv_faces[layout.face].astype(np.int32))  # [N, 3]
        self.register_buffer("texel_corners", texel_corners, persistent=False)
        used, local = np.unique(layout.face, return_inverse=True)
        self.register_buffer("used_corners", torch.from_numpy(uv_faces[used].reshape(-1)), persistent=False)  # [U * 3]
        texel_rows = np.repeat(np.arange(self.count), 3)
        texel_columns = (local.reshape(-1)[:, None] * 3 + np.arange(3)).reshape(-1)
        self.interpolate = FixedSparse(texel_rows, texel_columns, layout.barycentric.reshape(-1), (self.count, 3 * len(used)))

    def corners(self, vertices: Tensor) -> Tensor:
        """Position, texel-free width and height |dP/du| and |dP/dv across|, and quaternion at the UV corners: [T, 9]."""
        slopes = self.jacobian(vertices)  # [2T, 3]
        along, across = slopes.chunk(2)  # dP/du, dP/dv at the UV corners, [T, 3]
        x_axis, y_axis = vertices.new_tensor([_TINY, 0.0, 0.0]), vertices.new_tensor([0.0, _TINY, 0.0])
        along, across = along + x_axis, across + y_axis
        normal = _unit(torch.linalg.cross(along, across)) * self.outward
        tangent = _unit(along)
        bitangent = torch.linalg.cross(normal, tangent)
        quats = matrix_to_quaternion(torch.stack([tangent, bitangent, normal], -1))  # [T, 4]
        width = along.square().sum(-1, keepdim=True).sqrt()
        height = (across * bitangent).sum(-1, keepdim=True).abs()
        return torch.cat([vertices[self.corner_vertex], width, height, quats], -1)

    def forward(self, vertices: Tensor) -> TexelFrames:
        """Return the frames of the texels on a mesh with `vertices` [V, 3], metres."""
        corners = self.corners(vertices)[self.used_corners]  # [3U, 9]
        # Quaternions q and -q are one rotation: bring each face's three into one half of the sphere before blending.
        by_face = corners[:, 5:].view(-1, 3, 4)
        sign = torch.where((by_face * by_face[:, :1]).sum(-1, keepdim=True) < 0, -1.0, 1.0)  # [U, 3, 1]
        corners = torch.cat([corners[:, :5], (by_face * sign).reshape(-1, 4)], -1)
        texels = self.interpolate(corners)  # [N, 9]
        return TexelFrames(texels[:, :3], _unit(texels[:, 5:]), texels[:, 3:5] / self.grid)

    def place(
        self, vertices: Tensor, offsets: Tensor, position_unit: float, position_limit: float, scale_log_limit: float | None,
        texel_scale: float, normal_scale: float,
    ) -> Geometry:  # fmt: skip
        """Place the Gaussians on a mesh: `forward` and `place_gaussians`, compiled where that is possible.

        Args:
            vertices: [V, 3] metres.
            offsets: [N, 10]; this and the other arguments as for `place_gaussians`.
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
        packed = np.array(limits, np.float32)
        layout = (self.texel_corners.numpy(), self.barycentric.numpy())
        return Geometry(*_Place.apply(self.corners(vertices), offsets, layout, packed))


class _Place(torch.autograd.Function):
    """`placing` as a differentiable function of corner values [T, 9] and offsets [N, 10]."""

    @staticmethod
    def forward(
        ctx: Any, corners: Tensor, offsets: Tensor, layout: tuple[np.ndarray, np.ndarray], settings: np.ndarray
    ) -> tuple[Tensor, Tensor, Tensor]:
        from .placing import place_forward

        corners, offsets = corners.detach().contiguous(), offsets.detach().contiguous()
        ctx.save_for_backward(corners, offsets)
        ctx.layout, ctx.settings = layout, settings
        results = tuple(torch.empty((len(offsets), width)) for width in (3, 4, 3))
        place_forward(corners.numpy(), *layout, offsets.numpy(), settings, *(result.numpy() for result in results))
        return results

    @staticmethod
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:
        from .placing import place_backward, scatter

        corners, offsets = (saved.numpy() for saved in ctx.saved_tensors)
        g_offsets, g_texels = torch.empty((len(offsets), 10)), np.empty((len(offsets), 9), np.float32)
        given = (gradient.contiguous().numpy() for gradient in gradients)
        place_backward(corners, *ctx.layout, offsets, ctx.settings, *given, g_offsets.numpy(), g_texels)
        if not ctx.needs_input_grad[0]:
            return None, g_offsets, None, None
        g_corners = torch.zeros(corners.shape)
        scatter(corners, *ctx.layout, g_texels, g_corners.numpy())
        return g_corners, g_offsets, None, None


@dataclass
class Geometry:
    """Placed Gaussians without opacity and color.

    Attributes:
        means: [N, 3] metres.
        quats: [N, 4] unit wxyz.
        scales: [N, 3] metres.
    """

    means: Tensor
    quats: Tensor
    scales: Tensor


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
        offsets: Position 3, rotation 4, log scale 3, [N, 10]. Zero leaves the Gaussian on its texel.
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
    turn = torch.cat([rotation[:, :1] + 1.0, rotation[:, 1:]], -1)
    quats = _unit(multiply_quaternions(frames.quats, turn))
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


def rotate(quats: Tensor, vectors: Tensor) -> Tensor:
    """Rotate vectors [..., 3] by unit quaternions wxyz [..., 4]."""
    w, axis = quats[..., :1], quats[..., 1:]
    twice = 2.0 * torch.linalg.cross(axis, vectors)
    return vectors + w * twice + torch.linalg.cross(axis, twice)


def multiply_quaternions(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product a b of quaternions wxyz, [..., 4]: first b's rotation, then a's."""
    wa, va, wb, vb = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    real = wa * wb - (va * vb).sum(-1, keepdim=True)
    return torch.cat([real, wa * vb + wb * va + torch.linalg.cross(va, vb)], -1)


def matrix_to_quaternion(matrix: Tensor) -> Tensor:
    """Unit quaternions wxyz [..., 4] of rotation matrices [..., 3, 3].

    The four rows of 4 q q^T are linear in the matrix; the row with the largest diagonal, normalised, is q without any
    division by small numbers.
    """
    m00, m01, m02, m10, m11, m12, m20, m21, m22 = matrix.flatten(-2).unbind(-1)
    wx, wy, wz = m21 - m12, m02 - m20, m10 - m01
    xy, xz, yz = m10 + m01, m20 + m02, m21 + m12
    rows = torch.stack(
        [
            torch.stack([1 + m00 + m11 + m22, wx, wy, wz], -1),
            torch.stack([wx, 1 + m00 - m11 - m22, xy, xz], -1),
            torch.stack([wy, xy, 1 - m00 + m11 - m22, yz], -1),
            torch.stack([wz, xz, yz, 1 - m00 - m11 + m22], -1),
        ],
        -2,
    )
    best = rows.diagonal(dim1=-2, dim2=-1).argmax(-1)  # [...]
    row = rows.gather(-2, best[..., None, None].expand(*best.shape, 1, 4)).squeeze(-2)
    return _unit(row)


def _unit(vectors: Tensor) -> Tensor:
    return vectors / vectors.square().sum(-1, keepdim=True).clamp(min=_TINY_NORM).sqrt()


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _barycentric_slopes(uv: np.ndarray, uv_faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return d(barycentric_k)/d(u, v) of each face, [F, 3, 2], and signed UV areas, [F]; zero for degenerate faces."""
    a, b, c = (uv[uv_faces[:, k]] for k in range(3))
    area = _cross(b - a, c - a)
    usable = np.abs(area) > 1e-14
    inverse = np.where(usable, 1.0 / np.where(usable, area, 1.0), 0.0)[:, None]
    edges = (c - b, a - c, b - a)  # opposite to each corner
    slopes = np.stack([np.stack([-edge[:, 1], edge[:, 0]], -1) * inverse for edge in edges], 1)
    return slopes, np.where(usable, area, 0.0)


def _corner_vertices(uv_faces: np.ndarray, faces: np.ndarray, corner_count: int) -> np.ndarray:
    """Return the mesh vertex of each UV corner, [T] int64; unused corners get vertex 0."""
    vertex = np.zeros(corner_count, np.int64)
    vertex[uv_faces.reshape(-1)] = faces.reshape(-1)
    return vertex
