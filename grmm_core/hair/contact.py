"""Strands that keep their lengths while they are brought out of a skin that has moved: what `swing` and `settled` share.

A strand is moved at a few places along it, and everything between on smooth curves: curls, cuts and settings ride on that.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .body import BURIED, Body

PLACES = 8  # along a strand that are moved, the root among them
_STRANDS = 256  # of a task
FINE = 2 * PLACES - 1  # points of a strand that are asked for the skin: places and middles between them


@dataclass(frozen=True)
class Obstacle:
    """A body, and how it has moved: rows of points `p @ turn.T + shift` are where it was measured."""

    body: Body
    turn: np.ndarray
    shift: np.ndarray

    def numbers(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Field, first cell and motion, as the kernels read them."""
        motion = np.concatenate([self.turn, self.shift[:, None]], 1)
        return self.body.field, self.body.low.astype(np.float32), np.ascontiguousarray(motion, np.float32)

    def under(self, points: np.ndarray, clear: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """How far points [N, 3] are below their heights [N], metres, 0 where they are not, and the way out, [N, 3]."""
        heights, up = self.body.heights(points @ self.turn.T + self.shift)
        return np.where(heights > -BURIED, np.maximum(clear - heights, 0.0), 0.0), up @ self.turn


def rigid_motion(posed: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn [3, 3] and shift [3] that bring posed points [M, 3] best back to rest: `posed @ turn.T + shift`."""
    u, _, v = np.linalg.svd((posed - posed.mean(0)).T @ (rest - rest.mean(0)))
    turn = (u @ np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))]) @ v).T
    return turn, rest.mean(0) - posed.mean(0) @ turn.T


def held_out(
    fine: np.ndarray, offsets: np.ndarray, lengths: np.ndarray, clear: np.ndarray, obstacle: Obstacle, rounds: int,
    compiled: bool = True,
) -> np.ndarray:  # fmt: skip
    """Offsets of places after lengths and the skin were asked in turns.

    Args:
        fine: Where the groom has points of the strands, float32 [M, FINE, 3] metres.
        offsets: How far the places are from there, float32 [M, PLACES, 3].
        lengths: Of the segments between places, [M, PLACES - 1].
        clear: Height above the body that the points are to have, float32 [M, FINE].
        obstacle: The body.
        rounds: How often.
        compiled: Compute by the compiled kernel; else by its readable twin.
    """
    from ..compute.threads import for_rows
    from .swing_kernel import raise_into

    targets, numbers = fine[:, ::2], obstacle.numbers()

    def raise_some(low: int, high: int) -> None:
        raise_into(fine[low:high], offsets[low:high], clear[low:high], _BETWEEN, *numbers)

    for _ in range(rounds):
        points = targets + offsets
        _shorten(points, lengths)
        offsets = np.ascontiguousarray(points - targets)
        if compiled:
            for_rows(raise_some, len(fine), smallest=_STRANDS)
        else:
            offsets = _raised_readable(fine, offsets, clear, obstacle)
    return offsets


def _shorten(points: np.ndarray, lengths: np.ndarray) -> None:
    """Draw strands [M, S, 3] in where segments are longer than `lengths` [M, S - 1], from the root on."""
    for s in range(1, points.shape[1]):
        step = points[:, s] - points[:, s - 1]
        step *= np.minimum(1.0, lengths[:, s - 1] / np.maximum(np.linalg.norm(step, axis=1), 1e-9))[:, None]
        points[:, s] = points[:, s - 1] + step


def _raised_readable(fine: np.ndarray, offsets: np.ndarray, clear: np.ndarray, obstacle: Obstacle) -> np.ndarray:
    """The readable twin of `swing_kernel.raise_into`, which says what the arguments are; returns offsets."""
    points = moved(fine, offsets)
    under, up = (
        part.reshape(points.shape[:2] + part.shape[1:]) for part in obstacle.under(points.reshape(-1, 3), clear.ravel())
    )
    shares = under[:, :, None] * _BETWEEN.clip(0.0)  # [M, FINE, PLACES]
    push = np.einsum("mfp,mfc->mpc", shares**2, up) / np.maximum(shares.sum(1), 1e-9)[..., None]
    push[:, 0] = 0.0
    return (offsets + push).astype(np.float32)


def _between(count: int, places: int) -> np.ndarray:
    """What of each of `places` even places points between them take, [count, places]: Catmull and Rom's smooth curve."""
    last = places - 1
    at = np.linspace(0, last, count)
    base = np.minimum(at.astype(int), last - 1)
    t = at - base
    rows = (-t + 2 * t**2 - t**3, 2 - 5 * t**2 + 3 * t**3, t + 4 * t**2 - 3 * t**3, t**3 - t**2)
    shares = np.zeros((count, places), np.float32)
    for step, row in enumerate(rows):
        np.add.at(shares, (np.arange(count), np.clip(base + step - 1, 0, last)), 0.5 * row)
    return shares


_BETWEEN = _between(FINE, PLACES)


def moved(points: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """Strands [N, K, 3] with offsets of their places, [N, S, 3], on smooth curves between these."""
    return (points + np.matmul(_between(points.shape[1], offsets.shape[1]), offsets)).astype(np.float32)
