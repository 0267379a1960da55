"""Lines and blood that an expression brings to the skin: painted once per person, driven per shot. Needs numpy only.

`paint_lines` makes a relief map with three channels, in which families of lines that overlap nowhere share a channel;
`LineField.amounts` says for a shot how far each channel is driven at each vertex and how the color changes. The material adds
the product of both to the skin's relief and darkens the grooves. In the neutral face every amount is 0 and every color factor
1. Used by `textures`, `scene` and `materials`; all places are template positions (head space, metres), x = 0 the middle.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from grmm_core.controls.names import ARKIT_NAMES

from .fields import bump, smoothstep, wave_noise
from .subjects import Subject, skin_albedo

LINE_DEPTH = 0.0028  # metres of relief at a map value of 1
YOUNG_DEPTH, AGED_DEPTH = 0.36, 0.92  # share of the depth that everybody has, and that age adds
MAX_AMOUNT = 1.25
EYE_CORNER = (0.0425, 0.034)  # x, y of the outer corner of the eye
MOUTH_HEIGHT = -0.0325
NOSE_WING, FOLD_END = (0.0185, 0.004), (0.0365, -0.040)  # x, y of the ends of the nasolabial fold

# family: ((shape without its side, weight), ...); a family follows the strongest of its drivers on each side
DRIVERS: dict[str, tuple[tuple[str, float], ...]] = {
    "forehead_middle": (("browInnerUp", 1.0),),
    "forehead_side": (("browOuterUp", 1.0), ("browInnerUp", 0.25), ("eyeWide", 0.2)),
    "glabella": (("browDown", 1.0), ("noseSneer", 0.3)),
    "crow": (("eyeSquint", 0.85), ("cheekSquint", 0.9), ("mouthSmile", 0.6), ("eyeBlink", 0.25)),
    "under_eye": (("eyeSquint", 0.9), ("cheekSquint", 0.9), ("mouthSmile", 0.45), ("eyeBlink", 0.15)),
    "bunny": (("noseSneer", 1.0), ("mouthUpperUp", 0.25)),
    "fold": (
        ("mouthSmile", 1.0),
        ("noseSneer", 0.8),
        ("mouthUpperUp", 0.75),
        ("cheekSquint", 0.45),
        ("mouthStretch", 0.45),
        ("mouthDimple", 0.35),
    ),
    "cheek": (("mouthSmile", 0.8), ("mouthDimple", 0.7), ("mouthStretch", 0.55)),
    "dimple": (("mouthDimple", 1.0), ("mouthSmile", 0.15), ("mouthPress", 0.3)),
    "marionette": (("mouthFrown", 1.0), ("mouthStretch", 0.35), ("mouthShrugLower", 0.3)),
    "chin": (("mouthShrugLower", 1.0), ("mouthFrown", 0.35), ("mouthPress", 0.25), ("mouthPucker", 0.2)),
    "lips": (("mouthPucker", 1.0), ("mouthFunnel", 0.55), ("mouthPress", 0.25), ("mouthRollUpper", 0.3)),
    "neck": (("mouthStretch", 1.0), ("mouthLowerDown", 0.3), ("mouthFrown", 0.35)),
}


def drive(weights: Mapping[str, float], family: str, side: str = "") -> float:
    """How far a family of lines is driven, 0..1.

    Args:
        weights: ARKit names to their coefficients.
        family: Key of `DRIVERS`.
        side: "Left", "Right"; shapes without sides count for both.
    """
    values = [weight * _of(weights, name, side) for name, weight in DRIVERS[family]]
    return float(np.clip(max(values) + 0.25 * (sum(values) - max(values)), 0.0, 1.0))


def _of(weights: Mapping[str, float], name: str, side: str) -> float:
    value = weights[name] if name in weights else weights.get(name + side, 0.0)
    return float(np.clip(value, 0.0, 1.0))


def line_depth(subject: Subject) -> float:
    """Depth of the expression's lines of a person: some for everybody, more with age."""
    return YOUNG_DEPTH + AGED_DEPTH * subject.wrinkles**0.8


