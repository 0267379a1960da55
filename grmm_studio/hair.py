"""Growing strands: roots on the head, styles as fields that bend them, clumps, curls; and strands that follow the mesh.

A strand set is made once per person on the neutral head; each root is bound to a triangle and each point is stored in the
frame of that triangle, so that a posed head carries its hair, brows and lashes. Needs numpy and scipy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from .fields import smoothstep
from .grooms import Growth
from .styles import Style

STEPS = 13  # points of a scalp strand
RIBBON_WIDTH = 1.45  # of the radius: strips are seen at an angle


@dataclass
class Strands:
    """Strands bound to triangles.

    Attributes:
        faces: Bound triangle of each strand as vertex indices of the model, [N, 3].
        weights: Barycentric coordinates of the root, [N, 3].
        local: Points in the triangle's frame, metres, root first, [N, K, 3].
        radius: Radius at the root in metres, [N]; strands taper towards the tip.
        tint: Random factor of the color, [N].
    """

    faces: np.ndarray
    weights: np.ndarray
    local: np.ndarray
    radius: np.ndarray
    tint: np.ndarray

    def points(self, vertices: np.ndarray) -> np.ndarray:
        """World positions on a posed head [V, 3] -> [N, K, 3]."""
        origin, frame = triangle_frames(vertices, self.faces, self.weights)
        return origin[:, None] + self.local @ frame

    @staticmethod
    def join(sets: list[Strands]) -> Strands:
        """Concatenate sets of equal point count."""
        fields = ("faces", "weights", "local", "radius", "tint")
        return Strands(*(np.concatenate([getattr(s, name) for s in sets]) for name in fields))


@dataclass
class Ribbons:
    """Strands as flat strips of triangles, which render several times faster than curves at a few samples.

    Attributes:
        faces: Triangles, [N * (K - 1) * 2, 3].
        twist: Random direction that turns each strip out of the surface, [N, 1, 3].
    """

    faces: np.ndarray
    twist: np.ndarray

    @staticmethod
    def build(count: int, steps: int, seed: int) -> Ribbons:
        """Topology of `count` strands of `steps` points."""
        first = 2 * (np.arange(count)[:, None] * steps + np.arange(steps - 1)[None]).reshape(-1, 1)
        quads = first + np.array([[0, 1, 3, 0, 3, 2]])
        twist = np.random.default_rng(seed).normal(0, 0.55, (count, 1, 3))
        return Ribbons(quads.reshape(-1, 3), twist)

    def vertices(self, points: np.ndarray, radius: np.ndarray, centre: np.ndarray) -> np.ndarray:
        """Strip corners of strands [N, K, 3] with root radii [N], facing away from `centre` [3]; [N * K * 2, 3]."""
        tangent = np.gradient(points, axis=1)
        outward = _unit(points - centre) + self.twist
        side = _unit(np.cross(tangent, outward))
        taper = np.linspace(1.0, 0.4, points.shape[1])[None, :, None]
        half = side * taper * radius[:, None, None] * RIBBON_WIDTH
        return np.stack([points - half, points + half], 2).reshape(-1, 3)


def triangle_frames(vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Origins [N, 3] and frames [N, 3, 3] (rows: along the first edge, in the plane, normal)."""
    p = vertices[faces]
    edge = p[:, 1] - p[:, 0]
    normal = np.cross(edge, p[:, 2] - p[:, 0])
    edge = edge / np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-12)
    normal = normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-15)
    frame = np.stack([edge, np.cross(normal, edge), normal], 1)
    return (p * weights[..., None]).sum(1), frame


def bind(
    vertices: np.ndarray, faces: np.ndarray, weights: np.ndarray, points: np.ndarray, radius: np.ndarray, tint: np.ndarray
) -> Strands:
    """Store world points [N, K, 3] in the frames of their triangles."""
    origin, frame = triangle_frames(vertices, faces, weights)
    local = (points - origin[:, None]) @ frame.transpose(0, 2, 1)
    return Strands(
        faces.astype(np.int32),
        weights.astype(np.float32),
        local.astype(np.float32),
        radius.astype(np.float32),
        tint.astype(np.float32),
    )


