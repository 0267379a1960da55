"""What the parts of a head do with light: two lobes of shine, wetness, how far light wanders. By texel; needs numpy only.

Roughness of about 0.35 and 0.6 for the two lobes of skin and a reflectance of 0.028 at right angles are usual in the
literature; cornea, saliva and enamel are smooth. Oil is strongest on forehead and nose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..compute.recent import Recent
from .transfer import vertex_normals

if TYPE_CHECKING:
    from ..head import HeadModel

WANDER = np.array([1.11e-3, 0.41e-3, 0.21e-3])
"""How far beyond the terminator light reaches in skin, by color, metres: times the skin's curvature it is a cosine.

It wanders farthest in red. Of light that leaves skin with the profile of Burley (2015) and mean free paths of 3.67, 1.37 and
0.68 mm (Jensen et al. 2001): what arrives where a ball's surface is at right angles to the light, times its radius.
"""
SOFTER = np.array([0.34, 0.13, 0.065])
"""By how much more of a lamp that is hardly seen comes through at the edges of shadows, by color."""

RELIEF = 0.07
"""Share of a lamp that reaches what pores and wrinkles turn towards it where it is at right angles, by roughness squared.

Fitted to Cycles with the bumps of the studio's skin (`tools.light_truth`).
"""


@dataclass(frozen=True)
class Material:
    """What a part does with light.

    Attributes:
        smooth, rough: Roughness of the two lobes.
        share: Of the smooth lobe.
        reflectance: At right angles.
        shine: Factor of both lobes.
        wander: Factor of `WANDER` and `SOFTER`.
    """

    smooth: float
    rough: float
    share: float
    reflectance: float
    shine: float
    wander: float


SKIN = Material(0.35, 0.60, 0.35, 0.028, 0.75, 1.0)
MATERIALS: dict[str, Material] = {
    "scalp": Material(0.50, 0.70, 0.3, 0.028, 0.15, 0.6), "neck": Material(0.42, 0.65, 0.3, 0.028, 0.6, 1.0),
    "lips": Material(0.22, 0.50, 0.5, 0.030, 1.0, 0.9), "mouth_interior": Material(0.15, 0.45, 0.6, 0.025, 0.8, 1.0),
    "tongue": Material(0.18, 0.45, 0.6, 0.025, 0.9, 1.0), "upper_teeth": Material(0.10, 0.40, 0.7, 0.050, 1.0, 0.5),
    "lower_teeth": Material(0.10, 0.40, 0.7, 0.050, 1.0, 0.5), "left_eyeball": Material(0.07, 0.30, 0.9, 0.040, 1.0, 0.2),
    "right_eyeball": Material(0.07, 0.30, 0.9, 0.040, 1.0, 0.2), "lashes": Material(0.5, 0.7, 0.3, 0.03, 0.2, 0.0),
}  # fmt: skip
_OIL = (  # places on the head at rest (the right side of a pair), reach in metres, factor of the shine there
    ((0.0, 0.085, 0.095), 0.035, 0.5), ((0.0, 0.010, 0.115), 0.016, 0.9), ((0.035, 0.005, 0.085), 0.020, 0.35),
    ((0.0, -0.060, 0.095), 0.018, 0.2),
)  # fmt: skip


_HEAD = np.float32(12.5)  # curvature of a ball like a head, 1/m
_BENT = 250.0  # of the edge of an ear, and at most


@dataclass(frozen=True)
class Materials:
    """`Material` of every Gaussian.

    Attributes:
        smooth, rough, share, reflectance, shine, wander: See `Material`, [N] float32 each.
        curvature: 1/m, likewise; a number is that of all.
    """

    smooth: np.ndarray
    rough: np.ndarray
    share: np.ndarray
    reflectance: np.ndarray
    shine: np.ndarray
    wander: np.ndarray
    curvature: np.ndarray = _HEAD  # type: ignore[assignment]  # a number becomes an array

    def __post_init__(self) -> None:
        object.__setattr__(self, "curvature", np.ones_like(self.wander) * self.curvature)

    def taken(self, rows: np.ndarray | slice) -> Materials:
        """Of some Gaussians only."""
        return Materials(*(array[rows] for array in vars(self).values()))


def materials_of(head: HeadModel, face: np.ndarray, barycentric: np.ndarray) -> Materials:
    """Find the material of texels.

    Args:
        head: Head model.
        face: Face of each texel, [N].
        barycentric: [N, 3].
    """
    return _KNOWN.get((head, face, barycentric), lambda: _found(head, face, barycentric))


_KNOWN: Recent[Materials] = Recent(2)


def _found(head: HeadModel, face: np.ndarray, barycentric: np.ndarray) -> Materials:
    count = len(head.v_template)
    table = np.tile(np.array([*vars(SKIN).values()], np.float32), (count, 1))
    for name, look in MATERIALS.items():
        if name in head.regions:
            table[head.regions[name]] = [*vars(look).values()]
    corners = head.faces[face]
    nearest = corners[np.arange(len(face)), barycentric.argmax(1)]
    values = table[nearest]  # parts do not mix: a texel of the eye is no skin
    place = np.einsum("nk,nkx->nx", barycentric, head.v_template[corners])
    oil = np.ones(len(face), np.float32)
    for (x, y, z), reach, more in _OIL:
        for side in (-1.0, 1.0) if x else (1.0,):
            oil += more * np.exp(-((place - [side * x, y, z]) ** 2).sum(1) / (2.0 * reach**2)).astype(np.float32)
    skin = (values[:, 0] == np.float32(SKIN.smooth)) & (values[:, 3] == np.float32(SKIN.reflectance))
    values[:, 4] *= np.where(skin, oil, 1.0)
    bent = np.einsum("nk,nk->n", barycentric, curvature(head.v_template, head.faces)[corners]).astype(np.float32)
    return Materials(*(np.ascontiguousarray(column) for column in (*values.T, bent)))


def curvature(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How much the normals of a mesh turn from each vertex to its neighbours, in the mean, 1/m, [V].

    Args:
        vertices: [V, 3] metres.
        faces: [F, 3].
    """
    normals = vertex_normals(vertices, faces)
    edges = np.unique(np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), 1), axis=0)
    turned, apart = (np.linalg.norm(np.diff(values[edges], axis=1)[:, 0], axis=1) for values in (normals, vertices))
    both, count = edges.T.ravel(), len(vertices)
    result: np.ndarray = np.bincount(both, np.tile(turned, 2), count) / np.maximum(
        np.bincount(both, np.tile(apart, 2), count), 1e-9
    )
    return result.clip(0.0, _BENT)
