"""Teeth painted in the head model's UV layout: enamel, dark between the teeth, scalloped gums, cusps and fissures as a relief.

The head model has a smooth band for each row of teeth, 33 vertices along the arch and 7 across it. What makes teeth of it is
painted, at 0.2 mm a texel, in coordinates of the arch: how far along it, and how far from the row's edge on the outer or the
inner side. Needs numpy and scipy, no
bpy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from grmm_core.head import HeadModel
from grmm_core.model.layout import texel_layout
from grmm_core.wrinkles.noise import smoothstep

from . import fields
from .mesh import region_vertices
from .subjects import Subject
from .textures import noise

TEXELS = 2048  # a side of the UV square, of which only the rows with teeth are painted
MARGIN = 3  # rows of texels above the highest that is painted
UPPER, LOWER = "upper_teeth", "lower_teeth"
ROWS = (UPPER, LOWER)
# From the middle outwards, metres, after tables of dental anatomy: two incisors, canine, two premolars, two molars.
WIDTHS = {
    UPPER: (0.0086, 0.0066, 0.0076, 0.0070, 0.0068, 0.0100, 0.0095),
    LOWER: (0.0054, 0.0060, 0.0069, 0.0070, 0.0071, 0.0112, 0.0105),
}
CROWNS = {
    UPPER: (0.0105, 0.0092, 0.0104, 0.0088, 0.0082, 0.0077, 0.0072),
    LOWER: (0.0088, 0.0090, 0.0102, 0.0088, 0.0082, 0.0076, 0.0071),
}
TABLES = (0.0, 0.0, 0.0, 0.0072, 0.0074, 0.0090, 0.0088)  # how wide the chewing surface is, metres; 0: a cutting edge
ARCH_STRETCH = 1.06  # of the head model's arch over that of the widths
EDGE_KNOTS = 41  # places along half an arch where its edge is found
INNER_SLOPE, INNER_START = 0.36, 0.0002  # the inner side is farther inwards than this share of the way to the gum
GAP_COLOR = (0.17, 0.085, 0.065)  # linear, where nothing but the mouth is seen between teeth
FISSURE = (0.50, 0.36, 0.24)  # factor of the enamel's color at the bottom of a fissure
GUM_LIGHT, GUM_DARK = (0.53, 0.19, 0.175), (0.42, 0.115, 0.11)
CANINE = 2  # the third tooth is a little yellower than the rest


@dataclass
class TeethAtlas:
    """What lies under each painted texel: the rows v < `height` / `TEXELS` of the UV square.

    Attributes:
        height: Rows of texels.
        nearest: Index into the covered texels for every texel, [height, TEXELS].
        row: 0 upper, 1 lower, of each covered texel, [n]; so all the following.
        along: Signed metres along the arch from the middle.
        inner: Whether it lies on the side of the tongue.
        off: Metres along the surface from the edge of the row.
        rest: Template positions, metres, [n, 3].
    """

    height: int
    nearest: np.ndarray
    row: np.ndarray
    along: np.ndarray
    inner: np.ndarray
    off: np.ndarray
    rest: np.ndarray

    @staticmethod
    def build(head: HeadModel) -> TeethAtlas:
        """Find the texels of the teeth of a head model."""
        flags = np.zeros(len(head.v_template), int)
        for i, name in enumerate(ROWS):
            flags[region_vertices(head, name)] = 1 + i
        corners = np.asarray(head.faces)
        own = np.flatnonzero((flags[corners] > 0).all(1))
        layout = texel_layout(np.asarray(head.uv), np.asarray(head.uv_faces)[own], TEXELS)
        corners = corners[own][layout.face]
        rest = (np.asarray(head.v_template, float)[corners] * layout.barycentric[..., None]).sum(1)
        lines, columns = np.divmod(layout.texel, TEXELS)
        height = int(lines.max()) + 1 + MARGIN
        index = np.full((height, TEXELS), -1)
        index[lines, columns] = np.arange(len(layout))
        where = ndimage.distance_transform_edt(index < 0, return_distances=False, return_indices=True)
        row = flags[corners[:, 0]] - 1
        along = fields.tooth_arc(rest)
        inner, off = np.zeros(len(rest), bool), np.zeros(len(rest))
        for i in range(len(ROWS)):
            mine = row == i
            inner[mine], off[mine] = _across(rest[mine], np.abs(along[mine]), 1.0 if i == 0 else -1.0)
        return TeethAtlas(height, index[where[0], where[1]], row, along, inner, off, rest)

    @property
    def share(self) -> float:
        """Of the UV square's height that is painted."""
        return self.height / TEXELS


