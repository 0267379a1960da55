"""A scene's light on Gaussians at a glance: no shadows, no highlights, a normal from the Gaussian's own shape. Numpy only.

For viewports that draw splats of changing scenes: a few milliseconds for a head, beside the seconds' fraction of `shading`.
"""

from __future__ import annotations

import numpy as np

from ..geometry.rotations import quaternion_to_matrix
from .lamps import STUDIO, Lighting, arriving
from .relight import to_display, to_linear
from .shading import Response, ratio, reached

_WRAP = 0.25  # beyond the terminator: shadows' soft edges, as scattering and hair have them
_OUTWARDS = 0.35  # how much a normal is that of a ball: strands have none of their own


def rough_normals(means: np.ndarray, quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Outward normals of Gaussians of a head in its own axes, [N, 3] float32.

    Args:
        means: [N, 3] metres.
        quats: wxyz, [N, 4].
        scales: [N, 3] metres.
    """
    out = means / np.maximum(np.linalg.norm(means, axis=1, keepdims=True), 1e-9)
    rows, thin = np.arange(len(means)), scales.argmin(1)
    ordered = np.sort(scales, axis=1)
    axis = quaternion_to_matrix(quats)[rows, :, thin]
    axis = axis * np.where((axis * out).sum(1, keepdims=True) < 0.0, -1.0, 1.0)
    flat = 1.0 - ordered[:, :1] / np.maximum(ordered[:, 1:2], 1e-12)  # 0 of a strand, which is round
    normal = flat * axis + _OUTWARDS * out
    return (normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-9)).astype(np.float32)


def roughly_lit(
    colors: np.ndarray, means: np.ndarray, normals: np.ndarray, lighting: Lighting, response: Response
) -> np.ndarray:  # fmt: skip
    """Colors that were learned under the studio's rig in another light, display sRGB, [N, 3] float32.

    Args:
        colors: Display sRGB, [N, 3].
        means: [N, 3] metres.
        normals: Outward unit normals, [N, 3].
        lighting: In the same axes.
        response: Of the avatar; its intensity counts.
    """
    if not len(colors):
        return np.zeros((0, 3), np.float32)
    light, rig = (_irradiance(each, means, normals) for each in (lighting, STUDIO))
    found = to_linear(np.asarray(colors, np.float32)) * ratio(light * np.float32(response.intensity), reached(rig))
    return np.asarray(to_display(found)).astype(np.float32)


def _irradiance(lighting: Lighting, means: np.ndarray, normals: np.ndarray) -> np.ndarray:
    total = np.zeros((len(means), 3), np.float32)
    if lighting.surroundings is not None:
        total += np.maximum(lighting.surroundings.irradiance(normals), 0.0)
    for lamp in lighting.strongest(tuple(means.mean(0))):
        towards, strength = arriving(lamp, means)
        cosine = np.maximum((normals * towards).sum(1) + _WRAP, 0.0) / (1.0 + _WRAP) ** 2
        total += (cosine * strength)[:, None].astype(np.float32) * np.asarray(lamp.color, np.float32)
    return total
