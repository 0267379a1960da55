"""Light from everywhere on a head that shadows itself: nine numbers a vertex, and which way the head has turned.

Precomputed radiance transfer (Sloan, Kautz and Snyder 2002): the irradiance at a vertex is linear in the spherical harmonics of
the surroundings; its row holds the cosine and what the head itself hides. Made once for a head at rest, by depth maps from
directions all around, and carried along by the head's turn. Needs numpy; numba makes it faster.
"""

from __future__ import annotations

import numpy as np

from ..geometry import triangles
from .lamps import Sun
from .shadows import Casters, Receivers, compiled_kernels, visible
from .surroundings import basis, sphere

DIRECTIONS = 96


def transfer(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray, directions: int = DIRECTIONS) -> np.ndarray:
    """Irradiance at each vertex of a unit of each spherical harmonic of the surroundings, [V, 9] float32.

    Args:
        vertices: Of a head at rest, [V, 3] metres.
        normals: Outward unit normals, [V, 3].
        faces: [F, 3].
        directions: How many directions are looked along.
    """
    receivers = Receivers.around(np.asarray(vertices, np.float64), np.asarray(normals, np.float64))
    casters = Casters(vertices, faces)
    total = np.zeros((len(vertices), 9))
    around, solid = sphere(directions)
    for towards, share in zip(around, solid, strict=True):
        cosine = np.maximum(receivers.normals @ towards, 0.0)
        seen = visible(Sun(direction=tuple(towards)), receivers, casters)
        total += (cosine * seen * share)[:, None] * basis(towards)
    return total.astype(np.float32)


def openness(rows: np.ndarray) -> np.ndarray:
    """Ambient occlusion of rows of `transfer` [N, 9]: 1 where nothing is hidden, [N]."""
    result: np.ndarray = np.clip(rows[:, 0] / (np.pi * 0.282095), 0.0, 1.0)
    return result


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Unit normals of a mesh, by area, [V, 3]."""
    kernels = compiled_kernels()
    if kernels is not None:
        normals = np.zeros((len(vertices), 3))
        kernels.vertex_normals(np.ascontiguousarray(vertices, np.float64), np.ascontiguousarray(faces, np.int32), normals)
        return normals
    return triangles.vertex_normals(vertices, faces)


def turn_between(rest: np.ndarray, posed: np.ndarray) -> np.ndarray:
    """Rotation that takes points at rest nearest to the posed ones (Kabsch 1976), [3, 3].

    Args:
        rest: Of the rigid part of a head, [K, 3].
        posed: The same points, [K, 3].
    """
    a, b = rest - rest.mean(0), posed - posed.mean(0)
    u, _, v = np.linalg.svd(b.T @ a)
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    turn: np.ndarray = u @ flip @ v
    return turn
