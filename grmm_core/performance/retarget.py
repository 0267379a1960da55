"""From one head model to another: ARKit weights to expression coefficients and back, by least squares on vertices.

Both directions compare what the face does, not the numbers: vertex movements in metres, and joint turns as the path of a point
10 cm from the joint. Nobody in particular performs: ARKit shapes go as far as on the mean person. Needs numpy only.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from ..controls.names import ARKIT_NAMES, JOINT_NAMES
from ..errors import ShapeError
from ..head import HeadModel, arkit_gain
from ..jobs.progress import Share
from .types import Performance

_LEVER = 0.10  # metres from a joint to the surface that it moves
_RIDGE = 1e-4  # relative to the mean diagonal: keeps nearly parallel shapes from cancelling each other
_MAX_ITERATIONS = 2000
_TOLERANCE = 1e-5
_CHUNK = 4096
_MEAN = np.zeros(0, np.float32)  # shape of the mean person


def expression_features(head: HeadModel) -> np.ndarray:
    """What a unit of each expression component moves, [E, 3 V + 15] metres."""
    count = head.expression_dirs.shape[2]
    moves = np.asarray(head.expression_dirs, np.float64).reshape(-1, count).T
    turns = np.asarray(head.expression_pose, np.float64).reshape(count, -1) * _turn_weight(moves.shape[1])
    return np.concatenate([moves, turns], 1)


def _turn_weight(coordinates: int) -> float:
    """Weight of a radian: a twentieth of the vertices moves with the lever."""
    return _LEVER * (coordinates / 3 / 20) ** 0.5


def to_expression(performance: Performance, head: HeadModel, keep_weights: bool = False) -> Performance:
    """Turn ARKit weights into coefficients of `head`'s expression space, with its joint turns as rotations.

    The result has `expression`, jaw and eye rotations, and weights of zero, so that nothing moves twice.

    Args:
        performance: With ARKit weights.
        head: The target.
        keep_weights: Keep the weights beside them (for files that hold both).
    """
    weights = performance.weights.astype(np.float64) * arkit_gain(head, _MEAN)
    expression = weights @ np.asarray(head.arkit_to_expression, np.float64)  # [T, E]
    turns = np.einsum("te,ejk->tjk", expression, np.asarray(head.expression_pose, np.float64))
    turns += np.einsum("ta,ajk->tjk", weights, np.asarray(head.arkit_pose, np.float64))
    changes: dict[str, Any] = {}
    for joint, name in (("jaw", "jaw_rotation"), ("left_eye", "left_eye_rotation"), ("right_eye", "right_eye_rotation")):
        old = getattr(performance, name) if joint == "jaw" else None  # the eyes' own rotations repeat the eyeLook shapes
        turn = turns[:, JOINT_NAMES.index(joint)]
        changes[name] = turn if old is None else old + turn
    return replace(
        performance,
        weights=performance.weights if keep_weights else np.zeros_like(performance.weights),
        expression=expression.astype(np.float32),
        head_model="flame",
        recorded_shapes=performance.recorded_shapes if keep_weights else (),
        **changes,
    )


def to_arkit(performance: Performance, head: HeadModel, progress: Share | None = None) -> Performance:
    """Turn expression coefficients and jaw rotations of `head` into ARKit weights 0..1 that move its vertices most alike.

    Args:
        performance: With `expression` of `head`.
        head: The model that the coefficients belong to.
        progress: Called with the fraction done.

    Returns:
        A copy with weights; expression and jaw rotation are used up, the other rotations stay. `warnings` says how much of the
        movement the shapes could not follow.

    Raises:
        ShapeError: No expression, or more coefficients than the head has.
    """
    if performance.expression is None:
        raise ShapeError("This performance has no expression coefficients; it is in ARKit weights already.")
    count = head.expression_dirs.shape[2]
    width = performance.expression.shape[1]
    if width > count:
        raise ShapeError(
            f"The performance has {width} expression coefficients and the head {count}; choose its own head model."
        )
    features = expression_features(head)  # [E, F]
    shapes = np.asarray(head.arkit_to_expression, np.float64) @ features  # [52, F]
    shapes[:, -15:] += head.arkit_pose.reshape(len(ARKIT_NAMES), -1) * _turn_weight(features.shape[1] - 15)
    shapes *= arkit_gain(head, _MEAN)[:, None]
    gram, cross = shapes @ shapes.T, features[:width] @ shapes.T
    targets = np.asarray(performance.expression, np.float64) @ cross  # [T, 52]
    total = _squares(performance.expression, features[:width])
    if performance.jaw_rotation is not None:
        jaw = features.shape[1] - 15 + 3 * JOINT_NAMES.index("jaw")
        turned = np.asarray(performance.jaw_rotation, np.float64) * _turn_weight(features.shape[1] - 15)
        targets += turned @ shapes[:, jaw : jaw + 3].T
        total += (turned * turned).sum() + 2 * (turned * (performance.expression @ features[:width, jaw : jaw + 3])).sum()
    weights = bounded_least_squares(gram, targets, progress)
    residual = total - 2 * float((weights * targets).sum()) + float(np.einsum("ti,ij,tj->", weights, gram, weights))
    share = float(np.sqrt(max(residual, 0.0) / max(total, 1e-30)))
    warnings = [*performance.warnings, f"ARKit shapes follow the expression up to {100 * share:.0f} % of its movement."]
    return replace(
        performance,
        weights=weights.astype(np.float32),
        recorded_shapes=ARKIT_NAMES,
        expression=None,
        jaw_rotation=None,
        head_model="arkit",
        warnings=warnings,
    )


def _squares(coefficients: np.ndarray, features: np.ndarray) -> float:
    """Sum over frames of the squared movement."""
    values = np.asarray(coefficients, np.float64)
    return float(np.einsum("ti,ij,tj->", values, features @ features.T, values, optimize=True))


def bounded_least_squares(gram: np.ndarray, targets: np.ndarray, progress: Share | None = None) -> np.ndarray:
    """Weights 0..1 that minimise w^T G w - 2 w^T t for every frame, by accelerated projected gradient.

    Args:
        gram: G, [K, K], positive semidefinite.
        targets: t, [T, K].
        progress: Called with the fraction done.

    Returns:
        [T, K].
    """
    gram = gram + np.eye(gram.shape[0]) * _RIDGE * max(float(np.trace(gram)) / gram.shape[0], 1e-30)
    step = 1.0 / float(np.linalg.eigvalsh(gram)[-1])
    result = np.empty_like(targets)
    for start in range(0, targets.shape[0], _CHUNK):
        t = targets[start : start + _CHUNK]
        weights = np.zeros_like(t)
        ahead, momentum = weights, 1.0
        for _ in range(_MAX_ITERATIONS):
            updated = np.clip(ahead - step * (ahead @ gram - t), 0.0, 1.0)
            following = (1.0 + (1.0 + 4.0 * momentum * momentum) ** 0.5) / 2.0
            change = updated - weights
            # Restart where the momentum points uphill: keeps the fast rate on badly conditioned shapes.
            if float(((ahead - updated) * change).sum()) > 0:
                following, momentum = 1.0, 1.0
            ahead = updated + (momentum - 1.0) / following * change
            weights, momentum = updated, following
            if float(np.abs(change).max()) < _TOLERANCE:
                break
        result[start : start + _CHUNK] = weights
        if progress:
            progress(min(1.0, (start + _CHUNK) / targets.shape[0]))
    return result
