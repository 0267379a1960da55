"""A world's light: spherical harmonics of its radiance, with its strongest spots taken out as suns. Needs numpy only.

Nine numbers a color hold the irradiance of any surroundings within some percent (Ramamoorthi and Hanrahan 2001), but no hard
shadow: what is small and strong (the sun of an HDRI, a window) is taken out and shaded as a lamp.

Axes: y up. In a picture of a world the middle is seen along +z and the left edge follows it to +x.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ..errors import ConfigError

TERMS = 9
BANDS = np.array([math.pi] + [2 * math.pi / 3] * 3 + [math.pi / 4] * 5)
"""Factors from radiance to irradiance, by band."""
MAX_SPOTS = 3
_SPOT_RADIUS = math.radians(18.0)  # at most
_SMALL = math.radians(12.0)  # diameter up to which a spot is a sun; a larger one is a window or a soft box
_SMALL_SHARE, _LARGE_SHARE = 0.08, 0.25  # of the whole light that makes a spot worth a lamp of its own
_STEPS = 4
_SPOT_FLOOR = 0.2  # of its peak: what is darker does not belong to a spot
_ROWS = 128  # a larger picture is averaged down


def basis(directions: np.ndarray) -> np.ndarray:
    """Real spherical harmonics of the degrees 0 to 2 at unit vectors [..., 3]: [..., 9]."""
    x, y, z = directions[..., 0], directions[..., 1], directions[..., 2]
    parts = (
        np.full_like(x, 0.282095), 0.488603 * y, 0.488603 * z, 0.488603 * x, 1.092548 * x * y, 1.092548 * y * z,
        0.315392 * (3 * z * z - 1), 1.092548 * x * z, 0.546274 * (x * x - y * y),
    )  # fmt: skip
    return np.stack(parts, -1)


@dataclass(frozen=True)
class SunSpot:
    """A small strong part of a world.

    Attributes:
        direction: Unit vector towards it, [3].
        irradiance: Linear RGB on a surface that faces it, W/m2, [3].
        angle: Its diameter, radians.
    """

    direction: np.ndarray
    irradiance: np.ndarray
    angle: float


@dataclass(frozen=True)
class Surroundings:
    """Light from everywhere.

    Attributes:
        coefficients: Of the radiance, linear RGB, [9, 3].
        spots: Not contained in the coefficients.
    """

    coefficients: np.ndarray
    spots: tuple[SunSpot, ...] = ()

    def __post_init__(self) -> None:
        object.__setattr__(self, "spots", tuple(self.spots))

    @staticmethod
    def even(radiance: tuple[float, float, float]) -> Surroundings:
        """The same radiance from everywhere, linear RGB."""
        coefficients = np.zeros((TERMS, 3))
        coefficients[0] = np.asarray(radiance) * math.sqrt(4 * math.pi)
        return _checked(Surroundings(coefficients))

    @staticmethod
    def of_directions(directions: np.ndarray, radiance: np.ndarray, solid_angles: np.ndarray) -> Surroundings:
        """Surroundings without spots.

        Args:
            directions: Unit vectors, [K, 3].
            radiance: Linear RGB, [K, 3].
            solid_angles: Of each sample, steradians, [K].
        """
        return _checked(Surroundings(basis(directions).T @ (radiance * solid_angles[:, None])))

    @staticmethod
    def of_picture(picture: np.ndarray) -> Surroundings:
        """Surroundings of an equirectangular picture, first row up, linear RGB, [H, W, 3].

        Raises:
            ConfigError: Not such a picture, or values that are not finite.
        """
        image = np.asarray(picture, np.float64)
        if image.ndim != 3 or image.shape[2] != 3 or min(image.shape[:2]) < 2:
            raise ConfigError("The picture of the surroundings must have rows, columns and three colors.")
        if not np.isfinite(image).all():
            raise ConfigError("The picture of the surroundings has values that are not finite; save it again.")
        image = _averaged(np.maximum(image, 0.0))
        directions, solid = picture_directions(*image.shape[:2])
        spots = []
        for _ in range(MAX_SPOTS):
            spot = _take_spot(image, directions, solid)
            if spot is None:
                break
            spots.append(spot)
        smooth = Surroundings.of_directions(directions.reshape(-1, 3), image.reshape(-1, 3), solid.reshape(-1))
        return _checked(Surroundings(smooth.coefficients, tuple(spots)))

    def irradiance(self, normals: np.ndarray) -> np.ndarray:
        """Irradiance of the coefficients on unshadowed surfaces with unit normals [N, 3]: linear RGB, [N, 3]."""
        return (basis(normals) * BANDS) @ self.coefficients

    def turned(self, rotation: np.ndarray) -> Surroundings:
        """The same light turned by a matrix [3, 3]."""
        directions, solid = sphere(256)
        radiance = basis(directions @ rotation) @ self.coefficients  # what arrives from R d arrived from d before
        turned = Surroundings.of_directions(directions, radiance, solid).coefficients
        spots = (SunSpot(rotation @ spot.direction, spot.irradiance, spot.angle) for spot in self.spots)
        return Surroundings(turned, tuple(spots))

    def scaled(self, factor: float | tuple[float, float, float]) -> Surroundings:
        """The same light times a number or linear RGB."""
        spots = (SunSpot(spot.direction, spot.irradiance * np.asarray(factor), spot.angle) for spot in self.spots)
        return _checked(Surroundings(self.coefficients * np.asarray(factor), tuple(spots)))


def coefficients_of(surroundings: Surroundings | None, turn: np.ndarray | None = None) -> np.ndarray:
    """Coefficients in the axes that a rotation [3, 3] leads to, [9, 3] float32; zeros of a black world."""
    if surroundings is None:
        return np.zeros((TERMS, 3), np.float32)
    return (surroundings if turn is None else surroundings.turned(turn)).coefficients.astype(np.float32)


def mean_irradiance(surroundings: Surroundings | None) -> np.ndarray:
    """Irradiance in the mean over all normals, [3]; 0 of a black world."""
    found: np.ndarray = np.maximum(coefficients_of(surroundings)[0] * (BANDS[0] * 0.5 / math.sqrt(math.pi)), 0.0)
    return found


def sphere(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Evenly spread unit vectors (a Fibonacci lattice), [count, 3], and their solid angles, [count]."""
    i = np.arange(count) + 0.5
    height = 1.0 - 2.0 * i / count
    turn = math.pi * (1.0 + math.sqrt(5.0)) * i
    ring = np.sqrt(1.0 - height**2)
    return np.stack([ring * np.cos(turn), height, ring * np.sin(turn)], -1), np.full(count, 4.0 * math.pi / count)


