"""Irradiance and highlights at Gaussians: everything linear in the lights' colors, kept apart from them.

`transport` says what a unit of each lamp and of each harmonic of the surroundings gives at each Gaussian; `Transport.light`
multiplies by colors, for numpy and torch alike, so that fitting can ask for gradients with respect to them. `shade` is both in
one compiled pass, for pictures.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Generic, NamedTuple

import numpy as np

from ..geometry.libraries import Array, present
from .lamps import Area, Lamp, Point, Spot, Sun, arriving, half_angle
from .lobes import lobes, mirrored_share
from .materials import RELIEF, SOFTER, WANDER, Materials
from .shadows import Receivers, compiled_kernels
from .skin_relief import FAINT, VALUES
from .surroundings import basis
from .transfer import openness

_TURN = 0.03  # radians that normals turn by within a Gaussian of the eye: narrower glints would jump from one to the next
_DARKEST = 0.06  # of the rig's most: where it hardly reaches (in the mouth), colors say little about the light there
MAX_RATIO = 200.0
FADING, LEAST_FRONT = 10.0, 0.02  # skin whose normal is turned from the viewer by a cosine of 1 / FADING counts least
_MIRROR_BANDS = np.array([1.0] + [0.75] * 3 + [0.4] * 5)  # what a rough mirror leaves of the harmonics
NO_TILTS = np.zeros((0, 4), np.float32)


@dataclass(frozen=True)
class Response:
    """How an avatar takes light; factors that an animator sets.

    Attributes:
        intensity: Of all light.
        gloss: Of highlights.
        scattering: Of the way light takes inside the skin.
        softness: Of the size of lamps, where it makes shadows soft.
        unlit_by: Numbers of lamps in `Lighting.lamps` that are not for this avatar.
        even_mouth: The whole mouth takes the light of the lips (`resting.even_mouth`).
        detail: Of pores and furrows (`skin_relief`); 0: skin is as smooth as the mesh.
        rig_at_rest: Colors are taken to hold the rig as on the head at rest in every expression, as photos are fitted; else it
            follows what the expression adds to them (`expressed`).
    """

    intensity: float = 1.0
    gloss: float = 1.0
    scattering: float = 1.0
    softness: float = 1.0
    unlit_by: tuple[int, ...] = ()
    even_mouth: bool = False
    detail: float = 1.0
    rig_at_rest: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "unlit_by", tuple(self.unlit_by))


@dataclass(frozen=True)
class Transport(Generic[Array]):
    """What arrives at N Gaussians of L lamps and of the surroundings.

    Attributes:
        diffuse: Irradiance of a unit of each lamp's color, by color, [L, N, 3].
        highlights: Radiance that a unit of each lamp's color gives towards the viewer, [L, N].
        ambient: Irradiance of a unit of each harmonic, [N, 9].
        mirrored: Radiance towards the viewer of a unit of each harmonic, [N, 9].
        tilting: How `highlights` change with the normal's tilt (`lobes.lobes`), [L, N, 4]; None where nobody asks.
        leaning: How `diffuse` does, in the mean of colors and as if no light wandered, [L, N, 3]; likewise.
    """

    diffuse: Array
    highlights: Array
    ambient: Array
    mirrored: Array
    tilting: Array | None = None
    leaning: Array | None = None

    def light(self, colors: Array, coefficients: Array) -> tuple[Array, Array]:
        """Irradiance and highlights of lights.

        Args:
            colors: Linear RGB of each lamp, [L, 3].
            coefficients: Of the surroundings' radiance, [9, 3].

        Returns:
            Irradiance, W/m2, [N, 3], and radiance of highlights, [N, 3].
        """
        irradiance = (self.diffuse * colors[:, None, :]).sum(0) + self.ambient @ coefficients
        shine = self.highlights.T @ colors + self.mirrored @ coefficients
        return irradiance, shine

    def tilts(self, colors: Array, shine: Array) -> Array:
        """By how much the logarithm of highlights `shine` [N, 3] of lamps of these colors changes with tilts, [N, 4]."""
        bright = shine.mean(1)[:, None]
        result: Array = (present(self.tilting) * colors.mean(1)[:, None, None]).sum(0) / bright.clip(FAINT, None)
        return result * (bright > FAINT)

    def leanings(self, colors: Array, irradiance: Array) -> Array:
        """By which share of it the irradiance [N, 3] of lamps of these colors changes with tilts, [N, 3]."""
        result: Array = (present(self.leaning) * colors.mean(1)[:, None, None]).sum(0)
        return result / irradiance.mean(1)[:, None].clip(FAINT / 3.0, None)


def transport(
    lamps: tuple[Lamp, ...], receivers: Receivers, seen: list[np.ndarray], materials: Materials, rows: np.ndarray,
    eye: np.ndarray, response: Response = Response(), turn: np.ndarray | None = None,
) -> Transport[np.ndarray]:  # fmt: skip
    """Work out what arrives at Gaussians.

    Args:
        lamps: In the receivers' axes.
        receivers: Gaussians with their normals.
        seen: Which part of each lamp they see, L times [N].
        materials: What they do with light.
        rows: Rows of `transfer.transfer` at them, [N, 9].
        eye: The viewer's place, [3] metres.
        response: Factors.
        turn: From the axes of `rows`, which are those of the surroundings' coefficients, to the receivers', [3, 3]; None: they
            are the same.
    """
    normals = receivers.normals
    view = eye - receivers.points
    view = view / np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
    facing = np.clip((normals * view).sum(1), 0.05, 1.0)
    relief = RELIEF * materials.rough**2
    highlights, tilting, leaning = [], [], []
    for lamp, part in zip(lamps, seen, strict=True):
        towards, strength = arriving(lamp, receivers.points)
        cosine = (normals * towards).sum(1)
        size = _widening(lamp, receivers.centre)
        mirrored, change = lobes(materials, normals, view, facing, towards, np.maximum(cosine, 0.0), size)
        arrives = part * strength * (response.gloss * response.intensity)
        highlights.append(mirrored * arrives)
        tilting.append(change * arrives[:, None])
        slope = 0.5 + 0.5 * cosine / np.maximum(np.sqrt(cosine**2 + 4.0 * relief**2), 1e-9)  # of `uneven`
        leaning.append((towards - cosine[:, None] * normals) * (slope * part * strength * response.intensity)[:, None])
    count = len(normals)
    mirror = 2.0 * (normals * view).sum(1, keepdims=True) * normals - view
    mirror = mirror if turn is None else mirror @ turn
    glossy = mirrored_share(materials, facing) * materials.shine * openness(rows) * (response.gloss * response.intensity)
    return Transport(
        straight(lamps, receivers, seen, materials, response),
        np.stack(highlights).astype(np.float32) if highlights else np.zeros((0, count), np.float32),
        (rows * response.intensity).astype(np.float32),
        (glossy[:, None] * basis(mirror) * _MIRROR_BANDS).astype(np.float32),
        np.stack(tilting).astype(np.float32) if tilting else np.zeros((0, count, 4), np.float32),
        np.stack(leaning).astype(np.float32) if leaning else np.zeros((0, count, 3), np.float32),
    )


def straight(
    lamps: tuple[Lamp, ...], receivers: Receivers, seen: list[np.ndarray], materials: Materials, response: Response = Response()
) -> np.ndarray:  # fmt: skip
    """Irradiance at Gaussians of a unit of each lamp's color, by color, [L, N, 3] float32; arguments as of `transport`."""
    flesh = materials.wander[:, None] * response.scattering
    wander = np.clip(flesh * materials.curvature[:, None] * WANDER, 0.0, 0.9)  # [N, 3]
    relief = RELIEF * materials.rough[:, None] ** 2
    found = np.zeros((len(lamps), len(receivers.points), 3), np.float32)
    for lamp, part, own in zip(lamps, seen, found, strict=True):
        towards, strength = arriving(lamp, receivers.points)
        cosine = (receivers.normals * towards).sum(1)
        # wrapped diffuse that keeps the energy; shadows have soft red edges for the same reason
        reach = uneven(cosine[:, None] + wander, relief) / (1.0 + wander) ** 2
        through = part[:, None] * (1.0 + flesh * SOFTER) / (1.0 + flesh * SOFTER * part[:, None])
        own[:] = reach * through * strength[:, None] * response.intensity
    return found