def scatter(
    vertices: np.ndarray, faces: np.ndarray, template: np.ndarray, density: np.ndarray, count: int, g: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Draw roots on the skin.

    Args:
        vertices: The person's neutral head, [V, 3].
        faces: Candidate triangles, [F, 3].
        template: Template positions, [V, 3].
        density: Upper bound of the density of each triangle, [F]; exact densities are applied by the caller.
        count: Number of roots.
        g: Generator.

    Returns:
        Triangles [count, 3], barycentric weights [count, 3], template positions of the roots [count, 3].
    """
    p = vertices[faces]
    area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) * density
    chosen = g.choice(len(faces), count, p=area / area.sum())
    r = g.random((count, 2))
    s = np.sqrt(r[:, 0])
    weights = np.stack([1 - s, s * (1 - r[:, 1]), s * r[:, 1]], 1)
    triangles = faces[chosen]
    return triangles, weights, (template[triangles] * weights[..., None]).sum(1)


def grow(
    roots: np.ndarray,
    normals: np.ndarray,
    rest: np.ndarray,
    growth: Growth,
    surface: np.ndarray,
    surface_normals: np.ndarray,
    g: np.random.Generator,
) -> np.ndarray:
    """Grow scalp strands, [N, STEPS, 3].

    Args:
        roots: Root positions on the person, [N, 3].
        normals: Skin normals there, [N, 3].
        rest: Template positions of the roots, [N, 3].
        growth: How they grow.
        surface: Points of the head that hair must not enter, [M, 3].
        surface_normals: Their normals, [M, 3].
        g: Generator.
    """
    count, style = len(roots), growth.style
    tree = cKDTree(surface)
    length = growth.length(rest) * np.clip(g.normal(1.0, 0.10, count), 0.6, 1.4)
    pace = 0.25 + 1.75 * np.arange(STEPS) / (STEPS - 1)  # short first segments stay above the curved skull
    pace[0] = 0.0
    pace /= pace.sum()
    travelled = np.cumsum(pace)
    points = np.empty((count, STEPS, 3))
    points[:, 0] = roots - 0.001 * normals
    position = roots.copy()
    jitter = g.normal(0, style.messiness, (count, 3))
    direction = _unit(normals * growth.lift + growth.flow(rest) + jitter)
    for k in range(1, STEPS):
        t = float(travelled[k])
        want = growth.way(rest, position, t)
        direction = _unit((1 - style.follow) * direction + style.follow * want + 0.35 * jitter * style.follow)
        position = position + direction * (length * pace[k])[:, None]
        distance, near = tree.query(position)
        n = surface_normals[near]
        height = ((position - surface[near]) * n).sum(1)
        wanted = growth.clearance(rest) * min(1.0, 0.2 + 8.0 * t) + 0.0008
        push = np.where(distance < 0.04, np.maximum(wanted - height, 0.0), 0.0)
        if style.hug > 0:  # combed hair lies on the skull instead of flying off at its tangent
            over = np.maximum(height - wanted - 0.003, 0.0) * smoothstep(0.0, 0.05, position[:, 1]) * (distance < 0.06)
            push = push - style.hug * over
        position = position + push[:, None] * n
        points[:, k] = position
    points = _clump(points, roots, growth.style, g)
    return _curl(points, length, growth, g)


def _clump(points: np.ndarray, roots: np.ndarray, style: Style, g: np.random.Generator) -> np.ndarray:
    if style.clumps == 0 or style.clumping == 0:
        return points
    leaders = g.choice(len(points), min(style.clumps, len(points)), replace=False)
    # ragged clump borders: distances are perturbed per strand
    _, which = cKDTree(roots[leaders]).query(roots + g.normal(0, 0.0025, roots.shape))
    t = (np.linspace(0, 1, points.shape[1]) ** 1.5)[None, :, None]
    strength = style.clumping * np.clip(g.normal(1.0, 0.35, (len(points), 1, 1)), 0.0, 1.25)
    pull = np.clip(strength * smoothstep(0.05, 1.0, t), 0.0, 0.97)
    leader = points[leaders][which]
    return points + pull * (leader - points)


def _curl(points: np.ndarray, length: np.ndarray, growth: Growth, g: np.random.Generator) -> np.ndarray:
    if growth.curl_radius == 0:
        return points
    count, steps, style = *points.shape[:2], growth.style
    tangent = _unit(np.gradient(points, axis=1))
    side = _unit(np.cross(tangent, np.array([0.31, 0.42, 0.85])))
    other = np.cross(tangent, side)
    cell = np.floor(points[:, 0] / style.curl_cell).astype(np.int64)
    key = (cell @ np.array([73856093, 19349663, 83492791])) % 9973
    phase = (key * 0.618034 % 1.0) * 2 * np.pi + g.normal(0, style.curl_spread, count)
    turns = length / style.wavelength
    t = np.linspace(0, 1, steps) ** 1.6
    angle = phase[:, None] + 2 * np.pi * turns[:, None] * t
    radius = growth.curl_radius * smoothstep(0.0, 0.35, t) * np.clip(g.normal(1, 0.25, (count, 1)), 0.4, 1.6)
    return points + radius[..., None] * (np.cos(angle)[..., None] * side + np.sin(angle)[..., None] * other)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)
