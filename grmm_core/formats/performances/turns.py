"""Head and eye angles of recording programs: pitch, yaw and roll to the rotations of `Performance`, and back.

Pitch turns about x (the subject's left), yaw about y (up), roll about z (forward), R = R_yaw R_pitch R_roll, all right-handed:
pitch nods down, yaw turns to the subject's left, roll lifts the left ear. Programs differ in their signs; each reader says what
its own are, `flips` lets a user turn single axes round. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...files.format import Option
from ...geometry.rotations import euler_to_matrix, matrix_to_euler, unwrap_euler

FLIPS = tuple(
    Option(f"flip_{axis}", f"Flip Head {axis.capitalize()}", f"Turn the recorded head the other way: {what}", False)
    for axis, what in (("pitch", "up and down"), ("yaw", "left and right"), ("roll", "tilted to one shoulder and the other"))
)
"""Options of reading, in the order of the angles."""
_MIN_CORRELATION = 0.2


def to_euler(angles: np.ndarray) -> np.ndarray:
    """Rotations of `Performance` (XYZ Euler angles) from pitch, yaw, roll [T, 3] radians."""
    turns = [euler_to_matrix(np.where(np.arange(3) == axis, angles, 0.0)) for axis in (1, 0, 2)]
    return unwrap_euler(matrix_to_euler(turns[0] @ turns[1] @ turns[2]))


def from_euler(euler: np.ndarray) -> np.ndarray:
    """Pitch, yaw, roll [T, 3] radians of rotations of `Performance`: the inverse of `to_euler`."""
    matrix = euler_to_matrix(np.asarray(euler, np.float64))
    pitch = np.arcsin(np.clip(-matrix[:, 1, 2], -1.0, 1.0))
    yaw = np.arctan2(matrix[:, 0, 2], matrix[:, 2, 2])
    roll = np.arctan2(matrix[:, 1, 0], matrix[:, 1, 1])
    return unwrap_euler(np.stack([pitch, yaw, roll], 1))


def match_eye_signs(angles: np.ndarray, side: str, weights: np.ndarray) -> None:
    """Flip an eye's pitch and yaw [T, 3] where they contradict the eyeLook shapes of the same frames, in place.

    Args:
        angles: Pitch, yaw, roll.
        side: "Left" or "Right".
        weights: ARKit weights, [T, 52].
    """
    ways = ("Up", "Down", "In", "Out")
    look = {way: weights[:, ARKIT_NAMES.index(f"eyeLook{way}{side}")].astype(np.float64) for way in ways}
    outward = look["Out"] - look["In"]
    directions = (look["Down"] - look["Up"], outward if side == "Left" else -outward)  # positive x down, positive y to the left
    for axis, direction in enumerate(directions):
        spread = angles[:, axis].std() * direction.std()
        if spread > 0:
            correlation = np.mean((angles[:, axis] - angles[:, axis].mean()) * (direction - direction.mean())) / spread
            if correlation < -_MIN_CORRELATION:
                angles[:, axis] *= -1.0
