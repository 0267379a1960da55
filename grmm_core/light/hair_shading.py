"""Hair in light: Kajiya and Kay's strands (1989), shaded by where on the head they are.

A strand lights up where it lies across the light; a mass of them is bright on the lamp's side and dark on the other. Highlights
stand where the strand mirrors the lamp, wide along the head and narrow along the strand.
"""

from __future__ import annotations

import numpy as np

from .lamps import Lamp, arriving
from .shading import Response, Transport
from .surroundings import BANDS, basis

_WANDER = 0.35  # how far light reaches around a mass of hair
_LOBES = ((120.0, 0.030), (18.0, 0.012))  # exponent and strength: reflected at the surface, and from inside
_THROUGH = 0.5  # of the light of a lamp behind: what comes through the rim


def strand_transport(
    lamps: tuple[Lamp, ...], points: np.ndarray, tangents: np.ndarray, seen: list[np.ndarray], centre: np.ndarray,
    eye: np.ndarray, response: Response = Response(),  # noqa: B008 - frozen
) -> Transport[np.ndarray]:  # fmt: skip
    """Work out what arrives at pieces of strands; `shading.transport` for skin.

    Args:
        lamps: In the points' axes.
        points: [N, 3] metres.
        tangents: Unit vectors along the strands, either way, [N, 3].
        seen: Which part of each lamp they see, L times [N].
        centre: Of the head, [3] metres.
        eye: The viewer's place, [3] metres.
        response: Factors.
    """
    outward = points - centre
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    view = eye - points
    view = view / np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
    rim = np.clip(1.0 - np.abs((outward * view).sum(1)), 0.0, 1.0) ** 2
    diffuse, highlights = [], []
    for lamp, part in zip(lamps, seen, strict=True):
        towards, strength = arriving(lamp, points)
        across = np.sqrt(np.clip(1.0 - (tangents * towards).sum(1) ** 2, 0.0, 1.0))
        facing = np.clip(((outward * towards).sum(1) + _WANDER) / (1.0 + _WANDER), 0.0, 1.0)
        behind = _THROUGH * rim * np.clip(-(view * towards).sum(1), 0.0, 1.0)
        amount = (across * (facing * part + behind) * strength * response.intensity)[:, None]
        diffuse.append(np.broadcast_to(amount, (len(points), 3)))
        half = towards + view
        half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
        mirrored = np.clip(1.0 - (tangents * half).sum(1) ** 2, 0.0, 1.0)
        shine = sum(weight * mirrored ** (0.5 * power) for power, weight in _LOBES)
        highlights.append(shine * facing * part * strength * (response.gloss * response.intensity))
    count = len(points)
    return Transport(
        np.stack(diffuse).astype(np.float32) if diffuse else np.zeros((0, count, 3), np.float32),
        np.stack(highlights).astype(np.float32) if highlights else np.zeros((0, count), np.float32),
        (basis(outward) * BANDS * response.intensity).astype(np.float32),
        np.zeros((count, 9), np.float32),
    )
