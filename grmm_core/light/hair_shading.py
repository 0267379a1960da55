"""Hair in light: a mass of strands, with the highlights of Kajiya and Kay (1989).

A mass of strands is bright on the lamp's side and dark on the other, whichever way they lie: light goes from strand to strand.
Highlights stand where the strand mirrors the lamp, wide along the head and narrow along the strand; those from inside the
strand have its color. What hair keeps off skin and hair is that of a cloud on a grid of cells. What head, hair and things keep
off hair is known on a coarser grid (`LightGrid`), whatever the camera.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np

from ..geometry.rotations import quaternion_to_matrix
from .lamps import Lamp, arriving
from .shading import Arrived, Response, Transport, arriving_share, colors_of, lamp_rows
from .shadows import compiled_kernels
from .surroundings import BANDS, basis

# fitted to Cycles, four people in six lights from two sides
_WANDER = 1.3  # how far light reaches around a mass of hair
_LOBES = ((120.0, 0.015), (18.0, 0.2))  # exponent and strength: reflected at the surface, and, in the hair's color, from inside
_HIDING = 0.6
"""How much more of a lamp falls on strands that are seen from its side, and less on those seen from the other.

What hides a strand from the viewer is what keeps light off it where the lamp stands behind the viewer, and what is seen there
lies before that (Hapke 1986, the opposition effect).
"""

CELL = 0.006  # metres
REACH = 0.16  # metres that light is followed through hair
_LOCKS = 0.55  # of the extinction of evenly spread cylinders on skin: strands lie in locks, with gaps between
_PRODUCTS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
_WITHIN = 1.2  # of it in the midst of locks, fitted likewise
GRID = 0.012  # metres between places where hair's light is known


class HairCloud(NamedTuple):
    """Hair as what it keeps off.

    Attributes:
        extinction: At the middles of cells of the side `CELL`, of light from all around, 1/m, [X, Y, Z] float32.
        along: Mean squares and products of the strands' directions there: xx, yy, zz, xy, xz, yz, [X, Y, Z, 6] float32.
        low: Corner of the grid, [3] metres.
    """

    extinction: np.ndarray
    along: np.ndarray
    low: np.ndarray

    @staticmethod
    def of(points: np.ndarray, covers: np.ndarray) -> HairCloud:
        """The cloud of pieces of strands at points [P, 3] metres.

        Args:
            points: Their middles.
            covers: Vectors along them, as long as they cover seen from the side, [P, 3] square metres.
        """
        low = points.min(0) - 3 * CELL
        size = np.ceil((points.max(0) - low) / CELL).astype(int) + 3
        number = np.ravel_multi_index(tuple(((points - low) / CELL).astype(int).T), tuple(size))
        areas = np.maximum(np.linalg.norm(covers, axis=1), 1e-20)
        products = [covers[:, a] * covers[:, b] / areas for a, b in _PRODUCTS]

        def cloud(values: np.ndarray) -> np.ndarray:
            cells = np.bincount(number, values, int(size.prod())).reshape(size)
            for axis in range(3):  # its edge is empty: nothing comes in from the other side
                cells = 0.25 * np.roll(cells, 1, axis) + 0.5 * cells + 0.25 * np.roll(cells, -1, axis)
            return cells

        whole = cloud(areas)
        along = np.stack([cloud(values) for values in products], -1) / np.maximum(whole, 1e-20)[..., None]
        return HairCloud((_LOCKS * np.pi / 4 / CELL**3 * whole).astype(np.float32), along.astype(np.float32), low)

    def towards(self, lamp: Lamp) -> np.ndarray:
        """Extinction of a lamp's light, 1/m, [X, Y, Z] float32: strands that lie along it keep little off."""
        way = arriving(lamp, (self.low + 0.5 * CELL * np.array(self.extinction.shape))[None])[0][0]
        square = self.along @ np.array([way[a] * way[b] * (1.0 if a == b else 2.0) for a, b in _PRODUCTS], np.float32)
        across: np.ndarray = np.sqrt(1.5 * np.clip(1.0 - square, 0.0, 1.0))  # 1 where they lie in all ways
        return self.extinction * across

    def through_to_hair(self, lamp: Lamp, points: np.ndarray) -> np.ndarray:
        """As `through`, to places in the midst of locks, between which there are no gaps for them."""
        result: np.ndarray = self.through(lamp, points) ** np.float32(_WITHIN / _LOCKS)
        return result

    def through(self, lamp: Lamp, points: np.ndarray) -> np.ndarray:
        """Share of a lamp's light that comes through to points [N, 3], 0..1, [N] float32."""
        kernels = compiled_kernels()
        if kernels is None:
            return self.through_plain(lamp, points)
        from ..compute.threads import for_rows

        seen = np.ones(len(points), np.float32)
        grid = self.towards(lamp), self.low.astype(np.float32), CELL, int(REACH / CELL), lamp_rows((lamp,), self.low)
        for_rows(kernels.march, len(seen), *grid, np.ascontiguousarray(points, np.float32), seen)
        return seen

    def through_plain(self, lamp: Lamp, points: np.ndarray) -> np.ndarray:
        """The readable twin of `through`."""
        towards = arriving(lamp, points)[0]
        total, extinction = np.zeros(len(points)), self.towards(lamp)
        size = np.array(extinction.shape)
        for step in range(int(REACH / CELL)):
            at = (points - self.low) / CELL - 0.5 + (0.5 + step) * towards
            low = np.floor(at).astype(int)
            inside = ((low >= 0) & (low < size - 1)).all(1)
            low, share = low[inside], (at - low)[inside]
            for corner in np.ndindex(2, 2, 2):
                weight = np.where(corner, share, 1.0 - share).prod(1)
                total[inside] += weight * extinction[tuple((low + corner).T)]
        return np.exp(-CELL * total).astype(np.float32)


