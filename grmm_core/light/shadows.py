"""Which part of a lamp a point sees: depth maps of meshes from places on the lamp. Needs numpy; numba makes it faster."""

from __future__ import annotations

import dataclasses
import functools
import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ..geometry.boxes import box_around
from ..geometry.camera import Camera
from ..geometry.zbuffer import triangle_depth
from ..geometry.zbuffer_numpy import EMPTY
from .lamps import Area, Lamp, Sun, half_angle

RESOLUTION, SOFT_RESOLUTION = 512, 224  # pixels of a map that holds all receivers: alone, and of several of a wide lamp
_BIAS = 0.0003  # metres along the normal: what smooth normals and flat triangles differ by
_LIFT = 0.35  # pixels along the normal besides, where the surface is steep to the rays: what it is curved within a pixel
_STEEP = 0.25  # cosine between a surface and a lamp's rays below which its plane is no longer followed
_AWAY = 0.4  # cosine between normal and a lamp's rays from which on a point is turned away
_SOFT, _SOFTER = math.radians(1.5), math.radians(12.0)  # half angles from which on 3 and 9 places on a lamp are looked from
_THIRDS = (np.arange(3) + 0.5) / 3 * 2.0 - 1.0
# of a lamp's halves across and up: three places that spread as far as four in a square, and nine
_PATTERNS = {
    2: [(math.sqrt(0.5) * math.cos(a), math.sqrt(0.5) * math.sin(a)) for a in (math.pi / 2, math.pi * 7 / 6, math.pi * 11 / 6)],
    3: list(itertools.product(_THIRDS, repeat=2)),
}
_SIGNS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
_LEAST = 0.002  # metres that a box reaches beyond its points, who are lifted
_FAR = 12.0  # metres: as far before the receivers a sun's occluders may stand
_NEAR = 1e-3  # metres
_MARGIN = 1.03  # of a map around its receivers
_SHALLOW, _DEEP = 0.008, 0.030  # metres behind what throws a shadow: to where hair is lit, and from where it is dark
_WIDEST = 0.97  # sine of half the widest angle of a map


@dataclass(frozen=True)
class Receivers:
    """Points that shadows fall on.

    Attributes:
        points: [N, 3] metres.
        normals: Outward unit normals, [N, 3].
        centre: Of a box and a ball around them, [3].
        corners: Of the box, from its centre, [8, 3].
        radius: Of the ball, metres.
    """

    points: np.ndarray
    normals: np.ndarray
    centre: np.ndarray
    corners: np.ndarray
    radius: float

    @staticmethod
    def around(points: np.ndarray, normals: np.ndarray, within: np.ndarray | None = None) -> Receivers:
        """With box and ball around the points, or around fewer others that they lie between."""
        low, high = box_around(points if within is None else within)
        centre, corners = 0.5 * (low + high), _SIGNS * (0.5 * (high - low) + _LEAST)
        return Receivers(points, normals, centre, corners, float(np.linalg.norm(corners[0])))


class Casters(NamedTuple):
    """What throws shadows: triangles of a mesh.

    Attributes:
        vertices: [V, 3] metres.
        faces: [T, 3].
        closed: Of them the first ones, which light can meet from outside only: their backs need not be drawn.
    """

    vertices: np.ndarray
    faces: np.ndarray
    closed: int = 0

    def and_triangles(self, corners: np.ndarray) -> Casters:
        """With further triangles, [T, 3, 3] metres."""
        if not len(corners):
            return self
        more = len(self.vertices) + np.arange(3 * len(corners)).reshape(-1, 3)
        return Casters(np.concatenate([self.vertices, corners.reshape(-1, 3)]), np.concatenate([self.faces, more]), self.closed)


class _Map(NamedTuple):
    """A shadow map: axes x right, y down, z forward.

    Attributes:
        turn: World to its axes, [3, 3].
        shift: Added behind it, [3].
        focal: Pixels; of an orthographic map pixels a metre.
        flat: Whether it is orthographic.
    """

    turn: np.ndarray
    shift: np.ndarray
    focal: float
    flat: bool


