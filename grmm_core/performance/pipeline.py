"""The usual way from a recording to clean frames, in one call and the right order.

Calibration comes before the gains, so that these stretch the expression and not the resting face; smoothing before the change
of rate, so that noise does not alias; both before reduction to keys. Called by the importer and the command line. Needs numpy
only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from ..jobs.progress import Share
from .editing import apply_gain, calibrate_neutral, clamp, find_neutral_frames, range_warnings
from .smoothing import smooth
from .timing import resample, shift, trim
from .types import Performance

_STEPS = 6


@dataclass(frozen=True)
class CleanOptions:
    """What to do with a recording; the defaults leave it as it is.

    Attributes:
        start: First second of the recording to use.
        end: Last second, or None for all.
        neutral: Frames in which the actor rests, "auto" for the calmest ones, or None for no calibration.
        gains: Factors by region (`editing.REGIONS`, "head", "all") or ARKit name.
        smoothing: 0..1.
        fps: Frame rate of the result, or None for the recording's own.
        offset: Seconds by which the result is moved.
        limit: Keep weights within 0..1.
    """

    start: float = 0.0
    end: float | None = None
    neutral: Sequence[int] | Literal["auto"] | None = None
    gains: Mapping[str, float] = field(default_factory=dict)
    smoothing: float = 0.0
    fps: float | None = None
    offset: float = 0.0
    limit: bool = True


def clean(performance: Performance, options: CleanOptions, progress: Share | None = None) -> Performance:
    """Trim, calibrate, smooth, resample, amplify, limit and shift a recording.

    Args:
        performance: As read. `neutral` frames are numbered as in it, before trimming.
        options: What to do.
        progress: Called with the fraction done.

    Returns:
        A copy; `warnings` also says which weights went out of range.

    Raises:
        ShapeError: An option that does not fit the recording.
    """

    def report(step: int) -> None:
        if progress:
            progress(step / _STEPS)

    result = replace(performance, warnings=list(performance.warnings))
    if options.neutral is not None:
        frames = find_neutral_frames(result) if options.neutral == "auto" else options.neutral
        result = calibrate_neutral(result, frames)
    report(1)
    if options.start > 0.0 or options.end is not None:
        result = trim(result, options.start, result.times[-1] if options.end is None else options.end)
    report(2)
    if options.smoothing > 0.0:
        # Smoothing counts in frames, so gaps and jumps of the time line are filled first, at the recording's own rate.
        result = smooth(resample(result, result.fps, keep_peaks=False), options.smoothing)
    report(3)
    if options.fps is not None:
        result = resample(result, options.fps)
    report(4)
    result = apply_gain(result, options.gains, clip=False)
    outside = [warning for warning in range_warnings(result.weights) if warning not in result.warnings]
    if outside and options.limit:
        outside = [warning.removesuffix(".") + "; they were limited." for warning in outside]
    result.warnings.extend(outside)
    result = clamp(result) if options.limit else result
    report(5)
    result = shift(result, options.offset) if options.offset else result
    report(_STEPS)
    return result
