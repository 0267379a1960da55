"""Shared checks of the readers: names, limits, missing values and the time line.

Called by the readers and writers of this package only. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...files.access import bad_file
from ...jobs.progress import Share
from .shapes import map_shapes

MAX_FRAMES = 2_000_000  # nine hours at 60 frames per second
MAX_FILE_BYTES = 128 << 20  # ten minutes at 60 frames per second with full-precision text are about 50 MB
_GAP_FRAMES = 1.75  # a step longer than this many frames is called a gap
_MAX_REPAIRED = 0.5  # with more than this part of the frames unreadable nothing can be trusted
_MAX_LISTED = 6
_REPORT_EVERY = 2048  # frames between reports of a writer
_SECONDS_PER_DAY = 86400.0
_TOO_MUCH = 2.0  # no weight of 0..1 goes there but by a glitch
_PERCENT_SHARE = 0.05  # of the frames have such a weight where weights are percentages
_MOST_PERCENT = 200.0


def arkit_weights(
    path: Path, kind: str, names: Sequence[str], values: np.ndarray, warnings: list[str]
) -> tuple[np.ndarray, frozenset[int]]:
    """Turn a file's columns into ARKit weights, whatever they are called and scaled, and fill gaps.

    Args:
        path: For messages.
        kind: What the file was taken for.
        names: Of the columns.
        values: [T, columns]; NaN where something is missing.
        warnings: Sentences about what was done are appended.

    Returns:
        Weights [T, 52] float32, and the indices of the shapes that the file has.

    Raises:
        FileFormatError: No name is known, or more than half of the frames are unreadable.
    """
    shapes = map_shapes(names)
    if not shapes.arkit_indices:
        raise bad_file(path, kind, "none of its names is an ARKit shape")
    weights = fill_missing(path, kind, shapes.weights(values), "weights", warnings)
    warnings.extend(shapes.warnings)
    highest = weights.max(1)
    if weights.max() <= _MOST_PERCENT and (highest > _TOO_MUCH).mean() > _PERCENT_SHARE:
        weights /= 100.0
        warnings.append("The weights go up to 100 and were read as percentages.")
    return weights, shapes.arkit_indices


def scale_times(times: np.ndarray, fps: float, warnings: list[str]) -> np.ndarray:
    """Time stamps in seconds [T], whatever unit they count in; a sentence says which one was assumed.

    No recording has less than a frame a second, so that larger steps count milliseconds, microseconds or nanoseconds; whole
    steps of one count frames.

    Args:
        times: As the file has them, with at least two different ones.
        fps: Frame rate of time stamps that count frames.
        warnings: The sentence is appended.
    """
    steps = np.diff(np.sort(times))
    step = float(np.median(steps[steps > 0]))
    if step < 1.0:
        return times
    if (times == np.rint(times)).all() and steps[steps > 0].min() == step == 1.0:
        warnings.append(f"The time stamps count frames; {fps:g} frames per second were assumed.")
        return times / fps
    for unit, name in ((1e-3, "milliseconds"), (1e-6, "microseconds"), (1e-9, "nanoseconds")):
        if step * unit < 1.0:
            warnings.append(f"The time stamps are {step:g} apart and were read as {name}.")
            return times * unit
    return times


def times_of_stamps(
    stamps: np.ndarray, fps: float | None, default: float, warnings: list[str], say_unit: bool = True
) -> tuple[np.ndarray, np.ndarray, float]:
    """The time line of frames with time stamps [T] in any unit.

    Args:
        stamps: As the file has them, finite.
        fps: A frame rate that is over them, if any.
        default: Frame rate where they say nothing.
        warnings: Sentences about the unit and about repeated, reordered and missing frames are appended.
        say_unit: Off where the program's unit is known.

    Returns:
        Times [K], the indices [K] of the frames that are kept, and the frame rate.
    """
    if fps is None and np.ptp(stamps) > 0:
        times, order = clean_times(scale_times(stamps, default, warnings if say_unit else []), warnings)
        return times, order, median_rate(times, default)
    rate = fps or default
    return np.arange(len(stamps)) / rate, np.arange(len(stamps)), rate


def fill_missing(path: Path, kind: str, values: np.ndarray, what: str, warnings: list[str]) -> np.ndarray:
    """Interpolate rows with NaN or infinite values from their neighbours in place, [T, N], and say so.

    Raises:
        FileFormatError: More than half of the rows are unreadable.
    """
    bad = ~np.isfinite(values).all(1)
    count = int(bad.sum())
    if count == 0:
        return values
    if count > _MAX_REPAIRED * values.shape[0]:
        raise bad_file(path, kind, f"{count} of its {values.shape[0]} frames have no finite {what}")
    good, rows = np.flatnonzero(~bad), np.flatnonzero(bad)
    for column in range(values.shape[1]):
        values[rows, column] = np.interp(rows, good, values[good, column])
    warnings.append(
        f"{count} of {values.shape[0]} frames had no valid {what} (the first is frame {rows[0]}) and were interpolated."
    )
    return values


def clean_times(times: np.ndarray, warnings: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Make a time line start at zero and increase.

    Args:
        times: Seconds as recorded, [T]; a step back by more than half a day is midnight.
        warnings: Sentences about repeated, reordered and missing frames are appended.

    Returns:
        Times [K] and the indices [K] of the frames that are kept.
    """
    steps = np.diff(times)
    times = times + _SECONDS_PER_DAY * np.concatenate([[0], np.cumsum(steps < -_SECONDS_PER_DAY / 2)])
    order = np.argsort(times, kind="stable")
    if (np.diff(order) < 0).any():
        warnings.append("Frames were not in order of time and have been sorted.")
    times = times[order]
    keep = np.concatenate([[True], np.diff(times) > 0])
    if not keep.all():
        warnings.append(f"{int((~keep).sum())} frames had the time of another frame and were left out.")
    times, order = times[keep], order[keep]
    times = times - times[0]
    if times.size > 2:
        steps = np.diff(times)
        gaps = np.flatnonzero(steps > _GAP_FRAMES * np.median(steps))
        if gaps.size:
            longest = gaps[np.argmax(steps[gaps])]
            warnings.append(
                f"The recording has {gaps.size} gaps in time; the longest is {steps[longest]:.2f} s at {times[longest]:.2f} s."
            )
    return times, order


def median_rate(times: np.ndarray, default: float) -> float:
    """Frames per second of a time line; rates within 1 % of a whole number are rounded to it."""
    if times.size < 2:
        return default
    rate = 1.0 / float(np.median(np.diff(times)))
    nearest = round(rate)
    return float(nearest) if nearest and abs(rate - nearest) < 0.01 * nearest else rate


def missing_warning(recorded: set[int]) -> list[str]:
    """One sentence about ARKit names that a file does not have."""
    missing = [name for i, name in enumerate(ARKIT_NAMES) if i not in recorded]
    if not missing:
        return []
    more = f" and {len(missing) - _MAX_LISTED} more" if len(missing) > _MAX_LISTED else ""
    return [f"The file has no {', '.join(missing[:_MAX_LISTED])}{more}; they stay at zero."]


def report_frame(progress: Share | None, i: int, count: int) -> None:
    """Tell now and then how far a writer is, which is also where it is cancelled."""
    if progress and i % _REPORT_EVERY == 0:
        progress(0.95 * i / count)
