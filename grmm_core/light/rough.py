"""A scene's light on Gaussians at a glance: no shadows, no highlights, one irradiance by normal for the whole head. Numpy only.

Lamps and surroundings together are nine coefficients a color (Ramamoorthi and Hanrahan 2001), so that a head costs a few
milliseconds: for viewports that draw splats of changing scenes. `shading` is the exact way.
"""

from __future__ import annotations

import functools
import itertools

import numpy as np

from .lamps import STUDIO, Lighting, arriving
from .shading import MAX_RATIO
from .surroundings import basis, sphere

_DIRECTIONS = 256
_RADIUS = 0.1  # metres of the ball that stands for a head
_WRAP = 0.25  # beyond the terminator: soft edges, as scattering and hair have them
_FLAT = 3.0  # how fast a thin Gaussian's axis is trusted
_BALL = 0.3  # how much every normal is that of a ball
_EVEN, _CELLS = 0.006, 1 << 22  # metres of the cells of `evened`; more of them than a head has are not worth it
_GAMMA = 2.2  # of display values, nearly


def rough_normals(means: np.ndarray, quats: np.ndarray, scales: np.ndarray) -> np.ndarray:
    """Outward normals of Gaussians of a head in its own axes, [N, 3] float32.

    Those of skin lie flat, with their last axis outwards. Round ones, such as strands, get a ball's.

    Args:
        means: [N, 3] metres.
        quats: wxyz, [N, 4].
        scales: [N, 3] metres.
    """
    flat = _flatness(scales)[:, None]
    w, x, y, z = (quats / np.linalg.norm(quats, axis=1, keepdims=True)).T
    outwards = np.stack([2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], -1)
    normal = flat * outwards + (1.0 - flat + _BALL) * _unit(means)
    found: np.ndarray = _unit(normal).astype(np.float32)
    return found


def evened(means: np.ndarray, scales: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Normals of a head, those of skin as they are in the mean around each place: its own lean this way and that, into spots.

    Args:
        means: [N, 3] metres.
        scales: [N, 3] metres.
        normals: Unit, [N, 3] float32.
    """
    skin = np.flatnonzero(_flatness(scales))
    if not len(skin):
        return normals
    result = normals.copy()
    result[skin] = _averaged(means[skin], normals[skin])
    return result


def _averaged(means: np.ndarray, normals: np.ndarray) -> np.ndarray:
    at = (means - means.min(0)) / np.float32(_EVEN) + 1.0  # a cell to spare on all sides
    size = at.max(0).astype(int) + 3
    if size.prod() > _CELLS:
        return normals
    nearest = np.ravel_multi_index(tuple(np.rint(at).astype(int).T), size)
    grid = np.stack([np.bincount(nearest, normals[:, k], size.prod()) for k in range(3)], -1).reshape(*size, 3)
    for axis in range(3):
        grid = grid + 0.5 * (np.roll(grid, 1, axis) + np.roll(grid, -1, axis))
    flat, low = grid.astype(np.float32).reshape(-1, 3), at.astype(int)
    part, total = (at - low).astype(np.float32), np.zeros((len(means), 3), np.float32)
    for corner in itertools.product((0, 1), repeat=3):
        weight = np.where(corner, part, 1.0 - part).prod(1)
        total += weight[:, None] * flat.take(np.ravel_multi_index(tuple((low + corner).T), size), 0)
    found: np.ndarray = _unit(total).astype(np.float32)
    return found


def _flatness(scales: np.ndarray) -> np.ndarray:
    """How flat Gaussians of scales [N, 3] lie on a surface, 0..1, [N]."""
    found: np.ndarray = np.clip(_FLAT * (1.0 - scales[:, 2] / np.maximum(scales[:, :2].min(1), 1e-12)), 0.0, 1.0)
    return found


def roughly_lit(colors: np.ndarray, normals: np.ndarray, lighting: Lighting, intensity: float = 1.0) -> np.ndarray:
    """Colors that were learned under the studio's rig in another light, display sRGB, [N, 3] float32.

    Args:
        colors: Display sRGB, [N, 3].
        normals: Outward unit normals in head axes, [N, 3].
        lighting: In head space.
        intensity: Factor of the light.
    """
    harmonics = basis(normals.astype(np.float32)).astype(np.float32)
    light, rig = (harmonics @ coefficients.astype(np.float32) for coefficients in (harmonics_of(lighting), rig_harmonics()))
    ratio = np.clip(light * np.float32(intensity) / np.maximum(rig, 1e-3), 0.0, MAX_RATIO)
    found: np.ndarray = colors * ratio ** np.float32(1.0 / _GAMMA)
    return found


@functools.cache
def rig_harmonics() -> np.ndarray:
    """`harmonics_of` the studio's rig; not to be written to."""
    return harmonics_of(STUDIO)


def harmonics_of(lighting: Lighting) -> np.ndarray:
    """Irradiance of a ball in the place of a head, in whose space the light is, as harmonics of its normals, [9, 3]."""
    normals, solid = sphere(_DIRECTIONS)
    total = np.zeros((len(normals), 3))
    if lighting.surroundings is not None:
        total += np.maximum(lighting.surroundings.irradiance(normals), 0.0)
    for lamp in lighting.shaded((0.0, 0.0, 0.0)):
        towards, strength = arriving(lamp, _RADIUS * normals)
        cosine = np.maximum((normals * towards).sum(1) + _WRAP, 0.0) / (1.0 + _WRAP) ** 2
        total += (cosine * strength)[:, None] * np.asarray(lamp.color)
    found: np.ndarray = basis(normals).T @ (total * solid[:, None])
    return found


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.sqrt(np.einsum("nk,nk->n", vectors, vectors)), 1e-9)[:, None]
