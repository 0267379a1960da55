"""Hair styles as fields over the template head: length, direction, clearance. Needs numpy only.

`growth_of` reads a row of `styles.STYLES` for a person. A cut, a comb or a way is one function each, found by its name.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from grmm_core.wrinkles.noise import smoothstep, wave_noise

from .fields import azimuth
from .styles import BALD, STYLES, Style
from .subjects import Subject

DOWN = np.array([0.0, -1.0, 0.0])
KNOTS = {"ponytail": np.array([0.0, 0.085, -0.098]), "bun": np.array([0.0, 0.105, -0.088])}  # where hair is tied
SWEPT = 0.06  # metres from the middle: where swept hair goes to a side as much as it does anywhere
CROWN = np.array([0.0, 0.055, -0.01])  # what round hair stands away from


@dataclass
class Growth:
    """How the strands of one person grow.

    Attributes:
        style: The row of the table.
        length: Template roots [N, 3] -> metres [N].
        flow: Template roots -> combing direction at the root, [N, 3].
        way: (template roots, positions, t in 0..1) -> wanted unit direction, [N, 3].
        clearance: Template roots -> metres that the hair lies above the skin, [N].
        lift: Share of the skin's normal in the first direction.
        curl_radius: Metres.
        receding: 0..1.
    """

    style: Style
    length: Callable[[np.ndarray], np.ndarray]
    flow: Callable[[np.ndarray], np.ndarray]
    way: Callable[[np.ndarray, np.ndarray, float], np.ndarray]
    clearance: Callable[[np.ndarray], np.ndarray]
    lift: float
    curl_radius: float
    receding: float


def growth_of(subject: Subject) -> Growth | None:
    """The style of a person; None when bald."""
    if subject.hair_style == BALD:
        return None
    style = STYLES[subject.hair_style]
    return Growth(
        style,
        partial(CUTS[style.cut], style, subject),
        partial(_flow, style, subject),
        partial(WAYS[style.way], partial(COMBS[style.comb], subject)),
        partial(_clearance, style, subject),
        style.lift * (subject.hair_volume if style.lift_volume else 1.0),
        style.curl + style.own_curl * subject.hair_curl,
        1.0 if style.receding > 1 else style.receding * _recede(subject),
    )


def _recede(s: Subject) -> float:
    if s.female:
        return 0.0
    return float(np.clip((s.macros["age"] - 32) / 60 + 0.15 * np.sin(s.asymmetry), 0.0, 0.6))


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-9)


def _rows(rest: np.ndarray, *xyz: float | np.ndarray) -> np.ndarray:
    """A direction for each root from numbers or columns, [N, 3]."""
    return np.stack([np.broadcast_to(np.asarray(v, float), rest.shape[:1]) for v in xyz], -1)


def _top(rest: np.ndarray) -> np.ndarray:
    """1 on top of the head, 0 on the sides and the back, [N]."""
    side = smoothstep(0.055, 0.078, np.abs(rest[..., 0])) * smoothstep(0.135, 0.10, rest[..., 1])
    back = smoothstep(-0.055, -0.085, rest[..., 2]) * smoothstep(0.12, 0.09, rest[..., 1])
    return (1 - side) * (1 - back) * smoothstep(0.06, 0.095, rest[..., 1])


def _flow(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    top = _top(rest)[:, None]
    led = style.root_comb * COMBS[style.comb](s, rest, rest)
    down = style.root_down * DOWN
    return led * (top if style.comb_on_top else 1.0) + down * (1 - top if style.down_on_sides else 1.0)


def _clearance(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    where: dict[str, float | np.ndarray] = {"": 0.0, "top": _top(rest), "crown": smoothstep(0.0, 0.1, rest[:, 1])}
    return np.full(len(rest), style.clearance) + style.puff * s.hair_volume * where[style.puffs]


def _length(style: Style, s: Subject) -> float:
    return style.length if s.female or style.mens is None else style.mens


def _even(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    return np.full(len(rest), _length(style, s) * s.hair_length)


def _graded(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    low = smoothstep(-0.04, 0.06, rest[:, 1])
    sides = 0.004 + (style.sides - 0.004) * low
    if style.fade:  # shorn on the sides, from the temples down
        sides = np.maximum(sides * smoothstep(style.fade - 0.05, style.fade + 0.01, rest[:, 1]), 0.0012)
    return s.hair_length * (sides + (_length(style, s) - sides) * _top(rest))


def _crest(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    middle = smoothstep(0.030, 0.020, np.abs(rest[:, 0])) * smoothstep(0.02, 0.05, rest[:, 1])
    return s.hair_length * (style.sides + (_length(style, s) - style.sides) * middle)


def _fringe(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    # ends above the brows: the way over the forehead plus a few centimetres
    front = np.clip(0.105 - rest[:, 2], 0.0, 0.12)
    sides = style.sides if s.female or style.mens_sides is None else style.mens_sides
    return s.hair_length**0.3 * (_top(rest) * (_length(style, s) + 0.75 * front) + (1 - _top(rest)) * sides)


def _line(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    # one cutting line: hair from lower down is shorter
    return s.hair_length**0.5 * np.maximum(_length(style, s) - 0.55 * (0.14 - rest[:, 1]), 0.06)


def _layers(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    # in steps: the hair of the crown ends higher than that of the nape
    step = 0.55 + 0.45 * smoothstep(0.14, 0.02, rest[:, 1]) + 0.08 * np.sin(rest @ np.array([311.0, 207.0, 173.0]))
    return _line(style, s, rest) * np.clip(step, 0.4, 1.0)


def _round(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    height = 0.35 + 0.65 * smoothstep(-0.05, 0.08, rest[:, 1])
    return s.hair_length * _length(style, s) * height * np.where(azimuth(rest) < 75, 0.8, 1.0)


def _to_knot(style: Style, s: Subject, rest: np.ndarray) -> np.ndarray:
    return np.linalg.norm(rest - KNOTS[style.comb], axis=1) * 1.22 + 0.004


CUTS: dict[str, Callable[[Style, Subject, np.ndarray], np.ndarray]] = {
    "even": _even, "graded": _graded, "crest": _crest, "fringe": _fringe, "line": _line, "layers": _layers, "round": _round,
    "tied": _to_knot,
}  # fmt: skip


def _no_comb(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    return np.zeros_like(rest)


def _comb_forward(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    over = smoothstep(0.05, 0.10, at[:, 2])  # and down over the forehead
    return _rows(rest, 0.0, -0.15 - over, 1.0 - 0.75 * over)


def _comb_aside(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    away = np.sign(rest[:, 0] - np.sign(s.part) * 0.036)
    return _unit(_rows(rest, away, 0.10, np.where(rest[:, 2] > 0.05, 0.25, -0.25)))


def _comb_side(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Aside from a part line that dissolves behind the crown."""
    away = np.sign(rest[:, 0] - np.sign(s.part) * 0.036) * (1.0 - 0.8 * smoothstep(-0.01, -0.05, rest[:, 2]))
    behind = smoothstep(0.0, -0.05, rest[:, 2])
    return _unit(_rows(rest, away, 0.10 - 0.3 * behind, np.where(rest[:, 2] > 0.05, 0.25, -0.25) - 0.6 * behind))


