"""What a face does when it does nothing: blinks and breaths, drawn from a seed. Needs numpy only.

Both come as keys of one loop, whose end fits its start.
"""

from __future__ import annotations

import numpy as np

LOOP = 60.0  # seconds
_CLOSING, _CLOSED, _OPENING = 0.08, 0.04, 0.18  # seconds of a blink: the lid falls about twice as fast as it rises
_SPREAD = 0.5  # of the logarithm of the time between two blinks, which is about normally distributed
_SHORTEST = 0.4  # seconds between the starts of two blinks
_PARTIAL, _PARTIAL_DEPTH = 0.1, 0.7  # share of the blinks that do not close the eye, and how far these go
_INHALED = 0.42  # share of a breath
_UNEVEN = 0.15  # relative variation of length and depth of breaths


def blinks(rate: float, seed: int) -> np.ndarray:
    """Return seconds and weights of blinking, flat at each key, [K, 2].

    Args:
        rate: Blinks a minute, on average; people at rest blink 10 to 20 times.
        seed: Equal numbers draw the same.
    """
    generator = np.random.default_rng(seed)
    whole = _CLOSING + _CLOSED + _OPENING
    gaps = np.exp(generator.normal(0.0, _SPREAD, max(1, round(rate * LOOP / 60.0)) + 1))
    gaps = _SHORTEST + gaps * (LOOP - whole - _SHORTEST * len(gaps)) / gaps.sum()  # all of the loop, none too close
    keys = [(0.0, 0.0)]
    for start, drawn in zip(np.cumsum(gaps[:-1]), generator.random(len(gaps) - 1), strict=True):
        depth = _PARTIAL_DEPTH if drawn < _PARTIAL else 1.0
        times = start + np.cumsum([0.0, _CLOSING, _CLOSED, _OPENING])
        keys += zip(times.tolist(), (0.0, depth, depth, 0.0), strict=True)
    return np.array([*keys, (LOOP, 0.0)])


def breaths(rate: float, seed: int) -> np.ndarray:
    """Return seconds and depth (about 0 to 1) of breathing, flat at each key, [K, 2].

    Args:
        rate: Breaths a minute; adults at rest breathe 12 to 18 times. The loop has a whole number of them.
        seed: As for `blinks`.
    """
    generator = np.random.default_rng(seed)
    lengths, depths = 1.0 + generator.uniform(-_UNEVEN, _UNEVEN, (2, max(1, round(rate * LOOP / 60.0))))
    ends = np.cumsum(lengths) * (LOOP / lengths.sum())
    starts = np.concatenate([[0.0], ends[:-1]])
    peaks = np.stack([starts + _INHALED * (ends - starts), depths], 1)
    troughs = np.stack([ends, np.zeros_like(ends)], 1)
    return np.concatenate([[[0.0, 0.0]], np.stack([peaks, troughs], 1).reshape(-1, 2)])
