"""The border of the upper lip as one smooth line. Needs numpy only.

The open head's region of lips has a gap of one vertex on either side of its middle, and interpolated over faces its border
goes in steps. Who paints lips takes them from here.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .head_model import HeadModel

_SURROUNDED = 0.6  # share of a vertex's neighbours that are lips, from which on it is one
_SMOOTH = 0.0012  # metres along the border within which it is a mean
_NODES = 81
_CORNERS = 0.80, 0.94  # of the half width of the lip: between them the border fades
_DEEP = 0.006  # metres behind it, where no lip is seen


class UpperLip(NamedTuple):
    """The border between the upper lip and the skin above, on the template, from the person's right to the left.

    Attributes:
        points: [K, 3] metres, evenly along x.
    """

    points: np.ndarray

    def beyond(self, places: np.ndarray) -> np.ndarray:
        """Metres by which places [N, 3] lie above the border, [N]; below 0 on the lip."""
        x = self.points[:, 0]
        slope = np.gradient(self.points[:, 1], x)
        above = places[:, 1] - np.interp(places[:, 0], x, self.points[:, 1])
        found: np.ndarray = above / np.sqrt(1.0 + np.interp(places[:, 0], x, slope) ** 2)
        return found

    def share(self, places: np.ndarray, edge: float) -> np.ndarray:
        """How much of places [N, 3] near the border is lip, [N]: from 1 to 0 within `edge` metres on both sides of it."""
        found: np.ndarray = (0.5 - 0.5 * self.beyond(places) / edge).clip(0.0, 1.0)
        return found

    def near(self, places: np.ndarray, whole: float, nothing: float) -> np.ndarray:
        """Whether places [N, 3] are about the border, [N]: 1 within one distance, 0 from another on, in corners and inside."""
        apart, aside = np.abs(self.beyond(places)), np.abs(places[:, 0]) / self.points[-1, 0]
        found: np.ndarray = _falls(apart, whole, nothing) * _falls(aside, *_CORNERS) * (np.abs(self.behind(places)) < _DEEP)
        return found

    def behind(self, places: np.ndarray) -> np.ndarray:
        """Metres by which places [N, 3] lie behind the border, [N]."""
        found: np.ndarray = np.interp(places[:, 0], self.points[:, 0], self.points[:, 2]) - places[:, 2]
        return found


def whole_lips(head: HeadModel) -> np.ndarray:
    """Which vertices are lips, with those that lips surround, [V] bool."""
    lips, count = head.marked("lips"), len(head.v_template)
    edges = np.unique(np.sort(head.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)
    both, other = edges.T.ravel(), edges[:, ::-1].T.ravel()
    share = np.bincount(both, lips[other], count) / np.maximum(np.bincount(both, minlength=count), 1)
    found: np.ndarray = lips | (share > _SURROUNDED) & ~head.marked("mouth_interior")
    return found


def upper_lip(head: HeadModel) -> UpperLip | None:
    """The border of the upper lip, as on both sides in the mean; None on heads without lips."""
    inside, lining = whole_lips(head), head.marked("mouth_interior")
    edges = np.unique(np.sort(head.faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)
    edges = edges[(inside[edges].sum(1) == 1) & ~lining[edges].any(1)]
    if not len(edges):
        return None
    border = head.v_template[edges].mean(1)
    border = border[border[:, 1] > border[:, 1].mean()]
    border = np.concatenate([border, border * (-1.0, 1.0, 1.0)])
    x = np.linspace(border[:, 0].min(), border[:, 0].max(), _NODES)
    near = np.exp(-0.5 * ((x[:, None] - border[:, 0]) / _SMOOTH) ** 2)
    points = near @ border / near.sum(1, keepdims=True)
    return UpperLip(np.stack([x, points[:, 1], points[:, 2]], 1))


def _falls(values: np.ndarray, whole: float, nothing: float) -> np.ndarray:
    """1 below the first limit, 0 from the second on."""
    found: np.ndarray = ((nothing - values) / (nothing - whole)).clip(0.0, 1.0)
    return found