class LightGrid(NamedTuple):
    """Places all over hair where it is known which part of each lamp reaches them.

    Attributes:
        low: The first place, [3] metres.
        size: Places along x, y and z.
    """

    low: np.ndarray
    size: tuple[int, int, int]

    @staticmethod
    def around(low: np.ndarray, high: np.ndarray) -> LightGrid:
        """A grid of a box with corners [3] metres; its places stay where they are when the box changes."""
        first, last = np.floor(low / GRID).astype(int), np.ceil(high / GRID).astype(int)
        across, up, ahead = (last - first + 1).tolist()
        return LightGrid(first * GRID, (across, up, ahead))

    @property
    def points(self) -> np.ndarray:
        """All places, [X * Y * Z, 3] metres; not to be written to."""
        return _places(tuple(self.low.tolist()), self.size)

    def around_points(self, points: np.ndarray, coordinates: np.ndarray) -> np.ndarray:
        """Numbers of the places between which points [N, 3] lie (`Reaching.at`), ascending, [K]; `coordinates` as of there."""
        touched, kernels = np.zeros(self.size, np.bool_), compiled_kernels()
        if kernels is None:
            low = np.floor(_on_grid(points, coordinates, self.size)).astype(int)
            for corner in np.ndindex(2, 2, 2):
                touched[tuple((low + corner).T)] = True
        else:
            from ..compute.threads import for_rows

            given = np.ascontiguousarray(points, np.float32), coordinates.astype(np.float32)
            for_rows(kernels.touch, len(points), *given, touched)
        return np.flatnonzero(touched)

    def coordinates(self, turn: np.ndarray, shift: np.ndarray) -> np.ndarray:
        """What leads to numbers of places from points whose place in the grid's axes is turn @ point + shift, [3, 4]."""
        return np.concatenate([turn, (shift - self.low)[:, None]], 1) / GRID


@functools.lru_cache(maxsize=16)
def _places(low: tuple[float, ...], size: tuple[int, int, int]) -> np.ndarray:
    """`LightGrid.points`, kept: a grid stays while an expression changes."""
    found: np.ndarray = np.array(low) + GRID * np.stack(np.unravel_index(np.arange(np.prod(size)), size), -1)
    found.flags.writeable = False
    return found


def _on_grid(points: np.ndarray, coordinates: np.ndarray, size: tuple[int, ...]) -> np.ndarray:
    """Where points [N, 3] lie between the places of a grid, those beside it at its edge, [N, 3]."""
    found: np.ndarray = np.clip(points @ coordinates[:, :3].T + coordinates[:, 3], 0.0, np.array(size) - 1.001)
    return found


class Reaching(NamedTuple):
    """Which part of each lamp reaches hair.

    Attributes:
        parts: On a grid, lamps last, [X, Y, Z, L] float32.
        coordinates: Of `LightGrid`, [3, 4].
    """

    parts: np.ndarray
    coordinates: np.ndarray

    def at(self, points: np.ndarray) -> np.ndarray:
        """Between the grid's places, beside it as at its edge, [L, N]; points [N, 3]."""
        at = _on_grid(points, self.coordinates, self.parts.shape[:3])
        low = np.floor(at).astype(int)
        total = np.zeros((len(points), self.parts.shape[3]))
        for corner in np.ndindex(2, 2, 2):
            weight = np.where(corner, at - low, 1.0 - (at - low)).prod(1)
            total += weight[:, None] * self.parts[tuple((low + corner).T)]
        return total.T


