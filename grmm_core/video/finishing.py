"""What is wrong with tracked frames in ways that are known: gaps, half blinks, eyes that look down behind shut lids.

Needs numpy only.
"""

from __future__ import annotations

import numpy as np

from ..controls.names import ARKIT_NAMES

LONG_GAP = 0.5  # seconds without the face that are worth a warning
_SIDES = ("Left", "Right")
_RISE = 0.2  # by which a blink stands out
_SHORT = 0.5  # seconds: lids that stay down longer are no blink, and may be half shut
_WHOLE = 1.0  # what a usual blink becomes
_MOST_GAIN = 2.0
_SHUT = 0.3  # of a blink, from which the gaze is a guess
_REST, _USUAL = 50.0, 70.0  # percentiles: of all frames the open eye, of the blinks' heights the usual one


def fill_gaps(values: np.ndarray, seen: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Values [T, ...] of frames without the face between those with it, in a straight line; at the ends the nearest."""
    flat = values.reshape(len(values), -1)
    filled = np.stack([np.interp(times, times[seen], column[seen]) for column in flat.T], axis=1)
    return filled.reshape(values.shape)


def gap_warning(seen: np.ndarray, times: np.ndarray) -> str:
    """A sentence about the longest time without the face, or "" where it is short."""
    shown = times[seen]
    edges = np.concatenate([times[:1], shown, times[-1:]])
    longest = int(np.argmax(np.diff(edges)))
    begin, end = float(edges[longest]), float(edges[longest + 1])
    if end - begin < LONG_GAP:
        return ""
    lost = 100.0 * (1.0 - seen.mean())
    return f"The face is not seen from {begin:.1f} to {end:.1f} s ({lost:.0f} % of all frames); what it does there is made up."


def whole_blinks(weights: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Close the lids in blinks: a network that sees few frames of them reports two thirds.

    Each eye's weight is stretched from its usual value, open, so that a usual blink shuts it; half shut eyes stretch with it.

    Args:
        weights: [T, 52].
        times: Seconds, [T].

    Returns:
        A copy.
    """
    result = weights.copy()
    for side in _SIDES:
        column = ARKIT_NAMES.index(f"eyeBlink{side}")
        lid = weights[:, column]
        rest = float(np.percentile(lid, _REST))
        heights = [lid[begin:end].max() for begin, end in _runs(lid > rest + _RISE) if times[end - 1] - times[begin] < _SHORT]
        if not heights:
            continue
        usual = float(np.percentile(heights, _USUAL))
        gain = min((_WHOLE - rest) / (usual - rest), _MOST_GAIN)
        if gain > 1.0:
            result[:, column] = np.where(lid > rest, np.clip(rest + (lid - rest) * gain, 0.0, 1.0), lid)
    return result


def steady_gaze(weights: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Let eyes look on through a blink as before and after it: the irises are hidden, reported ones sink. Returns a copy."""
    result = weights.copy()
    for side in _SIDES:
        columns = [i for i, name in enumerate(ARKIT_NAMES) if name.startswith("eyeLook") and name.endswith(side)]
        shut = weights[:, ARKIT_NAMES.index(f"eyeBlink{side}")] > _SHUT
        for begin, end in _runs(shut):
            if times[end - 1] - times[begin] < _SHORT:
                around = [max(begin - 1, 0), min(end, len(weights) - 1)]
                for column in columns:
                    result[begin:end, column] = np.interp(times[begin:end], times[around], weights[around, column])
    return result


def _runs(flags: np.ndarray) -> list[tuple[int, int]]:
    """First and behind the last of each run of True in [T]."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], flags, [False]]).astype(np.int8)))
    return [(int(begin), int(end)) for begin, end in edges.reshape(-1, 2)]
