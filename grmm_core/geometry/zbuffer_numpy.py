"""Filling the samples of a depth picture with numpy alone; its compiled twin is `zbuffer_kernel`. Only `zbuffer` calls it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

EMPTY = np.float32(1.0e10)
"""Depth where nothing is; Blender's value for an empty Z pass."""
SPAN_SLACK = 1e-6
"""Samples; a shared edge must not leave a gap between two triangles."""
# Rows of what describes triangles: first and last row of samples; corners from the top down; columns per row along the edges
# top-bottom, top-middle and middle-bottom; value at the first sample, its change per column and per row.
FIRST, LAST = range(2)
TOP, MIDDLE, BOTTOM = range(3)
LONG, UPPER, LOWER = range(3)
VALUE, PER_COLUMN, PER_ROW = range(3)
_CHUNK = 1 << 18  # rows or samples handled at once: their arrays stay in the processor's cache


def draw(
    depth: np.ndarray, left: int, top: int,
    rows: np.ndarray, x: np.ndarray, y: np.ndarray, slopes: np.ndarray, plane: np.ndarray, orthographic: bool, far: float,
) -> None:  # fmt: skip
    """Write the nearer values into `depth` [H, W], whose corner is at (left, top); the rest is `zbuffer._edges_and_planes`."""
    width = depth.shape[1]
    right = left + width
    target = depth.reshape(-1)
    for which, step in _runs(rows[LAST] - rows[FIRST] + 1):
        row = rows[FIRST][which] + step
        center = row + 0.5
        # The row meets the triangle in one span: from the long edge to one of the two others.
        to_middle = center - y[MIDDLE][which]
        one = x[TOP][which] + (center - y[TOP][which]) * slopes[LONG][which]
        two = x[MIDDLE][which] + to_middle * np.where(to_middle < 0, slopes[UPPER][which], slopes[LOWER][which])
        low, high = np.minimum(one, two), np.maximum(one, two)
        first = np.ceil(np.clip(low, left - 1.0, right + 1.0) - 0.5 - SPAN_SLACK).clip(left, right).astype(np.int64)
        last = np.floor(np.clip(high, left - 1.0, right + 1.0) - 0.5 + SPAN_SLACK).clip(left - 1, right - 1).astype(np.int64)
        full = last >= first
        which, row, first, last = which[full], row[full], first[full], last[full]
        start, slope = plane[VALUE][which] + plane[PER_ROW][which] * row, plane[PER_COLUMN][which]
        for span, step in _runs(last - first + 1):
            column = first[span] + step
            value = start[span] + slope[span] * column
            z = value if orthographic else 1.0 / np.maximum(value, 1.0 / float(EMPTY))
            z[~(z <= far)] = EMPTY
            np.minimum.at(target, (row[span] - top) * width + (column - left), z.astype(np.float32))


def _runs(counts: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield, about `_CHUNK` at a time, the index i of every element of every run and its place 0..counts[i]-1 in the run."""
    ends = np.cumsum(counts)
    starts = ends - counts
    begin = 0
    while begin < len(counts):
        done = ends[begin - 1] if begin else 0
        end = max(begin + 1, int(np.searchsorted(ends, done + _CHUNK, side="right")))
        which = np.repeat(np.arange(begin, end), counts[begin:end])
        yield which, np.arange(done, done + len(which)) - starts[which]
        begin = end
