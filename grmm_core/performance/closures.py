"""Lips that touch in a recording touch after cleaning.

Calibration takes the actor's resting face off every frame, and with it what that face did to the lips: a constant half smile,
for one, holds them closer together, and the short closures of p, b and m stay open without it. Where the recording closes the
lips of a head and the cleaned frames do not, `keep_lips_closed` adds mouthClose until they do, with a ramp to both sides.

Called by the Blender importer. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from ..controls.names import ARKIT_NAMES
from .types import Performance

MOUTH_CLOSE = ARKIT_NAMES.index("mouthClose")
_INNER_LIPS = (62, 66)  # iBUG: upper and lower, middle
_STEP = 0.2  # weight at which a shape's effect on the lips is measured; turning the jaw is not quite linear
_TOUCHING = 1e-4  # metres above the resting distance at which lips count as touching
_WEAKEST = 5e-4  # metres that mouthClose must close at 1 to be of use
PosedMesh = Callable[[np.ndarray], np.ndarray]
_RAMP = 3  # frames over which the correction fades


class LipHead(Protocol):
    """What is needed of `head.HeadModel`."""

    @property
    def arkit_to_expression(self) -> np.ndarray:
        """[52, E]."""
        ...

    @property
    def expression_pose(self) -> np.ndarray:
        """[E, 5, 3]."""
        ...

    def vertices(self, shape: np.ndarray, expression: np.ndarray, pose_euler: np.ndarray) -> np.ndarray:
        """Posed vertices, [V, 3]."""
        ...

    def landmark_positions(self, vertices: np.ndarray) -> np.ndarray:
        """Landmarks, [68, 3]."""
        ...


@dataclass(frozen=True)
class LipModel:
    """How far apart the lips of a head are: rest + slopes @ weights, metres.

    Attributes:
        rest: At weights of zero; negative where they overlap.
        slopes: Change for each ARKit shape at 1, [52].
    """

    rest: float
    slopes: np.ndarray

    def distance(self, weights: np.ndarray) -> np.ndarray:
        """Distances of frames [T] for weights [T, 52]."""
        return self.rest + np.asarray(weights, np.float64) @ self.slopes


def lip_model(
    head: LipHead, gain: np.ndarray, resting: np.ndarray | None = None, posed: PosedMesh | None = None
) -> LipModel:  # fmt: skip
    """Measure a head's lips.

    Args:
        head: Head model.
        gain: How far each ARKit shape goes on the person, [52]: `head.arkit_gain`.
        resting: The person's resting mesh, [V, 3] metres; the head's mean person when None.
        posed: The person's mesh for ARKit weights [52], where a learned displacement moves the lips as well; it stands over
            `gain` and `resting`.
    """

    def apart(weights: np.ndarray) -> float:
        if posed is not None:
            return _apart(head, posed(weights))
        weights = weights * gain
        expression = np.asarray(head.arkit_to_expression, np.float32).T @ weights
        pose = np.einsum("e,ejk->jk", expression, np.asarray(head.expression_pose, np.float32))
        own: Any = getattr(head, "arkit_pose", None)
        if own is not None:
            pose = pose + np.einsum("a,ajk->jk", weights, np.asarray(own, np.float32))
        return _apart(head, head.vertices(np.zeros(1, np.float32), expression, pose))

    zero = np.zeros(len(ARKIT_NAMES), np.float32)
    base = apart(zero)
    slopes = np.array([(apart(zero + _STEP * unit) - base) / _STEP for unit in np.eye(len(ARKIT_NAMES), dtype=np.float32)])
    return LipModel(base if resting is None or posed is not None else _apart(head, resting), slopes)


def keep_lips_closed(cleaned: Performance, recorded: Performance, lips: LipModel) -> Performance:
    """Close the lips in cleaned frames where they are closed in the recorded ones.

    Args:
        cleaned: With ARKit weights.
        recorded: The same moments before calibration, gain and smoothing; its frames may stand elsewhere.
        lips: Of the head that plays them.
    """
    closing = -lips.slopes[MOUTH_CLOSE]
    if closing < _WEAKEST:
        return cleaned
    resting = max(lips.rest, 0.0)
    wanted = np.interp(cleaned.times, recorded.times, lips.distance(recorded.weights))
    aim = np.clip(wanted, 0.0, resting) + _TOUCHING  # a person whose lips rest apart closes them further than at rest
    closed = wanted <= resting + _TOUCHING
    missing = np.where(closed, np.maximum(lips.distance(cleaned.weights) - aim, 0.0), 0.0) / closing
    if not missing.any():
        return cleaned
    added = missing.copy()
    for shift in range(1, _RAMP):
        share = 1.0 - shift / _RAMP
        added[shift:] = np.maximum(added[shift:], share * missing[:-shift])
        added[:-shift] = np.maximum(added[:-shift], share * missing[shift:])
    weights = cleaned.weights.copy()
    weights[:, MOUTH_CLOSE] = np.minimum(weights[:, MOUTH_CLOSE] + added, 1.0)
    shapes = tuple(dict.fromkeys((*cleaned.recorded_shapes, ARKIT_NAMES[MOUTH_CLOSE])))
    return replace(cleaned, weights=weights, recorded_shapes=shapes)


def _apart(head: LipHead, vertices: np.ndarray) -> float:
    marks = head.landmark_positions(np.asarray(vertices))
    return float(marks[_INNER_LIPS[0], 1] - marks[_INNER_LIPS[1], 1])
