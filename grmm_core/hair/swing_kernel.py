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
def _raised(
    x: float, y: float, z: float, wanted: float, field: np.ndarray, low: np.ndarray, motion: np.ndarray
) -> tuple[float, float, float]:
    """A point brought up to the height `wanted` above a body that has moved."""
    px = motion[0, 0] * x + motion[0, 1] * y + motion[0, 2] * z + motion[0, 3]
    py = motion[1, 0] * x + motion[1, 1] * y + motion[1, 2] * z + motion[1, 3]
    pz = motion[2, 0] * x + motion[2, 1] * y + motion[2, 2] * z + motion[2, 3]
    u, v, w = (px - low[0]) / F(CELL), (py - low[1]) / F(CELL), (pz - low[2]) / F(CELL)
    height, dx, dy, dz = sampled(field, u, v, w)
    if height >= wanted or height < -F(BURIED):
        return x, y, z
    push = max(min(F(SOFT) * (wanted - height), F(MOST)), wanted - height - F(DEEP))
    push /= math.sqrt(dx * dx + dy * dy + dz * dz) + F(1e-6)
    dx, dy, dz = dx * push, dy * push, dz * push
    x += motion[0, 0] * dx + motion[1, 0] * dy + motion[2, 0] * dz
    y += motion[0, 1] * dx + motion[1, 1] * dy + motion[2, 1] * dz
    z += motion[0, 2] * dx + motion[1, 2] * dy + motion[2, 2] * dz
    return x, y, z


@compiled(**_OPTIONS)
def swing_into(
    places: np.ndarray, speeds: np.ndarray, before: np.ndarray, targets: np.ndarray, rates: np.ndarray, drags: np.ndarray,
    loose: np.ndarray, farthest: np.ndarray, lengths: np.ndarray, gravity: np.ndarray, count: int, dt: float, clear: np.ndarray,
    field0: np.ndarray, low0: np.ndarray, motion0: np.ndarray, field1: np.ndarray, low1: np.ndarray, motion1: np.ndarray,
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
        clear: Height above each body that a place keeps, [2, M, S].
        field0: Of the first body, see `Body`.
        low0: Likewise.
        motion0: What brings points to it, [3, 4].
        field1: Of the second body.
        low1: Likewise.
        motion1: Likewise.
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
                        x, y, z = _raised(x, y, z, clear[0, m, s], field0, low0, motion0)
                        x, y, z = _raised(x, y, z, clear[1, m, s], field1, low1, motion1)
                        if x != hx or y != hy or z != hz:
                            slide = F(SLIDE)
                new[0], new[1], new[2] = x, y, z
                for c in range(3):
                    speeds[m, s, c] = slide * (new[c] - places[m, s, c]) * inverse
                    places[m, s, c] = new[c]


@compiled(**_OPTIONS)
def raise_into(
    points: np.ndarray, clear: np.ndarray,
    field0: np.ndarray, low0: np.ndarray, motion0: np.ndarray, field1: np.ndarray, low1: np.ndarray, motion1: np.ndarray,
) -> None:  # fmt: skip
    """Bring points [M, S, 3] besides roots out of bodies; see `swing_into` for the arguments."""
    for m in range(len(points)):
        for s in range(1, points.shape[1]):
            x, y, z = points[m, s, 0], points[m, s, 1], points[m, s, 2]
            x, y, z = _raised(x, y, z, clear[0, m, s], field0, low0, motion0)
            x, y, z = _raised(x, y, z, clear[1, m, s], field1, low1, motion1)
            points[m, s, 0], points[m, s, 1], points[m, s, 2] = x, y, z
