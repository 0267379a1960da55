"""What people wear, hold and put on, as simple meshes and shapes: clothes, hats, glasses, makeup, hands. Numpy only."""

from __future__ import annotations

import numpy as np

from grmm_core.geometry.triangles import vertex_normals
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.head import HeadModel
from grmm_core.photo.parser import LABELS

from .drawn import Drawn, Generator, Surface, any_color, noise, pattern, smooth, tube

# heights, half widths and half depths of a body below the neck, metres in head space
TORSO = np.array([
    (-0.085, 0.050, 0.050), (-0.115, 0.060, 0.058), (-0.135, 0.085, 0.070), (-0.150, 0.120, 0.080), (-0.165, 0.155, 0.088),
    (-0.185, 0.185, 0.096), (-0.215, 0.208, 0.106), (-0.27, 0.22, 0.118), (-0.40, 0.21, 0.125), (-0.70, 0.21, 0.125),
])  # fmt: skip
MIDDLE = -0.018  # its depth
BARE_FROM = -0.15  # metres: clothes that begin lower have no collar


def body(head: HeadModel, vertices: np.ndarray, g: Generator, grown: float) -> np.ndarray:
    """Triangles [T, 3, 3] of shoulders and chest, with the head's own bust, both `grown` metres out of the skin."""
    angle = np.linspace(0, 2 * np.pi, 36, endpoint=False)
    rows = TORSO.copy()
    rows[2:, 1] *= g.uniform(0.88, 1.18)
    rows[2:, 0] += g.normal(0, 0.008)
    rings = np.stack([
        (rows[:, 1:2] + grown) * np.sign(np.cos(angle)) * np.abs(np.cos(angle)) ** 0.85, np.repeat(rows[:, :1], 36, 1),
        (rows[:, 2:3] + grown) * np.sin(angle) + MIDDLE,
    ], -1)  # fmt: skip
    turn, lean = g.normal(0, 0.22), g.normal(0, 0.05)
    c, s = np.cos(turn), np.sin(turn)
    below = rings[2:]
    x, y, z = below[..., 0], below[..., 1], below[..., 2] - MIDDLE
    below[...] = np.stack([c * x + s * z - lean * (y + 0.12), y + lean * x, c * z - s * x + MIDDLE], -1)
    bust = vertices + grown * vertex_normals(vertices, head.faces)
    own = np.isin(head.faces, head.regions["neck"]).all(1)
    return np.concatenate([tube(rings), bust[head.faces[own]]])


