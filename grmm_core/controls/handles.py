"""Handles on the face: points that are dragged, and the expressions that each direction gives.

A handle sits at the mean of some of the 68 landmarks (iBUG order), so that it fits every head that has them. The right side is
the left one in a mirror. Needs numpy only; called by what draws handles in a viewport.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from .control import in_words, mirrored
from .table import CONTROLS

Direction = Literal["up", "down", "left", "right"]
"""Of the subject: left is the picture's right where the face looks at the camera."""
_OTHER: dict[Direction, Direction] = {"up": "up", "down": "down", "left": "right", "right": "left"}  # in a mirror
_OPPOSITE: dict[Direction, Direction] = {**_OTHER, "up": "down", "down": "up"}
_FAR = 0.05  # metres
_STRAY = 0.15  # of a drag's way along one axis that a hand strays from it
_MIRRORED_LANDMARKS = {
    **{k: 16 - k for k in range(17)}, **{k: 43 - k for k in range(17, 27)}, **{k: 66 - k for k in range(31, 36)},
    **{k: 81 - k for k in (36, 37, 38, 39, 42, 43, 44, 45)}, **{40: 47, 41: 46, 46: 41, 47: 40},
    **{k: 102 - k for k in range(48, 55)}, **{k: 114 - k for k in range(55, 60)},
}  # fmt: skip


@dataclass(frozen=True)
class Handle:
    """A point of the face that is dragged.

    Attributes:
        name: Identifier, such as "brow_outer_left".
        landmarks: Of the 68; it sits at their mean.
        moves: Direction to the expressions that it gives; each gets the same weight.
        reach: How far it is dragged for a weight of 1, metres.
        offset: From the landmarks to where it is shown, so that neighbours do not cover each other: up, metres.
    """

    name: str
    landmarks: tuple[int, ...]
    moves: Mapping[Direction, tuple[str, ...]]
    reach: float = 0.03
    offset: float = 0.0

    @property
    def label(self) -> str:
        """Name in words."""
        return in_words(self.name)

    @property
    def expressions(self) -> tuple[str, ...]:
        """Every expression that it can give, each once."""
        return tuple(dict.fromkeys(name for names in self.moves.values() for name in names))

    @property
    def region(self) -> str:
        """Region of the face."""
        return CONTROLS[self.expressions[0]].region

    @property
    def partner(self) -> str:
        """Name of the handle of the other side; its own for one in the middle."""
        return _mirrored_name(self.name)

    def weights(self, start: Mapping[str, float], sideways: float, up: float) -> dict[str, float]:
        """Return the weights of its expressions after a drag, each within 0..1.

        What pulls the other way goes back to rest first: a smile that is dragged down fades before the corner frowns.

        Args:
            start: Weight of each of `expressions` when the drag began.
            sideways: To the subject's left, metres.
            up: Upwards, metres.
        """
        result = {name: float(start[name]) for name in self.expressions}
        sideways, up = _beyond(sideways, _STRAY * abs(up)), _beyond(up, _STRAY * abs(sideways))
        ways: tuple[Direction, ...] = ("left" if sideways > 0.0 else "right", "up" if up > 0.0 else "down")
        for ahead, moved in zip(ways, (sideways, up), strict=True):
            step = abs(moved) / self.reach
            forth = self.moves.get(ahead, ())
            back = [name for name in self.moves.get(_OPPOSITE[ahead], ()) if name not in forth]
            used = max((result[name] for name in back), default=0.0)
            for name in back:
                result[name] = max(result[name] - step, min(result[name], 0.0))
            for name in forth if step > used else ():
                result[name] = min(max(result[name], 0.0) + step - used, max(1.0, result[name]))
        return result


def _beyond(value: float, margin: float) -> float:
    return math.copysign(max(abs(value) - margin, 0.0), value)


def _mirrored_name(name: str) -> str:
    stem, _, side = name.rpartition("_")
    other = {"left": "right", "right": "left"}.get(side)
    return f"{stem}_{other}" if other else name


def _mirror(handle: Handle) -> Handle:
    moves = {_OTHER[way]: tuple(mirrored(name) for name in names) for way, names in handle.moves.items()}
    landmarks = tuple(_MIRRORED_LANDMARKS[k] for k in handle.landmarks)
    return Handle(_mirrored_name(handle.name), landmarks, moves, handle.reach, handle.offset)


def _all() -> Iterator[Handle]:
    for handle in (
        Handle("brow_inner_left", (22, 23), {"up": ("browInnerUp",), "down": ("browDownLeft",)}),
        Handle("brow_outer_left", (25, 26), {"up": ("browOuterUpLeft",), "down": ("browDownLeft",)}),
        Handle("upper_lid_left", (43, 44), {"up": ("eyeWideLeft",), "down": ("eyeBlinkLeft",)}, offset=0.005),
        Handle("lower_lid_left", (46, 47), {"up": ("eyeSquintLeft",)}, offset=-0.005),
        Handle("gaze_left", (42, 43, 44, 45, 46, 47), {
            "up": ("eyeLookUpLeft", "eyeLookUpRight"), "down": ("eyeLookDownLeft", "eyeLookDownRight"),
            "left": ("eyeLookOutLeft", "eyeLookInRight"), "right": ("eyeLookInLeft", "eyeLookOutRight"),
        }),
        Handle("cheek_left", (14, 35), {"up": ("cheekSquintLeft",), "left": ("cheekPuff",)}),
        Handle("nose_left", (35,), {"up": ("noseSneerLeft",)}),
        Handle("upper_lip_left", (52, 53), {"up": ("mouthUpperUpLeft",), "down": ("mouthRollUpper",)}),
        Handle("lower_lip_left", (55, 56), {"down": ("mouthLowerDownLeft",), "up": ("mouthRollLower",)}),
        Handle("mouth_corner_left", (54,), {
            "up": ("mouthSmileLeft",), "down": ("mouthFrownLeft",), "left": ("mouthStretchLeft",), "right": ("mouthPucker",),
        }),
    ):  # fmt: skip
        yield handle
        yield _mirror(handle)
    yield Handle("lips", (62, 66), {
        "left": ("mouthLeft",), "right": ("mouthRight",),
        "up": ("mouthShrugLower", "mouthShrugUpper"), "down": ("mouthFunnel",),
    })  # fmt: skip
    yield Handle("jaw", (8,), {"down": ("jawOpen",), "left": ("jawLeft",), "right": ("jawRight",)}, reach=_FAR)


HANDLES: dict[str, Handle] = {handle.name: handle for handle in _all()}
"""All handles by name."""
