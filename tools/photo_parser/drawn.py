"""A picture in the making: layers over one another with colors, labels, normals and depth; meshes drawn into it. Numpy only."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.photo.parser import LABELS

Generator = np.random.Generator


@dataclass
class Drawn:
    """A square picture of a person.

    Attributes:
        camera: In head space.
        color: Linear RGB, [S, S, 3].
        labels: Number of the label, uint8, [S, S].
        cover: By the person and what is before it, [S, S].
        normals: Head space, [S, S, 3].
        depth: Metres, [S, S].
        lit: The bare person in the picture's light, linear RGB, [S, S, 3].
        bare: How much of each pixel no layer covers, [S, S].
        downy: How much of each pixel is covered by strands that lie on skin, brows and beards, [S, S].
        falling: What of the picture's light falls on the skin, in the units of `lit`, [S, S, 3].
    """

    camera: Camera
    color: np.ndarray
    labels: np.ndarray
    cover: np.ndarray
    normals: np.ndarray
    depth: np.ndarray
    lit: np.ndarray
    bare: np.ndarray = field(init=False)
    downy: np.ndarray = field(init=False)
    falling: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.bare, self.downy = np.ones_like(self.cover), np.zeros_like(self.cover)
        self.falling = np.ones_like(self.color)

    def lay(
        self,
        cover: np.ndarray,
        color: np.ndarray,
        label: str | None,
        normals: np.ndarray | None = None,
        depth: np.ndarray | None = None,
    ) -> None:
        """Put a layer over all: cover [S, S] 0..1; color [3] or [S, S, 3]; without a label what is below keeps its own."""
        share = cover[..., None]
        self.color = self.color * (1 - share) + np.asarray(color) * share
        if label is not None:
            self.labels[cover > 0.4] = LABELS.index(label)
        self.cover = self.cover + cover * (1 - self.cover)
        self.bare, self.downy = self.bare * (1 - cover), self.downy * (1 - cover)
        if normals is not None:
            self.normals = np.where(share > 0.5, normals, self.normals)
        if depth is not None:
            self.depth = np.where(cover > 0.5, depth, self.depth)


@dataclass(frozen=True)
class Surface:
    """A mesh as a camera sees it: depth [S, S], points and normals in head space [S, S, 3], where it is seen [S, S]."""

    depth: np.ndarray
    points: np.ndarray
    normals: np.ndarray
    seen: np.ndarray

    @staticmethod
    def of(triangles: np.ndarray, camera: Camera) -> Surface:
        """Draw triangles [T, 3, 3]; normals are those of the depth."""
        depth = triangle_depth(triangles, camera)
        seen = depth < EMPTY
        points = unprojected(np.where(seen, depth, 1.0), camera)
        normals = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
        normals *= np.sign(((camera.position - points) * normals).sum(-1, keepdims=True))
        return Surface(depth, points, unit(normals), seen)


def unprojected(depth: np.ndarray, camera: Camera) -> np.ndarray:
    """Points in head space of depths [H, W], [H, W, 3]."""
    rows, columns = np.mgrid[: camera.height, : camera.width] + 0.5
    local = np.stack([(columns - camera.cx) / camera.fx * depth, (rows - camera.cy) / camera.fy * depth, depth], -1)
    return (local - camera.world_to_camera[:3, 3]) @ camera.world_to_camera[:3, :3]


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors [..., 3] of length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def tube(rings: np.ndarray) -> np.ndarray:
    """Triangles between rings of points [R, M, 3] that are closed, [T, 3, 3]."""
    a, b = rings[:-1], rings[1:]
    c, d = np.roll(a, -1, 1), np.roll(b, -1, 1)
    return np.concatenate([np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([c, b, d], 2).reshape(-1, 3, 3)])


def smooth(low: float, high: float, values: np.ndarray) -> np.ndarray:
    """0 below `low`, 1 above `high`."""
    t = np.clip((values - low) / (high - low), 0.0, 1.0)
    return t * t * (3 - 2 * t)


def noise(g: Generator, size: int, octaves: int = 4, first: int = 2) -> np.ndarray:
    """Smooth random numbers of about -1..1, [size, size]."""
    import torch
    from torch.nn import functional

    total = torch.zeros(1, 1, size, size)
    for octave in range(octaves):
        grid = torch.from_numpy(g.normal(0, 0.6**octave, (1, 1, first * 2**octave + 1, first * 2**octave + 1))).float()
        total += functional.interpolate(grid, (size, size), mode="bicubic", align_corners=True)
    return total[0, 0].numpy() * 0.6


def any_color(g: Generator, skin: np.ndarray, hair: np.ndarray) -> np.ndarray:
    """Color of cloth or wall, linear RGB: often none, sometimes that of the person's skin or hair."""
    kind = g.random()
    if kind < 0.2:
        return np.full(3, g.uniform(0.004, 0.05)) * g.uniform(0.8, 1.2, 3)
    if kind < 0.36:
        return np.full(3, g.uniform(0.35, 0.9)) * g.uniform(0.9, 1.1, 3)
    if kind < 0.52:
        return np.clip((skin if g.random() < 0.5 else hair) * g.uniform(0.5, 1.6) * g.uniform(0.8, 1.2, 3), 0.003, 0.95)
    color = g.random(3) ** 2.2
    return color + g.random() ** 2 * (color.mean() - color)


def pattern(g: Generator, points: np.ndarray, skin: np.ndarray, hair: np.ndarray) -> np.ndarray:
    """Colors of cloth at points in head space [S, S, 3], linear RGB [S, S, 3]."""
    color, other = any_color(g, skin, hair), any_color(g, skin, hair)
    kind = g.random()
    if kind < 0.6:
        mix = np.zeros(points.shape[:2])
    elif kind < 0.85:
        axis = unit(g.normal(0, 1, 3) * g.choice([0.1, 1.0], 3))
        wave = np.sin(points @ axis * 6.28 / g.uniform(0.008, 0.06))
        if g.random() < 0.3:
            wave = wave * np.sin(points[..., 0] * 6.28 / g.uniform(0.01, 0.05))
        mix = smooth(-0.2, 0.2, wave)
    else:
        mix = smooth(-0.4, 0.4, noise(g, points.shape[0], 5, 4))
    shade = 1 + g.uniform(0.02, 0.25) * noise(g, points.shape[0], 5, 5)
    return np.clip((color + (other - color) * mix[..., None]) * shade[..., None], 0.001, 1.0)