def uneven(cosine: Array, relief: Array) -> Array:
    """Cosine to a lamp in the mean over a spot whose pores and wrinkles turn the normal this way and that.

    It is `relief` where the mean normal is at right angles to the lamp. Nearly the mean over normals that spread by 2.5 times
    as much: the terminator is soft, and far from it nothing changes.
    """
    result: Array = 0.5 * (cosine + (cosine * cosine + 4.0 * relief * relief) ** 0.5)
    return result


class Arrived(NamedTuple):
    """What arrives at N Gaussians of all light together.

    Attributes:
        values: What the properties are parts of, [N, 8] float32.
    """

    values: np.ndarray

    @property
    def irradiance(self) -> np.ndarray:
        """W/m2, [N, 3]."""
        return self.values[:, :3]

    @property
    def highlights(self) -> np.ndarray:
        """Radiance towards the viewer, [N, 3]."""
        return self.values[:, 3:6]

    @property
    def front(self) -> np.ndarray:
        """How much they count of what is drawn at a pixel, by whether they face the viewer, [N, 1]."""
        return self.values[:, 6:7]

    @property
    def share(self) -> np.ndarray:
        """Of the lamps' light, what nothing keeps off, [N, 1]."""
        return self.values[:, 7:]


def shade(
    lamps: tuple[Lamp, ...], receivers: Receivers, seen: np.ndarray, materials: Materials, rows: np.ndarray, eye: np.ndarray,
    harmonics: np.ndarray, response: Response = Response(), turn: np.ndarray | None = None, tilts: np.ndarray = NO_TILTS,
) -> Arrived:  # fmt: skip
    """`transport` and `Transport.light` in one compiled pass where there is numba.

    Args:
        lamps: As in `transport`.
        receivers: As there.
        seen: Which part of each lamp they see, below 0 where nobody asks, [L, N].
        materials: As there.
        rows: As there.
        eye: As there.
        harmonics: Coefficients of the surroundings, [9, 3].
        response: As there.
        turn: As there.
        tilts: Written: how highlights change with the normal (`Transport.tilts`), [N, 4], and if it has seven columns how
            irradiance does (`leanings`); or [0, 4].
    """
    kernels = compiled_kernels()
    if kernels is None:
        parts = transport(lamps, receivers, list(seen.clip(0.0, None)), materials, rows, eye, response, turn)
        whole = transport(lamps, receivers, list((seen >= 0.0).astype(np.float32)), materials, rows, eye, response, turn)
        light, view = parts.light(colors_of(lamps), harmonics.astype(np.float32)), eye - receivers.points
        if len(tilts):
            tilts[:, :VALUES] = parts.tilts(colors_of(lamps), light[1])
        if tilts.shape[1] > VALUES:
            tilts[:, VALUES:] = parts.leanings(colors_of(lamps), light[0])
        facing = (receivers.normals * view).sum(1) / np.maximum(np.linalg.norm(view, axis=1), 1e-9)
        front = 1.0 + FADING * facing[:, None]
        shine, share = light[1] * (front > 0.0), arriving_share(lamps, parts, whole)
        return Arrived(np.concatenate([light[0], shine, front.clip(LEAST_FRONT, 1.0), share], 1).astype(np.float32))
    from ..compute.threads import for_rows
    from . import skin_light_kernel

    out = np.empty((len(receivers.points), 8), np.float32)
    scattering = response.scattering
    wander, softer = WANDER * scattering, SOFTER * scattering
    factors = [response.intensity, response.gloss, *wander, FADING, LEAST_FRONT, *softer, 2.0 * RELIEF]
    before = lamp_rows(lamps, receivers.centre), receivers.points, receivers.normals, seen.reshape(len(lamps), len(out))
    behind = (
        rows, eye, np.eye(3) if turn is None else turn, harmonics, harmonics * _MIRROR_BANDS[:, None], np.array(factors)
    )  # fmt: skip
    first, looks, last = (
        tuple(np.ascontiguousarray(array, np.float32) for array in arrays)
        for arrays in (before, vars(materials).values(), behind)
    )  # fmt: skip
    for_rows(skin_light_kernel.shade, len(out), *first, looks, *last, out, tilts)
    return Arrived(out)