def dress(drawn: Drawn, head: HeadModel, vertices: np.ndarray, g: Generator, skin: np.ndarray, hair: np.ndarray) -> np.ndarray:
    """Draw a body and clothes under the head; returns the depth of what hides hair behind it, [S, S]."""
    bare = Surface.of(body(head, vertices, np.random.default_rng(seed := int(g.integers(1 << 30))), 0.0), drawn.camera)
    flesh = bare.seen & (bare.depth < drawn.depth) & (bare.points[..., 1] < -0.11)
    drawn.lay(flesh.astype(float), skin * (1 + 0.1 * noise(g, len(flesh))[..., None]), "neck", bare.normals, bare.depth)
    if g.random() < 0.07:
        return drawn.depth
    cloth = Surface.of(body(head, vertices, np.random.default_rng(seed), g.uniform(0.003, 0.010)), drawn.camera)
    x, y, z = np.moveaxis(cloth.points, -1, 0)
    top = g.uniform(-0.135, -0.095) if g.random() < 0.5 else g.uniform(-0.105, -0.068)  # the others have collars
    if g.random() < 0.25:  # bare shoulders
        top = g.uniform(-0.25, -0.15)
    front = smooth(-0.02, 0.05, z)
    deep = g.choice([0.0, g.uniform(0.01, 0.06), g.uniform(0.05, 0.16)])
    cut = np.clip(1 - np.abs(x) / g.uniform(0.03, 0.10), 0, 1) ** g.uniform(0.3, 1.2)
    edge = top + g.normal(0, 0.006) - deep * front * cut
    worn = cloth.seen & (cloth.depth <= drawn.depth + 0.004) & (y < edge)
    color = pattern(g, cloth.points, skin, hair)
    if g.random() < 0.45:  # a jacket over it, and a tie
        if g.random() < 0.6:  # a plain, light shirt
            color = np.broadcast_to(g.uniform(0.4, 0.9) * g.uniform(0.85, 1.0, 3), color.shape)
        open_to = g.uniform(0.01, 0.05) + np.clip(-0.13 - y, -1, 1) * g.uniform(-0.35, 0.2)
        jacket = (np.abs(x) > np.maximum(open_to, 0.004)) | (z < 0)
        color = np.where(jacket[..., None], pattern(g, cloth.points, skin, hair), color)
        if g.random() < 0.5:
            tie = (np.abs(x) < 0.014 + np.clip(-0.13 - y, 0, 1) * 0.12) & (z > 0) & ~jacket
            color = np.where(tie[..., None], pattern(g, cloth.points * 2, skin, hair), color)
    drawn.lay(worn.astype(float), color, "clothes", cloth.normals, cloth.depth)
    kind = g.random()
    if kind < 0.62 and top > BARE_FROM:
        angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        gap = g.uniform(0.0, 0.9) if kind < 0.35 else 0.0  # a shirt's collar is open in front
        top, thick = g.uniform(-0.105, -0.07), g.uniform(0.002, 0.006)
        wide = g.uniform(0.062, 0.074)
        if kind > 0.55:  # scarf, the ring of a suit, a fur
            wide, top, thick = g.uniform(0.075, 0.14), g.uniform(-0.11, -0.07), g.uniform(0.01, 0.03)
        rings = []
        for height, out in ((-0.15, 0.012), (0.5 * (top - 0.13), 0.006), (top, thick), (top - 0.004, -0.002), (-0.14, -0.004)):
            slope = 0.018 * np.sin(angle) if height > -0.14 else 0.0
            rings.append(
                np.stack(
                    [
                        (wide + out) * np.cos(angle),
                        np.full(40, height) - slope,
                        (wide * 0.95 + out) * np.sin(angle) + MIDDLE + 0.006,
                    ],
                    -1,
                )
            )
        collar = Surface.of(tube(np.stack(rings)), drawn.camera)
        there = (
            collar.seen
            & (collar.depth < drawn.depth)
            & (np.abs(np.arctan2(collar.points[..., 0], collar.points[..., 2])) >= gap * 0.5)
        )
        drawn.lay(
            there.astype(float),
            pattern(g, collar.points, skin, hair) if kind > 0.4 else color.mean((0, 1)),
            "clothes",
            collar.normals,
            collar.depth,
        )
    return drawn.depth


