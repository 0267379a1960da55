"""How people's faces rest: what the mean of the open head's people lacks of it, and what some people lack.

Its lips are thicker than people's, corners of its mouth lower and brows higher (docs/fitting_measured.md, "Faces at rest"), so
that people looked sullen, as if they pouted, and surprised. And lips of people who are drawn at random stood open beside the
middle, where nothing was learned of what is behind them.

Used by people who are drawn at random and by fits. Needs numpy only.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from ..controls.names import ARKIT_NAMES
from .head_model import HeadModel

# Heights between MediaPipe's landmarks (a mean of some, minus a mean of others): what people's mean has more of them than the
# model's, over the distance between the middles of the eyes.
RESTING = (
    ((66, 105, 296, 334), (33, 133, 263, 362), -0.03),  # brows above the eyes
    ((159, 386), (145, 374), 0.0),  # between the lids
    ((0,), (13,), -0.035),  # upper lip
    ((14,), (17,), -0.035),  # lower lip
    ((13,), (14,), 0.0),  # between them
    ((13, 14), (61, 291), -0.018),  # the lips' middle above the corners
)
_EYES = ((33, 133), (362, 263))
_LIPS = ((312, 317), (82, 87), (311, 402), (81, 178), (310, 318), (80, 88))
"""Of MediaPipe's landmarks, the inner edges of the upper and the lower lip, one above the other."""
_SOFT = 0.15  # how far short of that they may stay for a smaller movement: made exact, the edge of the lower lip waves
_APART = 2e-4  # metres by which lips may stand farther apart than people's usually do
_RIDGE = 1e-4  # square metres of all vertices for the square of a coefficient


@lru_cache(maxsize=4)
def usual_shape(head: HeadModel) -> np.ndarray:
    """Shape coefficients that people's mean has, [S], read only: thinner lips, higher corners and lower brows than the model's.

    The smallest movement of the skin that changes the heights of `RESTING` by what they say. Zero for heads that are not of
    the open head's people, such as FLAME, whose mean is that of people.
    """
    usual = np.zeros(head.shape_count)
    if head.landmarks478 is not None and set(head.expression_names) & set(ARKIT_NAMES):
        usual = _rested(head)
    usual.flags.writeable = False
    return usual


def rested(head: HeadModel, shape: np.ndarray) -> np.ndarray:
    """Shape coefficients [S] of a person drawn about the model's mean, as one drawn about people's, whose lips are shut.

    Lips stand no farther apart at rest than the usual ones, by the smallest movement of the skin that brings them together.
    Other heads than the open head's are left alone.
    """
    usual = usual_shape(head)
    if not usual.any():
        return shape
    shape = shape + usual
    above, below = np.array(_LIPS).T
    _, moved = _moved(head)
    gaps = moved[above] - moved[below]  # [pairs, S]
    wider = np.maximum(gaps @ (shape - usual) - _APART, 0.0)
    return shape - _cheapest(head, gaps, _SOFT) @ wider


def _rested(head: HeadModel) -> np.ndarray:
    points, moved = _moved(head)
    eye = np.linalg.norm(np.subtract(*(points[list(side)].mean(0) for side in _EYES)))
    heights = np.stack([moved[list(above)].mean(0) - moved[list(below)].mean(0) for above, below, _ in RESTING])
    return _cheapest(head, heights) @ (eye * np.array([more for _, _, more in RESTING]))


def _moved(head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Landmarks of the mean head, [478, 3], and how high each coefficient moves them, [478, S]."""
    assert head.landmarks478 is not None
    triangles, barycentric = head.landmarks478
    moved = np.einsum("lk,lks->ls", barycentric, head.shape_dirs[head.faces[triangles], 1].astype(np.float64))
    return head.landmark_positions(head.v_template, 478).astype(np.float64), moved


def _cheapest(head: HeadModel, heights: np.ndarray, soft: float = 0.0) -> np.ndarray:
    """Coefficients that change each of some heights [H, S] by 1 and the others not, by the smallest movement, [S, H].

    With `soft` above 0 they do it less and less exactly.
    """
    directions = head.shape_dirs.astype(np.float64).reshape(-1, head.shape_count)
    cost = directions.T @ directions + _RIDGE * np.eye(head.shape_count)
    ways = np.linalg.solve(cost, heights.T)
    changed = heights @ ways
    found: np.ndarray = ways @ np.linalg.inv(changed + soft * np.diag(changed).mean() * np.eye(len(changed)))
    return found