class Maps(NamedTuple):
    """Depth maps from places on a lamp, and where they look from (`_Map`).

    Attributes:
        depths: Metres, [K, R, R] float32; `EMPTY` where nothing is.
        turns: [K, 3, 3] float32.
        shifts: [K, 3] float32.
        focals: [K] float32.
        flat: Of all of them, [].
    """

    depths: np.ndarray
    turns: np.ndarray
    shifts: np.ndarray
    focals: np.ndarray
    flat: np.ndarray

    @property
    def each(self) -> list[tuple[np.ndarray, _Map]]:
        """Each map's depths and where it looks from."""
        places = zip(self.depths, self.turns, self.shifts, self.focals, strict=True)
        return [(depth, _Map(turn, shift, float(focal), bool(self.flat))) for depth, turn, shift, focal in places]

    def seen(self, receivers: Receivers, rows: np.ndarray | None = None, known: np.ndarray | None = None) -> np.ndarray:
        """Which part of the lamp receivers, or those of some rows [M], see, 0..1, [N] float32.

        What `known` [N] holds of the others is kept, and it is changed.
        """
        result = np.zeros(len(receivers.points), np.float32) if known is None else known
        rows = np.arange(len(result)) if rows is None else rows
        if compiled_kernels() is None:
            some = dataclasses.replace(receivers, points=receivers.points[rows], normals=receivers.normals[rows])
            result[rows] = np.mean([compared(depth, some, one) for depth, one in self.each], 0, np.float32)
            return result
        from . import shadow_kernels as kernels

        limits = np.array([_BIAS, _LIFT, _AWAY, _STEEP], np.float32)
        self._for_points(kernels.compared, result, len(rows), limits, receivers.points, receivers.normals, rows=rows)
        return result

    def reaching(self, points: np.ndarray) -> np.ndarray:
        """Which part of the lamp's light reaches points [N, 3] among hair, 0..1, [N] float32, from places across the lamp.

        Hair lets light in: a point is lit down to `_SHALLOW` metres behind what the map holds and dark from `_DEEP` on, so that
        shadows on strands are soft and wander smoothly. Points need no normals, and those just inside a head are lit as the
        hair on it.
        """
        step = 4 if len(self.depths) > 3 else 1  # of nine the diagonal: what is soft already needs no more
        across = Maps(self.depths[::step], self.turns[::step], self.shifts[::step], self.focals[::step], self.flat)
        if compiled_kernels() is None:
            parts = [softly(depth, points, one) for depth, one in across.each]
            mean: np.ndarray = np.mean(parts, 0, np.float32)
            return mean
        from . import shadow_kernels as kernels

        seen = np.empty(len(points), np.float32)
        across._for_points(kernels.softly, seen, len(points), np.array([_SHALLOW, _DEEP], np.float32), points)
        return seen

    def _for_points(
        self, kernel: Callable[..., None], seen: np.ndarray, count: int, *arrays: np.ndarray, rows: np.ndarray | None = None
    ) -> None:  # fmt: skip
        from ..compute.threads import for_rows

        given = [np.ascontiguousarray(array, np.float32) for array in arrays]
        some = () if rows is None else (np.ascontiguousarray(rows, np.int32),)
        maps = (np.ascontiguousarray(array) for array in self[:4])
        for_rows(kernel, count, *maps, bool(self.flat), _NEAR, *given, *some, seen)


def maps_of(lamp: Lamp, receivers: Receivers, casters: Casters, softness: float = 1.0) -> Maps:
    """Draw what throws shadows as a lamp sees it.

    Args:
        lamp: In the receivers' axes.
        receivers: What the maps are to hold.
        casters: Everything that throws shadows.
        softness: Factor of the lamp's size.
    """
    places = _places(lamp, receivers, softness)
    side = RESOLUTION if len(places) == 1 else SOFT_RESOLUTION
    each = [_map_at(lamp, place, receivers, side) for place in places]
    turns, shifts, focals, flat = (np.array(column) for column in zip(*each, strict=True))
    depths = np.empty((len(each), side, side), np.float32)
    maps = Maps(depths, turns.astype(np.float32), shifts.astype(np.float32), focals.astype(np.float32), flat[0])
    if compiled_kernels() is None:
        for depth, one in zip(maps.depths, each, strict=True):
            depth[:] = drawn(casters, one, side)
        return maps
    from ..compute.threads import for_each
    from . import shadow_kernels as kernels

    vertices, faces = np.ascontiguousarray(casters.vertices, np.float32), np.ascontiguousarray(casters.faces, np.int32)

    def look(number: int) -> None:
        (depth, *place), crossing = (array[number] for array in maps[:4]), np.empty(len(faces), np.int32)
        cut = kernels.draw_map(vertices, faces, casters.closed, *place, each[0].flat, _NEAR, depth, EMPTY, crossing)
        if cut:
            some = casters._replace(faces=casters.faces[crossing[:cut]])
            np.minimum(depth, drawn(some, each[number], side), out=depth)

    for_each(len(each), look)
    return maps


