"""Which texels carry Gaussians, and the constant tables that lead from a mesh's vertices to them. Needs numpy only.

`texel_layout` finds once which texels of an N_g x N_g grid lie on the mesh and where (face and barycentric coordinates).
`anchor_tables` and `map_reader` are the linear maps of `texels` and `decoders` as entries of sparse matrices, for every
implementation of the model.

The Jacobian is averaged at the corners of the UV mesh and interpolated, not taken per face: hair stands centimetres off the
skull, where the kinks between flat faces would open gaps.

Conventions: texel (row i, column j) has its centre at u = (j + 1/2) / N_g, v = (i + 1/2) / N_g.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..compute.recent import Recent
from ..errors import ShapeError

if TYPE_CHECKING:
    from ..head import HeadModel

_INSIDE = -1e-7  # barycentric tolerance: a texel centre on an edge belongs to the first of its faces

Entries = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Rows, columns and values of a sparse matrix, [E] each; repeated positions add up."""


@dataclass(frozen=True)
class TexelLayout:
    """The active texels of a grid.

    Attributes:
        grid: N_g.
        texel: Flat index row * grid + column of each active texel, ascending, [N] int32.
        face: Face that holds the texel's centre, [N] int32.
        barycentric: Coordinates in that face, [N, 3] float32, rows sum to 1.
        uv: Corners of the UV map that the grid lies on, [T, 2].
    """

    grid: int
    texel: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray
    uv: np.ndarray

    def __len__(self) -> int:
        return len(self.texel)

    def on_lash_cards(self, head: HeadModel) -> np.ndarray:
        """Numbers of the texels on the strips of a head that lashes stand on, [K]; none where it has no such strips."""
        return np.flatnonzero(self.within(head, "lashes"))

    def within(self, head: HeadModel, *regions: str) -> np.ndarray:
        """Which texels lie in regions of the head or touch them, [N] bool; regions that it has not are empty."""
        touching: np.ndarray = head.marked(*regions)[head.faces[self.face]].any(1)
        return touching


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
    return _KNOWN.get((np.asarray(uv), np.asarray(uv_faces), grid), lambda: _found(uv, uv_faces, grid))


_KNOWN: Recent[TexelLayout] = Recent(4)
"""Every head that is added to a scene, painted or lit asks for the same few."""


def _found(uv: np.ndarray, uv_faces: np.ndarray, grid: int) -> TexelLayout:
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
    return TexelLayout(grid, texel.astype(np.int32), face[first].astype(np.int32), barycentric.astype(np.float32), uv)


@dataclass(frozen=True)
class AnchorTables:
    """How texels follow a mesh.

    Attributes:
        jacobian: Matrix [2 T, V] that takes vertices to dP/du (the first T rows) and dP/dv at the UV corners.
        outward: -1 at corners of mirrored UV islands, whose normals would turn inwards, else 1, [T, 1] float32.
        corner_vertex: Mesh vertex of each UV corner, [T] int64.
        texel_corners: UV corners of each texel's face, [N, 3] int32.
    """

    jacobian: Entries
    outward: np.ndarray
    corner_vertex: np.ndarray
    texel_corners: np.ndarray


def anchor_tables(layout: TexelLayout, faces: np.ndarray, uv_faces: np.ndarray) -> AnchorTables:
    """Return the tables of a layout on a mesh with `faces` [F, 3] and `uv_faces` [F, 3]."""
    faces, uv_faces, uv = np.asarray(faces, np.int64), np.asarray(uv_faces, np.int64), np.asarray(layout.uv, np.float64)
    slopes, weights = _barycentric_slopes(uv, uv_faces)  # [F, 3, 2], [F]
    corner_count = len(uv)
    total = np.zeros(corner_count)
    np.add.at(total, uv_faces.reshape(-1), np.repeat(np.abs(weights), 3))
    share = np.abs(weights)[:, None] / np.maximum(total[uv_faces], 1e-300)  # [F, 3 corners]
    rows = np.broadcast_to(uv_faces[:, :, None], (len(faces), 3, 3)).reshape(-1)
    columns = np.broadcast_to(faces[:, None, :], (len(faces), 3, 3)).reshape(-1)
    values = (share[:, :, None, None] * slopes[:, None, :, :]).reshape(-1, 2)
    jacobian = (
        np.concatenate([rows, rows + corner_count]),
        np.concatenate([columns, columns]),
        np.concatenate([values[:, 0], values[:, 1]]),
    )
    signed = np.zeros(corner_count)
    np.add.at(signed, uv_faces.reshape(-1), np.repeat(weights, 3))
    outward = np.where(signed < 0, -1.0, 1.0).astype(np.float32)[:, None]
    corner_vertex = _corner_vertices(uv_faces, faces, corner_count)
    return AnchorTables(jacobian, outward, corner_vertex, uv_faces[layout.face].astype(np.int32))


def map_reader(texel: np.ndarray, grid: int, side: int) -> Entries:
    """Return the matrix [N, side * side] that reads a side x side map at texels of a grid x grid map, bilinearly.

    Args:
        texel: Flat indices row * grid + column, [N].
        grid: Side of the texel grid, a multiple of `side`.
        side: Side of the map.
    """
    texel = np.asarray(texel, np.int64)
    rows, columns, values = [], [], []
    count = np.arange(len(texel))
    # centres of both grids at half texels, as in image resizing without aligned corners
    y, x = ((part + 0.5) * side / grid - 0.5 for part in (texel // grid, texel % grid))
    y, x = np.clip(y, 0, side - 1), np.clip(x, 0, side - 1)
    y0, x0 = np.minimum(np.floor(y), side - 1).astype(np.int64), np.minimum(np.floor(x), side - 1).astype(np.int64)
    for dy in (0, 1):
        for dx in (0, 1):
            weight = (dy * (y - y0) + (1 - dy) * (1 - (y - y0))) * (dx * (x - x0) + (1 - dx) * (1 - (x - x0)))
            keep = weight > 0
            rows.append(count[keep])
            columns.append((np.minimum(y0 + dy, side - 1) * side + np.minimum(x0 + dx, side - 1))[keep])
            values.append(weight[keep])
    return np.concatenate(rows), np.concatenate(columns), np.concatenate(values)


@dataclass(frozen=True)
class CompressedRows:
    """A sparse matrix by rows.

    Attributes:
        starts: First entry of each row and the number of entries, [R + 1] int32.
        columns: [E] int32, ascending in a row.
        values: [E] float32.
    """

    starts: np.ndarray
    columns: np.ndarray
    values: np.ndarray


def compressed_rows(entries: Entries, shape: tuple[int, int]) -> CompressedRows:
    """Sort entries by row and column and add up those at one position."""
    rows, columns, values = entries
    keys, inverse = np.unique(rows.astype(np.int64) * shape[1] + columns.astype(np.int64), return_inverse=True)
    summed = np.bincount(inverse.reshape(-1), weights=values.astype(np.float64), minlength=len(keys))
    starts = np.zeros(shape[0] + 1, np.int64)
    np.cumsum(np.bincount(keys // shape[1], minlength=shape[0]), out=starts[1:])
    return CompressedRows(starts.astype(np.int32), (keys % shape[1]).astype(np.int32), summed.astype(np.float32))


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
