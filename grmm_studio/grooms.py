"""Hair styles as fields over the template head: length, direction, clearance, clumps, curls. Needs numpy only."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .fields import azimuth, smoothstep
from .subjects import Subject

Field = Callable[[np.ndarray], np.ndarray]
DOWN = np.array([0.0, -1.0, 0.0])
TAIL_ROOT = np.array([0.0, 0.085, -0.098])  # where a ponytail is tied
BUN_ROOT = np.array([0.0, 0.105, -0.088])


@dataclass
class Groom:
    """One style.

    Attributes:
        count: Strands.
        length: Template root positions [N, 3] -> metres [N].
        flow: (template roots, person's roots) -> combing direction at the root, [N, 3].
        field: (template roots, positions, t in 0..1) -> wanted unit direction, [N, 3].
        clearance: Metres that the hair lies above the skin, [N, 3] -> [N].
        lift: Share of the skin's normal in the first direction.
        stiffness: (unused, how fast the direction follows the field), 0..1.
        messiness: Standard deviation of directions.
        clumps, clumping: Number of locks and how strongly strands join them.
        curl_radius, curl_wavelength, curl_cell, curl_spread: Metres, metres, metres, radians.
        receding: 0..1.
        hug: How much hair is held at the skull, 0..1.
        radius: Strand radius in metres.
    """

    count: int
    length: Field
    flow: Callable[[np.ndarray, np.ndarray], np.ndarray]
    field: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    clearance: Field
    lift: float = 0.6
    stiffness: tuple[float, float] = (0.0, 0.35)
    messiness: float = 0.12
    clumps: int = 500
    clumping: float = 0.5
    curl_radius: float = 0.0
    curl_wavelength: float = 0.03
    curl_cell: float = 0.008
    curl_spread: float = 0.4
    receding: float = 0.0
    hug: float = 0.0
    radius: float = 0.00021


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def _top(rest: np.ndarray) -> np.ndarray:
    """1 on top of the head, 0 on the sides and the back, [N]."""
    side = smoothstep(0.055, 0.078, np.abs(rest[..., 0])) * smoothstep(0.135, 0.10, rest[..., 1])
    back = smoothstep(-0.055, -0.085, rest[..., 2]) * smoothstep(0.12, 0.09, rest[..., 1])
    return (1 - side) * (1 - back) * smoothstep(0.06, 0.095, rest[..., 1])


def _forward(rest: np.ndarray) -> np.ndarray:
    return np.broadcast_to(np.array([0.0, -0.15, 1.0]), rest.shape)


def _parted(rest: np.ndarray, part: float, back: float) -> np.ndarray:
    """Directions away from a part line at x = part, a little backwards, then down."""
    away = np.sign(rest[..., 0] - part * 0.035 + 1e-6)
    # behind the crown the part dissolves and hair falls backwards
    crown = smoothstep(-0.03, -0.06, rest[..., 2])
    side = np.stack([away * (1 - 0.7 * crown), np.full_like(away, -0.25), np.full_like(away, -back) - crown], -1)
    return _unit(side)


def make_groom(subject: Subject) -> Groom | None:
    """The style of a person; None when bald."""
    s = subject
    scale, style = s.hair_length, s.hair_style
    volume = s.hair_volume
    sign = float(np.sign(s.part))

    def constant(value: float) -> Field:
        return lambda rest: np.full(len(rest), value)

    def down_flow(rest: np.ndarray, roots: np.ndarray) -> np.ndarray:
        return np.broadcast_to(DOWN, rest.shape) * 0.4

    def short_field(comb: Callable[[np.ndarray], np.ndarray]) -> Callable[[np.ndarray, np.ndarray, float], np.ndarray]:
        def field(rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
            top = _top(rest)[:, None]
            sides = np.stack([np.zeros(len(rest)), np.full(len(rest), -1.0), np.where(rest[:, 2] > 0, -0.45, -0.1)], -1)
            return _unit(top * comb(rest) + (1 - top) * sides)

        return field

    def graded(top_length: float, side_length: float) -> Field:
        def length(rest: np.ndarray) -> np.ndarray:
            low = smoothstep(-0.04, 0.06, rest[:, 1])
            sides = 0.004 + (side_length - 0.004) * low
            return scale * (sides + (top_length - sides) * _top(rest))

        return length

    def hanging(comb: Callable[[np.ndarray], np.ndarray], fall: float) -> Callable[[np.ndarray, np.ndarray, float], np.ndarray]:
        def field(rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
            # first along the skull, then straight down; hair in front of the ears is combed behind the face
            aside = smoothstep(0.035, 0.072, np.abs(position[:, 0]))
            behind = smoothstep(-0.045, -0.090, position[:, 2])
            weight = np.clip(fall * t + np.maximum(aside, behind) + smoothstep(0.08, 0.045, position[:, 1]), 0, 1)[:, None]
            # below the jaw the hair draws in towards the neck
            inward = -0.10 * np.sign(position[:, 0]) * smoothstep(0.02, -0.06, position[:, 1]) * (np.abs(position[:, 0]) > 0.06)
            fallen = np.stack([inward, np.full(len(rest), -1.0), np.where(position[:, 2] > 0.045, -0.45, 0.0)], -1)
            return _unit((1 - weight) * comb(rest) + weight * fallen)

        return field

    wave = s.hair_curl
    if style == "bald":
        return None
    if style == "buzz":
        return Groom(
            9000,
            constant(0.0055 * scale),
            down_flow,
            short_field(_forward),
            constant(0.0),
            lift=1.0,
            stiffness=(0, 0.15),
            messiness=0.25,
            clumps=0,
            radius=0.00016,
            receding=_recede(s),
        )
    if style in ("crop", "receding"):
        return Groom(
            8000,
            graded(0.036, 0.013),
            lambda r, p: 0.5 * _forward(r) + 0.3 * DOWN,
            short_field(_forward),
            constant(0.002),
            lift=1.0 * volume,
            stiffness=(0, 0.22),
            messiness=0.22,
            clumps=900,
            clumping=0.45,
            curl_radius=0.0018 * wave,
            curl_wavelength=0.018,
            receding=1.0 if style == "receding" else _recede(s),
        )
    if style == "side_part":

        def comb(r: np.ndarray) -> np.ndarray:
            away = np.sign(r[:, 0] - sign * 0.036)
            return _unit(np.stack([away, np.full(len(r), 0.10), np.where(r[:, 2] > 0.05, 0.25, -0.25)], -1))

        return Groom(
            8000,
            graded(0.075, 0.017),
            lambda r, p: 0.9 * comb(r) * _top(r)[:, None] + 0.4 * DOWN * (1 - _top(r))[:, None],
            short_field(comb),
            lambda r: 0.002 + 0.009 * volume * _top(r),
            lift=0.75 * volume,
            stiffness=(0, 0.30),
            messiness=0.09,
            hug=0.6,
            clumps=600,
            clumping=0.55,
            curl_radius=0.002 * wave,
            curl_wavelength=0.035,
            receding=_recede(s),
        )
    if style == "slick_back":

        def comb(r: np.ndarray) -> np.ndarray:
            return _unit(np.stack([0.15 * np.sign(r[:, 0]), np.where(r[:, 2] > 0.03, 0.35, -0.25), np.full(len(r), -1.0)], -1))

        def back_field(rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
            down = smoothstep(-0.02, -0.085, position[:, 2])[:, None]
            return _unit(comb(rest) * (1 - down) + DOWN * down)

        return Groom(
            8000,
            graded(0.115, 0.055),
            lambda r, p: comb(r),
            back_field,
            lambda r: 0.003 + 0.006 * volume * _top(r),
            lift=0.45,
            stiffness=(0, 0.40),
            messiness=0.06,
            hug=0.6,
            clumps=450,
            clumping=0.7,
            receding=_recede(s) * 0.7,
        )
    if style == "fringe":

        def comb(r: np.ndarray) -> np.ndarray:
            return _unit(
                np.stack([0.30 * sign * np.ones(len(r)), np.full(len(r), -0.1), np.where(r[:, 2] > -0.02, 1.0, -0.7)], -1)
            )

        def fringe_field(rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
            over = smoothstep(0.06, 0.095, position[:, 2])[:, None]
            top = _top(rest)[:, None]
            sides = np.stack([np.zeros(len(rest)), np.full(len(rest), -1.0), np.where(rest[:, 2] > 0, -0.15, 0.0)], -1)
            return _unit(top * (comb(rest) * (1 - over) + (DOWN + 0.15 * comb(rest)) * over) + (1 - top) * sides)

        side = 0.13 if s.macros["female"] > 0.5 else 0.03

        def fringe_length(rest: np.ndarray) -> np.ndarray:
            # ends above the brows: the way over the forehead plus a few centimetres
            front = np.clip(0.105 - rest[:, 2], 0.0, 0.12)
            return scale**0.3 * (_top(rest) * (0.042 + 0.75 * front) + (1 - _top(rest)) * side)

        return Groom(
            8500,
            fringe_length,
            lambda r, p: comb(r) * _top(r)[:, None] + 0.4 * DOWN,
            fringe_field,
            lambda r: 0.003 + 0.005 * volume * _top(r),
            lift=0.7,
            stiffness=(0, 0.38),
            messiness=0.07,
            hug=0.5,
            clumps=600,
            clumping=0.55,
        )
    if style in ("bob", "long", "wavy_long"):
        length = {"bob": 0.20, "long": 0.275, "wavy_long": 0.27}[style]

        def comb(r: np.ndarray) -> np.ndarray:
            return _parted(r, s.part, 0.55)

        waves = {"bob": 0.25 * wave, "long": 0.35 * wave, "wavy_long": 0.5 + 0.5 * wave}[style]

        def fall_length(rest: np.ndarray) -> np.ndarray:
            # one cutting line: hair from lower down is shorter
            return scale**0.5 * np.maximum(length - 0.55 * (0.14 - rest[:, 1]), 0.06)

        return Groom(
            8500,
            fall_length,
            lambda r, p: comb(r),
            hanging(comb, 0.35),
            lambda r: 0.003 + 0.007 * volume * smoothstep(0.0, 0.1, r[:, 1]),
            lift=0.4 * volume,
            stiffness=(0, 0.6),
            messiness=0.05,
            hug=0.6,
            clumps=420,
            clumping=0.6,
            curl_radius=0.0095 * waves,
            curl_wavelength=0.085,
            curl_cell=0.016,
            curl_spread=0.35,
            radius=0.00025,
        )
    if style in ("afro", "curly"):
        big = style == "afro"

        def out(rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
            outward = _unit(position - np.array([0.0, 0.055, -0.01]))
            weight = 0.0 if big else np.clip(0.9 * t, 0, 1)
            return _unit(outward * (1 - 0.6 * weight) + weight * DOWN)

        base = 0.060 if big else (0.13 if s.macros["female"] > 0.5 else 0.055)

        def curly_length(rest: np.ndarray) -> np.ndarray:
            return scale * base * (0.35 + 0.65 * smoothstep(-0.05, 0.08, rest[:, 1])) * np.where(azimuth(rest) < 75, 0.8, 1.0)

        return Groom(
            8500,
            curly_length,
            lambda r, p: np.zeros_like(r),
            out,
            constant(0.003),
            lift=1.0,
            stiffness=(0, 0.25),
            messiness=0.22 if big else 0.16,
            clumps=700 if big else 420,
            clumping=0.25 if big else 0.4,
            curl_radius=0.0035 if big else 0.0065,
            curl_wavelength=0.013 if big else 0.026,
            curl_cell=0.006,
            curl_spread=0.9 if big else 0.5,
            receding=_recede(s) * 0.5,
            radius=0.00023,
        )
    # ponytail, bun: combed to a knot; the tail itself is grown by `tail_points`
    knot = TAIL_ROOT if style == "ponytail" else BUN_ROOT

    def tied_length(rest: np.ndarray) -> np.ndarray:
        return np.linalg.norm(rest - knot, axis=1) * 1.22 + 0.004

    def tied(rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
        return _unit(knot + np.array([0, 0, -0.004]) - position)

    return Groom(
        7500,
        tied_length,
        lambda r, p: _unit(knot - r),
        tied,
        constant(0.0028),
        lift=0.25,
        stiffness=(0, 0.75),
        messiness=0.04,
        hug=0.5,
        clumps=350,
        clumping=0.35,
        radius=0.00022,
    )


def _recede(s: Subject) -> float:
    if s.macros["female"] > 0.5:
        return 0.0
    return float(np.clip((s.macros["age"] - 32) / 60 + 0.15 * np.sin(s.asymmetry), 0.0, 0.6))


def tail_points(subject: Subject, g: np.random.Generator, steps: int) -> np.ndarray:
    """Strands of a ponytail or a bun in template coordinates, [N, steps, 3]; empty for other styles."""
    t = np.linspace(0, 1, steps)
    if subject.hair_style == "ponytail":
        count, length = 2600, 0.24 * subject.hair_length
        disk = g.normal(0, 1, (count, 2))
        disk /= np.maximum(np.linalg.norm(disk, axis=1, keepdims=True), 1.0) * 1.0
        swell = (0.004 + 0.016 * np.sin(np.clip(t * 1.15, 0, 1) * np.pi) * (1 - 0.4 * t))[None]
        own = length * np.clip(g.normal(1, 0.12, (count, 1)), 0.6, 1.3)
        out = 0.035 * (1 - np.exp(-5 * t))[None] * np.ones((count, 1))
        wave = 0.006 * subject.hair_curl * np.sin(t * 9 + g.normal(0, 0.4, (count, 1)))
        x = disk[:, :1] * swell + wave
        y = 0.012 * np.sin(np.clip(t * 4, 0, np.pi))[None] - own * np.maximum(t - 0.06, 0)[None] ** 1.15
        z = -out + disk[:, 1:] * swell * 0.8
        return TAIL_ROOT + np.stack([x, y, z], -1)
    if subject.hair_style == "bun":
        count = 2600
        tilt = g.normal(0, 0.55, (count, 1))
        start = g.uniform(0, 2 * np.pi, (count, 1))
        ring = g.uniform(0.012, 0.030, (count, 1)) * np.sqrt(subject.hair_volume)
        angle = start + (0.9 + 0.8 * g.random((count, 1))) * np.pi * t[None]
        thickness = g.uniform(-1, 1, (count, 1)) * np.sqrt(np.maximum(0.031**2 - ring**2, 0)) * 0.75
        x, y = ring * np.cos(angle), ring * np.sin(angle) * 0.9
        z = -0.014 + thickness + 0.004 * np.sin(3 * angle + tilt)
        return BUN_ROOT + np.stack([x, y + 0.3 * z, z], -1)
    return np.zeros((0, steps, 3))
