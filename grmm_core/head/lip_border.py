"""Where lips end, as smooth lines through the landmarks of their borders. Needs numpy only.

The open head's region of lips is no border of theirs: it lies up to 1.6 mm outside, has no bow in the middle, and lacks a
vertex on either side of it. Who paints lips takes their borders from here; landmarks of photos lie on them as well.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from .head_model import HeadModel

# MediaPipe's landmarks along the upper border of the upper lip and the lower one of the lower lip
_UPPER = (61, 185, 40, 39, 37, 0, 267, 269, 270, 409, 291)
_LOWER = (61, 146, 91, 181, 84, 17, 314, 405, 321, 375, 291)
_SMOOTH = 0.0016  # metres along the border within which it is a mean
_NODES = 81
_CORNERS = 0.76, 0.92  # of the half width of the mouth: between them the border fades
_DEEP = 0.006  # metres behind it, where no lip is seen


class LipBorder(NamedTuple):
    """The border between a lip and the skin beyond, on the template, from the person's right to the left.

    Attributes:
        points: [K, 3] metres, evenly along x.
        up: 1 where the skin is above, -1 where it is below.
    """

    points: np.ndarray
    up: float

    def beyond(self, places: np.ndarray) -> np.ndarray:
        """Metres by which places [N, 3] lie beyond the border, [N]; below 0 on the lip."""
        x = self.points[:, 0]
        slope = np.gradient(self.points[:, 1], x)
        above = places[:, 1] - np.interp(places[:, 0], x, self.points[:, 1])
        found: np.ndarray = self.up * above / np.sqrt(1.0 + np.interp(places[:, 0], x, slope) ** 2)
        return found

    def share(self, places: np.ndarray, edge: float) -> np.ndarray:
        """How much of places [N, 3] near the border is lip, [N]: from 1 to 0 within `edge` metres on both sides of it."""
        found: np.ndarray = (0.5 - 0.5 * self.beyond(places) / edge).clip(0.0, 1.0)
        return found

    def near(self, places: np.ndarray, whole: float, nothing: float) -> np.ndarray:
        """Whether places [N, 3] are about the border, [N]: 1 within one distance, 0 from another on, in corners and inside."""
        apart, aside = np.abs(self.beyond(places)), np.abs(places[:, 0]) / self.points[-1, 0]
        behind = np.interp(places[:, 0], self.points[:, 0], self.points[:, 2]) - places[:, 2]
        found: np.ndarray = falls(apart, whole, nothing) * falls(aside, *_CORNERS) * (np.abs(behind) < _DEEP)
        return found


def lip_borders(head: HeadModel) -> tuple[LipBorder, ...]:
    """The borders of the upper and the lower lip, alike on both sides; none on heads without landmarks of them."""
    if head.landmarks478 is None:
        return ()
    marks = head.landmark_positions(head.v_template, 478).astype(float)
    return LipBorder(_along(marks[list(_UPPER)]), 1.0), LipBorder(_along(marks[list(_LOWER)]), -1.0)


def _along(marks: np.ndarray) -> np.ndarray:
    """A smooth line [K, 3] through landmarks [L, 3], from the person's right to the left, and their mirror images."""
    both = 0.5 * (marks + marks[::-1] * (-1.0, 1.0, 1.0))
    x = np.linspace(both[0, 0], both[-1, 0], _NODES)
    line = np.stack([x, *(np.interp(x, both[:, 0], both[:, k]) for k in (1, 2))], 1)
    near = np.exp(-0.5 * ((x[:, None] - x) / _SMOOTH) ** 2)
    line[:, 1:] = near @ line[:, 1:] / near.sum(1, keepdims=True)
    return line


def falls(values: np.ndarray, whole: float, nothing: float) -> np.ndarray:
    """1 below the first limit, 0 from the second on."""
    found: np.ndarray = ((nothing - values) / (nothing - whole)).clip(0.0, 1.0)
    return found