def facing(receivers: Receivers, eye: np.ndarray, least: float) -> np.ndarray:
    """Whether receivers face an eye [3] by a cosine times metres of more than `least`, [N] bool."""
    kernels = compiled_kernels()
    if kernels is None:
        found: np.ndarray = np.einsum("nk,nk->n", receivers.normals, eye - receivers.points) > least
        return found
    from ..compute.threads import for_rows

    out = np.empty(len(receivers.points), np.bool_)
    given = (np.ascontiguousarray(array, np.float32) for array in (receivers.points, receivers.normals, eye))
    for_rows(kernels.facing, len(out), *given, np.float32(least), out)
    return out


class Learned(NamedTuple):
    """What colors hold of the rig's light at N Gaussians.

    Attributes:
        rig: Its irradiance, as `reached` has it, [N, 3].
        highlights: Its highlights, [N, 3].
    """

    rig: np.ndarray
    highlights: np.ndarray

    @staticmethod
    def of(arrived: Arrived) -> Learned:
        """Of colors that were learned under light that arrives so."""
        kernels = compiled_kernels()
        if kernels is None:
            return Learned(reached(arrived.irradiance), arrived.highlights)
        from ..compute.threads import for_rows

        found = Learned(*np.empty((2, len(arrived.values), 3), np.float32))
        least = np.float32(_DARKEST * float(arrived.irradiance.max()) if len(arrived.values) else 0.0)
        for_rows(kernels.learned, len(arrived.values), arrived.values, least, *found)
        return found