class Hat:
    """A hat: what of the hair it hides, and itself."""

    def __init__(self, g: Generator) -> None:
        kinds = ["cap", "beanie", "brim", "crown", "officer", "scarf", "helmet"]
        self.kind = str(g.choice(kinds, p=[0.2, 0.2, 0.12, 0.3, 0.06, 0.06, 0.06]))
        self._plain = any_color(g, np.full(3, 0.3), np.full(3, 0.02)) if g.random() < 0.7 else None
        if self._plain is not None and g.random() < 0.5:  # as dark as hair
            self._plain = g.uniform(0.003, 0.04) * g.uniform(0.8, 1.2, 3)
        self.height = g.uniform(0.055, 0.085) if self.kind != "beanie" else g.uniform(0.04, 0.075)
        if self.kind == "crown":
            self.height = g.uniform(0.055, 0.1)
        self.slope = g.uniform(0.0, 0.55 if self.kind != "crown" else 0.9) if self.kind != "scarf" else 0.0
        self.out = g.uniform(0.008, 0.02) if self.kind != "helmet" else g.uniform(0.03, 0.05)

    def above(self, points: np.ndarray) -> np.ndarray:
        """Height over the hat's edge, metres, of points [..., 3]."""
        return points[..., 1] - self.height - self.slope * (points[..., 2] - 0.09)

    def hides(self, points: np.ndarray) -> np.ndarray:
        """Whether hair at points [N, 3] is under it."""
        if self.kind == "scarf":
            return np.ones(len(points), bool)
        return self.above(points) > -0.004

    def draw(
        self, drawn: Drawn, head: HeadModel, vertices: np.ndarray, g: Generator, skin: np.ndarray, hair: np.ndarray
    ) -> None:
        """Put it on the head."""
        outer = head.faces[np.asarray(head.uv_islands) == 0]
        out = np.full(len(vertices), self.out)
        above = self.above(vertices)
        if self.kind == "officer":
            out += smooth(0.01, 0.06, above) * g.uniform(0.01, 0.05)
        lumps = 1 + 0.35 * np.sin(vertices @ g.normal(0, 45, 3) + 1.0)
        grown = vertices + (out * lumps)[:, None] * vertex_normals(vertices, head.faces)
        if self.kind in ("helmet", "officer", "brim", "cap"):
            grown[:, 1] += smooth(0.0, 0.06, above) * g.uniform(0.0, 0.03)
        shell = Surface.of(grown[outer], drawn.camera)
        x, y, z = np.moveaxis(shell.points, -1, 0)
        worn = shell.seen & (self.above(shell.points) > 0)
        if self.kind == "scarf":
            wide, high = g.uniform(0.052, 0.066), g.uniform(0.07, 0.088)
            worn = shell.seen & ~(((x / wide) ** 2 + ((y - 0.012) / high) ** 2 < 1) & (z > 0.0)) & (y > -0.15)
        worn &= shell.depth < drawn.depth + 0.02
        self._cover(drawn, shell, worn, g, skin, hair)
        if self.kind == "crown":
            self._crown(drawn, g, skin, hair)
        if self.kind in ("cap", "brim", "officer", "crown") and g.random() < 0.9:
            around = self.kind in ("brim", "crown")
            reach = 2 * np.pi if around else g.uniform(1.0, 2.0)
            angle = np.pi / 2 + np.linspace(-reach / 2, reach / 2, 40)
            rings, wide = [], g.uniform(0.035, 0.13 if around else 0.085)
            for share in (0.0, 0.5, 1.0):
                r = 0.078 + self.out + wide * share
                p = np.stack([0.95 * r * np.cos(angle), np.zeros(40), 1.08 * r * np.sin(angle)], -1)
                p[:, 1] = (
                    self.height
                    + 0.004
                    + self.slope * (p[:, 2] - 0.09) * 0.6
                    - wide * share * g.uniform(0.0, 0.5)
                    - 0.6 * share * np.abs(p[:, 0]) ** 2
                )
                rings.append(p)
            rim = Surface.of(tube(np.stack(rings)), drawn.camera)
            self._cover(drawn, rim, rim.seen & (rim.depth < drawn.depth), g, skin, hair)
        if g.random() < 0.35:  # a badge
            spot = (x / g.uniform(0.01, 0.03)) ** 2 + ((self.above(shell.points) - 0.03) / g.uniform(0.008, 0.02)) ** 2 < 1
            drawn.lay((worn & spot & (z > 0)).astype(float), any_color(g, skin, hair), None)

    def _cover(self, drawn: Drawn, part: Surface, worn: np.ndarray, g: Generator, skin: np.ndarray, hair: np.ndarray) -> None:
        """Lay a part of it over the picture, in one plain color of the whole hat or in any."""
        color = pattern(g, part.points, skin, hair)
        if self._plain is not None:
            color = self._plain * (1 + 0.15 * noise(g, len(worn), 5, 5)[..., None])
        drawn.lay(worn.astype(float), np.clip(color, 0.001, 1.0), "hat", part.normals, part.depth)

    def _crown(self, drawn: Drawn, g: Generator, skin: np.ndarray, hair: np.ndarray) -> None:
        """What of a felt or straw hat stands over the head, with the dent on its top and sometimes a ribbon."""
        angle, high = np.linspace(0, 2 * np.pi, 40, endpoint=False), g.uniform(0.085, 0.135)
        narrow, dent, radius = g.uniform(0.7, 0.95), g.uniform(0.0, 0.02), 0.08 + self.out
        rings = []
        for up, share in ((0.0, 1.0), (0.5, 0.5 + 0.5 * narrow), (0.9, narrow), (1.0, 0.85 * narrow), (1.0 - dent / high, 0.0)):
            x, z = 0.95 * radius * share * np.cos(angle), 1.08 * radius * share * np.sin(angle)
            rings.append(np.stack([x, self.height + high * up + self.slope * (z - 0.09) * 0.6, z], -1))
        crown = Surface.of(tube(np.stack(rings)), drawn.camera)
        there = crown.seen & (crown.depth < drawn.depth + 0.03)
        self._cover(drawn, crown, there, g, skin, hair)
        if g.random() < 0.5:
            above = self.above(crown.points)
            drawn.lay((there & (above > 0.0) & (above < g.uniform(0.015, 0.04))).astype(float), any_color(g, skin, hair), None)


