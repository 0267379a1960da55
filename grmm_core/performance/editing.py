"""Strength and rest pose: gain per region of the face, calibration to the actor's neutral face, limits.

Called by the importer. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Any

import numpy as np

from ..controls.names import ARKIT_NAMES
from ..controls.table import REGIONS as FACE_REGIONS
from ..errors import ShapeError
from ..geometry.rotations import euler_to_matrix, matrix_to_euler, unwrap_euler
from .types import Performance

_TOGETHER = {"Lips": "mouth"}  # a recording's gain takes lips and corners together


def _regions() -> Iterator[tuple[str, tuple[int, ...]]]:
    names = [_TOGETHER.get(region, region.lower()) for region in FACE_REGIONS]
    for name in dict.fromkeys(names):
        inside = [n for own, found in zip(names, FACE_REGIONS.values(), strict=True) if own == name for n in found]
        yield name, tuple(index for index, shape in enumerate(ARKIT_NAMES) if shape in inside)


REGIONS: MappingProxyType[str, tuple[int, ...]] = MappingProxyType({name: found for name, found in _regions() if found})
"""Region name to indices of its ARKit shapes; every shape is in one region."""

HEAD_REGION = "head"
_MAX_OFFSET = 0.9  # a resting weight beyond this is no neutral face
_RANGE = (-0.05, 1.05)  # tracker noise outside 0..1 that is not worth a warning
_MAX_LISTED = 6
_CALM_SHARE = 0.05


def apply_gain(performance: Performance, gains: Mapping[str, float], clip: bool = True) -> Performance:
    """Multiply the weights of regions, and the rotation of the head.

    Args:
        performance: Any.
        gains: Region of `REGIONS`, "head", "all" (every region and not the head) or an ARKit name, to factor.
        clip: Keep weights within 0..1.

    Raises:
        ShapeError: Unknown region or a factor that is not finite.
    """
    factors = np.ones(len(ARKIT_NAMES))
    head = 1.0
    for name, gain in gains.items():
        if not np.isfinite(gain):
            raise ShapeError(f"The gain of {name} is not a finite number; set it to a number.")
        if name == HEAD_REGION:
            head *= gain
        elif name == "all":
            factors *= gain
        elif name in REGIONS:
            factors[list(REGIONS[name])] *= gain
        elif name in ARKIT_NAMES:
            factors[ARKIT_NAMES.index(name)] *= gain
        else:
            raise ShapeError(f"There is no region {name!r}; use {', '.join(REGIONS)}, head, all or an ARKit name.")
    weights = performance.weights * factors.astype(np.float32)
    changes: dict[str, Any] = {"weights": np.clip(weights, 0.0, 1.0) if clip else weights}
    if head != 1.0:
        names = [name for name in ("head_rotation", "neck_rotation") if getattr(performance, name) is not None]
        changes |= {name: getattr(performance, name) * head for name in names}
    return replace(performance, **changes)


def find_neutral_frames(performance: Performance, count: int | None = None) -> np.ndarray:
    """The calmest frames: little expression in total and little movement.

    Args:
        performance: Any.
        count: How many; by default one in twenty, at least one.

    Returns:
        Frame numbers in order, [count].
    """
    total = performance.weights.shape[0]
    values = performance.weights.astype(np.float64)
    if performance.expression is not None:
        values = np.concatenate([values, np.asarray(performance.expression, np.float64)], 1)
    speed = np.abs(np.gradient(values, axis=0)).sum(1) if total > 1 else np.zeros(total)
    # Gaze is left out: looking aside is no expression.
    values[:, list(REGIONS["gaze"])] = 0.0
    cost = np.abs(values).sum(1) + performance.fps * 0.1 * speed
    count = max(1, round(total * _CALM_SHARE)) if count is None else min(max(count, 1), total)
    return np.sort(np.argsort(cost, kind="stable")[:count])


def calibrate_neutral(performance: Performance, frames: Sequence[int] | np.ndarray, head: bool = True) -> Performance:
    """Make the face of the chosen frames the neutral one.

    With n the median of a weight over these frames, w becomes max(0, (w - n) / (1 - n)): the resting face goes to zero and a
    full expression stays at one. Expression coefficients lose their median; rotations become relative to the median rotation.

    Args:
        performance: Any.
        frames: Frame numbers in which the actor rests.
        head: Also calibrate the head's and the eyes' rotations.

    Raises:
        ShapeError: No frame, or one that does not exist.
    """
    chosen = np.asarray(list(frames), np.int64)
    if chosen.size == 0 or chosen.min() < 0 or chosen.max() >= performance.frame_count:
        raise ShapeError(f"Neutral frames must be some of 0 to {performance.frame_count - 1}; choose at least one.")
    neutral = np.clip(np.median(performance.weights[chosen], axis=0), 0.0, _MAX_OFFSET)
    changes: dict[str, Any] = {"weights": np.maximum((performance.weights - neutral) / (1.0 - neutral), 0.0)}
    if performance.expression is not None:
        changes["expression"] = performance.expression - np.median(performance.expression[chosen], axis=0)
    if head:
        for name in performance.rotation_names():
            angles = getattr(performance, name).astype(np.float64)
            matrices = euler_to_matrix(angles)
            rest = euler_to_matrix(np.median(angles[chosen], axis=0))
            changes[name] = unwrap_euler(matrix_to_euler(rest.T @ matrices))
    return replace(performance, **changes)


def clamp(performance: Performance) -> Performance:
    """Limit ARKit weights to 0..1."""
    return replace(performance, weights=np.clip(performance.weights, 0.0, 1.0))


def range_warnings(weights: np.ndarray) -> list[str]:
    """One sentence about ARKit weights [T, 52] outside 0..1, none where all are inside."""
    low, high = weights.min(0), weights.max(0)
    outside = np.flatnonzero((low < _RANGE[0]) | (high > _RANGE[1]))
    if outside.size == 0:
        return []
    listed = ", ".join(f"{ARKIT_NAMES[i]} ({low[i]:.2f} to {high[i]:.2f})" for i in outside[:_MAX_LISTED])
    more = f" and {outside.size - _MAX_LISTED} more" if outside.size > _MAX_LISTED else ""
    return [f"Weights outside 0..1: {listed}{more}."]