def _comb_back(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    return _unit(_rows(rest, 0.15 * np.sign(rest[:, 0]), np.where(rest[:, 2] > 0.03, 0.35, -0.25), -1.0))


def _comb_swept(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Back, without a valley between the two sides."""
    aside = 0.15 * np.clip(rest[:, 0] / SWEPT, -1.0, 1.0)
    return _unit(_rows(rest, aside, np.where(rest[:, 2] > 0.03, 0.35, -0.25), -1.0))


def _comb_quiff(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    front = smoothstep(0.02, 0.08, rest[:, 2])
    return _unit(_rows(rest, 0.25 * np.sign(s.part) * front, 0.9 * front - 0.15, -0.8))


def _comb_fringe(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    ahead = smoothstep(-0.075, -0.005, rest[:, 2])  # around a whorl behind the crown
    return _unit(_rows(rest, np.sign(s.part) * (0.30 + 1.2 * ahead * (1 - ahead)), -0.1, 1.7 * ahead - 0.7))


def _comb_parted(s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Away from a part line, a little backwards; behind the crown the part dissolves and hair falls backwards."""
    away = np.sign(rest[..., 0] - s.part * 0.035 + 0.0012 * wave_noise(rest, 0.012, 5))  # no ruler drew the line
    crown = smoothstep(-0.03, -0.06, rest[..., 2])
    return _unit(_rows(rest, away * (1 - 0.7 * crown), -0.25, -0.55 - crown))


def _comb_knot(name: str, s: Subject, rest: np.ndarray, at: np.ndarray) -> np.ndarray:
    return _unit(KNOTS[name] - at)


COMBS: dict[str, Callable[[Subject, np.ndarray, np.ndarray], np.ndarray]] = {
    "none": _no_comb, "forward": _comb_forward, "aside": _comb_aside, "side": _comb_side, "back": _comb_back,
    "swept": _comb_swept, "quiff": _comb_quiff, "fringe": _comb_fringe, "parted": _comb_parted,
    **{name: partial(_comb_knot, name) for name in KNOTS},
}  # fmt: skip
Comb = Callable[[np.ndarray, np.ndarray], np.ndarray]


def _sides(rest: np.ndarray, front: float, behind: float) -> np.ndarray:
    return _rows(rest, 0.0, -1.0, np.where(rest[:, 2] > 0, front, behind))


def _way_short(comb: Comb, rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
    top = _top(rest)[:, None]
    return _unit(top * comb(rest, position) + (1 - top) * _sides(rest, -0.45, -0.1))


def _way_fringe(comb: Comb, rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
    x, z = position[:, 0], position[:, 2]
    over = np.maximum(smoothstep(0.06, 0.095, z), smoothstep(0.055, 0.075, np.abs(x)))
    over, top = np.maximum(over, smoothstep(-0.06, -0.09, z))[:, None], _top(rest)[:, None]
    top = top * np.maximum(smoothstep(0.060, 0.045, np.abs(rest[:, 0])), smoothstep(0.03, 0.0, rest[:, 2]))[:, None]
    led = comb(rest, position)
    return _unit(top * (led * (1 - over) + (DOWN + 0.15 * led) * over) + (1 - top) * _sides(rest, -0.15, 0.0))


def _way_back(comb: Comb, rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
    down = smoothstep(-0.02, -0.085, position[:, 2])[:, None]
    return _unit(comb(rest, position) * (1 - down) + DOWN * down)


def _way_hanging(comb: Comb, rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
    """First along the skull, then straight down; hair in front of the ears is combed behind the face."""
    x, y, z = position.T
    aside, behind = smoothstep(0.035, 0.072, np.abs(x)), smoothstep(-0.045, -0.090, z)
    weight = np.clip(0.35 * t + np.maximum(aside, behind) + smoothstep(0.08, 0.045, y), 0, 1)[:, None]
    # below the jaw the hair draws in towards the neck
    inward = -0.10 * np.sign(x) * smoothstep(0.02, -0.06, y) * (np.abs(x) > 0.06)
    fallen = _rows(rest, inward, -1.0, np.where(z > 0.045, -0.45, 0.0))
    return _unit((1 - weight) * comb(rest, position) + weight * fallen)


def _way_out(droop: float, comb: Comb, rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
    weight = min(droop * t, 1.0)
    return _unit(_unit(position - CROWN) * (1 - 0.6 * weight) + weight * DOWN)


def _way_tied(comb: Comb, rest: np.ndarray, position: np.ndarray, t: float) -> np.ndarray:
    return comb(rest, position + np.array([0, 0, 0.004]))


WAYS: dict[str, Callable[[Comb, np.ndarray, np.ndarray, float], np.ndarray]] = {
    "short": _way_short, "fringe": _way_fringe, "back": _way_back, "hanging": _way_hanging, "out": partial(_way_out, 0.0),
    "drooping": partial(_way_out, 0.9), "ponytail": _way_tied, "bun": _way_tied,
}  # fmt: skip


def tail_points(s: Subject, g: np.random.Generator, steps: int) -> np.ndarray:
    """Strands of a ponytail or a bun in template coordinates, [N, steps, 3]; empty for other styles."""
    t = np.linspace(0, 1, steps)
    count = 9000
    if s.hair_style == "ponytail":
        length = 0.20 * s.hair_length
        disk = g.normal(0, 1, (count, 2))
        disk /= np.maximum(np.linalg.norm(disk, axis=1, keepdims=True), 1.0)
        locks = g.integers(0, 80, count)  # hair of which goes together towards the ends
        together = (0.8 * smoothstep(0.2, 1.0, t))[None, :, None]
        disk = disk[:, None] + together * (0.8 * g.normal(0, 0.6, (80, 1, 2))[locks] - disk[:, None])
        swell = 0.006 + 0.020 * np.sin(np.clip(t * 1.6, 0, 1.3) * np.pi / 2)[None]
        own = length * np.clip(g.normal(1, 0.05, (count, 1)) + g.normal(0, 0.12, (80, 1))[locks], 0.5, 1.3)
        out = 0.035 * (1 - np.exp(-5 * t))[None] * np.ones((count, 1))
        wave = 0.006 * s.hair_curl * np.sin(t * 9 + g.normal(0, 0.4, (count, 1)))
        x = disk[..., 0] * swell + wave
        y = 0.012 * np.sin(np.clip(t * 4, 0, np.pi))[None] - own * np.maximum(t - 0.06, 0)[None] ** 1.15
        z = -out + disk[..., 1] * swell * 0.8
        return KNOTS["ponytail"] + np.stack([x, y, z], -1)
    if s.hair_style == "bun":
        # turns of a ball of yarn, most of them about the axis that the knot has behind the head
        axis = _unit(np.array([0.0, 0.3, -1.0]) + g.normal(0, 0.45, (count, 3)))
        first = _unit(np.cross(axis, g.normal(0, 1, (count, 3))))
        off = g.uniform(-0.9, 0.9, (count, 1))
        ring = np.sqrt(1 - off**2) * (1 - 0.3 * g.random((count, 1)) ** 2)
        angle = ((0.9 + 0.8 * g.random((count, 1))) * np.pi * t[None])[..., None]
        ball = off[:, None] * axis[:, None] + ring[:, None] * (
            np.cos(angle) * first[:, None] + np.sin(angle) * np.cross(axis, first)[:, None]
        )
        return KNOTS["bun"] + np.array([0.0, 0.0, -0.016]) + 0.029 * np.sqrt(s.hair_volume) * ball * np.array([1.0, 0.95, 0.8])
    return np.zeros((0, steps, 3))
