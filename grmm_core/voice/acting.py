"""What a speaker's brows, lids, eyes and head do beside the mouth: by what is said where it shows, else drawn from a seed.

Heads dip and brows rise on syllables that stand out, find another pose with a new thought, and are never quite still; eyes stay
on the listener, look away now and then before speech begins, and blink more often in pauses than within words. It is an idle
actor's part, made to be overruled by keys. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..controls.names import ARKIT_NAMES
from ..performance.idle import LOOP, blinks
from .listening import SILENCE, Phone
from .mouth import VOWELS
from .sound import HOP

_BLINKS = 16.0  # a minute, beside those in pauses
_PAUSE = 0.3  # seconds of silence in which people blink and find another pose
_BLINK_SHARE, _LOOK_SHARE = 0.6, 0.35  # of the pauses
_BLINK = np.array([(0.0, 0.0), (0.08, 1.0), (0.12, 1.0), (0.3, 0.0)])  # seconds, weight
_APART = 0.35  # seconds between two blinks
_ACCENT = 1.5  # decibels above its surroundings from which a syllable stands out, and
_FULL_ACCENT = 7.0  # those with which it does so in full
_AROUND = 1.0  # seconds to both sides
_BETWEEN = 0.7  # seconds between two accents
_NOD, _NOD_RISE, _NOD_FALL = np.radians(3.0), 0.13, 0.32  # radians down, seconds
_BROWS = {"browInnerUp": 0.3, "browOuterUpLeft": 0.22, "browOuterUpRight": 0.22}
_BROW_SHARE = 0.6  # of the accents
_POSE = np.radians((2.0, 5.0, 2.0))  # standard deviations of the head's pose (pitch, yaw, roll) from thought to thought
_TURNING = 0.45  # seconds that a new pose takes, as the width of its step
_SWAY = np.radians((0.5, 0.9, 0.4))
_SWAYS = (0.13, 0.21, 0.34)  # hertz
_KEPT = 0.8  # share of the head's turn that the eyes take back
_LOOK_REACH = np.radians((18.0, 25.0))  # what eyeLook shapes turn at 1: up or down, to a side
_AWAY = np.radians((6.0, 11.0))  # up or down, to a side
_LOOK_DELAY, _LOOK_TIME, _LOOKING = 0.1, 0.7, 0.03  # seconds from a pause on; of the jump itself, as the width of its step


def act(
    phones: Sequence[Phone], levels: np.ndarray, times: np.ndarray, liveliness: float = 1.0, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Movements beside the mouth.

    Args:
        phones: In time.
        levels: Decibels every `sound.HOP` seconds.
        times: Seconds, [T].
        liveliness: Factor of all movements; 0 is a face that does not even blink.
        seed: Equal numbers draw the same.

    Returns:
        Weights of the ARKit shapes [T, 52], zero for the mouth's, and the head's rotation [T, 3], XYZ Euler angles in radians.
    """
    weights, turn = np.zeros((len(times), len(ARKIT_NAMES))), np.zeros((len(times), 3))
    if not liveliness or not len(times):
        return weights, turn
    generator = np.random.default_rng(seed)
    pauses = [phone for phone in phones if phone.name == SILENCE and phone.end - phone.start > _PAUSE]
    for time, size in _accents(phones, levels):
        turn[:, 0] += _NOD * size * _bump(times, time, _NOD_RISE, _NOD_FALL)
        if generator.random() < _BROW_SHARE:
            for name, weight in _BROWS.items():
                weights[:, ARKIT_NAMES.index(name)] += weight * size * _bump(times, time - 0.05, 0.18, 0.4)
    turn += _poses(pauses, times, generator) + _sway(times, generator)
    turn *= liveliness
    weights *= liveliness
    gaze = -_KEPT * turn[:, :2]
    for pause in pauses:
        if pause.start > 0.0 and generator.random() < _LOOK_SHARE:
            away = liveliness * _AWAY * generator.choice((-1.0, 1.0), 2)
            gone = _step(times, pause.start + _LOOK_DELAY, _LOOKING) - _step(times, pause.start + _LOOK_TIME, _LOOKING)
            gaze += away * gone[:, None]
    _look(weights, gaze)
    lids = _lids(pauses, times, generator, seed)
    for side in ("Left", "Right"):
        weights[:, ARKIT_NAMES.index(f"eyeBlink{side}")] = lids
    return weights.clip(0.0, 1.0), turn