def visible(lamp: Lamp, receivers: Receivers, casters: Casters, softness: float = 1.0) -> np.ndarray:
    """Which part of a lamp each receiver sees, 0..1, [N] float32; arguments as of `maps_of`."""
    if not lamp.shadow or not len(casters.faces):
        return np.ones(len(receivers.points), np.float32)
    return maps_of(lamp, receivers, casters, softness).seen(receivers)


def _places(lamp: Lamp, receivers: Receivers, softness: float) -> np.ndarray:
    """Places on a lamp to look from (of a sun: directions towards it), [K, 3]."""
    middle = np.asarray(lamp.direction if isinstance(lamp, Sun) else lamp.position, np.float64)  # type: ignore[attr-defined]
    distance = float(np.linalg.norm(middle - receivers.centre))
    half = half_angle(lamp, distance) * softness
    side = 3 if half > _SOFTER else 2 if half > _SOFT else 1
    if side == 1:
        return middle[None]
    if isinstance(lamp, Area):
        shrink = math.sqrt(math.pi) / 2.0 if lamp.ellipse else 1.0
        across, up = np.asarray(lamp.across) * softness * shrink, np.asarray(lamp.up) * softness * shrink
    else:
        towards = middle if isinstance(lamp, Sun) else middle - receivers.centre
        size = math.tan(half) * (1.0 if isinstance(lamp, Sun) else distance) * math.sqrt(math.pi) / 2.0
        across, up = (axis * size for axis in _axes(towards))
    return np.array([middle + a * across + b * up for a, b in _PATTERNS[side]])


