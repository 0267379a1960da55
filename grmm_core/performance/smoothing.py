"""Smoothing that takes jitter and leaves blinks and plosives.

A Savitzky-Golay filter (a local parabola, no delay) removes tracker noise but also shaves off what lasts two or three frames: a
closed lid, lips that touch. So the filtered curve is used only where it differs from the recording by no more than noise does:
the noise level of each curve is estimated robustly from its third differences, which movements of a face hardly reach,
differences of a few times that level are signal and are given back, and the hand-over is spread over neighbouring frames so
that it leaves no corner. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import ShapeError
from ..jobs.progress import Share
from .types import Performance

_MAD_TO_SIGMA = 1.4826
_LOWER, _UPPER = 2.5, 4.5  # standard deviations of noise between which the recording takes over again
_FLOOR = 1e-4  # noise below this is rounding
_MIN_WINDOW, _MAX_WINDOW = 0.10, 0.40  # seconds, at strength 0 and 1
_SPREAD = 2  # frames by which a transient's protection reaches beyond it
_THIRD_DIFFERENCE_GAIN = 20.0**0.5  # of white noise: 1 + 9 + 9 + 1


def smooth(performance: Performance, strength: float = 0.5, progress: Share | None = None) -> Performance:
    """Remove jitter from all curves of a performance.

    Args:
        performance: At a constant frame rate (see `timing.resample`).
        strength: 0 leaves it as it is, 1 is the strongest.
        progress: Called with the fraction done.

    Returns:
        A smoothed copy. No value moves by more than `_UPPER` times the noise level of its curve.

    Raises:
        ShapeError: A strength outside 0..1.
    """
    if not 0.0 <= strength <= 1.0:
        raise ShapeError(f"The strength of smoothing must be between 0 and 1; got {strength:g}.")
    if strength == 0.0:
        return performance
    window = (_MIN_WINDOW + (_MAX_WINDOW - _MIN_WINDOW) * strength) * performance.fps
    changes: dict[str, Any] = {}
    names = performance.channel_names()
    for i, name in enumerate(names):
        values = getattr(performance, name)
        changes[name] = smooth_curves(np.asarray(values, np.float64), window).astype(values.dtype)
        if progress:
            progress((i + 1) / len(names))
    return replace(performance, **changes)


def smooth_curves(values: np.ndarray, window: float) -> np.ndarray:
    """Smooth curves [T, N] over about `window` frames; transients keep their height. Returns [T, N] float64."""
    half = max(2, int(window // 2))
    if values.shape[0] < 2 * half + 1:
        return values.copy()
    filtered = savitzky_golay(values, half)
    removed = values - filtered
    t = np.clip((np.abs(removed) / noise_level(values) - _LOWER) / (_UPPER - _LOWER), 0.0, 1.0)
    gate = t * t * (3.0 - 2.0 * t)
    wide = gate.copy()
    for k in range(1, _SPREAD + 1):  # a transient and its neighbours count as one ...
        wide[k:] = np.maximum(wide[k:], gate[:-k])
        wide[:-k] = np.maximum(wide[:-k], gate[k:])
    smooth_gate = np.zeros_like(wide)
    for k in range(-_SPREAD, _SPREAD + 1):  # ... with an edge that fades over as many frames, so that the transient keeps 1
        weight = (_SPREAD + 1 - abs(k)) / (_SPREAD + 1) ** 2
        rows = np.clip(np.arange(wide.shape[0]) + k, 0, wide.shape[0] - 1)
        smooth_gate += weight * wide[rows]
    return filtered + removed * smooth_gate


def noise_level(values: np.ndarray) -> np.ndarray:
    """Standard deviation of the noise of curves [T, N], robust against movements, [N]."""
    if values.shape[0] < 4:
        return np.full(values.shape[1], _FLOOR)
    third = np.abs(np.diff(values, 3, axis=0))
    return np.maximum(_MAD_TO_SIGMA * np.median(third, axis=0) / _THIRD_DIFFERENCE_GAIN, _FLOOR)


def savitzky_golay(values: np.ndarray, half: int) -> np.ndarray:
    """Local parabola over 2 half + 1 frames, symmetric in time; the curve is mirrored about its end points. [T, N] float64."""
    offsets = np.arange(-half, half + 1)
    basis = np.stack([np.ones_like(offsets), offsets, offsets**2], 1).astype(np.float64)
    kernel = np.linalg.pinv(basis)[0]  # value at the centre
    start = 2.0 * values[:1] - values[half:0:-1]
    end = 2.0 * values[-1:] - values[-2 : -half - 2 : -1]
    padded = np.concatenate([start, values, end])
    result = np.zeros_like(values)
    for weight, k in zip(kernel, range(2 * half + 1), strict=True):
        result += weight * padded[k : k + values.shape[0]]
    return result
