"""Which part of a lamp a point sees: depth maps of meshes from places on the lamp. Needs numpy; numba makes it faster."""

from __future__ import annotations

import functools
import math
from dataclasses import dataclass
from types import ModuleType
from typing import NamedTuple

import numpy as np

from ..geometry.camera import Camera
from ..geometry.zbuffer import triangle_depth
from ..geometry.zbuffer_numpy import EMPTY
from .lamps import Area, Lamp, Sun, half_angle

RESOLUTION = 256  # pixels of a map that holds all receivers
_BIAS = 0.0016  # metres along the normal: what the mesh's triangles and the Gaussians on it differ by
_SOFT, _SOFTER = math.radians(1.5), math.radians(12.0)  # half angles from which 4 and 9 places on a lamp are looked from
_FAR = 12.0  # metres: as far before the receivers a sun's occluders may stand
_NEAR = 1e-3  # metres
_MARGIN = 1.02  # of a map around its receivers


@dataclass(frozen=True)
class Receivers:
    """Points that shadows fall on.

    Attributes:
        points: [N, 3] metres.
        normals: Outward unit normals, [N, 3].
        centre: Of a ball around them, [3].
        radius: Of it, metres.
    """

    points: np.ndarray
    normals: np.ndarray
    centre: np.ndarray
    radius: float

    @staticmethod
    def around(points: np.ndarray, normals: np.ndarray) -> Receivers:
        """With the ball around the points."""
        centre = 0.5 * (points.min(0) + points.max(0))
        return Receivers(points, normals, centre, float(np.sqrt(((points - centre) ** 2).sum(1).max())))


class Casters(NamedTuple):
    """What throws shadows: triangles of a mesh.

    Attributes:
        vertices: [V, 3] metres.
        faces: [T, 3].
    """

    vertices: np.ndarray
    faces: np.ndarray

    def and_triangles(self, corners: np.ndarray) -> Casters:
        """With further triangles, [T, 3, 3] metres."""
        if not len(corners):
            return self
        more = len(self.vertices) + np.arange(3 * len(corners)).reshape(-1, 3)
        return Casters(np.concatenate([self.vertices, corners.reshape(-1, 3)]), np.concatenate([self.faces, more]))


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

    def single(self) -> tuple[np.ndarray, np.ndarray, float, bool, float]:
        """What kernels take."""
        return self.turn.astype(np.float32), self.shift.astype(np.float32), self.focal, self.flat, _NEAR


def visible(lamp: Lamp, receivers: Receivers, casters: Casters, softness: float = 1.0) -> np.ndarray:
    """Which part of a lamp each receiver sees, 0..1, [N] float32.

    Args:
        lamp: In the receivers' axes.
        receivers: Where.
        casters: Everything that throws shadows.
        softness: Factor of the lamp's size.
    """
    if not lamp.shadow or not len(casters.faces):
        return np.ones(len(receivers.points), np.float32)
    places = _places(lamp, receivers, softness)
    parts = np.empty((len(places), len(receivers.points)), np.float32)
    lift = _BIAS + 2.0 * (receivers.radius * _MARGIN + _BIAS) / RESOLUTION  # a pixel more
    if compiled_kernels() is None:
        for place, part in zip(places, parts, strict=True):
            seen_from = _map_at(lamp, place, receivers)
            part[:] = compared(drawn(casters, seen_from), receivers.points + receivers.normals * lift, seen_from)
    else:
        from ..compute.threads import for_each
        from . import shadow_kernels as kernels

        points, normals = (np.ascontiguousarray(array, np.float32) for array in (receivers.points, receivers.normals))
        meshes = np.ascontiguousarray(casters.vertices, np.float32), np.ascontiguousarray(casters.faces, np.int32)

        def look(number: int) -> None:
            seen_from = _map_at(lamp, places[number], receivers)
            depth = np.full((RESOLUTION, RESOLUTION), EMPTY, np.float32)
            crossing = np.empty(len(casters.faces), np.int32)
            cut = kernels.draw_map(*meshes, *seen_from.single(), depth, crossing)
            if cut:
                some = casters._replace(faces=casters.faces[crossing[:cut]])
                np.minimum(depth, drawn(some, seen_from), out=depth)
            kernels.compared(depth, points, normals, lift, *seen_from.single(), parts[number])

        for_each(len(places), look)
    mean: np.ndarray = parts.mean(0, dtype=np.float32)
    return mean


