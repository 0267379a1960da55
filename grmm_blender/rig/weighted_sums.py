"""Weighted sums of many fixed rows, quick where the weights move along a few directions.

`live` adds up hundreds of small shape components on each frame. Reading them all takes a fifth of a frame's time. But
an animated shape moves along few directions: the curves between two keys span four at most, a dragged slider one. `RecentSums`
keeps the sums of recent directions; weights within their span cost as many rows as there are directions. Plain numpy.

Products are `einsum`'s and not matrix products: Blender's own numpy has no fast ones, and where there are, their threads
stall for tens of milliseconds on a busy machine.
"""

from __future__ import annotations

import numpy as np

DIRECTIONS = 12  # kept: a segment of an animation, its neighbours and a slider
NEGLIGIBLE = 1e-5  # of the weights: what is left outside of the span


def weighted_sum(weights: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return the sum of rows [K, N] times weights [K], [N] float32; trailing weights of zero cost nothing."""
    used = np.flatnonzero(weights)
    count = int(used[-1]) + 1 if used.size else 0
    return np.einsum("k,kn->n", weights[:count].astype(np.float32), rows[:count])


class RecentSums:
    """Sums of fixed rows for weights that are much like recent ones.

    Results depend on what was asked before, by as much as `NEGLIGIBLE` times the rows.
    """

    def __init__(self, rows: np.ndarray) -> None:
        """Prepare for rows [K, N] float32, which must not change."""
        self._rows = rows
        self._directions = np.zeros((0, len(rows)))  # [D, K], orthonormal
        self._sums = np.zeros((0, rows.shape[1]), np.float32)  # [D, N]

    @property
    def rows(self) -> np.ndarray:
        """What is added up, [K, N]."""
        return self._rows

    def __call__(self, weights: np.ndarray) -> np.ndarray:
        """Return the sum of the rows times weights [<=K], [N] float32; missing weights are zero."""
        wanted = np.zeros(len(self._rows))
        wanted[: weights.size] = weights
        rest = self._rest(wanted)
        if np.linalg.norm(rest) > NEGLIGIBLE:
            if len(self._directions) == DIRECTIONS:
                self._directions, self._sums = self._directions[DIRECTIONS // 2 :], self._sums[DIRECTIONS // 2 :]
                rest = self._rest(wanted)
            self._learn(rest)
        return np.einsum("d,dn->n", (self._directions @ wanted).astype(np.float32), self._sums)

    def _rest(self, weights: np.ndarray) -> np.ndarray:
        """What of weights [K] lies outside of the directions."""
        for _ in range(2):  # the second time takes away what rounding left
            weights = weights - (self._directions @ weights) @ self._directions
        return weights

    def _learn(self, direction: np.ndarray) -> None:
        direction = direction / np.linalg.norm(direction)
        self._directions = np.vstack([self._directions, direction])
        self._sums = np.vstack([self._sums, weighted_sum(direction, self._rows)])