def _across(rest: np.ndarray, arc: np.ndarray, up: float) -> tuple[np.ndarray, np.ndarray]:
    """Whether points of one row lie on its inner side, and their distance in metres from its edge; [n] each.

    The edge is found place by place: the arches are curved, and climb towards the molars.
    """
    knots = np.linspace(0.0, arc.max(), EDGE_KNOTS)
    y = up * rest[:, 1]
    edge = np.empty((EDGE_KNOTS, 3))
    for k, knot in enumerate(knots):
        near = np.flatnonzero(np.abs(arc - knot) <= knots[1])
        tip = near[y[near] <= y[near].min() + 0.0003]
        edge[k] = np.abs(rest[tip, 0]).mean(), y[tip].mean(), rest[tip, 2].mean()
    kernel = np.array([1.0, 2.0, 1.0]) / 4
    padded = np.concatenate([edge[1:2] * (-1.0, 1.0, 1.0), edge, edge[-1:]])  # the arch goes on at the other side
    edge = np.stack([np.convolve(padded[:, c], kernel, "valid") for c in range(3)], 1)
    side, level, front = (np.interp(arc, knots, edge[:, c]) for c in range(3))
    below = np.maximum(y - level, 0.0)
    away = np.stack([side, front - fields.ARCH_CENTRE], 1)
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    inwards = (side - np.abs(rest[:, 0])) * away[:, 0] + (front - rest[:, 2]) * away[:, 1]
    inner = inwards > INNER_SLOPE * below + INNER_START
    return inner, np.where(inner, np.hypot(inwards, below), below)


@dataclass
class TeethTextures:
    """Painted maps, first row at v = 0.

    Attributes:
        albedo: Linear RGB, [height, TEXELS, 3].
        detail: Height in metres, share of gum 0..1, roughness, [height, TEXELS, 3].
    """

    albedo: np.ndarray
    detail: np.ndarray


@dataclass
class _Row:
    """The teeth of one half of a row, from the middle outwards, [8] each; the last stands for what is behind them."""

    start: np.ndarray
    width: np.ndarray
    crown: np.ndarray
    short: np.ndarray  # metres that the tooth ends before the edge
    tint: np.ndarray
    turn: np.ndarray  # metres of relief from one side of the tooth to the other


def _draw_row(name: str, s: Subject, half: int) -> _Row:
    g = np.random.default_rng([s.asymmetry, 91, ROWS.index(name)])
    scale = ARCH_STRETCH * float(g.uniform(0.95, 1.05))
    crooked = float(g.beta(1.2, 3.0))  # of the person
    diastema = 0.0007 * max(0.0, float(g.normal(-0.6, 1.0)))
    worn = float(g.uniform(0.3, 1.0))
    g = np.random.default_rng([s.asymmetry, 92, ROWS.index(name), half])
    count = len(WIDTHS[name])
    width = np.array(WIDTHS[name]) * scale * g.uniform(0.95, 1.05, count)
    start = np.concatenate([[0.0], np.cumsum(width)]) + diastema
    crown = np.array(CROWNS[name]) * g.uniform(0.92, 1.08, count)
    short = np.abs(g.normal(0, 0.0005, count)) * crooked + np.where(np.arange(count) == 1, 0.0006 * worn, 0.0)
    tint = 1.0 + g.normal(0, 0.025, (count, 1)) * (0.6, 1.0, 1.6)
    tint[CANINE] *= (0.97, 0.93, 0.84)
    turn = g.normal(0, 0.0006, count) * crooked

    def closed(values: np.ndarray, last: float) -> np.ndarray:
        return np.concatenate([values, np.full((1, *values.shape[1:]), last)])

    return _Row(start, closed(width, 0.01), closed(crown, 0.0), closed(short, 0.0), closed(tint, 1.0), closed(turn, 0.0))


def paint_teeth(s: Subject, atlas: TeethAtlas) -> TeethTextures:
    """Paint both rows of teeth of a person."""
    albedo, detail = np.zeros((len(atlas.row), 3)), np.zeros((len(atlas.row), 3))
    for i, name in enumerate(ROWS):
        for half, sign in enumerate((-1.0, 1.0)):
            own = (atlas.row == i) & (atlas.along * sign > 0 if half else atlas.along <= 0)
            parts = {key: getattr(atlas, key)[own] for key in ("along", "inner", "off", "rest")}
            albedo[own], detail[own] = _paint_half(s, _draw_row(name, s, half), parts)
    return TeethTextures(albedo[atlas.nearest].astype(np.float32), detail[atlas.nearest].astype(np.float32))


