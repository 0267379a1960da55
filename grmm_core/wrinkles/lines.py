"""Where the furrows of expressions lie and how they run: painted for one person, as relief with three channels.

Families of lines that overlap nowhere share a channel. All places are template positions (head space, metres), x = 0 the
middle. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

from .families import CHANNELS, EYE_CORNER, FOLD_END, MOUTH_HEIGHT, NOSE_WING
from .noise import bump, smoothstep, wave_noise

_GROOVED = 7.0  # widths of a line beyond which a groove's profile is 0 to seven digits


def paint_lines(rest: np.ndarray, seed: int, age: float) -> np.ndarray:
    """Relief of all families: grooves to -1, the folds between them to about 0.4.

    Args:
        rest: Template positions, metres, [n, 3].
        seed: Of what is one person's own.
        age: How deep age has made the lines that stay, 0..1.

    Returns:
        By channel of `families.FAMILIES`, [n, 3].
    """
    maps = np.zeros((len(rest), CHANNELS))
    front = np.flatnonzero(furrowed(rest))
    brush = _Brush(rest[front].astype(np.float32), np.random.default_rng([seed, 61]))
    _forehead(brush)
    for sign in (1.0, -1.0):
        brush.x = np.float32(sign) * brush.points[:, 0]
        _eye_lines(brush)
        _nose_lines(brush)
        _fold(brush)
        _mouth_lines(brush, age)
    brush.x = brush.points[:, 0]
    _chin(brush)
    _lip_lines(brush)
    _neck(brush)
    maps[front] = np.clip(brush.relief, -1.0, 0.5)
    return maps


def furrowed(rest: np.ndarray) -> np.ndarray:
    """Where there may be furrows at all: face and front of the neck, template positions [n, 3] -> [n] bool."""
    low = np.where(rest[:, 1] > -0.07, 0.025, -0.02)
    found: np.ndarray = (rest[:, 2] > low) & (rest[:, 1] < 0.112) & (np.abs(rest[:, 0]) < 0.085)
    return found


def groove(across: np.ndarray, width: float) -> np.ndarray:
    """Profile across a line: a rounded valley between two low folds of skin; metres -> relief."""
    t = across / width
    near = np.abs(t) < _GROOVED  # a line is thin, and a face large
    some = t[near]
    relief = np.zeros_like(t)
    relief[near] = -np.exp(-(some**2)) + 0.42 * np.exp(-(((np.abs(some) - 2.2) / 1.1) ** 2))
    return relief


def _taper(along: np.ndarray, half: float) -> np.ndarray:
    left = 1 - (along / half) ** 2
    near = left > 0
    taper = np.zeros_like(left)
    taper[near] = left[near] ** 0.8
    return taper


class _Brush:
    """Adds lines to a relief: template positions, the noise that bends and breaks the lines, and a generator.

    `x` points away from the middle while the lines of one side are painted.
    """

    def __init__(self, points: np.ndarray, g: np.random.Generator) -> None:
        seeds = g.integers(1 << 30, size=5)
        self.points, self.g = points, g
        self.x, self.y = points[:, 0], points[:, 1]
        self.uneven = 0.0010 * wave_noise(points, 0.018, int(seeds[0])) + 0.00025 * wave_noise(points, 0.006, int(seeds[1]))
        large = smoothstep(-0.75, 0.05, wave_noise(points, 0.012, int(seeds[2])))
        self.whole = large * (0.75 + 0.25 * smoothstep(-0.5, 0.5, wave_noise(points, 0.004, int(seeds[3]))))
        self.pits = wave_noise(points, 0.0055, int(seeds[4]), 2)
        self.relief = np.zeros((len(points), CHANNELS), points.dtype)

    def add(self, channel: int, relief: np.ndarray, breaks: float = 0.0) -> None:
        """Add relief, interrupted by the share `breaks`."""
        self.relief[:, channel] += relief * (1 - breaks + breaks * self.whole)

    def between(self, low: float, high: float) -> float:
        """A random number."""
        return float(self.g.uniform(low, high))


def _forehead(b: _Brush) -> None:
    heights = np.arange(0.0705, 0.101, 0.0082)
    strong = b.g.permutation(len(heights))
    for k, height in enumerate(heights):
        at, strength = height + b.between(-0.0016, 0.0016), (1.0, 1.0, 0.8, 0.55)[int(strong[k]) % 4]
        middle, half = b.between(-0.008, 0.008), b.between(0.034, 0.054)
        arch = b.between(0.0012, 0.0035) * -np.cos(np.clip(np.abs(b.x) / 0.036, 0, 1.5) * np.pi)
        tilt = b.between(-0.035, 0.035) * b.x
        relief = groove(b.y - at - arch - tilt - 1.3 * b.uneven, b.between(0.0012, 0.0016))
        gap = 1 - 0.7 * np.exp(-(((b.x - b.between(-0.035, 0.035)) / 0.004) ** 2))
        b.add(0, strength * relief * _taper(b.x - middle, half) * gap, 0.6)


def _eye_lines(b: _Brush) -> None:
    ex, ey = EYE_CORNER
    r = np.hypot(b.x - ex, b.y - ey)
    angle = np.arctan2(b.y - ey, np.maximum(b.x - ex, 1e-5))
    for base in np.linspace(-0.75, 0.62, 5):
        at, bend = base + b.between(-0.10, 0.10), b.between(-9, 9)
        start, end = b.between(0.003, 0.006), b.between(0.015, 0.026)
        relief = groove((angle - at - bend * (r - 0.012)) * r + b.uneven, b.between(0.0008, 0.0012))
        taper = smoothstep(start, start + 0.005, r) * smoothstep(end, end - 0.010, r)
        b.add(1, b.between(0.6, 1.0) * relief * taper * (b.x > ex), 0.5)
    for k in range(3):
        line = 0.0215 - 0.0042 * k + b.between(-0.0008, 0.0008) + (9.0 - 2.0 * k) * (b.x - 0.029) ** 2
        relief = groove(b.y - line + b.uneven, (0.0012, 0.0009, 0.0009)[k])
        b.add(2, (0.75, 0.5, 0.3)[k] * relief * _taper(b.x - b.between(0.028, 0.034), b.between(0.012, 0.017)), 0.6)
    # between the brows: one line a side that leans outwards, and a faint one beside it
    for at, strength in ((b.between(0.0062, 0.0092), 1.0), (b.between(0.0135, 0.0165), 0.45)):
        low, high = 0.0485 + b.between(-0.001, 0.001), b.between(0.070, 0.077)
        ends = smoothstep(low, low + 0.006, b.y) * smoothstep(high, high - 0.012, b.y)
        b.add(1, strength * groove(b.x - at - 0.16 * (b.y - 0.056) + b.uneven, 0.0013) * ends * (b.x > -0.004), 0.4)


def _nose_lines(b: _Brush) -> None:
    for k in range(3):
        across = b.y - (0.0435 - 0.0060 * k + b.between(-0.001, 0.001)) + (0.30 + 0.22 * k) * (b.x - 0.004) + b.uneven
        b.add(2, (0.9, 0.8, 0.5)[k] * groove(across, 0.00105) * _taper(b.x - 0.007, 0.0095) * (b.x > -0.001), 0.45)
    # across the root of the nose, with lowered brows
    b.add(1, 0.5 * groove(b.y - b.between(0.0475, 0.0495) + b.uneven, 0.0012) * _taper(b.x, 0.0095) * (b.x > 0), 0.6)


def _fold(b: _Brush) -> None:
    t = (NOSE_WING[1] - b.y) / (NOSE_WING[1] - FOLD_END[1])
    run = np.clip(t, 0, 1)
    path = NOSE_WING[0] + (FOLD_END[0] - NOSE_WING[0]) * run + b.between(0.002, 0.0045) * np.sin(np.pi * run)
    across = (b.x - path) * 0.85 + 0.6 * b.uneven
    ends = smoothstep(-0.14, 0.08, t) * smoothstep(1.12, 0.72, t) * (b.x > 0.012)
    b.add(0, -0.65 * ends * np.exp(-((across / 0.0028) ** 2)))
    b.add(0, -0.35 * ends * np.exp(-((across / 0.0012) ** 2)), 0.35)
    b.add(0, 0.42 * ends * np.exp(-(((across - 0.0075) / 0.006) ** 2)))


def _mouth_lines(b: _Brush, age: float) -> None:
    # a second fold beside the mouth, which comes with age
    path = 0.0485 - 26.0 * (b.y + 0.024) ** 2 + b.between(-0.002, 0.002)
    relief = groove(b.x - path + b.uneven, 0.0020) * _taper(b.y + 0.024, b.between(0.015, 0.020))
    b.add(1, (0.12 + 0.5 * age) * relief, 0.6)
    path = 0.0365 - 40.0 * (b.y + 0.030) ** 2 + b.between(-0.001, 0.001)
    b.add(1, 0.9 * groove(b.x - path + b.uneven, 0.0017) * _taper(b.y + 0.030, 0.0095) * (b.x > 0.028))
    # from the corner of the mouth downwards
    path = 0.0290 + 0.10 * (-0.038 - b.y) + b.between(-0.001, 0.001)
    ends = smoothstep(-0.033, -0.039, b.y) * smoothstep(-b.between(0.062, 0.068), -0.052, b.y)
    b.add(2, groove(b.x - path + 1.2 * b.uneven, 0.0018) * ends * (b.x > 0.02), 0.4)


def _chin(b: _Brush) -> None:
    zone = bump(b.points, (0, -0.058, 0.10), (0.017, 0.011, 0.06), False)
    b.add(0, 0.62 * zone * np.clip(b.pits * 1.5, -1, 0.5))
    b.add(0, 0.9 * groove(b.y + 0.0475 - 6.0 * b.x**2 + b.uneven, 0.0019) * _taper(b.x, 0.020))


def _lip_lines(b: _Brush) -> None:
    height = b.y - MOUTH_HEIGHT
    out = np.hypot(b.x / 0.026, height / 0.013)
    ring = smoothstep(0.35, 0.6, out) * smoothstep(b.between(1.35, 1.5), 0.9, out) * (np.abs(b.x) < 0.027)
    total = np.zeros_like(b.x)
    for up in (1.0, -1.0):
        for at in np.linspace(-0.021, 0.021, 11 if up > 0 else 8):
            where, strength = at + b.between(-0.0011, 0.0011), b.between(0.2, 0.9)
            relief = groove(b.x - where * (1 + 8.0 * np.abs(height)) + 0.6 * b.uneven, 0.00095)
            total += strength * relief * (up * height > 0)
    b.add(1, 0.5 * np.clip(total, -1, 0.4) * ring, 0.65)


def _neck(b: _Brush) -> None:
    for centre in (0.013, -0.014, 0.031, -0.033):
        along = b.x * (1 - 1.5 * (b.y + 0.09)) - centre - 2.5 * b.uneven
        band = np.exp(-((along / 0.0035) ** 2)) - 0.7 * np.exp(-(((np.abs(along) - 0.0075) / 0.004) ** 2))
        b.add(0, 0.9 * band * smoothstep(-0.078, -0.090, b.y))