@dataclass
class LineField:
    """What lies where on a person's skin, for the vertices of the render mesh.

    Attributes:
        families: Channel and weight at each vertex, by (family, side), [n] each.
        colors: Weight at each vertex of each color change, by (name, side), [n] each.
        flush, pale: Factors of the color with more and with less blood, [3].
        depth: `line_depth` of the person.
    """

    families: dict[tuple[str, str], tuple[int, np.ndarray]]
    colors: dict[tuple[str, str], np.ndarray]
    flush: np.ndarray
    pale: np.ndarray
    depth: float

    @staticmethod
    def build(subject: Subject, rest: np.ndarray, skin: np.ndarray, lips: np.ndarray) -> LineField:
        """Lay the families out over template positions [n, 3]; `skin` and `lips` are weights of the vertices, [n]."""
        x, y, z = rest.T
        families: dict[tuple[str, str], tuple[int, np.ndarray]] = {}
        colors: dict[tuple[str, str], np.ndarray] = {}
        front = smoothstep(0.01, 0.04, z) * skin
        brow = smoothstep(0.056, 0.066, y) * front
        families["forehead_middle", ""] = (0, brow * np.exp(-((x / 0.030) ** 2)))
        families["neck", ""] = (0, smoothstep(-0.062, -0.082, y) * skin * smoothstep(-0.03, 0.01, z))
        families["chin", ""] = (0, bump(rest, (0, -0.056, 0.10), (0.022, 0.015, 0.06), False) * front)
        around = np.hypot(x / 0.030, (y - MOUTH_HEIGHT) / 0.019)
        families["lips", ""] = (1, smoothstep(1.15, 0.8, around) * front)
        for side, sign in (("Left", 1.0), ("Right", -1.0)):
            own = smoothstep(-0.007, 0.007, sign * x)
            outer = smoothstep(0.004, 0.026, sign * x)
            crow = smoothstep(0.036, 0.046, sign * x) * smoothstep(-0.008, 0.010, y) * smoothstep(0.066, 0.052, y)
            nose = smoothstep(0.023, 0.014, np.abs(x)) * smoothstep(0.010, 0.020, y) * smoothstep(0.052, 0.044, y)
            below = bump(rest, (0.031, 0.020, 0.09), (0.018, 0.012, 0.04)) * smoothstep(0.010, 0.017, np.abs(x))
            cheek = smoothstep(0.016, 0.020, sign * x) * smoothstep(0.014, 0.002, y) * smoothstep(-0.058, -0.046, y)
            low = smoothstep(0.018, 0.024, sign * x) * smoothstep(-0.028, -0.036, y) * smoothstep(-0.08, -0.064, y)
            corner = bump(rest * [sign, 1, 1], (0.037, -0.030, 0.085), (0.012, 0.014, 0.05), False)
            families["forehead_side", side] = (0, brow * outer)
            families["glabella", side] = (
                1,
                own * bump(rest, (0.0, 0.060, 0.11), (0.020, 0.017, 0.04), False) * front,
            )
            families["crow", side] = (1, crow * skin)
            families["under_eye", side] = (2, own * np.clip(1.4 * below, 0, 1) * front)
            families["bunny", side] = (2, own * nose * front)
            families["fold", side] = (0, cheek * front)
            families["cheek", side] = (1, smoothstep(0.036, 0.042, sign * x) * cheek * front)
            families["marionette", side] = (2, low * front)
            families["dimple", side] = (1, corner * front)
            colors["cheek", side] = own * bump(rest, (0.042, 0.004, 0.085), (0.022, 0.020, 0.04)) * skin
            colors["nose", side] = own * bump(rest, (0.006, 0.020, 0.115), (0.014, 0.022, 0.03)) * skin
            colors["glabella", side] = own * bump(rest, (0.004, 0.062, 0.11), (0.014, 0.015, 0.04)) * skin
            colors["forehead", side] = own * smoothstep(0.060, 0.072, y) * smoothstep(0.108, 0.09, y) * front
        colors["mouth", ""] = lips
        colors["chin", ""] = families["chin", ""][1] * (1 - lips)
        normal = skin_albedo(subject.melanin, subject.blood)
        return LineField(
            families,
            colors,
            skin_albedo(subject.melanin, subject.blood + 0.42) / normal,
            skin_albedo(subject.melanin, max(subject.blood - 0.34, 0.08)) / normal,
            line_depth(subject),
        )

    def amounts(self, expression: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Line amounts [n, 3] of the map's channels and color factors [n, 3] of a shot's coefficients [E >= 52]."""
        weights = {name: float(value) for name, value in zip(ARKIT_NAMES, expression, strict=False)}
        count = len(next(iter(self.colors.values())))
        lines, blood = np.zeros((count, 3)), np.zeros(count)
        for (family, side), (channel, where) in self.families.items():
            amount = drive(weights, family, side)
            if amount > 0:
                lines[:, channel] += amount**0.8 * where
        for (name, side), where in self.colors.items():
            amount = blood_change(weights, name, side)
            if amount:
                blood += amount * where
        blood = np.clip(blood, -1, 1)[:, None]
        color = 1 + np.maximum(blood, 0) * (self.flush - 1) + np.maximum(-blood, 0) * (self.pale - 1)
        return np.minimum(lines, 1.0) * min(self.depth, MAX_AMOUNT), color


def blood_change(weights: Mapping[str, float], place: str, side: str) -> float:
    """Flush (positive) or paling (negative) of a place of `LineField.colors`, -1..1."""

    def of(name: str) -> float:
        return _of(weights, name, side)

    if place == "cheek":
        return 0.55 * max(of("mouthSmile"), 0.9 * of("cheekPuff"), 0.8 * of("cheekSquint")) - 0.25 * of("mouthStretch")
    if place == "nose":
        return 0.6 * of("noseSneer")
    if place == "glabella":
        return 0.6 * of("browDown")
    if place == "forehead":
        return 0.25 * max(of("browInnerUp"), of("browOuterUp"))
    if place == "mouth":
        press = max(of("mouthRollLower"), of("mouthRollUpper"), 0.8 * max(of("mouthPressLeft"), of("mouthPressRight")))
        stretch = 0.35 * max(of("mouthSmileLeft"), of("mouthSmileRight"), of("mouthStretchLeft"), of("mouthStretchRight"))
        return 0.45 * max(of("mouthPucker"), 0.5 * of("mouthFunnel")) - max(press, stretch)
    return -0.4 * of("mouthShrugLower")


def paint_lines(subject: Subject, rest: np.ndarray) -> np.ndarray:
    """Relief of all families at template positions [n, 3]: grooves to -1, the folds between them to about 0.4, [n, 3]."""
    maps = np.zeros((len(rest), 3))
    front = np.flatnonzero(
        (rest[:, 2] > np.where(rest[:, 1] > -0.07, 0.025, -0.02)) & (rest[:, 1] < 0.112) & (np.abs(rest[:, 0]) < 0.085)
    )
    brush = _Brush(rest[front].astype(np.float32), np.random.default_rng([subject.asymmetry, 61]))
    _forehead(brush)
    for sign in (1.0, -1.0):
        brush.x = np.float32(sign) * brush.points[:, 0]
        _eye_lines(brush)
        _nose_lines(brush)
        _fold(brush)
        _mouth_lines(brush, subject.wrinkles)
    brush.x = brush.points[:, 0]
    _chin(brush)
    _lip_lines(brush)
    _neck(brush)
    maps[front] = np.clip(brush.relief, -1.0, 0.5)
    return maps


def groove(across: np.ndarray, width: float) -> np.ndarray:
    """Profile across a line: a rounded valley between two low folds of skin; metres -> relief."""
    t = across / width
    return -np.exp(-(t**2)) + 0.42 * np.exp(-(((np.abs(t) - 2.2) / 1.1) ** 2))


def _taper(along: np.ndarray, half: float) -> np.ndarray:
    return np.clip(1 - (along / half) ** 2, 0, 1) ** 0.8


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
        self.relief = np.zeros((len(points), 3))

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


def _mouth_lines(b: _Brush, wrinkles: float) -> None:
    # a second fold beside the mouth, which comes with age
    path = 0.0485 - 26.0 * (b.y + 0.024) ** 2 + b.between(-0.002, 0.002)
    relief = groove(b.x - path + b.uneven, 0.0020) * _taper(b.y + 0.024, b.between(0.015, 0.020))
    b.add(1, (0.12 + 0.5 * wrinkles) * relief, 0.6)
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