def make_up(drawn: Drawn, vertices: np.ndarray, head: HeadModel, g: Generator) -> None:
    """Darken lids, lashes and sockets, and redden lips: what is dark around eyes is not always glasses."""
    size = len(drawn.cover)
    rows, columns = np.mgrid[:size, :size] + 0.5
    metre = drawn.camera.fx / float(np.linalg.norm(drawn.camera.position - vertices.mean(0)))  # pixels of a metre
    factor = np.ones((size, size, 3))
    tone, depth = np.exp(g.normal(0, 0.25, 3)), g.uniform(0.2, 0.85)
    wide, high = g.uniform(0.013, 0.019), g.uniform(0.005, 0.011)
    lift, power = g.uniform(-0.001, 0.004), g.uniform(1.0, 3.0)
    for name in ("left", "right"):
        eye = drawn.camera.project(vertices[head.regions[f"{name}_eyeball"]].mean(0)[None])[1][0]
        x, y = (columns - eye[0]) / (wide * metre), (rows - eye[1] + lift * metre) / (high * metre)
        factor *= 1 - (depth * np.exp(-((x * x + y * y) ** power)))[..., None] * np.clip(tone, 0.5, 1.0)
    if g.random() < 0.5:
        lips = drawn.labels == LABELS.index("lips")
        factor[lips] *= g.uniform(0.3, 1.0) * np.array([1.2, g.uniform(0.2, 0.9), g.uniform(0.2, 0.9)])
    drawn.color, drawn.lit = drawn.color * factor, drawn.lit * factor


def shade_throat(drawn: Drawn, g: Generator) -> None:
    """Darken what faces down, chin and throat, as hair, collar and lamps above do: such shade is no beard."""
    down = smooth(g.uniform(-0.3, 0.1), g.uniform(0.3, 0.8), -drawn.normals[..., 1])
    down = np.maximum(down, (drawn.labels == LABELS.index("neck")) * g.uniform(0.3, 1.0))
    factor = 1 - g.uniform(0.3, 0.9) * (down * drawn.bare)[..., None] * np.clip(np.exp(g.normal(0, 0.1, 3)), 0.7, 1.0)
    drawn.lit = drawn.lit * factor