def _axes(towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to a direction."""
    x, y, z = (float(value) for value in towards)  # written out: a hundred times faster than numpy's products of two vectors
    length = math.sqrt(x * x + y * y + z * z)
    across = np.array([z, 0.0, -x] if abs(y) < 0.9 * length else [0.0, -z, y])
    across /= math.sqrt(float(across @ across))
    a, b, c = across.tolist()
    up = np.array([y * c - z * b, z * a - x * c, x * b - y * a])
    return across, up / math.sqrt(float(up @ up))


def _map_at(lamp: Lamp, place: np.ndarray, receivers: Receivers, side: int = RESOLUTION) -> _Map:
    """The map that holds all receivers as a place on a lamp sees them, in pixels as small as their box allows."""
    centre = receivers.centre
    if isinstance(lamp, Sun):
        eye = centre + place / np.linalg.norm(place) * (receivers.radius + _FAR)
    else:
        eye = place
    distance = float(np.linalg.norm(eye - centre))
    across, up = _axes(eye - centre)
    turn = np.stack([across, -up, (centre - eye) / max(distance, 1e-9)])
    x, y, z = np.abs(turn @ receivers.corners.T + (turn @ (centre - eye))[:, None])
    if isinstance(lamp, Sun):
        return _Map(turn, -turn @ eye, side / (2.0 * _MARGIN * max(x.max(), y.max())), True)
    # a lamp among the receivers cannot hold them all in one map: it sees a wide angle, and what lies beside is lit
    wide = max((x / z).max(), (y / z).max()) if distance > receivers.radius / _WIDEST else math.inf
    return _Map(turn, -turn @ eye, side / (2.0 * _MARGIN * min(wide, math.tan(math.asin(_WIDEST)))), False)


@functools.lru_cache(maxsize=1)
def compiled_kernels() -> ModuleType | None:
    """The compiled twins of this room, or None without numba."""
    try:
        from . import light_kernels
    except ImportError:
        return None
    return light_kernels


def drawn(casters: Casters, seen_from: _Map, side: int = RESOLUTION) -> np.ndarray:
    """Depths of meshes on a map, [R, R] float32 metres; `EMPTY` where nothing is."""
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = seen_from.turn, seen_from.shift
    middle, focal = side / 2.0, seen_from.focal
    camera = Camera(world_to_camera, focal, focal, middle, middle, side, side, orthographic=seen_from.flat)
    return triangle_depth(casters.vertices[casters.faces], camera, near=_NEAR)


def compared(depth: np.ndarray, receivers: Receivers, seen_from: _Map) -> np.ndarray:
    """Share of a map around receivers that is not nearer than they: 3 x 3 pixels, weighted as a tent; 1 outside, [N].

    The pixels around hold other depths of the same surface: each is compared with the plane through the point. Points are
    lifted along their normals besides, by `_BIAS` and by `_LIFT` pixels; where rays graze the surface, and the plane says
    little, by a whole pixel. What is turned away from the lamp by more than `_AWAY` sees none of it.
    """
    normals = receivers.normals @ seen_from.turn.T
    ahead = normals[:, 2]
    away = receivers.points @ seen_from.turn[2] + seen_from.shift[2]
    pixel = (1.0 if seen_from.flat else np.maximum(away, 0.0)) / seen_from.focal
    level = np.clip(-ahead / _STEEP, 0.0, 1.0)
    lift = _BIAS + (1.0 + level * (_LIFT - 1.0)) * pixel * np.sqrt(np.maximum(1.0 - ahead * ahead, 0.0))
    points = receivers.points + lift[:, None] * receivers.normals
    local = points @ seen_from.turn.T + seen_from.shift
    slopes = (level * pixel / np.maximum(-ahead, _STEEP))[:, None] * normals[:, :2]
    return np.where(ahead > _AWAY, 0.0, _filtered(depth, local, seen_from, 1.5, lambda there, z: there >= z, slopes))


def softly(depth: np.ndarray, points: np.ndarray, seen_from: _Map) -> np.ndarray:
    """As `compared` for points in hair: 1 down to `_SHALLOW` metres behind a pixel's depth, 0 from `_DEEP` on, [N]."""
    local = points @ seen_from.turn.T + seen_from.shift
    return _filtered(
        depth, local, seen_from, 1.0, lambda there, z: np.clip((there + _DEEP - z) / (_DEEP - _SHALLOW), 0.0, 1.0)
    )  # fmt: skip


def _filtered(
    depth: np.ndarray, local: np.ndarray, seen_from: _Map, reach: float,
    passing: Callable[[np.ndarray, np.ndarray], np.ndarray], slopes: np.ndarray | None = None,
) -> np.ndarray:  # fmt: skip
    """Mean of what passes pixels, of their depths and points' own, weighted as a tent of such a reach; 1 beside the map, [N].

    Slopes [N, 2] say how points' depths change by column and row of the map.
    """
    side = len(depth)
    scale = seen_from.focal if seen_from.flat else seen_from.focal / np.maximum(local[:, 2], 1e-4)
    x, y = local[:, 0] * scale + side / 2.0, local[:, 1] * scale + side / 2.0
    inside = (local[:, 2] > _NEAR) & (x >= 2) & (y >= 2) & (x < side - 2) & (y < side - 2)
    left, top = np.floor(x[inside] - 0.5), np.floor(y[inside] - 0.5)
    u, v = x[inside] - 0.5 - left, y[inside] - 0.5 - top
    total, whole = np.zeros_like(u), np.zeros_like(u)
    for row in range(-1, 3):
        for column in range(-1, 3):
            weight = np.maximum(0.0, reach - np.abs(column - u)) * np.maximum(0.0, reach - np.abs(row - v))
            level = local[inside, 2]
            if slopes is not None:
                level = level + slopes[inside, 0] * (column - u) + slopes[inside, 1] * (row - v)
            total += weight * passing(depth[(top + row).astype(int), (left + column).astype(int)], level)
            whole += weight
    seen = np.ones(len(local))
    seen[inside] = total / whole
    return seen
