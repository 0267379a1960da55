"""Lips, jaw and tongue that form phones: targets that blend by dominance, and closures that are always reached.

Each phone wants values of some channels (how far the jaw is open, how round lips are) and insists on each more or less: an S
wants teeth together and leaves the lips to its neighbors, a T hardly cares. The value at a time is the mean of all targets
around it, weighed by how much each insists and how near it is (Cohen and Massaro, Modeling Coarticulation in Synthetic Visual
Speech, 1993), so that lips round before the vowel that wants it, and quick speech opens less. What an audience reads first,
closed lips of P, B and M and teeth on the lip of F and V, is no matter of means: these gestures are made in full. Needs numpy
only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..controls.names import ARKIT_NAMES
from .listening import SILENCE, Phone
from .sound import HOP

CHANNELS = ("jaw", "pucker", "funnel", "stretch", "upper", "lower", "tongue")
_CLOSE, _BITE = frozenset("PBM"), frozenset("FV")
_STOPS = frozenset("PB")
_EARLY = {"pucker": 0.13, "funnel": 0.13}  # seconds before a phone at which its pull has fallen to 1/e; others:
_USUAL_EARLY, _LATE = 0.075, 0.085
_FALL = 1.4  # exponent of this fall: between a cusp (1) and a bell (2)
_CORE = 0.25  # of a phone's length to both sides of its middle, where it pulls in full
_EDGE = 0.1  # seconds of a pause at both ends in which lips still come from a word or make ready for one
_CLOSING, _OPENING = 0.06, 0.06  # seconds in which lips meet and part
_BURST = 0.7  # share of a stop's length after which its lips part
_LOUD = 0.035  # of the logarithm of how far a vowel opens, for each decibel above the speaker's usual vowel
_MOST_LOUD, _LEAST_LOUD = 1.45, 0.6
_AT_CLOSED = 0.55  # share of the jaw's opening that closed lips leave

# What each vowel wants: the channels that are not zero. Those that glide are one after the other of two.
_VOWELS: dict[str, dict[str, float]] = {
    "AA": {"jaw": 0.36, "lower": 0.22, "upper": 0.1},
    "AE": {"jaw": 0.31, "lower": 0.26, "upper": 0.14, "stretch": 0.22},
    "AH": {"jaw": 0.22, "lower": 0.16, "upper": 0.06},
    "AO": {"jaw": 0.29, "funnel": 0.34, "pucker": 0.18, "lower": 0.1},
    "EH": {"jaw": 0.24, "lower": 0.22, "upper": 0.1, "stretch": 0.2},
    "ER": {"jaw": 0.15, "funnel": 0.24, "pucker": 0.25, "lower": 0.1},
    "IH": {"jaw": 0.15, "lower": 0.18, "upper": 0.06, "stretch": 0.22},
    "IY": {"jaw": 0.1, "lower": 0.24, "upper": 0.1, "stretch": 0.4},
    "UH": {"jaw": 0.14, "pucker": 0.38, "funnel": 0.2},
    "UW": {"jaw": 0.09, "pucker": 0.85, "funnel": 0.22},
}
_GLIDES = {"AW": ("AA", "UW"), "AY": ("AA", "IY"), "EY": ("EH", "IY"), "OW": ("AO", "UW"), "OY": ("AO", "IY")}
VOWELS = frozenset((*_VOWELS, *_GLIDES))
"""Names of the phones that are vowels."""


@dataclass(frozen=True)
class _Pull:
    """What a phone wants: values of channels, and how much it insists on each; channels that are not named have `rest`."""

    values: dict[str, float]
    insists: dict[str, float]
    rest: float = 0.3


_SIBILANT = _Pull(
    {"jaw": 0.05, "lower": 0.2, "upper": 0.08, "stretch": 0.2}, {"jaw": 2.0, "pucker": 0.12, "funnel": 0.12, "lower": 0.8}
)
_HUSHING = _Pull(
    {"jaw": 0.06, "funnel": 0.4, "pucker": 0.3, "lower": 0.12}, {"jaw": 2.0, "funnel": 2.0, "pucker": 1.5, "lower": 0.6}
)
_TIP = _Pull({"jaw": 0.1, "lower": 0.12}, {"jaw": 0.9}, 0.12)
_BACK = _Pull({"jaw": 0.14}, {"jaw": 0.35}, 0.05)
_LIPS = _Pull({"jaw": 0.07}, {"jaw": 0.7}, 0.15)
_DENTAL = _Pull({"jaw": 0.13, "tongue": 0.3, "lower": 0.2}, {"jaw": 1.0, "tongue": 4.0}, 0.12)
_CONSONANTS: dict[str, _Pull] = {
    **dict.fromkeys(("P", "B", "M"), _LIPS),
    **dict.fromkeys(("F", "V"), _Pull({"jaw": 0.08}, {"jaw": 0.9}, 0.15)),
    **dict.fromkeys(("S", "Z"), _SIBILANT),
    **dict.fromkeys(("SH", "ZH", "CH", "JH"), _HUSHING),
    **dict.fromkeys(("T", "D", "N"), _TIP),
    "L": _Pull({"jaw": 0.15, "lower": 0.14}, {"jaw": 0.7}, 0.12),
    **dict.fromkeys(("K", "G", "NG"), _BACK),
    **dict.fromkeys(("TH", "DH"), _DENTAL),
    "HH": _Pull({"jaw": 0.14}, {"jaw": 0.08}, 0.02),
    "W": _Pull({"jaw": 0.07, "pucker": 0.9, "funnel": 0.15}, {"jaw": 0.8, "pucker": 4.0, "funnel": 2.0}),
    "R": _Pull({"jaw": 0.11, "pucker": 0.32, "funnel": 0.26}, {"jaw": 0.6, "pucker": 1.0, "funnel": 1.0}),
    "Y": _Pull({"jaw": 0.08, "stretch": 0.3, "lower": 0.16}, {"jaw": 0.8, "stretch": 0.8}),
    SILENCE: _Pull({}, dict.fromkeys(CHANNELS, 1.2)),
}  # fmt: skip
_SHAPES: dict[str, dict[str, float]] = {
    "jaw": {"jawOpen": 1.0},
    "pucker": {"mouthPucker": 1.0},
    "funnel": {"mouthFunnel": 1.0},
    "stretch": {"mouthStretch": 0.75, "mouthSmile": 0.35},
    "upper": {"mouthUpperUp": 1.0},
    "lower": {"mouthLowerDown": 1.0},
    "tongue": {"tongueOut": 1.0},
    "close": {"mouthPress": 0.12, "mouthRollLower": 0.12, "mouthRollUpper": 0.12},  # and mouthClose as far as the jaw is open
    "bite": {"mouthRollLower": 0.6, "mouthUpperUp": 0.25},
}
"""ARKit shapes of each channel at 1; both sides where there are two."""


@dataclass(frozen=True)
class _Target:
    """One phone, or half of a gliding vowel, at its place."""

    pull: _Pull
    start: float
    end: float
    is_vowel: bool


def mouth(phones: Sequence[Phone], levels: np.ndarray, times: np.ndarray, strength: float = 1.0) -> np.ndarray:
    """Weights of the ARKit shapes that say these phones.

    Args:
        phones: In time.
        levels: Decibels every `sound.HOP` seconds: loud vowels open wider.
        times: Seconds, [T].
        strength: Factor of all movements but closures.

    Returns:
        Weights in 0..1, [T, 52] float64.
    """
    targets = [target for phone in phones for target in _targets(phone)]
    loud = _loudness_of_vowels(targets, levels)
    sums, weights = np.zeros((len(CHANNELS), len(times))), np.full((len(CHANNELS), len(times)), 1e-9)
    for target, gain in zip(targets, loud, strict=True):
        edge = min(_EDGE, (target.end - target.start) / 2) if target.pull is _CONSONANTS[SILENCE] else None
        half = (target.end - target.start) * _CORE
        middle = (target.start + target.end) / 2
        low, high = (middle - half, middle + half) if edge is None else (target.start + edge, target.end - edge)
        begin, stop = np.searchsorted(times, (low - 4 * max(_EARLY.values()), high + 4 * _LATE))
        near = times[begin:stop]
        for row, channel in enumerate(CHANNELS):
            away = np.where(near < low, (low - near) / _EARLY.get(channel, _USUAL_EARLY), np.maximum(near - high, 0.0) / _LATE)
            weight = target.pull.insists.get(channel, target.pull.rest) * np.exp(-(away**_FALL))
            sums[row, begin:stop] += weight * target.pull.values.get(channel, 0.0) * gain
            weights[row, begin:stop] += weight
    channels = dict(zip(CHANNELS, strength * sums / weights, strict=True))
    channels["close"] = _gesture(phones, times, _CLOSE)
    channels["bite"] = _gesture(phones, times, _BITE)
    parted = 1.0 - channels["close"]
    channels["jaw"] = channels["jaw"] * (_AT_CLOSED + (1.0 - _AT_CLOSED) * parted)
    for name in ("upper", "lower", "stretch", "funnel", "tongue"):
        channels[name] = channels[name] * parted * (1.0 - 0.8 * channels["bite"])
    return _shapes(channels)


def _targets(phone: Phone) -> list[_Target]:
    if phone.name in _GLIDES:
        middle = (phone.start + phone.end) / 2
        first, second = (_Pull(_VOWELS[name], {}, 1.0) for name in _GLIDES[phone.name])
        return [_Target(first, phone.start, middle, True), _Target(second, middle, phone.end, True)]
    if phone.name in _VOWELS:
        return [_Target(_Pull(_VOWELS[phone.name], {}, 1.0), phone.start, phone.end, True)]
    return [_Target(_CONSONANTS.get(phone.name, _BACK), phone.start, phone.end, False)]


def _loudness_of_vowels(targets: Sequence[_Target], levels: np.ndarray) -> np.ndarray:
    """Factor of each target: of vowels by how loud they are against the speaker's median vowel, else 1."""
    peaks = np.full(len(targets), np.nan)
    for index, target in enumerate(targets):
        begin, end = round(target.start / HOP), max(round(target.end / HOP), round(target.start / HOP) + 1)
        if target.is_vowel and begin < len(levels):
            peaks[index] = levels[begin:end].max()
    if np.isnan(peaks).all():
        return np.ones(len(targets))
    factor = np.exp(_LOUD * (peaks - np.nanmedian(peaks)))
    return np.where(np.isnan(peaks), 1.0, np.clip(factor, _LEAST_LOUD, _MOST_LOUD))


