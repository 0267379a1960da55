"""From frames to keys: as few as a stated error allows.

`reduce_curves` gives each curve keys whose interpolation passes every recorded frame within the error. Two kinds:

* linear: a key starts a segment, and the longest segment is taken that still passes all frames (a cone of admissible slopes);
* bezier: handles at a third of the segment, so that the curve is a cubic in time as Blender evaluates it; the handles' heights
  are fitted to the frames by least squares, and the longest segment within the error is taken.

Called by the importer, which turns `ReducedCurve` into F-curves. All curves advance together, so that Python's overhead is paid
once a step and not once a curve. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ..errors import ShapeError
from ..jobs.progress import Share

Interpolation = Literal["linear", "bezier"]

DEFAULT_ERROR = 0.01  # of an ARKit weight
DEFAULT_ANGLE_ERROR = 0.005  # radians, about 0.3 degrees
DEFAULT_DISTANCE_ERROR = 0.0005  # metres
_MAX_SEGMENT = 96  # frames; longer Bezier segments gain nothing on recorded faces
_SAFETY = 0.999  # part of the allowed error that is used, so that single precision does not exceed it
_RIDGE = 1e-6
_BLOCK = 1024  # frames of a curve that are reduced at the same time as its other blocks


@dataclass
class ReducedCurve:
    """Keys of one curve.

    Attributes:
        times: Seconds of the keys, [K].
        values: Values at the keys, [K].
        left, right: Time and value of the handles before and after each key, [K, 2].
        interpolation: "linear" or "bezier".
    """

    times: np.ndarray
    values: np.ndarray
    left: np.ndarray
    right: np.ndarray
    interpolation: Interpolation

    def evaluate(self, times: np.ndarray) -> np.ndarray:
        """Values at `times` [...], constant beyond the ends."""
        times = np.asarray(times, np.float64)
        if self.times.size == 1:
            return np.full(times.shape, self.values[0])
        if self.interpolation == "linear":
            return np.interp(times, self.times, self.values)
        segment = np.clip(np.searchsorted(self.times, times, side="right") - 1, 0, self.times.size - 2)
        span = self.times[segment + 1] - self.times[segment]
        u = np.clip((times - self.times[segment]) / span, 0.0, 1.0)
        v = 1.0 - u
        points = (self.values[segment], self.right[segment, 1], self.left[segment + 1, 1], self.values[segment + 1])
        return v**3 * points[0] + 3 * v * v * u * points[1] + 3 * v * u * u * points[2] + u**3 * points[3]


def reduce_curves(
    times: np.ndarray,
    values: np.ndarray,
    max_error: float | np.ndarray,
    interpolation: Interpolation = "bezier",
    progress: Share | None = None,
) -> list[ReducedCurve]:
    """Reduce curves that share their frames.

    Args:
        times: Seconds, increasing, [T].
        values: [T, N].
        max_error: Largest deviation at any frame, one number or [N], positive.
        interpolation: Kind of keys.
        progress: Called with the fraction done.

    Returns:
        N curves. A curve that stays within the error of one value has one key.

    Raises:
        ShapeError: Shapes that do not fit, or an error that is not positive.
    """
    times, values = np.asarray(times, np.float64), np.asarray(values, np.float64)
    errors = np.broadcast_to(np.asarray(max_error, np.float64), (values.shape[-1],)) * _SAFETY
    if values.ndim != 2 or times.shape != values.shape[:1] or not (errors > 0).all():
        raise ShapeError(
            f"Key reduction needs times [T], values [T, N] and a positive error; got {times.shape} and {values.shape}."
        )
    if times.size == 0 or not np.isfinite(values).all() or (np.diff(times) <= 0).any():
        raise ShapeError("Key reduction needs finite values at increasing times.")
    low, high = values.min(0), values.max(0)
    moving = np.flatnonzero(high - low > 2.0 * errors)
    keys = _bezier_segments if interpolation == "bezier" else _linear_segments
    segments = keys(times, values[:, moving], errors[moving], progress) if moving.size else []
    result: list[ReducedCurve] = []
    position = {int(column): k for k, column in enumerate(moving)}
    for column in range(values.shape[1]):
        if column in position:
            rows, slopes = segments[position[column]]
            result.append(_assemble(times, values[:, column], rows, slopes, interpolation))
        else:
            middle = np.array([(low[column] + high[column]) / 2])
            point = np.stack([times[:1], middle], 1)
            result.append(ReducedCurve(times[:1].copy(), middle, point, point.copy(), interpolation))
    if progress:
        progress(1.0)
    return result


_Segments = list[tuple[np.ndarray, np.ndarray]]  # key frames [K] and slopes at both ends of each segment [K - 1, 2]


def _linear_segments(times: np.ndarray, values: np.ndarray, errors: np.ndarray, progress: Share | None) -> _Segments:
    """Longest straight segments, all curves at once: a segment to a frame is good if it lies in the cone of those between."""
    count, curves = values.shape
    start = np.zeros(curves, np.int64)
    low, high = np.full(curves, -np.inf), np.full(curves, np.inf)
    columns = np.arange(curves)
    is_key = np.zeros((count, curves), bool)
    is_key[[0, -1]] = True
    for row in range(1, count):
        # The frame before is a candidate end already checked; does the segment still hold when it ends here?
        span = times[row] - times[start]
        rise = values[row] - values[start, columns]
        slope = rise / span
        broken = (slope < low) | (slope > high)
        if broken.any():
            start = np.where(broken, row - 1, start)
            is_key[row - 1] |= broken
            span = np.where(broken, times[row] - times[row - 1], span)
            rise = np.where(broken, values[row] - values[row - 1], rise)
            low, high = np.where(broken, -np.inf, low), np.where(broken, np.inf, high)
        low = np.maximum(low, (rise - errors) / span)
        high = np.minimum(high, (rise + errors) / span)
        if progress and row % 4096 == 0:
            progress(row / count)
    return [(np.flatnonzero(is_key[:, k]), np.zeros((0, 2))) for k in range(curves)]


def _bezier_segments(times: np.ndarray, values: np.ndarray, errors: np.ndarray, progress: Share | None) -> _Segments:
    """Longest cubic segments: doubling, then halving, of the length.

    All curves advance side by side, and each in several blocks at once, which costs one key a block.
    """
    count, curves = values.shape
    bounds = np.unique(np.append(np.arange(0, count - 1, _BLOCK), count - 1))
    blocks = bounds.size - 1
    padded = np.concatenate([values, np.repeat(values[-1:], _MAX_SEGMENT, 0)])
    padded_times = np.concatenate([times, times[-1] + np.arange(1, _MAX_SEGMENT + 1)])
    curve = np.tile(np.arange(curves), blocks)  # [J] one job a curve and block
    start, last = np.repeat(bounds[:-1], curves), np.repeat(bounds[1:], curves)
    first_frames, found = start.copy(), []
    previous = np.full(curve.size, 2)
    active = np.arange(curve.size)
    total, steps = float((last - start).sum()), 0
    while active.size:
        s, c = start[active], curve[active]
        line = (values[s + 1, c] - values[s, c]) / (times[s + 1] - times[s])
        good, best = np.ones(active.size, np.int64), np.repeat(line[:, None], 2, 1)  # one frame's segment is always exact
        limit = np.minimum(last[active] - s, _MAX_SEGMENT)
        bad = limit + 1
        trial = np.minimum(previous[active], limit)
        growing = np.ones(active.size, bool)
        while (todo := np.flatnonzero(bad - good > 1)).size:
            length = np.clip(trial[todo], good[todo] + 1, bad[todo] - 1)
            passed, fitted = _try_segments(padded_times, padded, errors, s[todo], length, c[todo])
            good[todo[passed]], best[todo[passed]] = length[passed], fitted[passed]
            bad[todo[~passed]] = length[~passed]
            growing[todo[~passed]] = False
            trial = np.where(growing, good * 2, (good + bad) // 2)
        found.append((active, s, s + good, best))
        start[active] = s + good
        previous[active] = good
        active = active[start[active] < last[active]]
        steps += 1
        if progress and steps % 16 == 0:
            progress(1.0 - float((last - start).sum()) / total)
    job = np.concatenate([jobs for jobs, _, _, _ in found])
    ends, slopes = np.concatenate([end for _, _, end, _ in found]), np.concatenate([slope for *_, slope in found])
    order = np.lexsort((ends, curve[job]))  # frames rise from block to block
    split = np.cumsum(np.bincount(curve[job], minlength=curves))[:-1]
    first = first_frames[:1]
    rows = [np.concatenate([first, part]) for part in np.split(ends[order], split)]
    return list(zip(rows, np.split(slopes[order], split), strict=True))


def _try_segments(
    times: np.ndarray, values: np.ndarray, errors: np.ndarray, start: np.ndarray, length: np.ndarray, curve: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Fit the two end slopes of segments by least squares and check every frame.

    Args:
        times: Padded frames, [T + M].
        values: Padded frames, [T + M, N].
        errors: Allowed deviation, [N].
        start: First frame of each segment, [S].
        length: Number of intervals of each segment, [S].
        curve: Curve of each segment, [S].

    Returns:
        Which segments pass, [S], and their slopes at both ends, [S, 2].
    """
    offsets = np.arange(int(length.max()) + 1)
    index = start[:, None] + np.minimum(offsets, length[:, None])  # [S, L]
    inside = (offsets > 0) & (offsets < length[:, None])
    t0, t1 = times[start], times[start + length]
    span = t1 - t0
    u = (times[index] - t0[:, None]) / span[:, None]
    y = values[index, curve[:, None]]
    y0, y1 = y[:, :1], values[start + length, curve][:, None]
    line = y0 + (y1 - y0) * u
    # A Hermite cubic is the line plus the two end slopes' deviations from it times these:
    first, second = u * (1 - u) ** 2 * inside, -u * u * (1 - u) * inside
    rest = (y - line) * inside
    a, b, c = (first * first).sum(1) + _RIDGE, (first * second).sum(1), (second * second).sum(1) + _RIDGE
    p, q = (first * rest).sum(1), (second * rest).sum(1)
    determinant = a * c - b * b
    alpha, beta = (c * p - b * q) / determinant, (a * q - b * p) / determinant
    deviation = np.abs(rest - alpha[:, None] * first - beta[:, None] * second).max(1)
    slope = ((y1 - y0)[:, 0]) / span
    return deviation <= errors[curve], np.stack([slope + alpha / span, slope + beta / span], 1)


def _assemble(
    times: np.ndarray, values: np.ndarray, rows: np.ndarray, slopes: np.ndarray, interpolation: Interpolation
) -> ReducedCurve:
    """Keys and handles; handles lie at a third of each segment, horizontally at the ends of the curve."""
    key_times, key_values = times[rows], values[rows]
    third = np.diff(key_times) / 3.0
    if interpolation == "linear":
        slopes = np.repeat((np.diff(key_values) / np.diff(key_times))[:, None], 2, 1)
    left, right = np.stack([key_times, key_values], 1), np.stack([key_times, key_values], 1)
    right[:-1] += np.stack([third, slopes[:, 0] * third], 1)
    left[1:] -= np.stack([third, slopes[:, 1] * third], 1)
    return ReducedCurve(key_times, key_values, left, right, interpolation)
