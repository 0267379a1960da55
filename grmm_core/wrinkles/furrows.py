"""What furrows do to a picture: each pixel of skin darker or brighter by the light that its slope turns to, and by depth.

Learned colors are skin in even light. Where the relief tilts the normal they are multiplied by what arrives there beside what
arrives on the smooth skin (as nine numbers, Ramamoorthi and Hanrahan 2001), and grooves by what depth and blood leave. This
comes after the refinement network, which has never seen furrows, and before a scene's light. Needs numpy; numba makes it
faster.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..light.mesh_light import FAR, NEAR
from ..light.shadows import compiled_kernels
from ..light.skin_relief import texel_ways
from ..light.surroundings import basis
from ..pictures.color import MIN_ALPHA
from .families import LINE_DEPTH
from .shade import BRIGHTEST, DARKEST, DEPTHS, GROOVE, LEVELS, TILT

_GAMMA = 2.2  # of display values, nearly
_NEAREST = 1e-3  # metres: faces that reach nearer to the camera are left out
_ROWS = 96  # of a picture that a task takes at least


class Furrows(NamedTuple):
    """Furrows on a posed mesh, in the light that they are seen in.

    Attributes:
        levels: Heights on a part of the UV map, metres, of all sizes, the largest first, flat, float32.
        size: Rows and columns of the largest.
        faces: That may have furrows, [T, 3] int32.
        places: Of their corners on the part, column and row in pixels of the largest, [T, 3, 2] float32.
        vertices: [V, 3] float32 metres.
        normals: Outward unit normals there, [V, 3] float32.
        light: Irradiance as harmonics of the normal (`light.rough.harmonics_of`), [9, 3] float32.
    """

    levels: np.ndarray
    size: tuple[int, int]
    faces: np.ndarray
    places: np.ndarray
    vertices: np.ndarray
    normals: np.ndarray
    light: np.ndarray

    def draw(self, picture: np.ndarray, depth: np.ndarray, alpha: np.ndarray, skin: np.ndarray | None, camera: Camera) -> None:
        """Draw them into a picture.

        Args:
            picture: Display sRGB, premultiplied, contiguous float32, [H, W, 3]; changed.
            depth: Metres, [H, W].
            alpha: [H, W].
            skin: How much of the cover is skin, [H, W]; None: all.
            camera: In the axes of the vertices; what it scales them by, the depths are scaled by.
        """
        camera, size = camera.unscaled()
        depth = depth if size == 1.0 else depth / size
        local, pixels = camera.project(self.vertices)
        ahead = (local[:, 2] > _NEAREST)[self.faces].all(1)
        faces, places = self.faces[ahead], self.places[ahead]
        linear = local[:, 2] if camera.orthographic else 1.0 / np.maximum(local[:, 2], _NEAREST)
        seen = np.concatenate([pixels, linear[:, None]], 1).astype(np.float32)
        share = np.ones_like(alpha) if skin is None else skin / np.maximum(alpha, MIN_ALPHA)
        mesh = seen, faces, places, self.vertices, self.normals, camera.orthographic
        relief = self.levels, self.size, self.light
        if compiled_kernels() is None:
            draw(picture, depth, share, *mesh, *relief)
            return
        from ..compute.threads import for_rows
        from .furrow_kernels import draw as compiled_draw

        depth, share = (np.ascontiguousarray(array, np.float32) for array in (depth, share))
        for_rows(compiled_draw, len(depth), picture, depth, share, *mesh, *relief, smallest=_ROWS)


def sizes_of(heights: np.ndarray) -> np.ndarray:
    """Heights [H, W] of all `LEVELS`, the largest first, flat float32; sides are multiples of 2 ** (LEVELS - 1)."""
    levels = [heights]
    for _ in range(LEVELS - 1):
        large = levels[-1]
        levels.append(0.25 * (large[::2, ::2] + large[1::2, ::2] + large[::2, 1::2] + large[1::2, 1::2]))
    return np.concatenate([level.ravel() for level in levels]).astype(np.float32)


def draw(
    picture: np.ndarray, depth: np.ndarray, share: np.ndarray, seen: np.ndarray, faces: np.ndarray, places: np.ndarray,
    vertices: np.ndarray, normals: np.ndarray, flat: bool, levels: np.ndarray, size: tuple[int, int], light: np.ndarray,
) -> None:  # fmt: skip
    """Draw furrows into a picture: the readable twin of `furrow_kernels.draw`.

    Args:
        picture: Changed, [H, W, 3].
        depth: [H, W] metres.
        share: Of skin in the cover, [H, W].
        seen: Column, row and what is linear on the picture (one over the depth; the depth itself if flat) of vertices, [V, 3].
        faces: As of `Furrows`.
        places: Likewise.
        vertices: Likewise.
        normals: Likewise.
        flat: Whether the camera is orthographic.
        levels: As of `Furrows`.
        size: Likewise.
        light: Likewise.
    """
    height, width = depth.shape
    for t, face in enumerate(faces):
        corners = seen[face].astype(np.float64)
        (ax, ay), (bx, by), (cx, cy) = corners[:, :2]
        area = (bx - ax) * (cy - ay) - (cx - ax) * (by - ay)
        low, high = np.ceil(corners[:, :2].min(0) - 0.5), np.floor(corners[:, :2].max(0) - 0.5)
        left, top = np.maximum(low, 0).astype(int)
        right, bottom = np.minimum(high, [width - 1, height - 1]).astype(int)
        if area >= 0.0 or left > right or top > bottom:
            continue
        row, column = (grid.ravel() for grid in np.mgrid[top : bottom + 1, left : right + 1])
        dx, dy = column + 0.5 - ax, row + 0.5 - ay
        slopes = np.array([[cy - ay, ax - cx], [ay - by, bx - ax]]) / area  # of the second and third corner's weights
        u, v = slopes[0, 0] * dx + slopes[0, 1] * dy, slopes[1, 0] * dx + slopes[1, 1] * dy
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
        row, column, u, v = row[inside], column[inside], u[inside], v[inside]
        weights = np.stack([1.0 - u - v, u, v], -1)
        value = weights @ corners[:, 2]
        deep = value if flat else 1.0 / value
        if not flat:
            weights = weights * corners[:, 2] * deep[:, None]
        amount = np.clip((FAR - np.abs(depth[row, column] - deep)) / (FAR - NEAR), 0.0, 1.0) * share[row, column]
        edges = places[t, 1:].astype(np.float64) - places[t, 0]
        step = np.sqrt(((edges.T @ slopes) ** 2).sum(0)).max()  # pixels of the relief that a pixel of the picture covers
        slope, here = _relief(levels, size, weights @ places[t], step)
        ways = texel_ways(vertices[face][None], places[t][None])[0].astype(np.float64)  # [2, 3]
        tilt = np.linalg.solve(ways @ ways.T, slope.T).T @ ways
        smooth = _unit(weights @ normals[face])
        before, after = (basis(n) @ light for n in (smooth, _unit(smooth - TILT * tilt)))
        least = 0.05 * light[0].max() * 0.282095
        ratio = np.maximum(after, least) / np.maximum(before, least)
        ratio *= 1.0 + np.clip(here / LINE_DEPTH, *DEPTHS)[:, None] * np.array(GROOVE)
        factor = 1.0 + (np.clip(ratio, DARKEST, BRIGHTEST) - 1.0) * amount[:, None]
        picture[row, column] *= factor ** (1.0 / _GAMMA)


def _relief(levels: np.ndarray, size: tuple[int, int], place: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Slopes along columns and rows, metres a pixel of the largest size, [n, 2], and heights [n], as wide as a step."""
    level = min(max(np.log2(max(step, 1e-6)), 0.0), LEVELS - 1.0)
    low = min(int(level), LEVELS - 2)
    total = np.zeros((len(place), 3))
    for number, weight in ((low, low + 1 - level), (low + 1, level - low)):
        wide = 1 << number
        rows, columns = size[0] >> number, size[1] >> number
        first = sum((size[0] >> k) * (size[1] >> k) for k in range(number))
        image = levels[first : first + rows * columns].reshape(rows, columns)
        x, y = (place[:, 0] + 0.5) / wide - 0.5, (place[:, 1] + 0.5) / wide - 0.5
        j, i = np.floor(x).astype(int).clip(1, columns - 3), np.floor(y).astype(int).clip(1, rows - 3)
        p, q = (x - j).clip(0.0, 1.0), (y - i).clip(0.0, 1.0)

        def at(a: int, b: int, image: np.ndarray = image, i: np.ndarray = i, j: np.ndarray = j) -> np.ndarray:
            found: np.ndarray = image[i + a, j + b]
            return found

        def mixed(a: int, b: int, p: np.ndarray = p, q: np.ndarray = q) -> np.ndarray:
            return (1 - q) * ((1 - p) * at(a, b) + p * at(a, b + 1)) + q * ((1 - p) * at(a + 1, b) + p * at(a + 1, b + 1))

        across, down = (mixed(0, 1) - mixed(0, -1)) / (2 * wide), (mixed(1, 0) - mixed(-1, 0)) / (2 * wide)
        total += weight * np.stack([across, down, mixed(0, 0)], -1)
    return total[:, :2], total[:, 2]


def _unit(vectors: np.ndarray) -> np.ndarray:
    found: np.ndarray = vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-12)
    return found