def strand_light(
    lamps: tuple[Lamp, ...], points: np.ndarray, quats: np.ndarray, reaching: Reaching, centre: np.ndarray, eye: np.ndarray,
    harmonics: np.ndarray, response: Response = Response(),  # noqa: B008 - frozen
) -> Arrived:  # fmt: skip
    """`strand_transport` and `Transport.light` in one compiled pass where there is numba.

    Args:
        lamps: In the points' axes.
        points: [N, 3] metres.
        quats: wxyz, of which x leads along the strand, [N, 4].
        reaching: Which part of the lamps they see.
        centre: As in `strand_transport`.
        eye: As there.
        harmonics: Coefficients of the surroundings, [9, 3].
        response: As there.
    """
    kernels = compiled_kernels()
    if kernels is None:
        tangents, seen = quaternion_to_matrix(quats)[..., 0], reaching.at(points)
        transport = strand_transport(lamps, points, tangents, list(seen), centre, eye, response)
        light = transport.light(colors_of(lamps), harmonics.astype(np.float32))
        whole = strand_transport(lamps, points, tangents, list(np.ones_like(seen)), centre, eye, response)
        every = *light, np.ones((len(points), 1)), arriving_share(lamps, transport, whole)
        return Arrived(np.concatenate(every, 1).astype(np.float32))
    from ..compute.threads import for_rows
    from .strand_light_kernel import shade

    out = np.empty((len(points), 8), np.float32)
    factors = np.array([response.intensity, response.gloss, _WANDER, *(strength for _, strength in _LOBES), _HIDING])
    arrays = (
        lamp_rows(lamps, centre), points, quats, reaching.parts, reaching.coordinates, centre, eye,
        harmonics * BANDS[:, None], factors,
    )  # fmt: skip
    for_rows(shade, len(out), *(np.ascontiguousarray(array, np.float32) for array in arrays), out)
    return Arrived(out)


def strand_transport(
    lamps: tuple[Lamp, ...], points: np.ndarray, tangents: np.ndarray, seen: list[np.ndarray], centre: np.ndarray,
    eye: np.ndarray, response: Response = Response(),  # noqa: B008 - frozen
) -> Transport[np.ndarray]:  # fmt: skip
    """Work out what arrives at pieces of strands; `shading.transport` for skin.

    Args:
        lamps: In the points' axes.
        points: [N, 3] metres.
        tangents: Unit vectors along the strands, either way, [N, 3].
        seen: Which part of each lamp they see, L times [N].
        centre: Of the head, [3] metres.
        eye: The viewer's place, [3] metres.
        response: Factors.
    """
    outward = points - centre
    outward = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    view = eye - points
    view = view / np.maximum(np.linalg.norm(view, axis=1, keepdims=True), 1e-9)
    diffuse, highlights = [], []
    for lamp, part in zip(lamps, seen, strict=True):
        towards, strength = arriving(lamp, points)
        facing = np.clip(((outward * towards).sum(1) + _WANDER) / (1.0 + _WANDER), 0.0, 1.0)
        opposite = (view * towards).sum(1)
        shown = part / (part + (1.0 - part) * (1.0 - _HIDING * opposite) ** 2 + 1e-9)
        half = towards + view
        half = half / np.maximum(np.linalg.norm(half, axis=1, keepdims=True), 1e-9)
        mirrored = np.clip(1.0 - (tangents * half).sum(1) ** 2, 0.0, 1.0)
        shine, colored = (weight * mirrored ** (0.5 * power) for power, weight in _LOBES)
        amount = ((1.0 + colored) * facing * shown * strength * response.intensity)[:, None]
        diffuse.append(np.broadcast_to(amount, (len(points), 3)))
        highlights.append(shine * facing * shown * strength * (response.gloss * response.intensity))
    count = len(points)
    return Transport(
        np.stack(diffuse).astype(np.float32) if diffuse else np.zeros((0, count, 3), np.float32),
        np.stack(highlights).astype(np.float32) if highlights else np.zeros((0, count), np.float32),
        (basis(outward) * BANDS * response.intensity).astype(np.float32),
        np.zeros((count, 9), np.float32),
    )
