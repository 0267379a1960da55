"""Growing strands: roots on the skin, paths that styles bend, locks, ropes, curls, frizz. Needs numpy and scipy.

Strands are grown in head space on a person's neutral head; `grooming` binds them to the head's triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from grmm_core.head import HeadModel
from grmm_core.wrinkles.noise import smoothstep, wave_noise

from .grooms import Growth
from .mesh import RenderMesh, region_vertices
from .styles import Style

STEPS = 14  # of a path, before curls
RISE = 0.05  # metres from its root to where hair lies as high as it does
EARS_FREE = 0.07  # metres: hair shorter than that ends above an ear
FAR = (0.07, 0.035)  # metres from the end of its leader: where a strand is no longer in a lock, and where it is fully
UNTIED = (0.008, 0.03)  # metres: hair so short joins no lock, longer hair does
MIDDLE = np.array([0.0, 0.05, -0.01])  # what waves lie around, and below it the vertical through it
LIKE = 500  # groups of neighbouring hairs that grow alike
INSIDE = ("mouth_interior", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes")


@dataclass
class Roots:
    """Where strands begin.

    Attributes:
        triangles: Numbers of the head's triangles, [N].
        weights: Barycentric coordinates, [N, 3].
        rest: Template positions, [N, 3].
        points: Positions on the person's neutral head, [N, 3].
        normals: Skin normals there, [N, 3].
    """

    triangles: np.ndarray
    weights: np.ndarray
    rest: np.ndarray
    points: np.ndarray
    normals: np.ndarray

    @staticmethod
    def place(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, triangles: np.ndarray, weights: np.ndarray) -> Roots:
        """Roots at barycentric `weights` [N, 3] of numbered `triangles` [N]."""
        corners, w = np.asarray(head.faces)[triangles], weights[..., None]
        normals = _unit((mesh.normals(neutral)[corners] * w).sum(1))
        rest = (np.asarray(head.v_template, float)[corners] * w).sum(1)
        return Roots(triangles, weights, rest, (neutral[corners] * w).sum(1), normals)

    @staticmethod
    def scatter(
        head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, among: np.ndarray, density: np.ndarray, count: int,
        g: np.random.Generator,
    ) -> Roots:  # fmt: skip
        """Draw `count` roots evenly by area times `density` [F'] on the triangles numbered `among` [F']."""
        p = neutral[np.asarray(head.faces)[among]]
        area = np.linalg.norm(np.cross(p[:, 1] - p[:, 0], p[:, 2] - p[:, 0]), axis=1) * density
        chosen = among[g.choice(len(among), count, p=area / area.sum())]
        r = g.random((count, 2))
        s = np.sqrt(r[:, 0])
        return Roots.place(head, mesh, neutral, chosen, np.stack([1 - s, s * (1 - r[:, 1]), s * r[:, 1]], 1))

    def select(self, which: np.ndarray) -> Roots:
        """Some of them."""
        return Roots(*(value[which] for value in (self.triangles, self.weights, self.rest, self.points, self.normals)))


def skin_triangles(head: HeadModel, mesh: RenderMesh, without: tuple[str, ...] = ("mouth_interior",)) -> np.ndarray:
    """Numbers of the triangles of the skin that touch none of the named regions."""
    numbers = mesh.kept[mesh.materials[::4] == 0]
    for name in without:
        numbers = numbers[~np.isin(np.asarray(head.faces)[numbers], region_vertices(head, name)).any(1)]
    return numbers


class Skull:
    """The outer surface of a person, which hair must not enter."""

    def __init__(self, head: HeadModel, mesh: RenderMesh, neutral: np.ndarray) -> None:
        normals = mesh.normals(neutral)
        outside = np.ones(len(neutral))
        for name in INSIDE:
            outside[region_vertices(head, name)] = 0.0
        own = mesh.spread(outside) > 0.99
        ears = np.zeros(len(neutral))
        ears[region_vertices(head, "ears")] = 1.0
        self.points, self.normals = mesh.refine(neutral)[own], mesh.spread(normals)[own]
        ear = mesh.spread(ears)[own] > 0.5  # hair lies over ears, not between their folds
        self.normals[ear] = np.sign(self.points[ear, :1]) * np.array([1.0, 0.0, 0.0])
        self._ear = ear
        self._tree = cKDTree(self.points)

    def heights(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Height above the nearest skin [N], its normal [N, 3], distance to it [N]."""
        distance, near = self._tree.query(points)
        normal = self.normals[near]
        return ((points - self.points[near]) * normal).sum(1), normal, distance

    def shares_above_ears(self, paths: np.ndarray, travelled: np.ndarray) -> np.ndarray:
        """Share of each path [N, S, 3] before it gets to an ear, [N]; `travelled` [S] are the shares of its points."""
        over = self._ear[self._tree.query(paths)[1]]
        over[:, 0] = False
        return np.where(over.any(1), travelled[np.maximum(over.argmax(1) - 1, 1)], 1.0)


