"""The compiled inside of `swing`; `swing_readable` is its twin in numpy. Importing this module loads numba."""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .body import BURIED, CELL, DEEP, MOST, SLIDE, SOFT
from .body_kernels import sampled

_OPTIONS = {"boundscheck": False, "error_model": "numpy", "nogil": True}
F = np.float32
_ZERO, _ONE = F(0.0), F(1.0)


@compiled(**_OPTIONS)
def _height(
    x: float, y: float, z: float, field: np.ndarray, low: np.ndarray, motion: np.ndarray
) -> tuple[float, float, float, float]:
    """How high a point is above a body that has moved, and the unit direction out of it."""
    px = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2] * z + motion[0, 3]
    py = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2] * z + motion[1, 3]
    pz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2] * z + motion[2, 3]
    u, v, w = (px - low[0]) / F(CELL), (py - low[1]) / F(CELL), (pz - low[2]) / F(CELL)
    height, dx, dy, dz = sampled(field, u, v, w)
    scale = _ONE / (math.sqrt(dx * dx + dy * dy + dz * dz) + F(1e-6))
    dx, dy, dz = dx * scale, dy * scale, dz * scale
    ux = motion[0, 0] * dx + motion[1, 0] * dy + motion[2, 0] * dz
    uy = motion[0, 1] * dx + motion[1, 1] * dy + motion[2, 1] * dz
    uz = motion[0, 2] * dx + motion[1, 2] * dy + motion[2, 2] * dz
    return height, ux, uy, uz


@compiled(**_OPTIONS)
def _raised(
    x: float, y: float, z: float, wanted: float, field: np.ndarray, low: np.ndarray, motion: np.ndarray
) -> tuple[float, float, float]:
    """A point brought some of the way up to the height `wanted` above a body that has moved."""
    height, dx, dy, dz = _height(x, y, z, field, low, motion)
    if height >= wanted or height <= -F(BURIED):
        return x, y, z
    push = max(min(F(SOFT) * (wanted - height), F(MOST)), wanted - height - F(DEEP))
    return x + push * dx, y + push * dy, z + push * dz


@compiled(**_OPTIONS)
def swing_into(
    places: np.ndarray, speeds: np.ndarray, before: np.ndarray, targets: np.ndarray, rates: np.ndarray, drags: np.ndarray,
    loose: np.ndarray, farthest: np.ndarray, lengths: np.ndarray, gravity: np.ndarray, count: int, dt: float, clear: np.ndarray,
    field: np.ndarray, low: np.ndarray, motion: np.ndarray,
) -> None:  # fmt: skip
    """Move strands by one frame.

    Args:
        places: Changed, metres, [M, S, 3].
        speeds: Changed, m/s, [M, S, 3].
        before: Where the groom had the places in the frame before, [M, S, 3].
        targets: Where it has them now, [M, S, 3].
        rates: Of the springs, radians a second, [M, S].
        drags: Of what damps them, 1/s, [M, S].
        loose: 0 for places that stay with the head, [M, S].
        farthest: From where the groom has it that a place may be, metres, [M, S].
        lengths: Of the segments, [M, S - 1].
        gravity: That is not in the groom, m/s^2, [3].
        count: Steps.
        dt: Seconds of a step.
        clear: Height above the body that a place keeps, [M, S].
        field: Of the body, see `Body`.
        low: Likewise.
        motion: What brings points to it, [3, 4].
    """
    inverse = _ONE / dt
    new, goals = np.empty(3, np.float32), np.empty(3, np.float32)
    for m in range(len(places)):
        for step in range(count):
            share = F(step + 1) / F(count)
            for s in range(places.shape[1]):
                rate = rates[m, s]
                drag = drags[m, s]
                scale = _ONE / (_ONE + dt * (drag + dt * rate * rate))
                for c in range(3):
                    path = targets[m, s, c] - before[m, s, c]
                    goal = before[m, s, c] + share * path
                    force = rate * rate * (goal - places[m, s, c]) + drag * path * inverse / F(count) + gravity[c]
                    moved = places[m, s, c] + dt * (speeds[m, s, c] + dt * force) * scale
                    new[c] = goal + loose[m, s] * (moved - goal)
                    goals[c] = goal
                x, y, z = new[0] - goals[0], new[1] - goals[1], new[2] - goals[2]
                held = min(_ONE, farthest[m, s] / max(math.sqrt(x * x + y * y + z * z), F(1e-9)))
                x, y, z = goals[0] + held * x, goals[1] + held * y, goals[2] + held * z
                slide = _ONE
                if s > 0 and loose[m, s] > _ZERO:
                    ax, ay, az = places[m, s - 1, 0], places[m, s - 1, 1], places[m, s - 1, 2]
                    for _ in range(2):
                        dx, dy, dz = x - ax, y - ay, z - az
                        keep = lengths[m, s - 1] / max(math.sqrt(dx * dx + dy * dy + dz * dz), F(1e-9))
                        x, y, z = ax + dx * keep, ay + dy * keep, az + dz * keep
                        hx, hy, hz = x, y, z
                        x, y, z = _raised(x, y, z, clear[m, s], field, low, motion)
                        if x != hx or y != hy or z != hz:
                            slide = F(SLIDE)
                new[0], new[1], new[2] = x, y, z
                for c in range(3):
                    speeds[m, s, c] = slide * (new[c] - places[m, s, c]) * inverse
                    places[m, s, c] = new[c]


@compiled(**_OPTIONS)
def raise_into(
    fine: np.ndarray, offsets: np.ndarray, clear: np.ndarray, shares: np.ndarray,
    field: np.ndarray, low: np.ndarray, motion: np.ndarray,
) -> None:  # fmt: skip
    """Move strands out of a body, so that they stay smooth.

    A place goes its share of the way of the points beside it, most that of the deepest.

    Args:
        fine: Where the groom has points of the strands, among them between their places, [M, P, 3].
        offsets: Changed but for the roots', how far the places are from there, [M, S, 3].
        clear: Height above the body that the points are to have, [M, P].
        shares: What a point takes of each place's offset, [P, S].
        field: Of the body; see `swing_into` for what follows.
        low: Likewise.
        motion: Likewise.
    """
    points, places = shares.shape
    push, total = np.empty((places, 3), np.float32), np.empty(places, np.float32)
    for m in range(len(fine)):
        push[:] = _ZERO
        total[:] = _ZERO
        for p in range(1, points):
            x, y, z = fine[m, p, 0], fine[m, p, 1], fine[m, p, 2]
            for s in range(places):
                share = shares[p, s]
                if share != _ZERO:
                    x, y, z = x + share * offsets[m, s, 0], y + share * offsets[m, s, 1], z + share * offsets[m, s, 2]
            height, dx, dy, dz = _height(x, y, z, field, low, motion)
            under = clear[m, p] - height
            if under > _ZERO and height > -F(BURIED):
                for s in range(1, places):
                    share = shares[p, s] * under
                    if share > _ZERO:
                        total[s] += share
                        share *= share
                        push[s, 0] += share * dx
                        push[s, 1] += share * dy
                        push[s, 2] += share * dz
        for s in range(1, places):
            if total[s] > _ZERO:
                for c in range(3):
                    offsets[m, s, c] += push[s, c] / total[s]
