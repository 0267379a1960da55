"""Lamps with Blender's meaning, and all light of a scene. Needs numpy only.

Radiometry as Cycles has it (checked against renders of a white plane): a sun's strength is its irradiance in W/m2 on a surface
that faces it; a point or spot light of P watts has the radiant intensity P / 4 pi; an area light of P watts and A square metres
the radiance P / (pi A) on its front.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from ..errors import ConfigError
from .surroundings import Surroundings, sphere

Vector = tuple[float, float, float]
WHITE: Vector = (1.0, 1.0, 1.0)
MAX_LAMPS, MAX_SINGLE = 32, 16  # that are shaded; of more the strongest one by one, and the others together
MAX_STRENGTH = 1e9
_PARTS, _NARROW = MAX_LAMPS - MAX_SINGLE, 12.0  # of the sphere whose weak lamps are put together, and how softly they end
_FAINT = 1e-3  # share of their light below which a part is left out
_WIDEST = math.radians(35.0)  # half angle of what they become
NEAREST = 0.02  # metres: a lamp inside the head stays finite


@dataclass(frozen=True)
class Lamp:
    """What all lamps have.

    Attributes:
        color: Linear RGB that the strength is multiplied by.
        strength: Irradiance of a sun, watts of the others.
        shadow: Whether things throw shadows in its light.
    """

    color: Vector = WHITE
    strength: float = 1.0
    shadow: bool = True
    name: ClassVar[str] = "lamp"

    def __post_init__(self) -> None:
        for each in dataclasses.fields(self):
            value = getattr(self, each.name)
            if isinstance(value, (list, np.ndarray)):
                object.__setattr__(self, each.name, tuple(float(number) for number in value))
        values = np.concatenate([np.ravel(getattr(self, f.name)) for f in dataclasses.fields(self)]).astype(np.float64)
        if not np.isfinite(values).all() or not 0.0 <= self.strength <= MAX_STRENGTH or min(self.color) < 0.0:
            kind = ("An " if self.name[0] in "aeiou" else "A ") + self.name
            raise ConfigError(f"{kind} light has numbers that are not finite or below zero; correct it in the scene.")


@dataclass(frozen=True)
class Sun(Lamp):
    """Parallel light.

    Attributes:
        direction: Unit vector from the scene towards the sun, [3].
        angle: Its diameter as seen from the scene, radians.
    """

    direction: Vector = (0.0, 1.0, 0.0)
    angle: float = 0.0
    name: ClassVar[str] = "sun"


@dataclass(frozen=True)
class Point(Lamp):
    """Light from a ball.

    Attributes:
        position: Metres.
        radius: Metres.
    """

    position: Vector = (0.0, 0.0, 1.0)
    radius: float = 0.0
    name: ClassVar[str] = "point"


@dataclass(frozen=True)
class Spot(Point):
    """A point light within a cone.

    Attributes:
        direction: Unit vector along which it shines.
        cone: Full angle of the cone, radians.
        blend: Share of the cone over which the edge fades, 0..1.
    """

    direction: Vector = (0.0, 0.0, -1.0)
    cone: float = math.radians(45.0)
    blend: float = 0.15
    name: ClassVar[str] = "spot"


@dataclass(frozen=True)
class Area(Lamp):
    """A lit surface that shines to its front.

    Attributes:
        position: Its middle, metres.
        across, up: Half sides, metres, at right angles; it shines along up x across.
        ellipse: Whether it is an ellipse instead of a rectangle.
    """

    position: Vector = (0.0, 0.0, 1.0)
    across: Vector = (0.5, 0.0, 0.0)
    up: Vector = (0.0, 0.5, 0.0)
    ellipse: bool = False
    name: ClassVar[str] = "area"

    @property
    def area(self) -> float:
        """Square metres."""
        sides = math.hypot(*self.across) * math.hypot(*self.up)
        return max((math.pi if self.ellipse else 4.0) * sides, 1e-8)

    @property
    def direction(self) -> np.ndarray:
        """Unit vector along which it shines, [3]."""
        (a, b, c), (x, y, z) = self.up, self.across  # written out: numpy's products of two vectors take long
        normal = b * z - c * y, c * x - a * z, a * y - b * x
        return np.array(normal) / max(math.hypot(*normal), 1e-12)


@dataclass(frozen=True)
class Lighting:
    """All light of a scene, in the axes of one world (y up), metres.

    Attributes:
        lamps: In any order.
        surroundings: The world's light, or None for black.
        occluders: Corners of triangles that throw shadows besides the avatar's own mesh, [T, 3, 3].
        local: Factor of the irradiance at an avatar's vertices, linear RGB, [V, 3]; [0, 3]: 1. What a photo shows of its light
            that no lamp explains; it lies on the skin.
        fine: Likewise at the texels of an avatar's Gaussians, beside `local`, [N, 3] or [0, 3]: shade in folds.
    """

    lamps: tuple[Lamp, ...] = ()
    surroundings: Surroundings | None = None
    occluders: np.ndarray = field(default_factory=lambda: np.zeros((0, 3, 3), np.float32))
    local: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))
    fine: np.ndarray = field(default_factory=lambda: np.zeros((0, 3), np.float32))

    def __post_init__(self) -> None:
        object.__setattr__(self, "lamps", tuple(self.lamps))
        occluders = np.ascontiguousarray(self.occluders, np.float32)
        if occluders.ndim != 3 or occluders.shape[1:] != (3, 3) or not np.isfinite(occluders).all():
            raise ConfigError("What throws shadows must be triangles [T, 3, 3] of finite numbers.")
        object.__setattr__(self, "occluders", occluders)
        for name, where in (("local", "vertices"), ("fine", "texels")):
            factors = np.ascontiguousarray(getattr(self, name), np.float32)
            if factors.ndim != 2 or factors.shape[1] != 3 or not np.isfinite(factors).all() or (factors < 0.0).any():
                raise ConfigError(f"Factors of light at {where} must be finite and not below 0, [..., 3].")
            object.__setattr__(self, name, factors)

    def in_space(self, to_space: np.ndarray) -> Lighting:
        """The same light in other axes.

        Args:
            to_space: World to those axes: rotation, translation, one uniform scale, [4, 4]. Lengths and watts are scaled so
                that everything looks the same: watts by the square of the scale.
        """
        if np.array_equal(to_space, np.eye(4)):
            return self
        linear = to_space[:3, :3]
        scale = float(np.cbrt(np.linalg.det(linear)))
        turn = linear / scale

        def moved(lamp: Lamp) -> Lamp:
            changes: dict[str, object] = {}
            if isinstance(lamp, (Sun, Spot)):
                changes["direction"] = tuple(turn @ lamp.direction)
            if isinstance(lamp, (Point, Area)):
                changes["position"] = tuple(linear @ lamp.position + to_space[:3, 3])
                changes["strength"] = lamp.strength * scale**2
            if isinstance(lamp, Point):
                changes["radius"] = lamp.radius * scale
            if isinstance(lamp, Area):
                changes |= {"across": tuple(linear @ lamp.across), "up": tuple(linear @ lamp.up)}
            return dataclasses.replace(lamp, **changes)  # type: ignore[arg-type]  # names of the lamp's own fields

        around = None if self.surroundings is None else self.surroundings.turned(turn)
        occluders = self.occluders @ linear.T.astype(np.float32) + to_space[:3, 3].astype(np.float32)
        return Lighting(tuple(map(moved, self.lamps)), around, occluders, self.local, self.fine)

    def scaled(self, factor: Vector) -> Lighting:
        """The same light times linear RGB."""
        lamps = (dataclasses.replace(lamp, color=tuple(np.multiply(lamp.color, factor))) for lamp in self.lamps)
        around = None if self.surroundings is None else self.surroundings.scaled(factor)
        return dataclasses.replace(self, lamps=tuple(lamps), surroundings=around)

    def and_occluders(self, corners: np.ndarray) -> Lighting:
        """The same light before further triangles, [T, 3, 3] metres."""
        return dataclasses.replace(self, occluders=np.concatenate([self.occluders, corners]))

    def without(self, numbers: Sequence[int]) -> Lighting:
        """The same light but for some of the lamps."""
        if not numbers:
            return self
        return dataclasses.replace(self, lamps=tuple(lamp for i, lamp in enumerate(self.lamps) if i not in numbers))

    def shaded(self, at: Sequence[float], count: int = MAX_LAMPS, single: int = MAX_SINGLE) -> tuple[Lamp, ...]:
        """Lamps as a head at a point takes them, the suns of the surroundings included, strongest first.

        Args:
            at: The point, [3] metres.
            count: As many are taken as they are.
            single: Of more the strongest are; the others are put together into wide suns (`together`).
        """
        every = (*self.lamps, *(() if self.surroundings is None else suns_of(self.surroundings)))
        point, color = np.asarray(at, np.float64)[None], np.array([lamp.color for lamp in every]).reshape(-1, 3)
        found = [arriving(lamp, point) for lamp in every]
        light = color * np.array([strength[0] for _, strength in found]).reshape(-1, 1)
        bright = light.sum(1)
        order = [i for i in np.argsort(-bright, kind="stable") if bright[i] > 0.0]
        if len(order) <= count:
            return tuple(every[i] for i in order)
        rest = order[single:]
        suns = together(np.concatenate([found[i][0] for i in rest]), light[rest])
        return (*(every[i] for i in order[:single]), *suns)


def together(directions: np.ndarray, light: np.ndarray) -> tuple[Sun, ...]:
    """Wide suns that stand for many weak lamps, one for each of some parts of the sphere.

    The parts overlap softly, so that nothing jumps when a lamp wanders from one into the next.

    Args:
        directions: Unit vectors towards the lamps, [M, 3].
        light: Linear RGB on surfaces that face them, W/m2, [M, 3].
    """
    middles, _ = sphere(_PARTS)
    shares = np.exp(_NARROW * (directions @ middles.T - 1.0))
    shares *= 1.0 / shares.sum(1, keepdims=True)
    whole, bright = shares.T @ light, shares.T @ light.sum(1)
    towards = (shares * light.sum(1)[:, None]).T @ directions / np.maximum(bright, 1e-30)[:, None]
    suns = []
    for vector, color, amount in zip(towards, whole, bright, strict=True):
        length = float(np.linalg.norm(vector))  # the mean of unit vectors within a cone is (1 + cosine of its half) / 2 long
        if amount < _FAINT * bright.sum() or length < 1e-6:
            continue
        half = min(math.acos(min(max(2.0 * length - 1.0, -1.0), 1.0)), _WIDEST)
        suns.append(Sun(tuple(color * length), 1.0, True, tuple(vector / length), 2.0 * half))
    return tuple(suns)


def suns_of(surroundings: Surroundings) -> tuple[Sun, ...]:
    """The strongest spots of a world as suns."""
    return tuple(Sun(tuple(s.irradiance), 1.0, True, tuple(s.direction), s.angle) for s in surroundings.spots)


def arriving(lamp: Lamp, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Light of a lamp at points, without shadows and without its color.

    Args:
        lamp: In the points' axes.
        points: [N, 3] metres.

    Returns:
        Unit vectors towards the lamp's middle, [N, 3], and irradiance on surfaces that face it, [N] W/m2.
    """
    if isinstance(lamp, Sun):
        return np.broadcast_to(np.asarray(lamp.direction), points.shape), np.full(len(points), lamp.strength)
    assert isinstance(lamp, (Point, Area))
    towards = np.asarray(lamp.position) - points
    squares = (towards * towards).sum(-1)
    towards = towards / np.sqrt(np.maximum(squares, 1e-12))[:, None]
    squares = np.maximum(squares, NEAREST**2)
    if isinstance(lamp, Area):
        facing = np.clip(-(towards @ lamp.direction), 0.0, 1.0)
        # a surface's light does not grow without end near it: the solid angle of a disk of its size
        return towards, lamp.strength / math.pi * facing / (squares + lamp.area / math.pi)
    squares = squares + lamp.radius**2
    irradiance = lamp.strength / (4.0 * math.pi) / squares
    if isinstance(lamp, Spot):
        inner = math.cos(0.5 * lamp.cone)
        along = -(towards @ np.asarray(lamp.direction))
        share = np.clip((along - inner) / max((1.0 - inner) * lamp.blend, 1e-6), 0.0, 1.0)
        irradiance = irradiance * share * share * (3.0 - 2.0 * share)
    return towards, irradiance


