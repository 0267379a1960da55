"""Depth of triangle meshes as a camera sees them; numpy is enough, numba makes it faster.

The render engine uses it for scene objects that stand in front of avatars: Gaussians are drawn by the splat rasteriser,
meshes only hide them. Exact per sample, no color. Triangles are turned into pixel spans first, so that the work is
proportional to the covered samples and not to bounding boxes, and so that no loop of Python runs over triangles.
Everything per triangle is done here; the samples are filled by `zbuffer_numpy`, or by its compiled twin `zbuffer_kernel` where
numba can be imported (stock Blender has only numpy). Both do the same arithmetic in the same order.
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Callable

import numpy as np

from ..errors import ShapeError
from .camera import Camera
from .zbuffer_numpy import EMPTY, FIRST, LAST, SPAN_SLACK
from .zbuffer_numpy import draw as plain_draw

Window = tuple[int, int, int, int]
"""Left, top, right and bottom edge of a part of a picture, pixels."""


def triangle_depth(
    triangles: np.ndarray,
    camera: Camera,
    samples: int = 1,
    near: float = 1e-4,
    far: float = float(EMPTY),
    window: Window | None = None,
) -> np.ndarray:
    """Return the camera z of the nearest triangle at every sample.

    Args:
        triangles: World positions of the corners, [T, 3, 3], metres. Both sides count.
        camera: World to pixels.
        samples: Samples per pixel and direction, in a regular grid.
        near: Nearer parts are cut off, metres.
        far: Farther samples are ignored, metres.
        window: Part of the picture that is returned, None for all of it. A part has the very values that the whole has.

    Returns:
        [H * samples, W * samples] float32 of the window, metres; `EMPTY` where nothing is. Top row first.

    Raises:
        ShapeError: `triangles` is not [T, 3, 3].
    """
    corners = np.asarray(triangles, np.float64)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3):
        raise ShapeError(f"Triangles have shape {corners.shape}; it must be (T, 3, 3).")
    left, top, right, bottom = (edge * samples for edge in window or (0, 0, camera.width, camera.height))
    depth = np.full((bottom - top, right - left), EMPTY, np.float32)
    x, y, linear = _project(corners, camera, samples, near, far)
    draw = _compiled_draw() or plain_draw
    draw(depth, left, top, *_edges_and_planes(x, y, linear, (left, top, right, bottom)), camera.orthographic, float(far))
    return depth


def mean_of_samples(flags: Callable[[int, int], np.ndarray], samples: int) -> np.ndarray:
    """Return the mean over the samples of each pixel, [H, W] float32.

    Args:
        flags: Returns the boolean values [H, W] of the sample in a row and a column of the pixel's grid; numpy adds up such
            planes much faster than it takes the mean over two short axes.
        samples: Samples per pixel and direction.
    """
    planes = (flags(row, column).astype(np.float32) for row, column in itertools.product(range(samples), repeat=2))
    return functools.reduce(np.add, planes) / np.float32(samples * samples)


@functools.lru_cache(maxsize=1)
def _compiled_draw() -> Callable[..., None] | None:
    """Return the compiled twin of `plain_draw`, or None without numba."""
    try:
        from .zbuffer_kernel import draw
    except ImportError:  # not installed, or not for this numpy
        return None
    return draw


def _project(
    corners: np.ndarray, camera: Camera, samples: int, near: float, far: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return columns and rows in samples and what is linear on the screen, [3, K] each, of what may be seen of [T, 3, 3]."""
    matrix = camera.world_to_camera
    # Triangles come last from here on: numpy is fast along long axes only.
    flat = np.ascontiguousarray(corners.transpose(2, 1, 0)).reshape(3, -1)
    local = (matrix[:3, :3] @ flat + matrix[:3, 3:4]).reshape(3, 3, len(corners))  # [axis, corner, T]
    seen = np.isfinite(local).all(axis=(0, 1)) & (local[2].max(axis=0) >= near) & (local[2].min(axis=0) <= far)
    local = _clip_near(local if seen.all() else local[:, :, seen], near)
    z = local[2]
    scale = np.ones_like(z) if camera.orthographic else 1.0 / z
    x = (camera.fx * local[0] * scale + camera.cx) * samples
    y = (camera.fy * local[1] * scale + camera.cy) * samples
    # What is linear on the screen: z itself, or its reciprocal under perspective.
    return x, y, z if camera.orthographic else scale


