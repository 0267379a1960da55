"""Time: another frame rate, a shift, a cut.

Called by the importer after reading, before smoothing. Going to a lower rate by plain interpolation would step over the one
frame in which lids touch or lips close; peaks that fall between the new frames are therefore moved to the nearest one. Needs
numpy only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import ShapeError
from ..geometry.rotations import unwrap_euler
from .types import Performance

_PROMINENCE = 0.04  # weight; a bump lower than this is noise and need not survive a lower frame rate
_MAX_RATE = 1000.0
_MAX_FRAMES = 4_000_000


def resample(performance: Performance, fps: float, keep_peaks: bool = True) -> Performance:
    """Convert to a constant frame rate by linear interpolation.

    Args:
        performance: Any time line, also with gaps.
        fps: Frames per second of the result, 1..1000.
        keep_peaks: Going to a lower rate, let the frame nearest to each peak of an ARKit weight take the peak's value.

    Returns:
        A copy with frames at k / fps.

    Raises:
        ShapeError: An impossible rate.
    """
    if not 1.0 <= fps <= _MAX_RATE or performance.duration * fps > _MAX_FRAMES:
        raise ShapeError(f"The frame rate must be 1 to {_MAX_RATE:g} and give at most {_MAX_FRAMES} frames; got {fps:g}.")
    old = performance.times - performance.times[0]
    count = int(np.floor(old[-1] * fps + 1e-6)) + 1
    times = np.arange(count) / fps
    changes: dict[str, Any] = {}
    for name in performance.channel_names():
        values = np.asarray(getattr(performance, name), np.float64)
        values = unwrap_euler(values) if name in performance.rotation_names() else values
        resampled = np.stack([np.interp(times, old, column) for column in values.T], 1)
        if keep_peaks and name == "weights" and old.size > 2 and fps < 0.99 / float(np.median(np.diff(old))):
            _restore_peaks(old, values, fps, resampled)
        changes[name] = resampled.astype(getattr(performance, name).dtype)
    return replace(performance, times=times, fps=float(fps), timecodes=None, warnings=list(performance.warnings), **changes)


def _restore_peaks(old: np.ndarray, values: np.ndarray, fps: float, resampled: np.ndarray) -> None:
    """Move extremes that fell between two new frames to the nearer one, in place, [T', N]."""
    nearest = np.clip(np.rint(old * fps).astype(np.int64), 0, resampled.shape[0] - 1)
    inner = values[1:-1]
    for column in range(values.shape[1]):
        before, here, after = values[:-2, column], inner[:, column], values[2:, column]
        for sign in (1.0, -1.0):
            rows = 1 + np.flatnonzero((sign * here >= sign * before) & (sign * here > sign * after))
            short = sign * (values[rows, column] - resampled[nearest[rows], column])
            rows = rows[short > _PROMINENCE]
            # Of several peaks near one frame the highest is written last.
            rows = rows[np.argsort(sign * values[rows, column], kind="stable")]
            resampled[nearest[rows], column] = values[rows, column]


def shift(performance: Performance, seconds: float) -> Performance:
    """Move the performance in time by `seconds` (may be negative)."""
    return replace(performance, times=performance.times + seconds)


def trim(performance: Performance, start: float, end: float) -> Performance:
    """Keep the frames from `start` to `end` in seconds and let them begin at 0.

    Raises:
        ShapeError: No frame is left.
    """
    keep = (performance.times >= start - 1e-9) & (performance.times <= end + 1e-9)
    if not keep.any():
        length = performance.duration
        raise ShapeError(f"There is no frame between {start:g} s and {end:g} s; the recording lasts {length:.2f} s.")
    changes = {name: getattr(performance, name)[keep] for name in performance.channel_names()}
    times = performance.times[keep]
    codes = performance.timecodes
    codes = None if codes is None else tuple(np.array(codes, object)[keep])
    return replace(performance, times=times - times[0], timecodes=codes, **changes)
