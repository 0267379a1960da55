"""How people's mouths rest: what the mean of the open head's people lacks of it.

Corners of mouths lie lower than the middle of the lips by 0.036 of the distance of the eyes in the open head's people, by 0.018
in people on photos who do not smile (docs/fitting_measured.md, "Mouths at rest"), so that they looked sullen.

Used by people who are drawn at random and by fits. Needs numpy only.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from .head_model import HeadModel

SMILES = ("mouthSmileLeft", "mouthSmileRight")
RESTING = 0.15  # of a full smile, by which corners of mouths are higher in people than in the open head's people
_RIDGE = 1e-5  # square metres of all vertices for the square of a coefficient


@lru_cache(maxsize=4)
def usual_shape(head: HeadModel) -> np.ndarray:
    """Shape coefficients that people's mean has, [S], read only: corners of the mouth higher than in the model's mean.

    The shape directions hold a third of the movement of a smile: the corners, as far above the middle of the lips as the smile
    has them. Zero for heads without a smile of that name, such as FLAME, whose mean is that of people.
    """
    usual = np.zeros(head.shape_count)
    if set(SMILES) <= set(head.expression_names):
        usual = _lifted(head)
    usual.flags.writeable = False
    return usual


def _lifted(head: HeadModel) -> np.ndarray:
    smile = head.expression_dirs[..., [head.expression_index(name) for name in SMILES]].astype(np.float64).sum(-1)  # [V, 3]
    shapes = head.shape_dirs.astype(np.float64).reshape(-1, head.shape_count)
    return np.linalg.solve(shapes.T @ shapes + _RIDGE * np.eye(head.shape_count), shapes.T @ (RESTING * smile.reshape(-1)))
