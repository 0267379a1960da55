"""How far shapes go that shut something: they are sculpted for one face, and people's eyes and mouths are of many sizes.

The open head's `eyeBlink` at 1 moves the upper lid 11 to 12 mm, while eyes open by 6 to 10: they are shut at 0.65 to 0.85, and
lids go on over the cheek. Its `mouthClose` leaves lips a quarter of the way apart that the jaw's turn opens. ARKit means shut
eyes by 1 and shut lips by a `mouthClose` as large as `jawOpen`, and so do performances and animators: `arkit_gain` says how
much of the sculpted shape that is. Captures, trainings and fits know the sculpted shapes alone. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

from ..controls.frame import Controls, resolve
from ..controls.names import ARKIT_NAMES
from .head_model import HeadModel

CLOSING = ("eyeBlinkLeft", "eyeBlinkRight", "mouthClose")
"""The shapes that go differently far on each person."""
_UPPER_LIDS, _LOWER_LIDS = {"Left": (43, 44), "Right": (37, 38)}, {"Left": (47, 46), "Right": (41, 40)}  # iBUG landmarks
_UPPER_LIP, _LOWER_LIP = (61, 62, 63), (67, 66, 65)  # likewise, of the inner edges
_LIDS_OVERLAP = 5e-4  # metres: edges of lids are round, and lashes stand on them
_LIPS_TOUCH = 5e-4  # metres between the edges of lips that touch, at the most; some people's overlap
_JAW = 0.5  # where lips are measured: speech opens the jaw less, and what it leaves open grows with its turn
_RANGE = (0.5, 1.5)
_LEAST = 1e-3  # metres that a shape must close to be measured
_KEPT = 64  # people whose gains are remembered


def arkit_gain(head: HeadModel, shape: np.ndarray) -> np.ndarray:
    """How much of each sculpted ARKit shape a weight of 1 stands for on a person: 1, but for those that are `CLOSING`.

    Args:
        head: Head model; without landmarks all are 1.
        shape: The person's coefficients, [<=S].

    Returns:
        Factors, [52] float32, not to be written to.
    """
    known: dict[bytes, np.ndarray] = head.__dict__.setdefault("_gains", {})
    person = np.asarray(shape, np.float32)[: head.shape_count]
    key = person.tobytes()
    found = known.get(key)
    if found is None:
        found = _measured(head, person)
        found.flags.writeable = False
        if len(known) >= _KEPT:
            known.clear()
        known[key] = found
    return found


def _measured(head: HeadModel, shape: np.ndarray) -> np.ndarray:
    gain = np.ones(len(ARKIT_NAMES), np.float32)
    if head.landmarks68 is None:
        return gain

    def apart(upper: tuple[int, ...], lower: tuple[int, ...], **weights: float) -> np.ndarray:
        """From the upper to the lower edge, downwards, metres, [N]."""
        performed = resolve(Controls().set_named(weights), head)
        points = head.landmark_positions(head.vertices(shape, performed.expression, performed.pose))
        return np.asarray(points[list(upper), 1] - points[list(lower), 1])

    def keep(name: str, wanted: np.ndarray, closed: np.ndarray, last: bool) -> None:
        if closed.min() > _LEAST:
            factors = wanted / closed
            gain[ARKIT_NAMES.index(name)] = np.clip(factors.max() if last else factors.mean(), *_RANGE)

    for side, upper in _UPPER_LIDS.items():
        name, lower = f"eyeBlink{side}", _LOWER_LIDS[side]
        opened = apart(upper, lower)
        keep(name, opened + _LIDS_OVERLAP, opened - apart(upper, lower, **{name: 1.0}), last=True)
    lips = _UPPER_LIP, _LOWER_LIP
    resting, opened = apart(*lips), apart(*lips, jawOpen=_JAW)
    left = opened - np.clip(resting, 0.0, _LIPS_TOUCH)
    keep("mouthClose", left, opened - apart(*lips, jawOpen=_JAW, mouthClose=_JAW), last=False)
    return gain
