"""What surfaces mirror: of lamps by two lobes, of light from all around by their share. Needs numpy only."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from .materials import Materials

_UPRIGHT = 0.1  # cosine between normal and half vector below which no highlight is left that could change


def lobes(
    materials: Materials, normals: np.ndarray, view: np.ndarray, facing: np.ndarray, towards: np.ndarray, cosine: np.ndarray,
    size: float,
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Two GGX lobes (Walter et al. 2007) times the cosine, widened by a lamp's size, and their change with the normal.

    The square of a lobe's width is its own and the lamp's, and a wider one is lower by as much. Where the half vector stands m
    beside the normal, a tangent, the logarithm of a lobe of width a changes by 4 m / (a^2 + m^2) for each radian that the
    normal tilts towards it, and falls to all sides by 2 a^2 / (a^2 + m^2)^2 for each square.

    Args:
        materials: Of N points.
        normals: [N, 3].
        view: Unit vectors to the viewer, [N, 3].
        facing: Cosine to it, [N].
        towards: Unit vectors to the lamp, [N, 3].
        cosine: To it, no less than 0, [N].
        size: Of the lamp as it widens lobes, radians.

    Returns:
        The lobes, [N], and, times these, change by tilt in space (3) and fall, [N, 4].
    """
    half = towards + view
    half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
    tilt = np.clip((normals * half).sum(1), 0.0, 1.0)
    fresnel = materials.reflectance + (1.0 - materials.reflectance) * (1.0 - np.clip((view * half).sum(1), 0.0, 1.0)) ** 5
    upright = np.maximum(tilt, _UPRIGHT)
    beside, away = half / upright[:, None] - normals, 1.0 / upright**2 - 1.0
    total, change = np.zeros(len(normals)), np.zeros((len(normals), 4))
    for roughness, share in ((materials.smooth, materials.share), (materials.rough, 1.0 - materials.share)):
        squares = np.minimum(roughness**4 + size * size, 1.0)
        spread = squares / (np.pi * (tilt * tilt * (squares - 1.0) + 1.0) ** 2)
        k = 0.5 * np.sqrt(squares)
        visible = 1.0 / ((cosine * (1.0 - k) + k) * (facing * (1.0 - k) + k))
        lobe, wide = share * spread * visible, squares + away
        total += lobe
        change += (lobe / wide)[:, None] * np.concatenate([4.0 * beside, (2.0 * squares / wide)[:, None]], 1)
    factor = 0.25 * fresnel * materials.shine * cosine
    return total * factor, change * factor[:, None]


def mirrored_share(materials: Materials, facing: np.ndarray) -> np.ndarray:
    """Share of even light from all around that surfaces mirror to a viewer, [N]; `facing` is the cosine to it, [N].

    The GGX lobe over all directions, fitted (Karis 2014): a rough surface mirrors much less at its outline than a smooth one.
    """
    rough = materials.share * materials.smooth + (1.0 - materials.share) * materials.rough
    narrow = 1.0 - rough
    at_outline = np.minimum(narrow * narrow, np.exp2(-9.28 * facing)) * narrow + 0.0425 - 0.0275 * rough
    result: np.ndarray = (
        materials.reflectance * (1.04 - 0.572 * rough - 1.04 * at_outline) + 1.04 * at_outline - 0.04 + 0.022 * rough
    )
    return np.maximum(result, 0.0)
