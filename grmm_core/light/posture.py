"""How a posed head lies beside itself at rest: by its rigid part, which hair grows on."""

from __future__ import annotations

import functools

import numpy as np

from ..geometry.boxes import box_around
from .lamps import Lamp, Lighting
from .transfer import turn_between

_PLACES = 5  # of numbers that a turn is known by: what an expression pulls at the scalp is no turn


class Posture:
    """A head at rest and posed.

    Args:
        rest: Vertices at rest, [V, 3] metres.
        posed: [V, 3] metres.
        rigid: Numbers of vertices of the rigid part, [K].
    """

    def __init__(self, rest: np.ndarray, posed: np.ndarray, rigid: np.ndarray) -> None:
        self._rest, self._parts = rest, (rest[rigid], posed[rigid])
        self._lamps: dict[tuple[Lamp, bytes], Lamp] = {}

    @functools.cached_property
    def turn(self) -> np.ndarray:
        """From the axes of the head at rest to those of the posed one, [3, 3]."""
        return turn_between(*self._parts)

    @functools.cached_property
    def to_rest(self) -> np.ndarray:
        """From the axes of the posed head to those of the head at rest, by the turn and the way of its rigid part, [4, 4]."""
        rest, posed = self._parts
        back = np.eye(4)
        back[:3, :3] = self.turn.T
        back[:3, 3] = rest.mean(0) - back[:3, :3] @ posed.mean(0)
        return np.round(back, _PLACES) + 0.0  # without negative zeros, which keys would tell apart

    @functools.cached_property
    def rest_box(self) -> tuple[np.ndarray, np.ndarray]:
        """Around the head at rest, in its axes: low and high, [3] each."""
        return box_around(self._rest)

    @functools.cached_property
    def middle(self) -> np.ndarray:
        """Of the rigid head, from where hair grows outwards, [3]: not of the mesh, whose jaw opens."""
        (low, high), back = self.rest_box, self.to_rest
        middle: np.ndarray = (0.5 * (low + high) - back[:3, 3]) @ back[:3, :3]
        return middle

    def moved(self, lamp: Lamp, to_space: np.ndarray) -> Lamp:
        """A lamp in other axes, which `to_space` [4, 4] leads to; kept."""
        key = lamp, to_space.tobytes()
        if key not in self._lamps:
            self._lamps[key] = Lighting((lamp,)).in_space(to_space).lamps[0]
        return self._lamps[key]
