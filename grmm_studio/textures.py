"""Skin textures painted with numpy in the head model's UV layout: color, relief, wrinkle grooves, roughness.

Painting once per person is far cheaper than noise nodes, which Cycles would evaluate for every sample and bounce. Needs numpy
and scipy, no bpy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage
from scipy.spatial import cKDTree

from grmm_core.head import HeadModel
from grmm_core.head.lash_cards import lash_edges
from grmm_core.head.lip_border import lip_borders
from grmm_core.light.lip_tone import tone_at
from grmm_core.wrinkles.lines import paint_lines
from grmm_core.wrinkles.noise import bump, smoothstep

from . import fields
from .face_hair import beard_field
from .grooms import growth_of
from .marks import Canvas, paint_marks
from .mesh import region_vertices
from .subjects import Subject, skin_albedo

LATTICE = 64  # cells of the periodic noise lattice
LIP_BORDER, LIP_EDGE = (0.0026, 0.0034), 0.0012  # metres about it where lips end as it does, and within which they do


@dataclass
class Atlas:
    """What lies under each texel.

    Attributes:
        size: Side in texels.
        rest: Template positions of the covered texels, metres, [n, 3].
        masks: Region weights of the covered texels, [n] each.
        nearest: Index into the covered texels for every texel, [size, size].
        lash_line: Template points along the edges of the upper lids, [m, 3].
        lip_tone: What colors of the covered texels are multiplied by, [n, 3] (`light.lip_tone`).
    """

    size: int
    rest: np.ndarray
    masks: dict[str, np.ndarray]
    nearest: np.ndarray
    lash_line: np.ndarray
    lip_tone: np.ndarray

    @staticmethod
    def build(head: HeadModel, size: int = 1024) -> Atlas:
        """Rasterise the UV layout of everything but the lash cards."""
        faces, uv, uv_faces = np.asarray(head.faces), np.asarray(head.uv, float), np.asarray(head.uv_faces)
        lashes = np.zeros(len(head.v_template), bool)
        lashes[region_vertices(head, "lashes")] = True
        owner = np.full((size, size), -1, np.int32)
        weights = np.zeros((size, size, 3), np.float32)
        for f in np.flatnonzero(~lashes[faces].all(1)):
            a, b, c = uv[uv_faces[f]] * size - 0.5
            low = np.maximum(np.floor(np.minimum(np.minimum(a, b), c)).astype(int), 0)
            high = np.minimum(np.ceil(np.maximum(np.maximum(a, b), c)).astype(int), size - 1)
            x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
            area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
            if abs(area) < 1e-12:
                continue
            v = ((x - a[0]) * (c[1] - a[1]) - (y - a[1]) * (c[0] - a[0])) / area
            w = ((b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0])) / area
            inside = (v >= -1e-4) & (w >= -1e-4) & (v + w <= 1.0001)
            owner[y[inside], x[inside]] = f
            weights[y[inside], x[inside]] = np.stack([1 - v - w, v, w], -1)[inside]
        covered = owner >= 0
        corners = faces[owner[covered]]
        bary = weights[covered]
        rest = (np.asarray(head.v_template, float)[corners] * bary[..., None]).sum(1)
        masks = {}
        for name in ("lips", "mouth_interior"):
            masks[name] = (head.marked(name).astype(float)[corners] * bary).sum(1)
        for border in lip_borders(head):
            near = border.near(rest, *LIP_BORDER)
            masks["lips"] += near * (border.share(rest, LIP_EDGE) - masks["lips"])
        index = np.full((size, size), -1)
        index[covered] = np.arange(covered.sum())
        where = ndimage.distance_transform_edt(~covered, return_distances=False, return_indices=True)
        edges = [np.asarray(head.v_template, float)[card.root] for card in lash_edges(head) if card.upper]
        finer = [
            np.stack([np.interp(np.linspace(0, 1, 80), np.linspace(0, 1, len(e)), e[:, k]) for k in range(3)], 1) for e in edges
        ]
        tone = tone_at(head, rest)
        tone = np.ones((1, 3)) if tone is None else tone
        return Atlas(size, rest, masks, index[where[0], where[1]], np.concatenate(finer), tone)


@dataclass
class SkinTextures:
    """Painted maps, first row at v = 0.

    Attributes:
        albedo: Linear RGB, [size, size, 3].
        groove_albedo: Factor of the color inside wrinkles, [3].
        detail: Height in metres, groove depth 0..1, roughness, [size, size, 3].
        lines: Relief of the lines that expressions bring, by channel of `wrinkles`, [size, size, 3].
    """

    albedo: np.ndarray
    groove_albedo: np.ndarray
    detail: np.ndarray
    lines: np.ndarray


def noise(points: np.ndarray, frequency: float, seed: int, octaves: int = 3, roughness: float = 0.5) -> np.ndarray:
    """Value noise 0..1 with mean 0.5 and standard deviation near 0.15; points [n, 3] in metres, frequency per metre."""
    g = np.random.default_rng([seed, 51])
    total = np.zeros(len(points), np.float32)
    power, weight = 0.0, 1.0
    for octave in range(octaves):
        lattice = g.random((LATTICE, LATTICE, LATTICE), np.float32)
        p = points * (frequency * 2.03**octave) + g.random(3) * LATTICE
        cell = np.floor(p)
        f = p - cell
        p = cell + f * f * (3 - 2 * f)
        total += weight * (ndimage.map_coordinates(lattice, p.T, order=1, mode="grid-wrap") - 0.5)
        power += weight**2
        weight *= roughness
    return 0.5 + total / np.sqrt(power) * 0.95


def paint_skin(subject: Subject, atlas: Atlas) -> SkinTextures:
    """Paint the maps of one person."""
    s, rest = subject, atlas.rest
    seed = s.asymmetry
    g = np.random.default_rng([seed, 52])
    lips = atlas.masks["lips"] * (1 - atlas.masks["mouth_interior"])
    mouth = atlas.masks["mouth_interior"]
    large = noise(rest, 38.0, seed, 4, 0.6)
    small = noise(rest, 230.0, seed + 1, 3, 0.65)
    pores = noise(rest, 900.0, seed + 2, 2, 0.7)
    lip_lines = noise(rest * np.array([5.0, 0.7, 1.1]), 180.0, seed + 3, 2)

    color = np.broadcast_to(skin_albedo(s.melanin, s.blood), rest.shape)
    red, dark = skin_albedo(s.melanin * 1.02, s.blood + 0.55), skin_albedo(s.melanin * 1.25 + 0.07, s.blood * 1.12)
    color = _mix(fields.redness(rest) * s.redness * 0.75, color, red)
    color = _mix(smoothstep(0.42, 0.75, large) * 0.24, color, red)
    color = _mix(smoothstep(0.45, 0.8, small) * 0.30, color, dark)
    color = _mix(smoothstep(0.55, 0.8, noise(rest, 21.0, seed + 4, 3)) * 0.30, color, dark)
    color = _mix(smoothstep(0.58, 0.85, pores) * 0.30 * s.pores, color, dark)
    color = _mix(fields.eye_shadow(rest) * g.uniform(0.2, 0.9), color, dark)
    if s.freckles > 0.05:
        zone = (
            bump(rest, (0.03, 0.008, 0.10), (0.035, 0.025, 0.05))
            + bump(rest, (0, 0.01, 0.115), (0.02, 0.02, 0.02), False)
            + 0.2
        )
        zone = np.clip(zone * smoothstep(0.35, 0.6, noise(rest, 80.0, seed + 5)), 0, 1)
        color = _mix(
            _dots(rest, zone, int(700 * s.freckles) + 40, (0.0005, 0.0012), g) * 0.42,
            color,
            skin_albedo(s.melanin + 0.5, s.blood + 0.15),
        )
    if s.spots > 0.02:
        count = int(14 * s.spots) + 1
        color = _mix(
            _dots(rest, np.ones(len(rest)), count, (0.0008, 0.0018), g) * 0.7,
            color,
            skin_albedo(s.melanin + 1.2, s.blood + 0.3),
        )
    if s.macros["age"] > 52:
        blotch = _dots(rest, np.ones(len(rest)), int((s.macros["age"] - 45) * 1.5), (0.0015, 0.0045), g)
        color = _mix(blotch * 0.35, color, skin_albedo(s.melanin + 0.45, s.blood + 0.1))

    hair_dark = 0.55 * np.array(s.hair_color)
    scalp = np.zeros(len(rest))
    growth = growth_of(s)
    if growth is not None:
        scalp = fields.scalp_density(rest, growth.receding, s.hairline, seed)
        color = _mix(scalp * (0.44 + 0.12 * smoothstep(0.4, 0.65, pores)), color, hair_dark)
    else:
        shade = fields.scalp_density(rest, 0.9, s.hairline, seed) * smoothstep(0.35, 0.65, pores) * 0.35 * s.stubble
        color = _mix(shade, color, hair_dark)
    if s.stubble > 0.03:
        grown = np.minimum(1.0, 0.5 * np.array(s.hair_color) + 0.035)
        color = _mix((0.16 + 0.2 * pores) * beard_field(rest, s) * s.stubble * (1 - lips), color, grown)
    lip = skin_albedo(s.melanin * 0.85, s.blood + 0.35) * np.array(s.lips)
    lip = _mix(
        smoothstep(0.45, 0.75, lip_lines) * 0.4,
        np.broadcast_to(lip, rest.shape),
        skin_albedo(s.melanin * 1.05 + 0.1, s.blood + 0.8),
    )
    edge = smoothstep(0.15, 0.85, lips + 0.25 * (small - 0.5))
    color = _mix(edge, color, lip)
    lining = _mix(
        smoothstep(0.4, 0.7, large), np.broadcast_to(np.array([0.44, 0.13, 0.12]), rest.shape), np.array([0.30, 0.07, 0.07])
    )
    color = _mix(smoothstep(0.2, 0.9, mouth), color, lining)

    _, phase = fields.wrinkle_lines(rest)
    wave = 0.5 + 0.5 * np.sin(2 * np.pi * (phase + 2.2 * (noise(rest, 60.0, seed + 7, 2) - 0.5)))
    groove = wave**3 * smoothstep(0.30, 0.60, noise(rest, 95.0, seed + 8, 2))
    height = (pores - 0.5) * 0.00022 * (0.35 + 0.9 * s.pores) * (1 - 0.8 * mouth) * (1 - lips)
    height = height + (noise(rest, 190.0, seed + 9, 2) - 0.5) * 0.0006 * (0.35 + s.wrinkles) * (1 - mouth)
    height = height + (lip_lines - 0.5) * 0.0006 * lips
    oily = np.clip(
        bump(rest, (0, 0.03, 0.11), (0.02, 0.05, 0.03), False) + 0.6 * bump(rest, (0, 0.085, 0.10), (0.035, 0.02, 0.03), False),
        0,
        1,
    )
    roughness = (
        0.56 - 0.10 * s.shine + 0.12 * (small - 0.5) - oily * (0.10 + 0.08 * s.shine) - 0.14 * lips - 0.28 * mouth + 0.2 * scalp
    )
    canvas = Canvas(rest, color, height, roughness)
    paint_marks(s, canvas, edge * (1 - mouth), atlas.lash_line)
    return SkinTextures(
        albedo=np.clip(canvas.color * atlas.lip_tone, 0, 1).astype(np.float16)[atlas.nearest],
        groove_albedo=np.asarray(dark / skin_albedo(s.melanin, s.blood)),
        detail=np.stack([canvas.height, groove, canvas.roughness], -1).astype(np.float16)[atlas.nearest],
        lines=(paint_lines(rest, s.asymmetry, s.wrinkles) * (1 - mouth)[:, None]).astype(np.float16)[atlas.nearest],
    )


def _mix(factor: np.ndarray, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    f = np.clip(factor, 0, 1)[:, None]
    return a * (1 - f) + np.asarray(b) * f


def _dots(rest: np.ndarray, weight: np.ndarray, count: int, radii: tuple[float, float], g: np.random.Generator) -> np.ndarray:
    """Soft dots at random texels drawn by weight, 0..1, [n]."""
    chosen = g.choice(len(rest), count, p=weight / weight.sum())
    radius = g.uniform(*radii, count)
    strength = g.uniform(0.35, 1.0, count)
    distance, near = cKDTree(rest[chosen]).query(rest, distance_upper_bound=2 * radii[1])
    near = np.minimum(near, count - 1)
    return np.where(np.isfinite(distance), smoothstep(1.25, 0.5, distance / radius[near]) * strength[near], 0.0)
