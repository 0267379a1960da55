"""Shadows on a grid of texels: fewer looks where neighbours see the same of a wide lamp, and more where texels are long.

Texels of a face lie closer than the pixels of a shadow map. Of a wide lamp, whose shadows are soft, every other one is compared
with the maps, and those between them only where these differ. On a neck texels are up to 9 mm long: there the edge of a shadow
is the mean of several places on each, or it would be a saw. Needs numpy; numba makes it faster.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from .shadows import Maps, Receivers, compiled_kernels

_NEAR = 0.0065  # metres between the texels at both sides of one that need not be compared
_ALIKE = 0.02  # of a lamp that they may differ by
# metres of a texel that is looked at from several places, where the lamp changes by so much beside it
_LONG, _STEP = 0.0035, 0.25
_PLACES = np.linspace(-0.9, 0.9, 8, dtype=np.float32)  # on it and to the middles of those at its ends, in lengths
_WEIGHTS = (1.0 - np.abs(_PLACES)) / (1.0 - np.abs(_PLACES)).sum()


class TexelShadows(NamedTuple):
    """How texels lie on a head.

    Attributes:
        between: Numbers of compared texels around each one, twice where there are two, -1 where it is itself, [N, 4] int32.
        long: Numbers of long texels, [M] int32.
        along: How the barycentric coordinates change along their length, [M, 3] float32.
        beside: Numbers of the texels at their ends, [M, 2] int32; themselves where there are none.
        corners: Vertices around them, [M, 3] int32.
    """

    between: np.ndarray
    long: np.ndarray
    along: np.ndarray
    beside: np.ndarray
    corners: np.ndarray

    @staticmethod
    def of(
        grid: int, texel: np.ndarray, corners: np.ndarray, uv: np.ndarray, vertices: np.ndarray, points: np.ndarray
    ) -> TexelShadows:
        """Find it.

        Args:
            grid: Texels along a side.
            texel: Flat index of each texel, [N].
            corners: Vertices around each, [N, 3].
            uv: Their places on the UV map, in texels, [N, 3, 2].
            vertices: [V, 3] metres.
            points: Places of the texels, [N, 3] metres.
        """
        count = len(texel)
        rows = np.full((grid + 2, grid + 2), -1, np.int32)
        row, column = texel // grid + 1, texel % grid + 1
        rows[row, column] = np.arange(count)

        def at(down: np.ndarray | int, right: np.ndarray | int) -> np.ndarray:
            found: np.ndarray = rows[row + down, column + right]
            return found

        odd_row, odd_column = row % 2, column % 2
        sides = ((-1, -1), (1, 1), (-1, 1), (1, -1))
        between = np.stack([at(down * odd_row, right * odd_column) for down, right in sides], -1)
        apart = np.linalg.norm(points[between[:, 0]] - points[between[:, 1]], axis=1)
        across = np.linalg.norm(points[between[:, 2]] - points[between[:, 3]], axis=1)
        alone = (between < 0).any(1) | (np.maximum(apart, across) > _NEAR) | ((odd_row == 0) & (odd_column == 0))
        between[alone] = -1
        # compared texels are those of even rows and columns, and those without such neighbours
        lonely = (between >= 0).all(1) & ~((row[between] % 2 == 0) & (column[between] % 2 == 0)).all(1)
        between[lonely] = -1

        at_corners = vertices[corners]
        sides_uv, sides_at = uv[:, 1:] - uv[:, :1], at_corners[:, 1:] - at_corners[:, :1]
        with np.errstate(divide="ignore", invalid="ignore"):
            # barycentric coordinates of the second and third corner by column and row, [N, 2, 2]
            inverse = np.linalg.pinv(sides_uv)
        lengths = np.linalg.norm(inverse @ sides_at, axis=2)  # metres by column and row
        axis = lengths.argmax(1)
        long = np.flatnonzero(lengths.max(1) > _LONG)
        change = inverse[long, axis[long]]
        along = np.concatenate([-change.sum(1, keepdims=True), change], 1)
        down = axis == 1
        ends = np.stack([at(-1 * down, -1 * ~down), at(1 * down, 1 * ~down)], -1)[long]
        ends = np.where(ends < 0, long[:, None], ends)
        return TexelShadows(
            between, long.astype(np.int32), along.astype(np.float32), ends.astype(np.int32), corners[long].astype(np.int32)
        )

    def split(self, asked: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Those of some texels, [K] ascending, that are compared anyway, and those that may be like the ones around them."""
        alone = self.between[asked, 0] < 0
        return asked[alone], asked[~alone]

    def seen(
        self, maps: Maps, receivers: Receivers, asked: tuple[np.ndarray, np.ndarray], known: np.ndarray, vertices: np.ndarray
    ) -> None:  # fmt: skip
        """Write which part of a lamp texels see.

        Args:
            maps: Of the lamp.
            receivers: All texels.
            asked: Numbers of those that are asked for, of `split`.
            known: Changed, below 0 everywhere before, [N] float32.
            vertices: [V, 3] metres.
        """
        alone, rest = asked
        maps.seen(receivers, alone, known)
        if len(maps.depths) > 1:
            rest = self._unlike(rest, known)
        maps.seen(receivers, rest, known)
        self._averaged(maps, receivers, known, vertices)

    def all_seen(self, maps: Maps, receivers: Receivers, vertices: np.ndarray) -> np.ndarray:
        """Which part of a lamp all texels see, [N] float32; arguments as of `seen`."""
        known = np.full(len(receivers.points), -1.0, np.float32)
        self.seen(maps, receivers, self.split(np.arange(len(known), dtype=np.int32)), known, vertices)
        return known

    def _unlike(self, some: np.ndarray, known: np.ndarray) -> np.ndarray:
        """Give texels what those around them see, where that is the same; return the others' numbers."""
        if compiled_kernels() is None:
            around = known[self.between[some]]
            same = (around.min(1) >= 0.0) & (np.ptp(around, axis=1) <= _ALIKE)
            known[some[same]] = around[same].mean(1)
            return some[~same]
        from .shadow_kernels import same_around

        left = np.empty(len(some), np.int32)
        count = same_around(some, self.between, np.float32(_ALIKE), known, left)
        return left[:count]

    def _averaged(self, maps: Maps, receivers: Receivers, known: np.ndarray, vertices: np.ndarray) -> None:
        """Put the mean of several places into long texels that see quite another part of the lamp than what is beside them."""
        number = self._at_edges(known)
        if not len(number):
            return
        some, places = self.long[number], self._places(number, receivers, vertices)
        known[some] = maps.seen(places).reshape(-1, len(_PLACES)) @ _WEIGHTS

    def _at_edges(self, known: np.ndarray) -> np.ndarray:
        """Which of the long texels lie at the edge of a shadow, [K]."""
        if compiled_kernels() is None:
            own, one, other = known[self.long], known[self.beside[:, 0]], known[self.beside[:, 1]]
            differs = np.maximum(np.abs(one - own), np.abs(other - own)) > _STEP
            return np.flatnonzero(differs & (own >= 0.0) & (one >= 0.0) & (other >= 0.0))
        from .shadow_kernels import at_edges

        found = np.empty(len(self.long), np.int32)
        return found[: at_edges(self.long, self.beside, np.float32(_STEP), known, found)]

    def _places(self, number: np.ndarray, receivers: Receivers, vertices: np.ndarray) -> Receivers:
        """Places on some of the long texels, `_PLACES` on each, [K * P], with the normals of the texels.

        They lie on the curve through the texels beside: a plane would leave a hollow neck, and be dark below it.
        """
        points = receivers.points
        if compiled_kernels() is None:
            own, ends = self.long[number], self.beside[number]
            axis = np.einsum("mk,mkx->mx", self.along[number], vertices[self.corners[number]])
            whole = (ends != own[:, None]).all(1)[:, None]
            before, here, behind = points[ends[:, 0]], points[own], points[ends[:, 1]]
            axis = np.where(whole, 0.5 * (behind - before), axis)
            bend = np.where(whole, 0.5 * (before + behind) - here, 0.0)
            steps = _PLACES[:, None]
            there = (here[:, None] + steps * axis[:, None] + steps**2 * bend[:, None]).reshape(-1, 3).astype(np.float32)
            return dataclasses.replace(receivers, points=there, normals=np.repeat(receivers.normals[own], len(_PLACES), 0))
        from .shadow_kernels import places_along

        given = (np.ascontiguousarray(array, np.float32) for array in (points, receivers.normals, vertices))
        there, normals = np.empty((2, len(number) * len(_PLACES), 3), np.float32)
        places_along(number, *self[1:], *given, _PLACES, there, normals)
        return dataclasses.replace(receivers, points=there, normals=normals)