def _accents(phones: Sequence[Phone], levels: np.ndarray) -> list[tuple[float, float]]:
    """Seconds and sizes (to 1) of the syllables that stand out."""
    vowels = [phone for phone in phones if phone.name in VOWELS]
    found: list[tuple[float, float]] = []
    middles = np.array([(phone.start + phone.end) / 2 for phone in vowels])
    loud = np.array([_peak(levels, phone) for phone in vowels])
    for index, (time, level) in enumerate(zip(middles, loud, strict=True)):
        around = loud[np.abs(middles - time) < _AROUND]
        size = (level - np.median(around) - _ACCENT) / (_FULL_ACCENT - _ACCENT)
        if level == around.max() and size > 0.0 and (not found or time - found[-1][0] > _BETWEEN):
            found.append((float(vowels[index].start), float(min(0.5 + 0.5 * size, 1.0))))
    return found


def _peak(levels: np.ndarray, phone: Phone) -> float:
    begin = min(round(phone.start / HOP), len(levels) - 1)
    return float(levels[begin : max(round(phone.end / HOP), begin + 1)].max())


def _poses(pauses: Sequence[Phone], times: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """A pose of the head for each stretch between two pauses, [T, 3]."""
    result, last = np.zeros((len(times), 3)), np.zeros(3)
    for pause in pauses:
        pose = generator.normal(0.0, 1.0, 3) * _POSE
        result += (pose - last) * _step(times, (pause.start + pause.end) / 2, _TURNING)[:, None]
        last = pose
    return result


def _sway(times: np.ndarray, generator: np.random.Generator) -> np.ndarray:
    """Slow small movements of a head that is held up, [T, 3]."""
    phases = generator.uniform(0.0, 2.0 * np.pi, (len(_SWAYS), 3))
    return sum(np.sin(2.0 * np.pi * rate * times[:, None] + phase) * _SWAY for rate, phase in zip(_SWAYS, phases, strict=True))


def _look(weights: np.ndarray, gaze: np.ndarray) -> None:
    """Set the eyes' shapes by how far they turn down and to the person's left, [T, 2] radians, in place."""
    down, left = (gaze / _LOOK_REACH).T
    ways = {
        "Down": (down, down), "Up": (-down, -down), "Out": (left, -left), "In": (-left, left),
    }  # fmt: skip
    for way, sides in ways.items():
        for side, values in zip(("Left", "Right"), sides, strict=True):
            weights[:, ARKIT_NAMES.index(f"eyeLook{way}{side}")] = np.maximum(values, 0.0)


def _lids(pauses: Sequence[Phone], times: np.ndarray, generator: np.random.Generator, seed: int) -> np.ndarray:
    keys = blinks(_BLINKS, seed)
    result = np.interp(times % LOOP, *keys.T)
    for pause in pauses:
        if generator.random() < _BLINK_SHARE:
            begin = pause.start + generator.uniform(0.0, 0.15)
            near = (times > begin - _APART) & (times < begin + _BLINK[-1, 0] + _APART)
            if result[near].max(initial=0.0) == 0.0:
                result = np.maximum(result, np.interp(times - begin, _BLINK[:, 0], _BLINK[:, 1]))
    return result


def _bump(times: np.ndarray, peak: float, rise: float, fall: float) -> np.ndarray:
    """1 at the peak, a bell to both sides."""
    away = times - peak
    return np.exp(-((away / np.where(away < 0.0, rise, fall)) ** 2))


def _step(times: np.ndarray, middle: float, width: float) -> np.ndarray:
    """From 0 to 1, smooth."""
    return 0.5 + 0.5 * np.tanh((times - middle) / width)
