"""Light of skin read from the mesh at each pixel, instead of from the Gaussians that were blended there.

Gaussians blur what they carry, and of a surface that turns away they show what is nearer. Their colors were learned so, their
light was not: shadows and highlights would be blurred, and wander at edges. So where the picture's depth says that skin on the
mesh is seen, light is read from the texels around the mesh's point at the pixel. Elsewhere (strands, trained hair, lashes) it
stays as it was blended. Needs numpy; numba makes it faster.
"""

from __future__ import annotations

import itertools
from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..pictures.color import MIN_ALPHA
from .shadows import compiled_kernels
from .skin_relief import DIMMEST, DULL, LIGHTEST, REPEATS, SIDE, VALUES, gleam, texel_ways, tile

NEAR, FAR = 0.004, 0.010  # metres between mesh and picture up to which light is the mesh's, and from which on it is not
SHINE = slice(3, 6)  # channels of highlights
FRONT = 6  # number of the channel that others are premultiplied by (`shading.relative`)
_LEAST_WEIGHT = 0.05  # of the texels around a point: what is turned away from the viewer was not lit for it
_APART = 6.0  # texels from a point to the face beside it in a picture: one of them hides what the other borders on
_AT_EDGES = 0.5  # of the mesh's light there: one sample a pixel would make steps
_LEAST = 0.002  # share of the mesh's light in a pixel below which it is left out, as where strands hide skin
_NEAREST = 1e-3  # metres: faces that reach nearer to the camera are left out
_ROWS = 96  # of a picture that a task takes at least
NOT_SOFTENED = np.zeros(0, np.float32)


class TexelGrid(NamedTuple):
    """Where a mesh lies on a grid of texels.

    Attributes:
        faces: That are drawn, [T, 3] int32.
        places: Of their corners on the grid, in texels, whose middles are whole numbers: column, row, [T, 3, 2] float32.
        rows: Which row of the light each texel has, -1 where none, [G, G] int32.
        closed: How many of the faces, the first ones, are seen from outside only.
    """

    faces: np.ndarray
    places: np.ndarray
    rows: np.ndarray
    closed: int = 0

    @staticmethod
    def of(
        faces: np.ndarray, uv: np.ndarray, uv_faces: np.ndarray, grid: int, texel: np.ndarray, closed: int = 0
    ) -> TexelGrid:  # fmt: skip
        """Find it.

        Args:
            faces: That are drawn, [T, 3].
            uv: Corners of the UV map, [U, 2].
            uv_faces: Of the same faces, [T, 3].
            grid: G.
            texel: Flat index of each texel that light is known of, [N].
            closed: Of the faces the first ones, which are seen from outside only.
        """
        rows = np.full(grid * grid, -1, np.int32)
        rows[texel] = np.arange(len(texel))
        places = np.asarray(uv, np.float32)[uv_faces] * np.float32(grid) - np.float32(0.5)
        return TexelGrid(np.ascontiguousarray(faces, np.int32), places, rows.reshape(grid, grid), closed)


