"""From what an avatar did, frame by frame, to a performance: the way back from `Performance.controls`.

Called by the exporters. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..controls.frame import Controls, ExpressionBasis, arkit_weights, resolve
from ..controls.names import ARKIT_NAMES, JOINT_NAMES
from ..geometry.rotations import euler_to_matrix, matrix_to_euler, unwrap_euler
from .types import Performance

_TINY = 1e-5  # radians or weight: what counts as never moved
_EYE_LOOKS = [k for k, name in enumerate(ARKIT_NAMES) if name.startswith("eyeLook")]


def record(controls: Sequence[Controls], times: np.ndarray, fps: float, head: ExpressionBasis | None) -> Performance:
    """Return controls as ARKit weights with head, jaw and eye rotations.

    Mixtures become the ARKit shapes that they are made of. The eyes' rotations are whole: bones and eyeLook shapes together, as
    Live Link Face records them. What the format cannot hold is a warning.

    Args:
        controls: Of each frame.
        times: Seconds, [T].
        fps: Frames a second.
        head: Of the avatar; None for one whose eyes only bones turn.
    """
    weights = np.stack([arkit_weights(frame) for frame in controls])
    poses = np.stack([frame.pose for frame in controls]).astype(np.float64)  # [T, 5, 3]
    warnings = []
    if any(frame.expression.size and np.abs(frame.expression).max() > _TINY for frame in controls):
        warnings.append("Raw expression coefficients are animated; ARKit weights cannot hold them and they were left out.")
    whole_eyes = poses[:, 3:]
    if head is not None:
        whole_eyes = np.stack([resolve(frame, head).pose[3:] for frame in controls])
        if np.abs(poses[:, 3:]).max() > _TINY and np.abs(weights[:, _EYE_LOOKS]).max() > _TINY:
            warnings.append("Eye bones and eyeLook shapes are both animated; import the file with the eyes from its rotations.")
    moved = {name: np.abs(poses[:, joint]).max() > _TINY for joint, name in enumerate(JOINT_NAMES)}
    turned = None
    if moved["root"] or moved["neck"]:
        turned = unwrap_euler(matrix_to_euler(euler_to_matrix(poses[:, 0]) @ euler_to_matrix(poses[:, 1])))
    eyes = [whole_eyes[:, side] if np.abs(whole_eyes[:, side]).max() > _TINY else None for side in (0, 1)]
    return Performance(
        times, weights, fps, "scene", ARKIT_NAMES, head_rotation=turned, jaw_rotation=poses[:, 2] if moved["jaw"] else None,
        left_eye_rotation=eyes[0], right_eye_rotation=eyes[1], warnings=warnings,
    )  # fmt: skip


def record_expression(
    controls: Sequence[Controls], times: np.ndarray, fps: float, head: ExpressionBasis, gain: np.ndarray
) -> Performance:
    """Return controls as expression coefficients and joint rotations of a FLAME head, its own.

    Arguments as `record`, and the person's `head.arkit_gain`, [52].
    """
    found = [resolve(frame, head, gain) for frame in controls]
    poses = np.stack([frame.pose for frame in found]).astype(np.float64)
    return Performance(
        times, np.zeros((len(found), len(ARKIT_NAMES)), np.float32), fps, "scene", head_rotation=poses[:, 0],
        neck_rotation=poses[:, 1], jaw_rotation=poses[:, 2], left_eye_rotation=poses[:, 3], right_eye_rotation=poses[:, 4],
        expression=np.stack([frame.expression for frame in found]), head_model="flame",
    )  # fmt: skip