def _paint_half(s: Subject, row: _Row, at: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Color [n, 3], and height, gum and roughness [n, 3], of the texels of half a row."""
    arc, off, inner, rest = np.abs(at["along"]), at["off"], at["inner"], at["rest"]
    ragged = noise(rest, 900.0, s.asymmetry + 5, 2) - 0.5
    tooth = np.clip(np.searchsorted(row.start, arc, "right") - 1, 0, len(row.start) - 1)
    width, crown, table = row.width[tooth], row.crown[tooth], np.append(TABLES, 0.0)[tooth]
    across = np.clip((arc - row.start[tooth]) / width, 0.0, 1.0) * 2 - 1  # -1..1 over the tooth
    from_side = (1.0 - np.abs(across)) * width / 2  # metres from the boundary with the next tooth
    chewing = table > 0
    # Behind a cutting edge the crown is shorter; a chewing surface is followed by a low wall.
    length = np.where(inner, np.where(chewing, table + 0.0022, 0.82 * crown), crown)

    papilla = np.where(inner & chewing, 0.0006, 0.0026) * np.abs(across) ** 3  # the gum reaches down between two teeth
    gum = smoothstep(-0.00012, 0.00025, off - (length - papilla) + 0.0003 * ragged)
    gum = np.where(tooth == len(row.width) - 1, 1.0, gum)

    # Outline: narrower at the neck, corners rounded off at the edge, of which a short tooth does not reach all.
    edge_off = off - np.where(inner & chewing, 0.0, row.short[tooth])
    neck = 0.0002 * np.clip(off / np.maximum(crown, 1e-6), 0, 1) ** 2
    corner = np.where(chewing, 0.0006, 0.0010)
    rounding = corner * np.clip(1 - np.maximum(edge_off, 0) / (1.6 * corner), 0, 1) ** 2
    on_table = inner & chewing & (off < table)
    gap = smoothstep(0.00026, 0.00002, from_side - np.where(on_table, 0.0, neck + rounding))
    void = np.where(inner, 0.0, smoothstep(0.0002, -0.0001, edge_off))

    # Enamel: yellower and darker to the neck, bluish and glassy at cutting edges, a little unlike from tooth to tooth.
    neck_share = np.clip(off / np.maximum(length, 1e-6), 0, 1)
    color = np.array(s.teeth) * row.tint[tooth]
    color = color * (1 - neck_share[:, None] ** 1.5 * (1 - np.array((0.93, 0.85, 0.70))))
    glassy = np.where(chewing, 0.0, smoothstep(0.0022, 0.0004, edge_off))[:, None] * 0.35
    color = color * (1 - glassy * (1 - np.array((0.72, 0.78, 0.86))))
    streaks = noise(np.stack([arc, 0.15 * off, 0 * arc], 1), 1400.0, s.asymmetry + 6, 2) - 0.5
    color = color * (1 + 0.10 * streaks[:, None])

    cusps, fissure = _chewing_surface(across, off, np.maximum(table, 1e-6), tooth, ragged)
    cusps, fissure = np.where(on_table, cusps, 0.0), np.where(on_table, fissure, 0.0)
    color = color * (1 - fissure[:, None] * (1 - np.array(FISSURE)))
    color = color * (1 - gap[:, None] * (1 - np.array((0.36, 0.25, 0.19))))
    color = color * (1 - void[:, None]) + void[:, None] * np.array(GAP_COLOR)
    pink = noise(rest, 420.0, s.asymmetry + 7, 3)[:, None]
    flesh = np.array(GUM_DARK) + (np.array(GUM_LIGHT) - np.array(GUM_DARK)) * np.clip(pink * 1.4 - 0.2, 0, 1)
    color = color * (1 - gum[:, None]) + gum[:, None] * flesh

    bulge = 0.0009 * np.sqrt(np.clip(1 - across**2, 0, 1)) * np.where(on_table, 0.35, 1.0)
    height = bulge + 0.5 * row.turn[tooth] * across + cusps + 0.00005 * streaks
    height = height * (1 - void) * (1 - gum) + gum * (0.0007 + 0.00025 * (pink[:, 0] - 0.5))
    roughness = 0.16 + 0.18 * gum + 0.3 * np.maximum(void, 0.5 * gap)
    return color, np.stack([height, gum, roughness], 1)


def _chewing_surface(
    across: np.ndarray, off: np.ndarray, table: np.ndarray, tooth: np.ndarray, ragged: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Relief in metres and share of fissure 0..1, [n] each: a ridge on either side, cusps on it, grooves between them."""
    over = np.clip(off / table, 0, 1)
    middle = over - 0.48 + 0.10 * ragged
    molar = tooth >= 5
    ridge = 0.5 - 0.5 * np.cos(2 * np.pi * np.clip(np.abs(middle) / 0.56, 0, 1))
    cusp = np.where(molar, 0.62 + 0.38 * np.abs(np.sin(np.pi * across)), 0.7 + 0.3 * np.cos(0.5 * np.pi * across))
    rim = smoothstep(1.0, 0.8, np.abs(across))
    along_groove = smoothstep(0.055, 0.015, np.abs(middle)) * rim
    between = np.where(molar, smoothstep(0.10, 0.03, np.abs(across + 0.25 * middle)), 0.0) * smoothstep(
        0.45, 0.25, np.abs(middle)
    )
    fissure = np.clip(np.maximum(along_groove, 0.7 * between), 0, 1)
    return 0.0011 * ridge * cusp - 0.0005 * fissure, 0.5 * fissure
