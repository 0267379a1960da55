"""How people's faces rest: what the mean of the open head's people lacks of it.

Its lips are thicker than people's, corners of its mouth lower and brows higher (docs/fitting_measured.md, "Faces at rest"), so
that people looked sullen, as if they pouted, and surprised.

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


def _rested(head: HeadModel) -> np.ndarray:
    points = head.landmark_positions(head.v_template, 478).astype(np.float64)
    eye = np.linalg.norm(np.subtract(*(points[list(side)].mean(0) for side in _EYES)))
    assert head.landmarks478 is not None
    triangles, barycentric = head.landmarks478
    moved = np.einsum("lk,lks->ls", barycentric, head.shape_dirs[head.faces[triangles], 1].astype(np.float64))  # [478, S]
    heights = np.stack([moved[list(above)].mean(0) - moved[list(below)].mean(0) for above, below, _ in RESTING])
    directions = head.shape_dirs.astype(np.float64).reshape(-1, head.shape_count)
    cost = directions.T @ directions + _RIDGE * np.eye(head.shape_count)
    cheapest = np.linalg.solve(cost, heights.T)  # [S, heights]
    return cheapest @ np.linalg.solve(heights @ cheapest, eye * np.array([more for _, _, more in RESTING]))