def half_angle(lamp: Lamp, distance: float) -> float:
    """Half the angle that a lamp fills as seen from a distance in metres, radians."""
    if isinstance(lamp, Sun):
        return 0.5 * lamp.angle
    if isinstance(lamp, Area):
        size = math.sqrt(lamp.area / math.pi)
    else:
        size = lamp.radius if isinstance(lamp, Point) else 0.0
    return math.atan2(size, max(distance, NEAREST))


def soft_box(yaw: float, pitch: float, distance: float, side: float, power: float, color: Vector = WHITE) -> Area:
    """A square area light that looks at the origin.

    Args:
        yaw: Where it is seen from the head, degrees to the person's left.
        pitch: Degrees upwards.
        distance: Metres.
        side: Of the square, metres.
        power: Watts.
        color: Linear RGB.
    """
    turn, lift = math.radians(yaw), math.radians(pitch)
    towards = np.array([math.sin(turn) * math.cos(lift), math.sin(lift), math.cos(turn) * math.cos(lift)])
    helper = np.array([0.0, 1.0, 0.0]) if abs(towards[1]) < 0.99 else np.array([0.0, 0.0, -1.0])
    across = np.cross(helper, towards)
    across /= np.linalg.norm(across)
    up = np.cross(towards, across)
    # up x across points from the lamp to the origin
    place, half = towards * distance, 0.5 * side
    return Area(color, power, True, tuple(place), tuple(across * half), tuple(up * half))


STUDIO = Lighting(
    (
        soft_box(32, 28, 1.5, 0.9, 16.0), soft_box(-42, 18, 1.5, 0.9, 9.0), soft_box(120, 25, 1.6, 1.1, 8.0),
        soft_box(-120, 25, 1.6, 1.1, 8.0), soft_box(0, 75, 1.5, 1.0, 7.0), soft_box(180, 10, 1.7, 1.0, 6.0),
    ),
    Surroundings.even((0.42, 0.42, 0.42)),
)  # fmt: skip
"""The capture studio's rig: what trained colors are lit by. `grmm_studio.lights.RIG` is the same light for Blender."""
