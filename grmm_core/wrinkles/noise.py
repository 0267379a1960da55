"""Smooth functions of places on the template head, which furrows and the studio's people are painted with. Needs numpy only."""

from __future__ import annotations

import math

import numpy as np


def smoothstep(low: float | np.ndarray, high: float | np.ndarray, x: np.ndarray) -> np.ndarray:
    """Cubic step from 0 at `low` to 1 at `high`."""
    t = np.clip((x - low) / (np.asarray(high) - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def bump(
    points: np.ndarray, centre: tuple[float, float, float], radii: tuple[float, float, float], mirror: bool = True
) -> np.ndarray:
    """Gaussian blob around a template point, on both sides where `mirror`; points [..., 3] -> [...]."""
    p = points.copy()
    if mirror:
        p[..., 0] = np.abs(p[..., 0])
    return np.exp(-(((p - np.array(centre)) / np.array(radii)) ** 2).sum(-1))


def wave_noise(points: np.ndarray, scale: float, seed: int, octaves: int = 3) -> np.ndarray:
    """Smooth noise in about -1..1 from sums of random plane waves; points [..., 3] in metres, scale in metres.

    In the points' own precision.
    """
    g = np.random.default_rng(seed)
    total = np.zeros(points.shape[:-1], points.dtype)
    weight = 0.0
    for octave in range(octaves):
        amplitude = 0.55**octave
        for _ in range(5):
            direction = g.normal(0, 1, 3) * (2.0 * math.pi * 1.9**octave / scale / 1.7)
            total += amplitude * np.sin(points @ direction.astype(points.dtype) + points.dtype.type(g.uniform(0, 6.3)))
        weight += amplitude
    noise: np.ndarray = total / (weight * 2.2)
    return noise