def picture_directions(rows: int, columns: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors of an equirectangular picture's pixels, [H, W, 3], and their solid angles, [H, W]."""
    polar = (np.arange(rows) + 0.5) * math.pi / rows
    around = ((np.arange(columns) + 0.5) / columns - 0.5) * 2.0 * math.pi
    x = -np.sin(polar)[:, None] * np.sin(around)[None]
    z = np.sin(polar)[:, None] * np.cos(around)[None]
    directions = np.stack([x, np.broadcast_to(np.cos(polar)[:, None], x.shape), z], -1)
    solid = np.broadcast_to((np.sin(polar) * math.pi / rows * 2.0 * math.pi / columns)[:, None], x.shape)
    return directions, solid


def _averaged(image: np.ndarray) -> np.ndarray:
    step = max(1, image.shape[0] // _ROWS)
    rows, columns = image.shape[0] // step, image.shape[1] // step
    return image[: rows * step, : columns * step].reshape(rows, step, columns, step, 3).mean((1, 3))


def _take_spot(image: np.ndarray, directions: np.ndarray, solid: np.ndarray) -> SunSpot | None:
    """Remove the strongest spot from a picture [H, W, 3], in place, where it is worth a lamp."""
    light = image.sum(-1)
    peak = np.unravel_index(int(light.argmax()), light.shape)
    bright, centre = light > _SPOT_FLOOR * light[peak], directions[peak]
    for _ in range(_STEPS):  # from its edge, where it is as bright everywhere, to its middle
        middle = np.einsum("hwc,hw->c", directions, bright * light * solid * (directions @ centre > math.cos(_SPOT_RADIUS)))
        centre = middle / max(float(np.linalg.norm(middle)), 1e-12)
    near = directions @ centre > math.cos(_SPOT_RADIUS)
    ring = (directions @ centre > math.cos(2.0 * _SPOT_RADIUS)) & ~near
    floor = np.median(image[ring], 0) if ring.any() else np.zeros(3)
    inside = near & bright
    above = np.maximum(image[inside] - floor, 0.0) * solid[inside][:, None]
    irradiance = above.sum(0)
    wide = 2.0 * math.sqrt(float(solid[inside].sum()) / math.pi)
    share = _SMALL_SHARE if wide <= _SMALL else _LARGE_SHARE
    if irradiance.sum() < share * (image * solid[..., None]).sum() or irradiance.sum() <= 0.0:
        return None
    weight = above.sum(-1)
    middle = (directions[inside] * weight[:, None]).sum(0)
    middle /= np.linalg.norm(middle)
    image[inside] = np.minimum(image[inside], floor)
    return SunSpot(middle, irradiance, wide)


def _checked(surroundings: Surroundings) -> Surroundings:
    if not np.isfinite(surroundings.coefficients).all():
        raise ConfigError("The world's light has a strength that is not finite; correct it in the scene.")
    return surroundings
