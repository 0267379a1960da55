"""Which part of a lamp a point sees: depth maps of meshes from places on the lamp. Needs numpy; numba makes it faster."""

from __future__ import annotations

import functools
import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..geometry.camera import Camera
from ..geometry.zbuffer import triangle_depth
from .lamps import Area, Lamp, Sun, half_angle

RESOLUTION = 256  # pixels of a map that holds all receivers
_BIAS = 0.0016  # metres along the normal: what the mesh's triangles and the Gaussians on it differ by
_SOFT, _SOFTER = math.radians(1.5), math.radians(12.0)  # half angles from which 4 and 9 places on a lamp are looked from
_FAR = 12.0  # metres: as far before the receivers a sun's occluders may stand


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
        return Receivers(points, normals, centre, float(np.linalg.norm(points - centre, axis=1).max()))


def visible(lamp: Lamp, receivers: Receivers, triangles: np.ndarray, softness: float = 1.0) -> np.ndarray:
    """Which part of a lamp each receiver sees, 0..1, [N] float32.

    Args:
        lamp: In the receivers' axes.
        receivers: Where.
        triangles: Everything that throws shadows, [T, 3, 3] metres.
        softness: Factor of the lamp's size.
    """
    if not lamp.shadow or not len(triangles):
        return np.ones(len(receivers.points), np.float32)
    places = _places(lamp, receivers, softness)
    parts = [_seen_from(lamp, place, receivers, triangles) for place in places]
    mean: np.ndarray = np.mean(parts, axis=0, dtype=np.float32)
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


def _seen_from(lamp: Lamp, place: np.ndarray, receivers: Receivers, triangles: np.ndarray) -> np.ndarray:
    """Whether receivers see a place, with soft edges of about a pixel of the map, [N] 0..1."""
    centre, radius = receivers.centre, receivers.radius * 1.02 + _BIAS
    if isinstance(lamp, Sun):
        towards = place / np.linalg.norm(place)
        eye, distance = centre + towards * (radius + _FAR), radius + _FAR
    else:
        eye = place
        distance = float(np.linalg.norm(eye - centre))
    across, up = _axes(eye - centre)
    back = (eye - centre) / max(distance, 1e-9)
    turn = np.stack([across, -up, -back])  # camera axes: x right, y down, z forward
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = turn, -turn @ eye
    if isinstance(lamp, Sun):
        focal, flat = RESOLUTION / (2.0 * radius), True
    else:
        # a lamp among the receivers cannot hold them all in one map: it sees a wide angle, and what lies beside is lit
        spread = math.asin(min(radius / max(distance, 1e-6), 0.97))
        focal, flat = RESOLUTION / (2.0 * math.tan(spread)), False
    middle = RESOLUTION / 2.0
    camera = Camera(world_to_camera, focal, focal, middle, middle, RESOLUTION, RESOLUTION, orthographic=flat)
    depth = triangle_depth(triangles, camera, near=1e-3)
    pixel = 2.0 * radius / RESOLUTION
    lifted = receivers.points + receivers.normals * (_BIAS + pixel)
    local = lifted @ turn.T + world_to_camera[:3, 3]
    scale = focal if flat else focal / np.maximum(local[:, 2], 1e-4)
    x, y = local[:, 0] * scale + middle, local[:, 1] * scale + middle
    inside = (local[:, 2] > 1e-3) & (x >= 1) & (y >= 1) & (x < RESOLUTION - 1) & (y < RESOLUTION - 1)
    found, rows = np.ones(len(x)), np.flatnonzero(inside)
    compare = _compiled() or compared
    found[rows] = compare(depth, x[rows], y[rows], local[rows, 2])
    return found


@functools.lru_cache(maxsize=1)
def _compiled() -> Callable[..., np.ndarray] | None:
    """The compiled twin of `compared`, or None without numba."""
    try:
        from .shadow_kernel import compared as kernel
    except ImportError:
        return None

    def compare(depth: np.ndarray, *points: np.ndarray) -> np.ndarray:
        seen = np.empty(len(points[0]))
        kernel(depth, *points, seen)
        return seen

    return compare


def compared(depth: np.ndarray, x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Share of the map around a place that is not nearer than it: comparisons of 3 x 3 pixels, weighted as a tent."""
    height, width = depth.shape
    left, top = np.floor(x - 0.5), np.floor(y - 0.5)
    u, v = x - 0.5 - left, y - 0.5 - top
    total = np.zeros_like(x)
    for row in range(-1, 3):
        for column in range(-1, 3):
            weight = np.maximum(0.0, 1.5 - np.abs(column - u)) * np.maximum(0.0, 1.5 - np.abs(row - v))
            at = depth[
                np.clip(top + row, 0, height - 1).astype(np.int32), np.clip(left + column, 0, width - 1).astype(np.int32)
            ]
            total += weight * (at >= z)
    reach = sum(np.maximum(0.0, 1.5 - np.abs(k - u)) for k in range(-1, 3))
    down = sum(np.maximum(0.0, 1.5 - np.abs(k - v)) for k in range(-1, 3))
    result: np.ndarray = total / (reach * down)
    return result
