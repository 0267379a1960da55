"""Heads that throw shadows on one another. Called by `compose`."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.libraries import to_numpy
from ..light.resting import casting_faces
from .evaluator import Evaluator, Inputs, OpenAvatar

Body = tuple[OpenAvatar, Inputs, np.ndarray]
"""Who, the inputs of the frame, and the placement, [4, 4]."""


def mutual_shadows(placed: Sequence[Body | None], evaluator: Evaluator) -> list[np.ndarray | None]:
    """What throws shadows on each of some instances: the meshes of all others. Their hair throws none.

    Args:
        placed: Avatars, and None for what is none.
        evaluator: Of the session.

    Returns:
        Corners of triangles in the world, [T, 3, 3] float32 metres; None where nothing else is.
    """
    if sum(item is not None for item in placed) < 2:
        return [None] * len(placed)
    heads: list[np.ndarray] = []
    for item in placed:
        corners = np.zeros((0, 3, 3), np.float32)
        if item is not None:
            target, inputs, matrix = item
            corners = to_numpy(evaluator.mesh(target, inputs).vertices)[casting_faces(target.model.head_model)[0]]
            corners = (corners @ matrix[:3, :3].T + matrix[:3, 3]).astype(np.float32)
        heads.append(corners)
    return [np.concatenate([head for k, head in enumerate(heads) if k != own]) for own in range(len(heads))]
