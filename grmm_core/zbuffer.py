"""Depth of triangle meshes as a camera sees them, with numpy alone.

The render engine uses it for scene objects that stand in front of avatars: Gaussians are drawn by the splat rasteriser,
meshes only hide them. Exact per sample, no colour. Triangles are turned into pixel spans first, so that the work is
proportional to the covered samples and not to bounding boxes, and so that no loop runs over triangles.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator

import numpy as np

from .camera import Camera
from .errors import ShapeError

EMPTY = np.float32(1.0e10)
"""Depth where nothing is; Blender's value for an empty Z pass."""
_CHUNK = 1 << 21  # samples handled at once: bounds memory to some tens of megabytes
_SPAN_SLACK = 1e-6  # samples; a shared edge must not leave a gap between two triangles


def triangle_depth(
    triangles: np.ndarray,
    camera: Camera,
    samples: int = 1,
    near: float = 1e-4,
    far: float = float(EMPTY),
) -> np.ndarray:
    """Return the camera z of the nearest triangle at every sample.

    Args:
        triangles: World positions of the corners, [T, 3, 3], metres. Both sides count.
        camera: World to pixels.
        samples: Samples per pixel and direction, in a regular grid.
        near: Nearer parts are cut off, metres.
        far: Farther samples are ignored, metres.

    Returns:
        [H * samples, W * samples] float32, metres; `EMPTY` where nothing is. Top row first.

    Raises:
        ShapeError: `triangles` is not [T, 3, 3].
    """
    corners = np.asarray(triangles, np.float64)
    if corners.ndim != 3 or corners.shape[1:] != (3, 3):
        raise ShapeError(f"Triangles have shape {corners.shape}; it must be (T, 3, 3).")
    height, width = camera.height * samples, camera.width * samples
    depth = np.full(height * width, EMPTY, np.float32)
    matrix = camera.world_to_camera
    local = (corners.reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]).reshape(-1, 3, 3)  # flat: one product, not T small ones
    local = local[np.isfinite(local).all(axis=(1, 2))]
    local = _clip_near(local, near)
    local = local[local[:, :, 2].min(axis=1) <= far]
    z = local[:, :, 2]  # [T, 3]
    divisor = np.ones_like(z) if camera.orthographic else z
    x = (camera.fx * local[:, :, 0] / divisor + camera.cx) * samples
    y = (camera.fy * local[:, :, 1] / divisor + camera.cy) * samples
    # What is linear on the screen: z itself, or its reciprocal under perspective.
    linear = z if camera.orthographic else 1.0 / z
    for row, first, count, plane in _spans(x, y, linear, width, height):
        _draw(depth, row, first, count, plane, width, camera.orthographic, far)
    return depth.reshape(height, width)


def visible_fraction(depth: np.ndarray, occluders: np.ndarray, samples: int) -> np.ndarray:
    """Return which part of each pixel no occluder covers.

    Args:
        depth: Camera z of what may be hidden, [H, W].
        occluders: Result of `triangle_depth`, [H * samples, W * samples].
        samples: As given there.

    Returns:
        0..1, [H, W] float32.
    """
    height, width = depth.shape
    grid = occluders.reshape(height, samples, width, samples)
    return mean_of_samples(lambda row, column: grid[:, row, :, column] > depth, samples)


def mean_of_samples(flags: Callable[[int, int], np.ndarray], samples: int) -> np.ndarray:
    """Return the mean over the samples of each pixel, [H, W] float32.

    Args:
        flags: Returns the boolean values [H, W] of the sample in a row and a column of the pixel's grid; numpy adds up such
            planes much faster than it takes the mean over two short axes.
        samples: Samples per pixel and direction.
    """
    total = sum(flags(row, column).astype(np.float32) for row in range(samples) for column in range(samples))
    return total / np.float32(samples * samples)


def _clip_near(triangles: np.ndarray, near: float) -> np.ndarray:
    """Cut triangles [T, 3, 3] in camera axes at z = near; those that cross it become one or two."""
    inside = triangles[:, :, 2] >= near  # [T, 3]
    count = inside.sum(axis=1)
    parts = [triangles[count == 3]]
    for wanted in (1, 2):
        chosen = count == wanted
        if not chosen.any():
            continue
        crossing, flags = triangles[chosen], inside[chosen]
        # Turn each triangle so that its odd corner comes first.
        odd = np.argmax(flags if wanted == 1 else ~flags, axis=1)
        order = (odd[:, None] + np.arange(3)) % 3
        a, b, c = np.moveaxis(np.take_along_axis(crossing, order[:, :, None], axis=1), 1, 0)
        ab, ac = _cut(a, b, near), _cut(a, c, near)
        if wanted == 1:
            parts.append(np.stack([a, ab, ac], axis=1))
        else:
            parts += [np.stack([ab, b, c], axis=1), np.stack([ab, c, ac], axis=1)]
    return np.concatenate(parts)


def _cut(a: np.ndarray, b: np.ndarray, near: float) -> np.ndarray:
    """Points where the segments a-b, [T, 3] each, meet z = near."""
    t = (near - a[:, 2]) / (b[:, 2] - a[:, 2])
    return a + t[:, None] * (b - a)