class LitSurface(NamedTuple):
    """A mesh and its light.

    Attributes:
        grid: Where the light is.
        vertices: [V, 3] metres.
        light: Of the texels, as of `shading.relative`, [N, 8] float32.
        tilts: How highlights change with the normal (`shading.Transport.tilts`), [N, 4] float32, and where `softened` holds
            something how irradiance does (`leanings`), [N, 7]; None: as smooth as the mesh.
        relief: How relief lies there (`skin_relief.lying`), [N, 4] float32.
        detail: Factor of the relief's tilts.
        softened: How much of them stands in irradiance, by color (`skin_relief.softened`), [3]; [0]: nothing.
    """

    grid: TexelGrid
    vertices: np.ndarray
    light: np.ndarray
    tilts: np.ndarray | None = None
    relief: np.ndarray | None = None
    detail: float = 1.0
    softened: np.ndarray = NOT_SOFTENED

    def read_into(
        self, channels: np.ndarray, which: slice, depth: np.ndarray, alpha: np.ndarray, skin: int | None, camera: Camera
    ) -> None:
        """Put the surface's light into a picture's channels where it shows the surface.

        Args:
            channels: Of the picture, contiguous float32, [H, W, C]; changed.
            which: Of them the light: all of `light`, or without its last.
            depth: Of the picture, metres, [H, W].
            alpha: Of the picture, [H, W].
            skin: Number of the channel that holds how much of the cover is skin; None: all.
            camera: In the axes of the vertices; what it scales them by, the depths are scaled by.
        """
        camera, size = camera.unscaled()
        depth = depth if size == 1.0 else depth / size
        local, pixels = camera.project(self.vertices)
        linear = local[:, 2] if camera.orthographic else 1.0 / np.maximum(local[:, 2], _NEAREST)
        seen = np.concatenate([pixels, linear[:, None]], 1)
        faces, places, rows, closed = self.grid
        if local[:, 2].min() <= _NEAREST:
            ahead = (local[:, 2] > _NEAREST)[faces].all(1)
            faces, places, closed = faces[ahead], places[ahead], int(ahead[:closed].sum())
        light = np.ascontiguousarray(self.light, np.float32)
        given = seen.astype(np.float32), faces, closed, places, rows, light, camera.orthographic
        if compiled_kernels() is None:
            share = np.ones_like(depth) if skin is None else channels[..., skin] / np.maximum(alpha, MIN_ALPHA)
            skin_here = self.tilts, self.relief, self.detail, self.softened
            read(*given, channels[..., which], np.asarray(depth), share, self.vertices, *skin_here)
            return
        from ..compute.threads import for_rows
        from .mesh_light_kernels import read as compiled_read

        limits = np.array([NEAR, FAR, _LEAST_WEIGHT, _APART, _AT_EDGES, MIN_ALPHA, _LEAST], np.float32)
        depth, alpha = (np.ascontiguousarray(array, np.float32) for array in (depth, alpha))
        picture = channels, which.start, which.stop - which.start, depth, alpha, -1 if skin is None else skin
        nothing = np.zeros((0, VALUES), np.float32)
        smooth = self.tilts is None or self.relief is None or not self.detail
        fine = (nothing, nothing) if smooth else (self.tilts, self.relief)
        scale = np.float32(REPEATS * SIDE / len(rows))
        below = np.ascontiguousarray(self.vertices, np.float32), *fine, *tile(), scale, np.float32(self.detail), self.softened
        for_rows(compiled_read, len(depth), *given, *picture, limits, *below, smallest=_ROWS)


