"""Light that skin throws on skin: one bounce between patches of a head at rest. Needs numpy only.

What a vertex does not see of the surroundings is the head itself. How much that is says `transfer`; which skin it is say form
factors of disks (Cohen and Wallace 1993), without a look at what stands between. Irradiance of light from all over a patch is
taken as even.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from .relight import to_linear
from .shadows import compiled_kernels
from .transfer import openness

PATCH = 0.02  # metres
_SIDE = 1e-3  # of a normal, that counts as turned to a side
_GIVERS = 12  # patches that a vertex takes light from
_TASK = 1024  # vertices that a thread takes at least
_MOST = 0.9  # albedo of the brightest skin


class Exchange(NamedTuple):
    """Which patches light which vertices.

    Attributes:
        patch: Of each vertex, [V].
        area: Of each vertex, as a share of its patch, [V] float32.
        givers: Patches that a vertex sees most of, [V, _GIVERS].
        shares: Of what reaches a vertex from all around if it is even, what comes from each of them, [V, _GIVERS] float32.
    """

    patch: np.ndarray
    area: np.ndarray
    givers: np.ndarray
    shares: np.ndarray

    @staticmethod
    def of(vertices: np.ndarray, normals: np.ndarray, faces: np.ndarray, rows: np.ndarray) -> Exchange:
        """Find it.

        Args:
            vertices: Of a head at rest, [V, 3] metres.
            normals: Outward unit normals, [V, 3].
            faces: [F, 3].
            rows: Of `transfer.transfer` at the vertices, [V, 9].
        """
        sides = vertices[faces[:, 1:]] - vertices[faces[:, :1]]
        doubled = np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=1)
        area = np.bincount(faces.ravel(), np.repeat(doubled / 6.0, 3), len(vertices)) + 1e-12
        # skin that faces the same way; a head's middle lies within cells and sides, which noise would share out
        cells = np.concatenate([np.rint(vertices / PATCH), normals > _SIDE], 1)
        patch = np.unique(cells, axis=0, return_inverse=True)[1].ravel()
        whole = np.bincount(patch, area)

        def mean(values: np.ndarray) -> np.ndarray:
            return np.stack([np.bincount(patch, area * values[:, k]) for k in range(3)], -1) / whole[:, None]

        givers, shares = _strongest(vertices, normals, mean(vertices), mean(normals), whole)
        total = shares.sum(1)
        shares *= np.where(total > 0.0, (1.0 - openness(rows)) / np.maximum(total, 1e-20), 0.0)[:, None]
        return Exchange(patch, (area / whole[patch]).astype(np.float32), givers, shares.astype(np.float32))

    def light(self, inside: np.ndarray, around: np.ndarray, share: float) -> None:
        """Let the inside of a hollow take a share of what skin around its opening throws back, wherever it lies in there.

        Args:
            inside: Which vertices lie in the hollow, [V] bool.
            around: Which lie around its opening, likewise.
            share: Of light that leaves these.
        """
        self.shares[inside] = 0.0
        if not around.any():
            return
        patches, area = np.unique(self.patch[around], return_inverse=True)
        weight = np.bincount(area, self.area[around])
        most = np.argsort(-weight)[:_GIVERS]
        self.givers[inside, : len(most)] = patches[most]
        self.shares[inside, : len(most)] = share * weight[most] / weight[most].sum()

    def bounced(self, irradiance: np.ndarray, albedo: np.ndarray) -> np.ndarray:
        """Irradiance at vertices of light that left skin once, [V, 3], of what arrives there straight, [V, 3]."""
        count, kernels = int(self.patch.max()) + 1, compiled_kernels()
        if kernels is not None:
            from ..compute.threads import for_rows

            out, sums = np.empty((len(self.shares), 3), np.float32), np.zeros((count, 3), np.float32)
            kernels.thrown_back(
                self.patch, self.area, *(np.ascontiguousarray(v, np.float32) for v in (irradiance, albedo)), sums
            )
            for_rows(kernels.bounced, len(out), self.givers, self.shares, sums, out, smallest=_TASK)
            return out
        means = np.stack([np.bincount(self.patch, self.area * irradiance[:, k], count) for k in range(3)], -1)
        result: np.ndarray = np.einsum("vk,vkc->vc", self.shares, (means * albedo).astype(np.float32)[self.givers])
        return result


def _strongest(
    vertices: np.ndarray, normals: np.ndarray, middles: np.ndarray, facing: np.ndarray, whole: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Patches that vertices see most of, and their form factors, [V, _GIVERS] each.

    Args:
        vertices: [V, 3] metres.
        normals: [V, 3].
        middles: Of the patches, [P, 3] metres.
        facing: Their mean normals, [P, 3].
        whole: Their areas, [P] square metres.
    """
    kernels = compiled_kernels()
    if kernels is not None:
        from ..compute.threads import for_rows

        givers, factors = np.zeros((len(vertices), _GIVERS), np.int64), np.zeros((len(vertices), _GIVERS))
        given = (np.ascontiguousarray(array, np.float64) for array in (vertices, normals, middles, facing, whole))
        for_rows(kernels.strongest, len(vertices), *given, givers, factors, smallest=_TASK)
        return givers, factors
    arriving = normals @ middles.T - (normals * vertices).sum(1)[:, None]  # cosines times distances, [V, P]
    leaving = (facing * middles).sum(1) - vertices @ facing.T
    squares = (vertices**2).sum(1)[:, None] + (middles**2).sum(1) - 2.0 * vertices @ middles.T + whole / math.pi
    every = np.maximum(arriving, 0.0) * np.maximum(-leaving, 0.0) * whole / squares**2
    givers = np.argpartition(-every, _GIVERS, axis=1)[:, :_GIVERS].copy()  # not a part of all of them
    return givers, np.take_along_axis(every, givers, 1)


def albedo_of(colors: np.ndarray, rig: np.ndarray) -> np.ndarray:
    """What skin throws back, linear RGB, [3].

    Args:
        colors: Of skin as learned under the rig, display sRGB, [K, 3].
        rig: The rig's irradiance on it, [N, 3].
    """
    light = np.median(rig, 0) / math.pi
    return np.clip(np.median(np.asarray(to_linear(np.asarray(colors, np.float64))), 0) / light, 0.0, _MOST)


def nearest_points(corners: np.ndarray, barycentric: np.ndarray, count: int) -> np.ndarray:
    """Which of N points on faces is nearest to each vertex, [count]; any where there is none on its faces.

    Args:
        corners: Vertices of the face that each point lies on, [N, 3].
        barycentric: [N, 3].
        count: Of vertices.
    """
    order = np.argsort(barycentric.ravel(), kind="stable")
    found = np.zeros(count, np.int64)
    found[corners.ravel()[order]] = order // 3  # of several the last one counts
    return found