def glasses(drawn: Drawn, head: HeadModel, vertices: np.ndarray, g: Generator) -> None:
    """Put glasses before the eyes: frames and dark lenses are labeled, clear lenses only reflect."""
    wide, high, power = g.uniform(0.021, 0.030), g.uniform(0.014, 0.025), g.uniform(1.0, 2.6)
    thick, forward = g.choice([g.uniform(0.0008, 0.002), g.uniform(0.002, 0.006)]), g.uniform(0.016, 0.024)
    angle = np.linspace(0, 2 * np.pi, 40, endpoint=False)
    across, up = (np.sign(wave(angle)) * np.abs(wave(angle)) ** (1 / power) for wave in (np.cos, np.sin))
    drop, middles, parts, lenses = g.uniform(-0.004, 0.006), [], [], []
    for side, name in ((-1, "right"), (1, "left")):
        eye = vertices[head.regions[f"{name}_eyeball"]].mean(0)
        middle = eye + np.array([side * 0.002, -drop, forward])
        middles.append(middle)
        bent = middle[2] - 3.0 * (wide * across) ** 2
        rings = [np.stack([middle[0] + (wide + t) * across, middle[1] + (high + t) * up, bent], -1) for t in (0.0, thick)]
        parts.append(tube(np.stack(rings)))
        lenses.append(np.stack([np.broadcast_to(middle, (40, 3)), rings[0], np.roll(rings[0], -1, 0)], 1))
        hinge = middle + np.array([side * (wide + thick), 0.3 * high, -0.002])
        parts.append(_bar(hinge, np.array([side * 0.078, eye[1] - 0.004, 0.0]), max(thick, 0.0015)))
    parts.append(_bar(middles[0] + np.array([wide, 0, 0]), middles[1] - np.array([wide, 0, 0]), max(thick, 0.001)))
    lens = Surface.of(np.concatenate(lenses), drawn.camera)
    behind = lens.seen & (lens.depth < drawn.depth + 0.006)
    if dark := g.random() < 0.22:
        drawn.lay(behind * g.uniform(0.75, 1.0), g.uniform(0.0, 0.06, 3), "glasses", lens.normals, lens.depth)
    size = len(behind)
    if g.random() < 0.5:  # a reflection
        gleam = smooth(0.5, 1.2, noise(g, size, 3, 4)) * g.uniform(0.1, 0.6)
        drawn.lay(behind * gleam, g.uniform(0.5, 1.2, 3), None)
    depth = triangle_depth(np.concatenate(parts), drawn.camera, samples=2).reshape(size, 2, size, 2)
    rim = ((depth < EMPTY) & (depth < drawn.depth[:, None, :, None] + 0.006)).mean((1, 3))
    color = any_color(g, np.array([0.25, 0.15, 0.06]), np.full(3, 0.02))
    if thick > 0.001 or dark or g.random() < 0.7:
        drawn.lay(rim, color * (1 + 0.3 * noise(g, size)[..., None]), "glasses", lens.normals)


def _bar(start: np.ndarray, end: np.ndarray, half: float) -> np.ndarray:
    """Triangles of an upright strip between two points, [2, 3, 3]."""
    up = np.array([0, half, 0])
    return np.stack([np.stack([start - up, start + up, end + up]), np.stack([start - up, end + up, end - up])])