def _clip_near(triangles: np.ndarray, near: float) -> np.ndarray:
    """Cut triangles [axis, corner, T] in camera axes at z = near; those that cross it become one or two."""
    inside = triangles[2] >= near  # [3, T]
    if inside.all():
        return triangles
    count = inside.sum(axis=0)
    parts = [triangles[:, :, count == 3]]
    for wanted in (1, 2):
        chosen = count == wanted
        crossing, flags = triangles[:, :, chosen], inside[:, chosen]
        # Turn each triangle so that its odd corner comes first.
        odd = np.argmax(flags if wanted == 1 else ~flags, axis=0)
        order = (odd + np.arange(3)[:, None]) % 3
        a, b, c = np.take_along_axis(crossing, order[None], axis=1).swapaxes(0, 1)  # [axis, T] each
        ab, ac = _cut(a, b, near), _cut(a, c, near)
        if wanted == 1:
            parts.append(np.stack([a, ab, ac], axis=1))
        else:
            parts += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(parts, axis=2)


def _cut(a: np.ndarray, b: np.ndarray, near: float) -> np.ndarray:
    """Points where the segments a-b, [axis, T] each, meet z = near."""
    return a + (near - a[2]) / (b[2] - a[2]) * (b - a)


def _edges_and_planes(
    x: np.ndarray, y: np.ndarray, linear: np.ndarray, edges: Window
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return what `draw` needs of the triangles that may cover a sample.

    Args:
        x: Columns of the corners in samples, [3, T].
        y: Rows of the corners in samples, [3, T].
        linear: Value per corner that is linear on the screen, [3, T].
        edges: Those of what is drawn, samples.

    Returns:
        First and last row, [2, K] int64; columns and rows of the corners from the top down, [3, K] each; columns per row
        along the edges top-bottom, top-middle and middle-bottom, [3, K]; the value as a plane, [3, K]: at a sample it is
        plane[VALUE] + plane[PER_COLUMN] * column + plane[PER_ROW] * row (names of `zbuffer_numpy`).
    """
    left, top, right, bottom = edges
    area = (x[1] - x[0]) * (y[2] - y[0]) - (x[2] - x[0]) * (y[1] - y[0])
    rows = np.stack([
        np.ceil(np.clip(y.min(axis=0), top - 1.0, bottom + 1.0) - 0.5).clip(top, bottom),
        np.floor(np.clip(y.max(axis=0), top - 1.0, bottom + 1.0) - 0.5).clip(top - 1, bottom - 1),
    ])  # fmt: skip
    x_min, x_max = x.min(axis=0), x.max(axis=0)
    # Most triangles of a dense mesh lie between samples and draw nothing.
    between = np.floor(x_max - 0.5 + SPAN_SLACK) < np.ceil(x_min - 0.5 - SPAN_SLACK)
    keep = (area != 0) & np.isfinite(area) & (x_max > left) & (x_min < right) & (rows[LAST] >= rows[FIRST]) & ~between
    order = np.argsort(y[:, keep], axis=0)
    x, y, linear = (np.take_along_axis(array[:, keep], order, axis=0) for array in (x, y, linear))
    # Sorting the corners may turn the triangle over, and with it the sign of the area.
    x01, x12, x02, y01, y12, y02 = x[1] - x[0], x[2] - x[1], x[2] - x[0], y[1] - y[0], y[2] - y[1], y[2] - y[0]
    area = x01 * y02 - x02 * y01
    u, v = linear[1] - linear[0], linear[2] - linear[0]
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):
        # A flat edge needs no slope: the two other edges end in its corners.
        slopes = np.stack([x02 / y02, np.where(y01 > 0, x01 / y01, 0.0), np.where(y12 > 0, x12 / y12, 0.0)])
        dx, dy = (u * y02 - v * y01) / area, (v * x01 - u * x02) / area
    plane = np.stack([linear[0] + dx * (0.5 - x[0]) + dy * (0.5 - y[0]), dx, dy])
    return rows[:, keep].astype(np.int64), x, y, slopes, plane