def _spans(
    x: np.ndarray, y: np.ndarray, linear: np.ndarray, width: int, height: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield the rows that triangles cover.

    Args:
        x: Columns of the corners in samples, [T, 3].
        y: Rows of the corners in samples, [T, 3].
        linear: Value per corner that is linear on the screen, [T, 3].
        width: Columns of samples.
        height: Rows of samples.

    Yields:
        Row index, first column and number of columns, [S] each, and the value as a plane: at column i of a span it is
        plane[:, 0] + plane[:, 1] * (first + i), [S, 2].
    """
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    top = np.ceil(np.clip(y.min(axis=1), -1.0, height + 1.0) - 0.5).clip(0, height).astype(np.int64)
    bottom = np.floor(np.clip(y.max(axis=1), -1.0, height + 1.0) - 0.5).clip(-1, height - 1).astype(np.int64)
    x_min, x_max = x.min(axis=1), x.max(axis=1)
    # Most triangles of a dense mesh lie between samples and draw nothing.
    between = np.floor(x_max - 0.5 + _SPAN_SLACK) < np.ceil(x_min - 0.5 - _SPAN_SLACK)
    keep = (area != 0) & (x_max > 0) & (x_min < width) & (bottom >= top) & ~between
    x, y, linear, area, top, bottom = (array[keep] for array in (x, y, linear, area, top, bottom))
    if not len(area):
        return
    # The plane through the three corners: value = base + dx * column + dy * row, at sample centres.
    u, v = linear[:, 1] - linear[:, 0], linear[:, 2] - linear[:, 0]
    dx = (u * (y[:, 2] - y[:, 0]) - v * (y[:, 1] - y[:, 0])) / area
    dy = (v * (x[:, 1] - x[:, 0]) - u * (x[:, 2] - x[:, 0])) / area
    base = linear[:, 0] + dx * (0.5 - x[:, 0]) + dy * (0.5 - y[:, 0])
    rows = bottom - top + 1
    for chunk in _chunks(rows):
        which = np.repeat(chunk, rows[chunk])  # [R]
        row = top[which] + _ramp(rows[chunk])
        low = np.full(len(which), -np.inf)
        high = np.full(len(which), np.inf)
        for start, end in ((0, 1), (1, 2), (2, 0)):
            x0, y0, x1, y1 = x[which, start], y[which, start], x[which, end], y[which, end]
            crosses = (np.minimum(y0, y1) <= row + 0.5) & (np.maximum(y0, y1) >= row + 0.5)
            slope = np.where(y1 == y0, 0.0, (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0))
            at = x0 + (row + 0.5 - y0) * slope
            flat = crosses & (y1 == y0)
            left = np.where(flat, np.minimum(x0, x1), at)
            right = np.where(flat, np.maximum(x0, x1), at)
            # The row meets a convex shape in one span between its outermost crossings.
            low = np.where(crosses & (np.isinf(low) | (left < low)), left, low)
            high = np.where(crosses & (np.isinf(high) | (right > high)), right, high)
        first = np.ceil(np.clip(low, -1.0, width + 1.0) - 0.5 - _SPAN_SLACK).clip(0, width).astype(np.int64)
        last = np.floor(np.clip(high, -1.0, width + 1.0) - 0.5 + _SPAN_SLACK).clip(-1, width - 1).astype(np.int64)
        full = np.isfinite(low) & np.isfinite(high) & (last >= first)
        which, row, first, last = which[full], row[full], first[full], last[full]
        plane = np.stack([base[which] + dy[which] * row, dx[which]], axis=1)
        yield row, first, last - first + 1, plane


def _draw(
    depth: np.ndarray, row: np.ndarray, first: np.ndarray, count: np.ndarray, plane: np.ndarray,
    width: int, orthographic: bool, far: float,
) -> None:  # fmt: skip
    """Write the nearer value into `depth` [H * W] for the spans of `_spans`."""
    for chunk in _chunks(count):
        lengths = count[chunk]
        column = np.repeat(first[chunk], lengths) + _ramp(lengths)
        value = np.repeat(plane[chunk, 0], lengths) + np.repeat(plane[chunk, 1], lengths) * column
        z = value if orthographic else 1.0 / np.maximum(value, 1.0 / float(EMPTY))
        index = np.repeat(row[chunk] * width, lengths) + column
        near_enough = z <= far
        np.minimum.at(depth, index[near_enough], z[near_enough].astype(np.float32))


def _chunks(counts: np.ndarray) -> Iterator[np.ndarray]:
    """Split indices 0..N into runs whose counts add up to about `_CHUNK` (at least one index each)."""
    total = np.cumsum(counts)
    start = 0
    while start < len(counts):
        done = total[start - 1] if start else 0
        end = max(start + 1, int(np.searchsorted(total, done + _CHUNK, side="right")))
        yield np.arange(start, end)
        start = end


def _ramp(counts: np.ndarray) -> np.ndarray:
    """Return 0..counts[0]-1, 0..counts[1]-1 ... in one row."""
    ends = np.cumsum(counts)
    return np.arange(int(ends[-1]) if len(ends) else 0) - np.repeat(ends - counts, counts)