def relative(
    arrived: Arrived, bounced: np.ndarray, corners: np.ndarray, weights: np.ndarray, learned: Learned, gloss: float,
    inside: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Light as it changes learned colors: `ratio`, highlights less those that are in the colors, share of the lamps' light.

    All three are premultiplied by `weight`, which is there besides.

    Args:
        arrived: Of the scene; may be overwritten.
        bounced: Irradiance at vertices besides, [V, 3].
        corners: Vertices around each Gaussian, [N, 3], or [0, 3] where nothing bounces.
        weights: Of them, likewise.
        learned: At the Gaussians.
        gloss: Factor of the highlights in colors.
        inside: Irradiance of what is seen from behind, [3], such as the inner side of an open bust, whatever arrives outside.

    Returns:
        Ratio (3), highlights (3), their weight (1), share (1), [N, 8] float32.
    """
    kernels = compiled_kernels()
    if kernels is None:
        more = np.einsum("nk,nkc->nc", weights, bounced[corners]) if len(corners) else 0.0
        light = ratio(arrived.irradiance + more, learned.rig)
        front = arrived.front
        if inside is not None:
            light = np.where(front <= LEAST_FRONT, ratio(np.broadcast_to(inside, light.shape), learned.rig), light)
        shine, counts = arrived.highlights - gloss * learned.highlights * light, weight(front, learned.rig)
        return np.concatenate([light * counts, shine * counts, counts, arrived.share * counts], 1).astype(np.float32)
    from ..compute.threads import for_rows

    arrays = (np.ascontiguousarray(array, np.float32) for array in (bounced, weights, *learned))
    within = np.zeros(0, np.float32) if inside is None else np.ascontiguousarray(inside, np.float32)
    limits = MAX_RATIO, np.float32(LEAST_FRONT)
    for_rows(kernels.relative, len(arrived.values), arrived.values, corners, *arrays, within, float(gloss), *limits)
    return arrived.values


def weight(front: np.ndarray, rig: np.ndarray) -> np.ndarray:
    """How much light counts where it is blended, by the rig's irradiance [N, 3] and `Arrived.front` [N, 1]: [N, 1].

    Gaussians are a little transparent, and what a lamp makes of the far side of a head, or of the skin just behind an outline,
    must not shine through where it is dark before. And the mean of a ratio is that of what is above the line over that of what
    is below: a pixel that the underside of a jaw, dark in the rig, shares with a neck shows the neck's color, and must not be
    as bright as the jaw becomes on snow. Of a white surface under an irradiance of pi it is 1.
    """
    result: np.ndarray = front * (rig.mean(1, keepdims=True) / np.float32(math.pi))
    return result


def colors_of(lamps: tuple[Lamp, ...]) -> np.ndarray:
    """Linear RGB of lamps, [L, 3] float32."""
    return np.array([lamp.color for lamp in lamps], np.float32).reshape(-1, 3)


def arriving_share(lamps: tuple[Lamp, ...], parts: Transport[np.ndarray], whole: Transport[np.ndarray]) -> np.ndarray:
    """Share of the lamps' light that nothing keeps off, [N, 1], of what arrives and what would if all lamps were seen."""
    bright = [float(np.mean(lamp.color)) for lamp in lamps]
    amounts = (sum(b * amount.mean(1) for b, amount in zip(bright, each.diffuse, strict=True)) for each in (parts, whole))
    arrives, all_ = (np.full(parts.ambient.shape[0], 1e-6) + amount for amount in amounts)
    share: np.ndarray = (arrives / all_)[:, None]
    return share


def lamp_rows(lamps: tuple[Lamp, ...], centre: np.ndarray) -> np.ndarray:
    """Lamps as numbers for `light_kernels`, [L, LAMP_VALUES]; `centre` [3] is where their size is seen from."""
    from .light_kernels import (
        AREA,
        COLOR,
        FADE,
        INNER,
        KIND,
        LAMP_VALUES,
        PLACE,
        POINT,
        POWER,
        SIZE,
        SPOT,
        SPREAD,
        SUN,
        TOWARDS,
    )

    rows = np.zeros((len(lamps), LAMP_VALUES), np.float32)
    for row, lamp in zip(rows, lamps, strict=True):
        row[COLOR:], row[SIZE], row[POWER] = lamp.color, _widening(lamp, centre), lamp.strength
        if isinstance(lamp, Sun):
            row[KIND], row[PLACE:POWER] = SUN, lamp.direction
            continue
        assert isinstance(lamp, (Point, Area))
        row[PLACE:POWER] = lamp.position
        if isinstance(lamp, Area):
            row[KIND], row[POWER], row[SPREAD] = AREA, lamp.strength / math.pi, lamp.area / math.pi
            row[TOWARDS:INNER] = lamp.direction
            continue
        row[KIND], row[POWER], row[SPREAD] = POINT, lamp.strength / (4.0 * math.pi), lamp.radius**2
        if isinstance(lamp, Spot):
            inner = math.cos(0.5 * lamp.cone)
            row[KIND], row[TOWARDS:INNER] = SPOT, lamp.direction
            row[INNER], row[FADE] = inner, 1.0 / max((1.0 - inner) * lamp.blend, 1e-6)
    return rows


def ratio(scene: Array, rig: Array) -> Array:
    """Irradiance relative to the rig's that colors were learned under, both [N, 3] W/m2: [N, 3]."""
    result: Array = (scene / reached(rig)).clip(0.0, MAX_RATIO)
    return result


def reached(rig: Array) -> Array:
    """The rig's irradiance [N, 3], no less than what colors can tell of."""
    result: Array = rig.clip(_DARKEST * float(rig.max()), None)
    return result


def _widening(lamp: Lamp, at: np.ndarray) -> float:
    """By how much a lamp's size as seen from a place, and normals that turn within a Gaussian, widen lobes, radians."""
    distance = 1.0
    if not isinstance(lamp, Sun):
        assert isinstance(lamp, (Point, Area))
        distance = float(np.linalg.norm(np.asarray(lamp.position) - at))
    return math.hypot(0.5 * half_angle(lamp, distance), _TURN)