def grow(roots: Roots, growth: Growth, skull: Skull, g: np.random.Generator) -> np.ndarray:
    """Grow scalp strands, [N, points of the style, 3]."""
    style, count = growth.style, len(roots.rest)
    # neighbours grow alike: what differs differs more by lock than by hair
    centres = g.choice(count, min(LIKE, count), replace=False)
    _, alike = cKDTree(roots.points[centres]).query(roots.points + g.normal(0, 0.003, (count, 3)))
    common = g.normal(0, 1, (len(centres), 5))[alike]
    length = growth.length(roots.rest) * np.clip(1 + 0.05 * common[:, 3] + g.normal(0, 0.03, count), 0.6, 1.4)
    pace = 0.25 + 1.75 * np.arange(STEPS) / (STEPS - 1)  # short first segments stay above the curved skull
    pace[0] = 0.0
    pace /= pace.sum()
    travelled = np.cumsum(pace)
    path = np.empty((count, STEPS, 3))
    path[:, 0] = roots.points - 0.001 * roots.normals
    position = roots.points.copy()
    jitter = style.messiness * (common[:, :3] + 0.35 * g.normal(0, 1, (count, 3)))
    direction = _unit(roots.normals * growth.lift + growth.flow(roots.rest) + jitter)
    clearance = growth.clearance(roots.rest) * np.clip(
        1 + 0.1 * common[:, 4] - g.random(count), 0.05, 1.1
    )  # hair lies in layers
    for k in range(1, STEPS):
        t = float(travelled[k])
        want = growth.way(roots.rest, position, t)
        direction = _unit((1 - style.follow) * direction + style.follow * want + 0.35 * jitter * style.follow)
        position = position + direction * (length * pace[k])[:, None]
        height, normal, distance = skull.heights(position)
        wanted = clearance * np.minimum(1.0, 0.15 + t * length / RISE) + 0.0008
        push = np.where(distance < 0.04, np.maximum(wanted - height, 0.0), 0.0)
        if style.hug > 0:  # combed hair lies on the skull instead of flying off at its tangent
            over = np.maximum(height - wanted - 0.003, 0.0) * smoothstep(0.02, 0.09, position[:, 1]) * (distance < 0.06)
            push = push - style.hug * over
        position = position + push[:, None] * normal
        path[:, k] = position
    free = np.flatnonzero(length < EARS_FREE)
    shares = np.ones(count)
    shares[free] = skull.shares_above_ears(path[free], travelled)
    points = shortened(resample(path, travelled, style.points), shares)
    points = style_strands(points, growth, g)
    height, normal, distance = skull.heights(points[:, 1:].reshape(-1, 3))
    push = np.where(distance < 0.03, np.maximum(0.0008 - height, 0.0), 0.0)
    points[:, 1:] += (push[:, None] * normal).reshape(count, -1, 3)
    return points