def read(
    seen: np.ndarray, faces: np.ndarray, closed: int, places: np.ndarray, rows: np.ndarray, light: np.ndarray, flat: bool,
    channels: np.ndarray, depth: np.ndarray, share: np.ndarray, vertices: np.ndarray, tilts: np.ndarray | None = None,
    relief: np.ndarray | None = None, detail: float = 1.0, softened: np.ndarray = NOT_SOFTENED,
) -> None:  # fmt: skip
    """Read light at each pixel: the readable twin of `mesh_light_kernels.read`.

    Args:
        seen: Column, row and what is linear on the picture (one over the depth; the depth itself if flat) of vertices, [V, 3].
        faces: [T, 3].
        closed: As of `TexelGrid`.
        places: Likewise, [T, 3, 2].
        rows: Likewise, [G, G].
        light: Of the texels, [N, 8].
        flat: Whether the camera is orthographic.
        channels: The picture's light, changed, [H, W, K].
        depth: [H, W] metres.
        share: [H, W].
        vertices: [V, 3] metres.
        tilts: As of `LitSurface`, [N, VALUES or VALUES + 3].
        relief: Likewise, [N, VALUES].
        detail: Likewise.
        softened: Likewise.
    """
    height, width = depth.shape
    corners = seen[faces].astype(np.float64)
    low = np.ceil(corners[..., :2].min(1) - 0.5).clip(0, [width, height]).astype(np.int64)
    high = np.floor(corners[..., :2].max(1) - 0.5).clip(-1, [width - 1, height - 1]).astype(np.int64)
    extent = np.maximum(high - low + 1, 0)
    counts = extent[:, 0] * extent[:, 1]
    face = np.repeat(np.arange(len(faces)), counts)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    column, row = low[face, 0] + within % extent[face, 0], low[face, 1] + within // extent[face, 0]
    a, b, c = (corners[face, k, :2] for k in range(3))
    point = np.stack([column, row], -1) + 0.5
    with np.errstate(divide="ignore", invalid="ignore"):
        area = _cross(b - a, c - a)
        weights = np.stack([_cross(b - point, c - point), _cross(c - point, a - point), _cross(a - point, b - point)], -1)
        weights /= area[:, None]
        inside = (weights >= 0.0).all(1) & (area != 0.0) & ((face >= closed) | (area < 0.0))
    face, column, row, weights = face[inside], column[inside], row[inside], weights[inside]
    linear = corners[face, :, 2]
    value = (weights * linear).sum(1)
    deep = value if flat else 1.0 / value
    order = np.lexsort((deep, row * width + column))
    first = order[np.unique((row * width + column)[order], return_index=True)[1]]
    face, column, row, deep = face[first], column[first], row[first], deep[first]
    weights = weights[first] if flat else weights[first] * linear[first] * deep[:, None]

    place = np.einsum("nk,nkc->nc", weights, places[face])
    middle = np.floor(place + 0.5).astype(np.int64).clip(1, len(rows) - 2)
    rough = None if tilts is None or relief is None or not detail else np.concatenate([relief, tilts], 1)
    total, fine = np.zeros((len(face), channels.shape[-1])), np.zeros((len(face), 0 if rough is None else rough.shape[1]))
    splines = [_spline(place[:, axis] - middle[:, axis]) for axis in (0, 1)]
    for across, down in itertools.product(range(3), repeat=2):
        texel = rows[middle[:, 1] + down - 1, middle[:, 0] + across - 1]
        weight = splines[0][across] * splines[1][down] * (texel >= 0)
        total += weight[:, None] * light[texel, : channels.shape[-1]]
        fine += 0.0 if rough is None else weight[:, None] * rough[texel]
    front = total[:, FRONT]
    if rough is not None:
        steps = np.linalg.norm(_per_pixel(corners[face, :, :2], places[face]), axis=-1).max(1)
        lies, leans = fine[:, :VALUES], fine[:, VALUES:]
        shine, lean = gleam(leans, lies, texel_ways(vertices[faces[face]], places[face]), place, steps, len(rows), detail)
        bright = total[:, SHINE].max(1) > DULL * front
        total[:, SHINE] *= np.where(bright[:, None] & (total[:, SHINE] > 0.0), shine[:, None], 1.0)
        total[:, : len(softened)] *= (1.0 + lean[:, None] * softened).clip(DIMMEST, LIGHTEST)
    amount = np.clip((FAR - np.abs(depth[row, column] - deep)) / (FAR - NEAR), 0.0, 1.0) * share[row, column]
    amount = np.where(amount < _LEAST, 0.0, amount)
    number = np.full((height + 2, width + 2), -1)
    number[row + 1, column + 1] = face
    edge = np.zeros(len(face), bool)
    for step, inside in (((0, 1), column > 0), ((2, 1), column < width - 1), ((1, 0), row > 0), ((1, 2), row < height - 1)):
        other = number[row + step[1], column + step[0]]
        away = np.maximum(places[other].min(1) - place, place - places[other].max(1)).max(1)
        edge |= inside & ((other < 0) | (away > _APART))
    amount = np.where(front >= _LEAST_WEIGHT, amount * np.where(edge, _AT_EDGES, 1.0), 0.0)[:, None]
    here = channels[row, column]
    there = total * (here[:, FRONT] / np.maximum(front, 1e-6))[:, None]
    channels[row, column] = here + amount * (there - here)


def _spline(way: np.ndarray) -> tuple[np.ndarray, ...]:
    """Weights of a quadratic B-spline at three points in a row, `way` behind the middle one."""
    before, behind = 0.5 * (0.5 - way) ** 2, 0.5 * (0.5 + way) ** 2
    return before, 1.0 - before - behind, behind


def _per_pixel(corners: np.ndarray, places: np.ndarray) -> np.ndarray:
    """How far a pixel reaches on the grid, along columns and rows of the picture, by flat faces, [N, 2, 2]; all [N, 3, 2]."""
    b, c = np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)
    to_b, to_c = np.moveaxis(places[:, 1:] - places[:, :1], 1, 0)
    inverse = 1.0 / _cross(b, c)[:, None]
    across = (to_b * c[:, 1:] - to_c * b[:, 1:]) * inverse
    down = (to_c * b[:, :1] - to_b * c[:, :1]) * inverse
    return np.stack([across, down], 1)


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    result: np.ndarray = a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
    return result
