"""What life leaves on a skin: moles, scars, pimples, pale patches, make-up; painted over the color. Needs numpy only.

Everything is drawn from `Subject.asymmetry`, in template positions (head space, metres). `textures` calls `paint_marks`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grmm_core.wrinkles.noise import bump, smoothstep, wave_noise

from .subjects import Subject, skin_albedo

LIPSTICKS = (
    (0.42, 0.02, 0.03), (0.30, 0.02, 0.06), (0.45, 0.10, 0.09), (0.20, 0.015, 0.02), (0.48, 0.12, 0.18), (0.34, 0.10, 0.07),
)  # fmt: skip
SHADOWS = (
    (0.12, 0.06, 0.04), (0.10, 0.05, 0.12), (0.05, 0.06, 0.12), (0.30, 0.20, 0.08), (0.02, 0.02, 0.02), (0.30, 0.12, 0.12),
)  # fmt: skip
MADE_UP = {True: 0.55, False: 0.02}  # share of women and of men
SCARRED, PALE_PATCHES = 0.22, 0.02  # shares of all


@dataclass
class Canvas:
    """A skin while it is painted.

    Attributes:
        rest: Template positions of the texels, [n, 3].
        color: Linear RGB, [n, 3].
        height: Metres, [n].
        roughness: [n].
    """

    rest: np.ndarray
    color: np.ndarray
    height: np.ndarray
    roughness: np.ndarray

    def lay(self, where: np.ndarray, color: np.ndarray) -> None:
        """Mix a color over the skin by weights [n]."""
        w = np.clip(where, 0, 1)[:, None]
        self.color = self.color * (1 - w) + np.asarray(color) * w


def paint_marks(s: Subject, canvas: Canvas, lips: np.ndarray, lash_line: np.ndarray) -> None:
    """Paint a person's marks and make-up.

    Args:
        s: The person.
        canvas: The skin; changed.
        lips: Weight of the lips, [n].
        lash_line: Points along the edges of the upper lids, [m, 3].
    """
    g = np.random.default_rng([s.asymmetry, 81])
    rest, age = canvas.rest, s.macros["age"]
    skin = 1 - np.clip(lips, 0, 1)
    for _ in range(int(g.poisson(1.8 + 2.5 * s.spots))):
        where = _dot(rest, _place(rest, g), float(g.uniform(0.0009, 0.0026)))
        canvas.lay(0.85 * where * skin, skin_albedo(s.melanin + float(g.uniform(0.4, 1.6)), s.blood + float(g.uniform(0, 0.5))))
        canvas.height += 0.0006 * float(g.random()) * where
    if age < 32:
        for _ in range(int(g.poisson(float(g.choice([0.5, 2.0, 14.0], p=[0.5, 0.35, 0.15]))))):
            where = _dot(rest, _place(rest, g), float(g.uniform(0.0010, 0.0022)))
            canvas.lay(0.6 * where * skin, skin_albedo(s.melanin, s.blood + 0.75))
            canvas.height += 0.0004 * where
    if g.random() < SCARRED:
        for _ in range(int(g.integers(1, 3))):
            where = _line(rest, _place(rest, g), float(g.uniform(0.004, 0.014)), g)
            old = g.random() < 0.6
            healed = skin_albedo(0.6 * s.melanin, max(s.blood - 0.1, 0.25)) if old else skin_albedo(s.melanin, s.blood + 0.4)
            canvas.lay(0.7 * where * skin, healed)
            canvas.height -= 0.00025 * where
            canvas.roughness -= 0.12 * where
    if g.random() < PALE_PATCHES:
        field = wave_noise(rest, 0.045, s.asymmetry + 5)
        canvas.lay(0.9 * smoothstep(0.46, 0.56, field) * skin, skin_albedo(0.05, s.blood))
    if g.random() < MADE_UP[s.female]:
        _make_up(s, canvas, lips, lash_line, g)


def _make_up(s: Subject, canvas: Canvas, lips: np.ndarray, lash_line: np.ndarray, g: np.random.Generator) -> None:
    rest = canvas.rest
    much = float(g.beta(1.5, 1.8))
    even = skin_albedo(s.melanin, s.blood)
    canvas.lay(0.45 * much * (1 - lips), 0.5 * even + 0.5 * canvas.color)  # foundation
    if g.random() < 0.8:
        canvas.lay(np.clip(lips, 0, 1) * (0.3 + 0.6 * much), np.array(LIPSTICKS[int(g.integers(len(LIPSTICKS)))]))
        canvas.roughness -= float(g.uniform(-0.05, 0.18)) * lips
    blush = bump(rest, (0.046, 0.004, 0.080), (0.020, 0.013, 0.03))
    canvas.lay(0.45 * much * float(g.random()) * blush, even * np.array([1.0, 0.45, 0.48]))
    shadow = bump(rest, (0.031, 0.0450, 0.090), (0.017, 0.0065, 0.03))
    canvas.lay(0.75 * much * float(g.random()) * shadow, np.array(SHADOWS[int(g.integers(len(SHADOWS)))]))
    if g.random() < 0.6:
        near = np.flatnonzero(np.abs(rest[:, 1] - 0.036) < 0.014)
        distance = np.min([np.linalg.norm(rest[near] - point, axis=1) for point in lash_line], axis=0)
        width = float(g.uniform(0.0006, 0.0016))
        liner = np.zeros(len(rest))
        liner[near] = smoothstep(1.6 * width, 0.6 * width, distance)
        canvas.lay((0.5 + 0.5 * much) * liner, np.array([0.015, 0.013, 0.012]))


def _place(rest: np.ndarray, g: np.random.Generator) -> np.ndarray:
    """A place on the front of face and neck more often than elsewhere."""
    for _ in range(12):
        place = rest[int(g.integers(len(rest)))]
        if place[2] > 0.03:
            break
    return place


def _dot(rest: np.ndarray, place: np.ndarray, radius: float) -> np.ndarray:
    return smoothstep(1.2, 0.55, np.linalg.norm(rest - place, axis=1) / radius)


def _line(rest: np.ndarray, place: np.ndarray, half: float, g: np.random.Generator) -> np.ndarray:
    """A bent line around a place."""
    angle = float(g.uniform(0, np.pi))
    along = np.array([np.cos(angle), np.sin(angle), 0.0])
    offset = rest - place
    run = offset @ along
    aside = np.linalg.norm(offset - run[:, None] * along, axis=1) + 0.0004 * np.sin(run * 900 + angle)
    return smoothstep(0.0011, 0.0004, aside) * smoothstep(half, 0.6 * half, np.abs(run))