def style_strands(points: np.ndarray, growth: Growth, g: np.random.Generator) -> np.ndarray:
    """Gather paths [N, K, 3] into locks, and curl and ruffle them."""
    style, count = growth.style, len(points)
    length = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1)
    stray = g.random(count) < style.flyaway
    which = np.arange(count)
    if style.clumps:
        leaders = g.choice(count, min(style.clumps, count), replace=False)
        # by root and by the way that hair goes, so that no lock spans a parting; borders are ragged
        place = np.concatenate([points[:, 0], 0.6 * points[:, points.shape[1] // 3]], 1)
        _, which = cKDTree(place[leaders]).query(place + g.normal(0, 0.0 if style.rope else 0.0025, place.shape))
        if style.rope:
            points = _rope(points, points[leaders][which], which, style, g)
        else:
            loose = np.where(stray, 0.15, 1.0) * smoothstep(*UNTIED, length)
            points = _clump(points, points[leaders][which], style.clumping * loose, style.gather, g)
            if not style.curl:  # curls of locks that join would cross
                large = leaders[:: max(len(leaders) // (len(leaders) // 9 + 1), 1)]
                _, near = cKDTree(place[large]).query(place + g.normal(0, 0.005, place.shape))
                points = _clump(points, points[large][near], 0.45 * style.clumping * loose, 1.0, g)
    if growth.curl_radius:
        points = points + _curls(points, length, which, growth, g)
    if style.frizz:
        amount = style.frizz * np.where(stray, 5.0, 1.0) * np.clip(length / 0.08, 0.15, 1.3)
        points = points + _ruffle(points.shape, length, g) * amount[:, None, None]
    return points


def resample(path: np.ndarray, places: np.ndarray, count: int) -> np.ndarray:
    """`count` points at even places on smooth curves through points [N, S, 3] that lie at `places` [S] in 0..1."""
    at = np.interp(np.linspace(0, 1, count), places, np.arange(len(places)))
    i = np.minimum(at.astype(int), len(places) - 2)
    f = (at - i)[None, :, None]
    last = len(places) - 1
    a, b, c, d = (path[:, np.clip(i + k, 0, last)] for k in (-1, 0, 1, 2))
    # Catmull-Rom
    return b + 0.5 * f * (c - a + f * (2 * a - 5 * b + 4 * c - d + f * (3 * (b - c) + d - a)))


def shortened(points: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Cut strands [N, K, 3] to a share of their length, [N]."""
    steps = points.shape[1]
    where = np.linspace(0, 1, steps)[None] * share[:, None] * (steps - 1)
    low = np.minimum(where.astype(int), steps - 2)
    f = (where - low)[..., None]
    rows = np.arange(len(points))[:, None]
    return points[rows, low] * (1 - f) + points[rows, low + 1] * f


def _clump(
    points: np.ndarray, leader: np.ndarray, clumping: np.ndarray, gather: float, g: np.random.Generator
) -> np.ndarray:  # fmt: skip
    """Pull strands to their leaders, fully from the share `gather` of the length on; those that end far from theirs less."""
    t = (np.minimum(np.linspace(0, 1, points.shape[1]) / gather, 1.0) ** 1.5)[None, :, None]
    near = smoothstep(*FAR, np.linalg.norm(points[:, -1] - leader[:, -1], axis=1))
    strength = (near * clumping * np.clip(g.normal(1.0, 0.22, len(points)), 0.0, 1.2))[:, None, None]
    return points + np.clip(strength * smoothstep(0.05, 1.0, t), 0.0, 0.97) * (leader - points)


def _rope(points: np.ndarray, leader: np.ndarray, which: np.ndarray, style: Style, g: np.random.Generator) -> np.ndarray:
    """Wind strands around their leaders, loosely or in three parts."""
    count, steps = points.shape[:2]
    side, other = _across(leader)
    t = np.linspace(0, 1, steps)[None]
    gather = smoothstep(0.0, style.wound, t)[..., None] * np.clip(g.normal(0.97, 0.05, (count, 1, 1)), 0.5, 1.0)
    radius = style.rope * (1 - 0.45 * t**3) * np.sqrt(g.random((count, 1)))
    turns = np.linalg.norm(np.diff(leader, axis=1), axis=2).sum(1)[:, None] / style.wavelength
    phase = (which * 0.618034 % 1.0)[:, None]
    if style.braided:
        angle = 2 * np.pi * (turns * 3.4 * t + phase + (np.arange(count) % 3)[:, None] / 3)
        u, v = 1.1 * style.rope * np.sin(angle), 0.55 * style.rope * np.sin(2 * angle)
        swing = g.uniform(0, 2 * np.pi, (count, 1))
        u, v = u + 0.45 * radius * np.cos(swing), v + 0.45 * radius * np.sin(swing)
    else:
        angle = 2 * np.pi * (turns * 2.0 * t + g.random((count, 1)))
        lumps = 1 + 0.16 * np.sin(2 * np.pi * (t * 9 + phase)) + 0.12 * np.sin(2 * np.pi * (t * 23 + 3 * phase))
        u, v = radius * lumps * np.cos(angle), radius * lumps * np.sin(angle)
    return points + gather * (leader + u[..., None] * side + v[..., None] * other - points)


def _curls(points: np.ndarray, length: np.ndarray, which: np.ndarray, growth: Growth, g: np.random.Generator) -> np.ndarray:
    """Displacement of helices around the paths; a lock turns together."""
    style = growth.style
    count, steps = points.shape[:2]
    side, other = _across(points) if style.flat == 1.0 else _around(points)
    locks, t, waves = int(which.max()) + 1, np.linspace(0, 1, steps)[None], style.flat < 1.0
    if waves:  # those of neighbours go together, and by how far it is to the ends, which are at one height
        lock = g.normal(0, 0.5, (locks, 2))[which] + 1.5 * wave_noise(points[:, 0], 0.08, 9)[:, None]
        hand, t = np.ones(count), t - 1.0
    else:  # curls of one hand would all be seen to slant one way
        lock = g.uniform(0, 2 * np.pi, (locks, 2))[which]
        hand = np.where(lock[:, 1] > np.pi, 1.0, -1.0)
    wider = 1 + (0.1 if waves else 0.25) * np.sin(lock[:, 1]) + g.normal(0, 0.15 * style.curl_spread, count)
    turns = hand * length / (style.wavelength * np.clip(wider, 0.5, 1.6))
    angle = lock[:, :1] + g.normal(0, style.curl_spread, (count, 1)) + 2 * np.pi * turns[:, None] * t
    even = np.clip(g.normal(1, min(0.25, style.curl_spread), (count, 1)), 0.4, 1.6)
    radius = growth.curl_radius * smoothstep(0.0, 0.35, np.linspace(0, 1, steps)[None]) * even
    return radius[..., None] * (np.cos(angle)[..., None] * side + style.flat * np.sin(angle)[..., None] * other)


def _ruffle(shape: tuple[int, ...], length: np.ndarray, g: np.random.Generator) -> np.ndarray:
    """Smooth random waves of unit size along strands, 0 at their roots, [N, K, 3]."""
    t = np.linspace(0, 1, shape[1])[None, :, None]
    total = np.zeros(shape)
    for wave, size in ((0.09, 1.0), (0.03, 0.45)):
        turns = np.minimum(length / wave, 0.35 * shape[1])[:, None, None]
        phase = g.uniform(0, 2 * np.pi, (shape[0], 1, 3))
        total += size * g.normal(0, 1, (shape[0], 1, 3)) * (np.sin(2 * np.pi * turns * t + phase) - np.sin(phase))
    return total * t**0.7


def _across(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two directions across each strand that turn smoothly along it, [N, K, 3] each."""
    tangent = _unit(np.gradient(points, axis=1))
    side = _unit(np.cross(tangent, np.array([0.31, 0.42, 0.85])))
    return side, np.cross(tangent, side)


def _around(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Directions across each strand, along the surface of the hair and out of it, [N, K, 3] each."""
    tangent = _unit(np.gradient(points, axis=1))
    out = points - MIDDLE
    out[..., 1] = np.maximum(out[..., 1], 0.0)
    side = _unit(np.cross(tangent, out))
    return side, np.cross(tangent, side)


def _unit(v: np.ndarray) -> np.ndarray:
    return v / np.maximum(np.linalg.norm(v, axis=-1, keepdims=True), 1e-12)