def occluder(drawn: Drawn, g: Generator, skin: np.ndarray, hair: np.ndarray, face: np.ndarray) -> None:
    """Something before the person: fingers, a microphone, a cup, a board; `face` is the middle of the mouth in pixels [2]."""
    size = len(drawn.cover)
    rows, columns = np.mgrid[:size, :size] + 0.5
    unit = size / 128.0
    kind = g.choice(["hand", "microphone", "thing", "board"], p=[0.3, 0.3, 0.2, 0.2])
    at = face + g.normal(0, 16, 2) * unit
    cover = np.zeros((size, size))
    if kind == "hand":
        color = skin * g.uniform(0.8, 1.15)
        away = g.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(away), np.sin(away)])
        side = np.array([-direction[1], direction[0]])
        for finger in range(int(g.integers(2, 5))):
            start = at + side * finger * 5.6 * unit + direction * g.normal(0, 2)
            end = start + (direction + side * g.normal(0, 0.12)) * g.uniform(18, 50) * unit
            cover = np.maximum(cover, _capsule(columns, rows, start, end, g.uniform(2.3, 3.2) * unit))
        color = color * (1 - 0.35 * smooth(0.2, 1.0, 1 - cover))[..., None] * (1 + 0.1 * noise(g, size))[..., None]
        cover = smooth(0.0, 0.3, cover)
    elif kind == "microphone":
        at = face + np.array([g.normal(0, 10), g.uniform(6, 50)]) * unit
        foot = at + np.array([g.normal(0, 12), 60]) * unit
        ball = smooth(1.08, 0.95, np.hypot(columns - at[0], (rows - at[1]) / g.uniform(0.9, 1.4)) / (g.uniform(3, 10) * unit))
        cover = np.maximum(ball, smooth(0.0, 0.3, _capsule(columns, rows, at, foot, g.uniform(1.0, 3.5) * unit)))
        color = any_color(g, np.full(3, 0.02), np.full(3, 0.3)) * (1 + 0.4 * noise(g, size, 5, 8))[..., None]
    else:
        turn, wide, high, power = g.uniform(0, np.pi), g.uniform(5, 25) * unit, g.uniform(4, 16) * unit, g.uniform(2, 8)
        if kind == "board":  # before up to half of the face, from a side
            turn, wide, high, power = g.normal(0, 0.15), g.uniform(14, 34) * unit, g.uniform(14, 45) * unit, 12.0
            at = face + np.array([g.choice([-1, 1]) * (wide + g.uniform(-4, 14) * unit), g.normal(-8, 14) * unit])
        u = (columns - at[0]) * np.cos(turn) + (rows - at[1]) * np.sin(turn)
        v = (rows - at[1]) * np.cos(turn) - (columns - at[0]) * np.sin(turn)
        cover = smooth(1.15, 0.9, np.abs(u / wide) ** power + np.abs(v / high) ** power)
        color = pattern(g, np.stack([columns, rows, rows], -1) / (unit * 280), skin, hair)
    drawn.lay(
        cover,
        np.clip(color, 0, 1),
        "other",
        -drawn.camera.forward,
        np.where(cover > 0.5, drawn.depth.min() - 0.02, drawn.depth),
    )


def leaves(drawn: Drawn, g: Generator, skin: np.ndarray, hair: np.ndarray, face: np.ndarray) -> None:
    """Leaves, cloth or arms around the face and before what is beside it."""
    size = len(drawn.cover)
    rows, columns = np.mgrid[:size, :size] + 0.5
    color = any_color(g, skin, hair)
    for _ in range(int(g.integers(2, 7))):
        away, turn = g.uniform(0, 2 * np.pi), g.uniform(0, np.pi)
        at = face + np.array([np.cos(away), np.sin(away) - 0.4]) * g.uniform(0.22, 0.45) * size
        u = (columns - at[0]) * np.cos(turn) + (rows - at[1]) * np.sin(turn)
        v = (rows - at[1]) * np.cos(turn) - (columns - at[0]) * np.sin(turn)
        cover = smooth(1.1, 0.9, (u / (g.uniform(0.1, 0.3) * size)) ** 2 + np.abs(v / (g.uniform(0.04, 0.12) * size)) ** 1.5)
        tint = np.clip(color * np.exp(g.normal(0, 0.3)) * (1 + 0.25 * noise(g, size, 5, 6)[..., None]), 0.001, 1.0)
        drawn.lay(cover, tint, "other", -drawn.camera.forward, np.where(cover > 0.5, drawn.depth.min() - 0.02, drawn.depth))


def _capsule(columns: np.ndarray, rows: np.ndarray, start: np.ndarray, end: np.ndarray, radius: float) -> np.ndarray:
    """1 on the axis of a thick line, 0 at its edge, [S, S]."""
    along = end - start
    t = np.clip(((columns - start[0]) * along[0] + (rows - start[1]) * along[1]) / max(float(along @ along), 1e-6), 0, 1)
    return np.clip(1 - np.hypot(columns - start[0] - t * along[0], rows - start[1] - t * along[1]) / radius, 0, 1)
