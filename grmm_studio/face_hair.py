"""Brows, beard and lashes of one person, grown in head space. Needs numpy and scipy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from grmm_core.head import HeadModel
from grmm_core.head.lash_cards import lash_edges
from grmm_core.wrinkles.noise import smoothstep, wave_noise

from .fields import beard_density, sideburns
from .hair import Roots, skin_triangles
from .mesh import RenderMesh
from .subjects import Subject

STEPS = 6  # points of a strand
BROW_X = (0.008, 0.014, 0.024, 0.035, 0.044, 0.053)
# between where portraits of 22 people have them and the head's own region of brows; up to studio 8 they stood 6 mm higher
BROW_Y = (0.0465, 0.0485, 0.0514, 0.0535, 0.0522, 0.0470)
BROW_HALF = (0.0032, 0.0042, 0.0042, 0.0032, 0.0022, 0.0008)
CANDIDATES = 16000  # roots drawn for brows, of which those in the brow are kept
BEARD_ROOTS = 30000  # likewise
STUBBLE = 0.0011  # metres


@dataclass
class Hairs:
    """Strands in head space before they are bound.

    Attributes:
        triangles: Numbers of the head's triangles, [N].
        weights: Barycentric coordinates of the roots, [N, 3].
        points: Head space, root first, metres, [N, K, 3].
        widths: Diameters at root and tip, metres, [N, 2].
    """

    triangles: np.ndarray
    weights: np.ndarray
    points: np.ndarray
    widths: np.ndarray

    def with_more(self, triangle: int, points: np.ndarray, width: float) -> Hairs:
        """The same and more strands [M, K, 3] from the middle of one triangle."""
        count = len(points)
        return Hairs(
            np.concatenate([self.triangles, np.full(count, triangle)]),
            np.concatenate([self.weights, np.full((count, 3), 1 / 3)]),
            np.concatenate([self.points, points]),
            np.concatenate([self.widths, np.tile([width, 0.5 * width], (count, 1))]),
        )


def brow_density(points: np.ndarray, subject: Subject) -> np.ndarray:
    """Density of brow hair 0..1 at template points [..., 3]."""
    x = np.abs(points[..., 0])
    middle = (
        np.interp(x, BROW_X, BROW_Y)
        + subject.brow_height
        + 0.0012 * (subject.brow_arch - 0.8) * np.sin(np.clip((x - 0.01) / 0.04, 0, 1) * np.pi)
    )
    half = np.interp(x, BROW_X, BROW_HALF) * subject.brow_thickness
    off = np.abs(points[..., 1] - middle + 0.0006 * wave_noise(points, 0.006, subject.asymmetry)) / np.maximum(half, 1e-5)
    ends = smoothstep(0.0065, 0.012, x) * smoothstep(0.056, 0.049, x)
    return smoothstep(1.15, 0.55, off) * ends * (points[..., 2] > 0.05)


def brows(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, s: Subject, g: np.random.Generator) -> Hairs:
    """Eyebrows on the neutral head [V, 3]."""
    numbers = skin_triangles(head, mesh)
    p = np.asarray(head.v_template, float)[np.asarray(head.faces)[numbers]].mean(1)
    near = numbers[(np.abs(p[:, 1] - 0.0505) < 0.018) & (p[:, 2] > 0.05) & (np.abs(p[:, 0]) < 0.066)]
    roots = Roots.scatter(head, mesh, neutral, near, np.ones(len(near)), CANDIDATES, g)
    roots = roots.select(g.random(CANDIDATES) < brow_density(roots.rest, s) * 0.65 * s.brow_density)
    rest, x = roots.rest, np.abs(roots.rest[:, 0])
    along = np.clip((x - 0.009) / 0.043, 0, 1)
    off = (rest[:, 1] - np.interp(x, BROW_X, BROW_Y) - s.brow_height) / np.maximum(np.interp(x, BROW_X, BROW_HALF), 1e-4)
    rise = np.interp(along, (0, 0.15, 0.45, 0.7, 1.0), (1.9, 0.9, 0.28, -0.15, -0.5)) - 0.30 * off
    aside = np.sign(rest[:, 0]) * np.interp(along, (0, 0.2, 1), (0.45, 1, 1))
    direction = np.stack([aside, rise, -0.25 * along], 1) + g.normal(0, 0.16, (len(rest), 3))
    direction = _tangent(direction, roots.normals) + 0.22 * roots.normals
    length = np.interp(along, (0, 0.3, 1), (0.0062, 0.0082, 0.0058)) * np.clip(g.normal(1, 0.18, len(rest)), 0.5, 1.4)
    return _hairs(roots, _bent(roots, direction, length, -0.16), 0.00011)


def beard_field(points: np.ndarray, s: Subject) -> np.ndarray:
    """Density of the beard of a person, by its cut, 0..1 at template points [..., 3]."""
    x, y = np.abs(points[..., 0]), points[..., 1]
    chin = smoothstep(0.034, 0.027, x) * smoothstep(0.010, 0.0, y)
    lip = smoothstep(0.031, 0.025, x) * smoothstep(-0.0335, -0.0315, y)
    ragged = 0.002 * wave_noise(points, 0.02, s.asymmetry)
    line = smoothstep(0.030, 0.036, x) * smoothstep(-0.030, -0.037, y + ragged - 0.35 * np.maximum(x - 0.045, 0))
    strap = np.maximum(np.maximum(line, sideburns(points)), chin * smoothstep(-0.038, -0.043, y))
    cut = {"full": 1.0, "goatee": chin, "moustache": lip, "chinstrap": strap}
    return beard_density(points, s.asymmetry) * cut[s.beard_cut]


def beard(head: HeadModel, mesh: RenderMesh, neutral: np.ndarray, s: Subject, g: np.random.Generator) -> Hairs | None:
    """Beard or stubble on the neutral head [V, 3]; None where there is neither."""
    shaven = s.beard <= 0
    if shaven and s.stubble < 0.05:
        return None
    grown = STUBBLE * (0.4 + s.stubble) if shaven else s.beard
    faces, template = np.asarray(head.faces), np.asarray(head.v_template, float)
    numbers = skin_triangles(head, mesh, ("mouth_interior", "lips"))
    near = numbers[beard_field(template, s)[faces[numbers]].max(1) > 0.0]
    roots = Roots.scatter(head, mesh, neutral, near, np.ones(len(near)), BEARD_ROOTS, g)
    roots = roots.select(g.random(BEARD_ROOTS) < beard_field(roots.rest, s) * (0.25 + 0.75 * s.stubble if shaven else 1.0))
    rest, count = roots.rest, len(roots.rest)
    aside = 0.25 * np.sign(rest[:, 0])
    direction = np.stack([aside, np.full(count, -1.0), np.full(count, 0.1)], 1) + g.normal(0, 0.35, (count, 3))
    direction = _tangent(direction, roots.normals) + 0.55 * roots.normals
    short = np.where(rest[:, 1] > -0.028, np.minimum(1.0, 0.009 / grown), 1.0)
    short *= 0.45 + 0.55 * smoothstep(0.10, 0.85, beard_field(rest, s))  # edges are shorter
    length = grown * np.clip(g.normal(1, 0.25, count), 0.4, 1.5) * short
    long = grown > 0.008
    points = _bent(roots, direction, length, -0.12 if long else 0.0)
    if long:
        wave = np.sin(np.linspace(0, 7, STEPS) + g.uniform(0, 6, (count, 1))) - np.sin(g.uniform(0, 6, (count, 1)))
        points[..., 0] += 0.0008 * np.linspace(0, 1, STEPS) * wave
    return _hairs(roots, points, 0.00012)


def lashes(head: HeadModel, neutral: np.ndarray, s: Subject, g: np.random.Generator) -> Hairs:
    """Curved lashes from the root edge of each lash card to its outer edge."""
    triangles, weights, points = [], [], []
    t = np.linspace(0, 1, STEPS)[None, :, None]
    for card in lash_edges(head):
        root, tip = card.root, card.tip
        count = int((95 if card.upper else 60) * s.lash_density)
        u = np.sort(g.random(count)) * (len(root) - 1)
        i = np.minimum(u.astype(int), len(root) - 2)
        f = (u - i)[:, None]
        a = neutral[root[i]] * (1 - f) + neutral[root[i + 1]] * f
        j = np.clip(u + g.normal(0, 0.22, count), 0, len(tip) - 1.001)
        k = j.astype(int)
        h = (j - k)[:, None]
        b = neutral[tip[k]] * (1 - h) + neutral[tip[k + 1]] * h
        b = a + (b - a) * np.clip(g.normal(0.85 if card.upper else 0.62, 0.14, (count, 1)), 0.35, 1.1)
        sag = (1 if card.upper else -1) * 0.22 * np.linalg.norm(b - a, axis=1)[:, None, None] * np.array([0, 1.0, 0])
        points.append(a[:, None] * (1 - t) + b[:, None] * t + sag * (t**2 - t))
        triangles.append(card.triangles[i])
        corners = np.asarray(head.faces)[card.triangles[i]]
        weights.append((corners == root[i][:, None]) * (1 - f) + (corners == root[i + 1][:, None]) * f)
    count = sum(map(len, triangles))
    return Hairs(
        np.concatenate(triangles), np.concatenate(weights), np.concatenate(points), np.tile([0.00011, 0.00004], (count, 1))
    )


def _hairs(roots: Roots, points: np.ndarray, width: float) -> Hairs:
    return Hairs(roots.triangles, roots.weights, points, np.tile([width, 0.4 * width], (len(points), 1)))


def _tangent(direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    flat = direction - (direction * normal).sum(1, keepdims=True) * normal
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)


def _bent(roots: Roots, direction: np.ndarray, length: np.ndarray, bend: float) -> np.ndarray:
    t = np.linspace(0, 1, STEPS)[None, :, None]
    lifted = roots.points - 0.0004 * roots.normals
    return lifted[:, None] + length[:, None, None] * (t * direction[:, None] + bend * t**2 * roots.normals[:, None])