def _places(lamp: Lamp, receivers: Receivers, softness: float) -> np.ndarray:
    """Places on a lamp to look from (of a sun: directions towards it), [K, 3]."""
    middle = np.asarray(lamp.direction if isinstance(lamp, Sun) else lamp.position, np.float64)  # type: ignore[attr-defined]
    distance = float(np.linalg.norm(middle - receivers.centre))
    half = half_angle(lamp, distance) * softness
    side = 3 if half > _SOFTER else 2 if half > _SOFT else 1
    if side == 1:
        return middle[None]
    steps = (np.arange(side) + 0.5) / side * 2.0 - 1.0
    if isinstance(lamp, Area):
        shrink = math.sqrt(math.pi) / 2.0 if lamp.ellipse else 1.0
        across, up = np.asarray(lamp.across) * softness * shrink, np.asarray(lamp.up) * softness * shrink
    else:
        towards = middle if isinstance(lamp, Sun) else middle - receivers.centre
        size = math.tan(half) * (1.0 if isinstance(lamp, Sun) else distance) * math.sqrt(math.pi) / 2.0
        across, up = (axis * size for axis in _axes(towards))
    grid = [middle + a * across + b * up for a in steps for b in steps]
    return np.array(grid)


def _axes(towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two unit vectors at right angles to a direction."""
    helper = np.array([0.0, 1.0, 0.0]) if abs(towards[1]) < 0.9 * np.linalg.norm(towards) else np.array([1.0, 0.0, 0.0])
    across = np.cross(helper, towards)
    across /= np.linalg.norm(across)
    up = np.cross(towards, across)
    return across, up / np.linalg.norm(up)


def _map_at(lamp: Lamp, place: np.ndarray, receivers: Receivers) -> _Map:
    """The map that holds all receivers as a place on a lamp sees them."""
    centre, radius = receivers.centre, receivers.radius * _MARGIN + _BIAS
    if isinstance(lamp, Sun):
        eye = centre + place / np.linalg.norm(place) * (radius + _FAR)
    else:
        eye = place
    distance = float(np.linalg.norm(eye - centre))
    across, up = _axes(eye - centre)
    turn = np.stack([across, -up, (centre - eye) / max(distance, 1e-9)])
    if isinstance(lamp, Sun):
        return _Map(turn, -turn @ eye, RESOLUTION / (2.0 * radius), True)
    # a lamp among the receivers cannot hold them all in one map: it sees a wide angle, and what lies beside is lit
    spread = math.asin(min(radius / max(distance, 1e-6), 0.97))
    return _Map(turn, -turn @ eye, RESOLUTION / (2.0 * math.tan(spread)), False)


@functools.lru_cache(maxsize=1)
def compiled_kernels() -> ModuleType | None:
    """The compiled twins of this room, or None without numba."""
    try:
        from . import light_kernels
    except ImportError:
        return None
    return light_kernels


def drawn(casters: Casters, seen_from: _Map) -> np.ndarray:
    """Depths of meshes on a map, [R, R] float32 metres; `EMPTY` where nothing is."""
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = seen_from.turn, seen_from.shift
    middle, focal = RESOLUTION / 2.0, seen_from.focal
    camera = Camera(world_to_camera, focal, focal, middle, middle, RESOLUTION, RESOLUTION, orthographic=seen_from.flat)
    return triangle_depth(casters.vertices[casters.faces], camera, near=_NEAR)


def compared(depth: np.ndarray, points: np.ndarray, seen_from: _Map) -> np.ndarray:
    """Share of a map around points [N, 3] that is not nearer than they: 3 x 3 pixels, weighted as a tent; 1 outside, [N]."""
    side = len(depth)
    local = points @ seen_from.turn.T + seen_from.shift
    scale = seen_from.focal if seen_from.flat else seen_from.focal / np.maximum(local[:, 2], 1e-4)
    x, y = local[:, 0] * scale + side / 2.0, local[:, 1] * scale + side / 2.0
    inside = (local[:, 2] > _NEAR) & (x >= 1) & (y >= 1) & (x < side - 1) & (y < side - 1)
    left, top = np.floor(x[inside] - 0.5), np.floor(y[inside] - 0.5)
    u, v = x[inside] - 0.5 - left, y[inside] - 0.5 - top
    total, whole = np.zeros_like(u), np.zeros_like(u)
    for row in range(-1, 3):
        for column in range(-1, 3):
            weight = np.maximum(0.0, 1.5 - np.abs(column - u)) * np.maximum(0.0, 1.5 - np.abs(row - v))
            place = np.clip(top + row, 0, side - 1).astype(int), np.clip(left + column, 0, side - 1).astype(int)
            total += weight * (depth[place] >= local[inside, 2])
            whole += weight
    seen = np.ones(len(points))
    seen[inside] = total / whole
    return seen