def _gesture(phones: Sequence[Phone], times: np.ndarray, names: frozenset[str]) -> np.ndarray:
    """How far a closure of some phones is made at each time, 0..1, [T]: whole while they last, smooth before and after."""
    result = np.zeros(len(times))
    for phone in phones:
        if phone.name not in names:
            continue
        length = phone.end - phone.start
        end = phone.start + (_BURST if phone.name in _STOPS else 0.9) * length
        begin, stop = np.searchsorted(times, (phone.start - _CLOSING, end + _OPENING))
        near = times[begin:stop]
        away = np.maximum(np.maximum((phone.start - near) / _CLOSING, (near - end) / _OPENING), 0.0)
        result[begin:stop] = np.maximum(result[begin:stop], 0.5 + 0.5 * np.cos(np.pi * np.minimum(away, 1.0)))
    return result


def _shapes(channels: dict[str, np.ndarray]) -> np.ndarray:
    result = np.zeros((len(channels["jaw"]), len(ARKIT_NAMES)))
    for channel, recipe in _SHAPES.items():
        for shape, weight in recipe.items():
            for name in (shape, f"{shape}Left", f"{shape}Right"):
                if name in ARKIT_NAMES:
                    result[:, ARKIT_NAMES.index(name)] += weight * channels[channel]
    jaw, close = ARKIT_NAMES.index("jawOpen"), ARKIT_NAMES.index("mouthClose")
    result[:, close] = result[:, jaw] * channels["close"]
    return result.clip(0.0, 1.0)
