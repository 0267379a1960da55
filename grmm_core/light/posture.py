"""How a posed head lies beside itself at rest, by the joint that turns it: what an expression does to the scalp is no turn."""

from __future__ import annotations

import functools

import numpy as np

from ..controls.names import JOINT_NAMES
from ..geometry.boxes import box_around
from ..geometry.rotations import euler_to_matrix
from ..head.head_model import HeadModel
from ..head.skinning import joint_transforms
from .lamps import Lamp, Lighting

_NECK = JOINT_NAMES.index("neck")
_PLACES = 5  # of numbers that a turn is known by


class Posture:
    """A head at rest and posed.

    Args:
        head: Head model.
        shape: Its coefficients, [<=S].
        still: Pose at rest, XYZ Euler angles of the joints, [5, 3] radians.
        pose: Posed, likewise.
        rest: Vertices at rest, [V, 3] metres.
    """

    def __init__(self, head: HeadModel, shape: np.ndarray, still: np.ndarray, pose: np.ndarray, rest: np.ndarray) -> None:
        self._rest, self._still, self._posed = rest, _placed(head, shape, still), _placed(head, shape, pose)
        self._lamps: dict[tuple[Lamp, bytes], Lamp] = {}

    @functools.cached_property
    def turn(self) -> np.ndarray:
        """From the axes of the head at rest to those of the posed one, [3, 3]."""
        turn: np.ndarray = self._posed[:3, :3] @ self._still[:3, :3].T
        return turn

    @functools.cached_property
    def to_rest(self) -> np.ndarray:
        """From the axes of the posed head to those of the head at rest, [4, 4]."""
        back: np.ndarray = self._still @ np.linalg.inv(self._posed)
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


def _placed(head: HeadModel, shape: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """What the neck's joint does to the head in a pose [5, 3], [4, 4]."""
    rotations, joints = euler_to_matrix(np.asarray(pose, np.float64)), head.joints(shape).astype(np.float64)
    placed = np.eye(4)
    placed[:3] = joint_transforms(rotations, joints, head.parents.tolist())[_NECK]
    return placed
