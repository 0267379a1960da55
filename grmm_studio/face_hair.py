"""Brows, lashes, beard and scalp hair of one person as strand sets. Needs numpy and scipy."""

from __future__ import annotations

from collections import Counter

import numpy as np

from .fields import beard_density, scalp_density, smoothstep, wave_noise
from .grooms import growth_of, tail_points
from .hair import STEPS, Strands, bind, grow, scatter
from .mesh import Head, RenderMesh, region_vertices
from .subjects import Subject

SHORT_STEPS = 5
COUNT_SHARE, WIDENING = 0.75, 1.7  # fewer, wider strips: pictures of a few samples a pixel are not speckled
LASH_CARD_ROWS = 4  # quads across a lash card
BROW_X = (0.008, 0.014, 0.024, 0.035, 0.044, 0.053)
BROW_Y = (0.0530, 0.0550, 0.0580, 0.0600, 0.0580, 0.0515)
BROW_HALF = (0.0032, 0.0042, 0.0042, 0.0032, 0.0022, 0.0008)


def scalp_strands(head: Head, mesh: RenderMesh, neutral: np.ndarray, subject: Subject, share: float = 1.0) -> Strands | None:
    """Scalp hair on the neutral head [V, 3]; `share` of the style's strand count."""
    growth = growth_of(subject)
    if growth is None:
        return None
    g = np.random.default_rng([subject.seed, subject.index, 21])
    template = np.asarray(head.v_template, float)
    skin = mesh.coarse_faces[mesh.materials[::4] == 0]
    skin = skin[~np.isin(skin, region_vertices(head, "mouth_interior")).any(1)]
    corner = scalp_density(template, growth.receding, subject.hairline, subject.asymmetry)
    bound = corner[skin].max(1)
    triangles, weights, rest = scatter(
        neutral, skin, template, np.maximum(bound, 0.02) * (bound > 0), int(growth.style.count * share * 1.15 * COUNT_SHARE), g
    )
    keep = g.random(len(rest)) < scalp_density(rest, growth.receding, subject.hairline, subject.asymmetry) / np.maximum(
        bound_of(corner, triangles), 0.02
    )
    triangles, weights, rest = triangles[keep], weights[keep], rest[keep]
    normals = mesh.normals(neutral)
    roots = (neutral[triangles] * weights[..., None]).sum(1)
    root_normals = (normals[triangles] * weights[..., None]).sum(1)
    root_normals /= np.linalg.norm(root_normals, axis=1, keepdims=True)
    inner = np.concatenate(
        [
            region_vertices(head, n)
            for n in ("mouth_interior", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes")
        ]
    )
    outside = np.ones(len(neutral), bool)
    outside[inner] = False
    fine = mesh.refine(neutral)
    fine_normals = mesh.spread(normals)
    fine_outside = mesh.spread(outside.astype(float)) > 0.99
    points = grow(roots, root_normals, rest, growth, fine[fine_outside], fine_normals[fine_outside], g)
    # baby hair: shorter strands at the border
    border = scalp_density(rest, growth.receding, subject.hairline, subject.asymmetry)
    short = np.clip(0.35 + 0.65 * smoothstep(0.1, 0.9, border) + g.normal(0, 0.1, len(rest)), 0.2, 1.0)
    if growth.curl_radius < 0.003 and subject.hair_style not in ("ponytail", "bun"):
        points = _shorten(points, short)
    # nothing hangs in front of the throat or comes out of the chest
    stray = ((points[..., 2] > 0.025) & (points[..., 1] < -0.065) & (np.abs(points[..., 0]) < 0.055)).any(1)
    points, triangles, weights = points[~stray], triangles[~stray], weights[~stray]
    tail = tail_points(subject, g, STEPS)
    radius = np.full(len(points), growth.style.radius * WIDENING)
    if len(tail):
        moved = tail + _local_shift(neutral, template, tail[:, 0])[:, None]
        nearest = _nearest_face(skin, template, np.array([0.0, 0.09, -0.09]))
        faces = np.repeat(nearest[None], len(tail), 0)
        middle = np.full((len(tail), 3), 1 / 3)
        points = np.concatenate([points, moved])
        triangles, weights = np.concatenate([triangles, faces]), np.concatenate([weights, middle])
        radius = np.concatenate([radius, np.full(len(tail), growth.style.radius * WIDENING * 1.2)])
    return bind(neutral, triangles, weights, points, radius, g.normal(0, 1, len(points)))


def bound_of(corner: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Largest corner density of each triangle, [N]."""
    return corner[triangles].max(1)


def face_strands(head: Head, mesh: RenderMesh, neutral: np.ndarray, subject: Subject) -> Strands:
    """Brows, lashes and beard on the neutral head [V, 3]; tint >= 100 marks lashes."""
    g = np.random.default_rng([subject.seed, subject.index, 22])
    sets = [_brows(head, mesh, neutral, subject, g), _lashes(head, neutral, subject, g)]
    if subject.beard > 0:
        sets.append(_beard(head, mesh, neutral, subject, g))
    return Strands.join([s for s in sets if len(s.faces)])


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


def _brows(head: Head, mesh: RenderMesh, neutral: np.ndarray, s: Subject, g: np.random.Generator) -> Strands:
    template = np.asarray(head.v_template, float)
    skin = mesh.coarse_faces[mesh.materials[::4] == 0]
    p = template[skin].mean(1)
    near = skin[(np.abs(p[:, 1] - 0.0565) < 0.018) & (p[:, 2] > 0.05) & (np.abs(p[:, 0]) < 0.066)]
    triangles, weights, rest = scatter(neutral, near, template, np.ones(len(near)), 9000, g)
    keep = g.random(len(rest)) < brow_density(rest, s) * 0.65 * s.brow_density
    triangles, weights, rest = triangles[keep], weights[keep], rest[keep]
    roots, normal = _roots(mesh, neutral, triangles, weights)
    along = np.clip((np.abs(rest[:, 0]) - 0.009) / 0.043, 0, 1)
    off = (rest[:, 1] - np.interp(np.abs(rest[:, 0]), BROW_X, BROW_Y) - s.brow_height) / np.maximum(
        np.interp(np.abs(rest[:, 0]), BROW_X, BROW_HALF), 1e-4
    )
    rise = np.interp(along, (0, 0.15, 0.45, 0.7, 1.0), (1.9, 0.9, 0.28, -0.15, -0.5)) - 0.30 * off
    direction = np.stack(
        [np.sign(rest[:, 0]) * np.interp(along, (0, 0.2, 1), (0.45, 1, 1)), rise, -0.25 * along], 1
    ) + g.normal(0, 0.16, (len(rest), 3))
    direction = _tangent(direction, normal) + 0.22 * normal
    length = np.interp(along, (0, 0.3, 1), (0.0062, 0.0082, 0.0058)) * np.clip(g.normal(1, 0.18, len(rest)), 0.5, 1.4)
    points = _bent(roots, direction, normal, length, -0.16)
    return bind(neutral, triangles, weights, points, np.full(len(rest), 0.000085), g.normal(0, 1, len(rest)))


def _beard(head: Head, mesh: RenderMesh, neutral: np.ndarray, s: Subject, g: np.random.Generator) -> Strands:
    template = np.asarray(head.v_template, float)
    skin = mesh.coarse_faces[mesh.materials[::4] == 0]
    skin = skin[
        ~np.isin(skin, region_vertices(head, "mouth_interior")).any(1) & ~np.isin(skin, region_vertices(head, "lips")).any(1)
    ]
    density = beard_density(template, s.asymmetry)
    near = skin[density[skin].max(1) > 0.02]
    count = 12000 if s.beard < 0.006 else 9000
    triangles, weights, rest = scatter(neutral, near, template, np.ones(len(near)), count, g)
    keep = g.random(len(rest)) < beard_density(rest, s.asymmetry)
    triangles, weights, rest = triangles[keep], weights[keep], rest[keep]
    roots, normal = _roots(mesh, neutral, triangles, weights)
    direction = np.stack([0.25 * np.sign(rest[:, 0]), np.full(len(rest), -1.0), np.full(len(rest), 0.1)], 1) + g.normal(
        0, 0.35, (len(rest), 3)
    )
    direction = _tangent(direction, normal) + 0.55 * normal
    length = (
        s.beard
        * np.clip(g.normal(1, 0.25, len(rest)), 0.4, 1.5)
        * np.where(rest[:, 1] > -0.028, np.minimum(1.0, 0.006 / s.beard), 1.0)
    )
    points = _bent(roots, direction, normal, length, -0.12 if s.beard > 0.008 else 0.0)
    points[:, :, 0] += 0.0008 * (s.beard > 0.008) * np.sin(np.linspace(0, 7, SHORT_STEPS) + g.uniform(0, 6, (len(rest), 1)))
    return bind(neutral, triangles, weights, points, np.full(len(rest), 0.00009), g.normal(0, 1, len(rest)))


def _lashes(head: Head, neutral: np.ndarray, s: Subject, g: np.random.Generator) -> Strands:
    """Curved lashes from the root edge of each lash card to its outer edge."""
    cards = lash_edges(head)
    faces, weights, points = [], [], []
    for root, tip, side, upper in cards:
        count = int((95 if upper else 60) * s.lash_density)
        u = np.sort(g.random(count)) * (len(root) - 1)
        i = np.minimum(u.astype(int), len(root) - 2)
        f = (u - i)[:, None]
        a = neutral[root[i]] * (1 - f) + neutral[root[i + 1]] * f
        shift = g.normal(0, 0.22, (count, 1)) + 0.0
        j = np.clip(u + shift[:, 0], 0, len(tip) - 1.001)
        k = j.astype(int)
        h = (j - k)[:, None]
        b = neutral[tip[k]] * (1 - h) + neutral[tip[k + 1]] * h
        b = a + (b - a) * np.clip(g.normal(0.85 if upper else 0.62, 0.14, (count, 1)), 0.35, 1.1)
        t = np.linspace(0, 1, SHORT_STEPS)[None, :, None]
        lift = (1 if upper else -1) * 0.22 * np.linalg.norm(b - a, axis=1)[:, None, None] * np.array([0, 1.0, 0])
        points.append(a[:, None] * (1 - t) + b[:, None] * t + lift * (t**2 - t) * 1.0)
        triangle = np.stack([root[i], root[i + 1], side[i]], 1)
        faces.append(triangle)
        weights.append(np.concatenate([1 - f, f, np.zeros_like(f)], 1))
    if not faces:
        empty = np.zeros((0, 3))
        return Strands(empty.astype(int), empty, np.zeros((0, SHORT_STEPS, 3)), np.zeros(0), np.zeros(0))
    count = sum(len(f) for f in faces)
    return bind(
        neutral,
        np.concatenate(faces),
        np.concatenate(weights),
        np.concatenate(points),
        np.full(count, 0.00009),
        np.full(count, 100.0),
    )


def lash_edges(head: Head) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, bool]]:
    """Root edge, outer edge and the row beside the root of each lash card, as vertex indices, and whether it is an upper lid's.

    Cards are grids of `LASH_CARD_ROWS` quads across; the root edge is the long border that lies at the skin.
    """
    template = np.asarray(head.v_template, float)
    mask = np.zeros(len(template), bool)
    mask[region_vertices(head, "lashes")] = True
    triangles = np.asarray(head.faces)
    triangles = triangles[mask[triangles].all(1)]
    other = np.ones(len(template), bool)
    for name in ("lashes", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue"):
        other[region_vertices(head, name)] = False
    skin = template[other]
    parent = {int(v): int(v) for v in np.flatnonzero(mask)}

    def find(v: int) -> int:
        while parent[v] != v:
            parent[v] = parent[parent[v]]
            v = parent[v]
        return v

    for a, b, c in triangles.tolist():
        parent[find(a)] = find(b)
        parent[find(b)] = find(c)
    cards: dict[int, list[list[int]]] = {}
    for triangle in triangles.tolist():
        cards.setdefault(find(triangle[0]), []).append(triangle)
    result = []
    for faces in cards.values():
        uses = Counter(tuple(sorted((t[i], t[(i + 1) % 3]))) for t in faces for i in range(3))
        border = [edge for edge, count in uses.items() if count == 1]
        links: dict[int, list[int]] = {}
        for a, b in border:
            links.setdefault(a, []).append(b)
            links.setdefault(b, []).append(a)
        loop = [border[0][0]]
        previous = -1
        while True:
            following = [v for v in links[loop[-1]] if v != previous]
            previous = loop[-1]
            if following[0] == loop[0]:
                break
            loop.append(following[0])
        columns = (len(loop) - 2 * LASH_CARD_ROWS) // 2 + 1
        distance = np.array([np.linalg.norm(skin - template[v], axis=1).min() for v in loop])
        near = np.array(
            [
                np.roll(distance, -r)[:columns].sum()
                - np.roll(distance, -r)[columns + LASH_CARD_ROWS - 1 : 2 * columns + LASH_CARD_ROWS - 1].sum()
                for r in range(len(loop))
            ]
        )
        turned = np.roll(loop, -int(near.argmin()))
        root = turned[:columns]
        tip = turned[columns + LASH_CARD_ROWS - 1 : 2 * columns + LASH_CARD_ROWS - 1][::-1]
        upper = template[tip, 1].mean() > template[root, 1].mean()
        neighbour = np.array([_third(faces, root[i], root[i + 1]) for i in range(columns - 1)])
        result.append((root, tip, neighbour, bool(upper)))
    return result


def _third(faces: list[list[int]], a: int, b: int) -> int:
    for face in faces:
        if a in face and b in face:
            return next(v for v in face if v not in (a, b))
    return int(a)


def _roots(mesh: RenderMesh, neutral: np.ndarray, triangles: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    normals = mesh.normals(neutral)
    normal = (normals[triangles] * weights[..., None]).sum(1)
    return (neutral[triangles] * weights[..., None]).sum(1), normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _tangent(direction: np.ndarray, normal: np.ndarray) -> np.ndarray:
    flat = direction - (direction * normal).sum(1, keepdims=True) * normal
    return flat / np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)


def _bent(roots: np.ndarray, direction: np.ndarray, normal: np.ndarray, length: np.ndarray, bend: float) -> np.ndarray:
    t = np.linspace(0, 1, SHORT_STEPS)[None, :, None]
    lifted = roots + 0.0004 * normal
    return lifted[:, None] + length[:, None, None] * (t * direction[:, None] + bend * t**2 * normal[:, None])


def _shorten(points: np.ndarray, share: np.ndarray) -> np.ndarray:
    steps = points.shape[1]
    where = np.linspace(0, 1, steps)[None] * share[:, None] * (steps - 1)
    low = np.minimum(where.astype(int), steps - 2)
    f = (where - low)[..., None]
    rows = np.arange(len(points))[:, None]
    return points[rows, low] * (1 - f) + points[rows, low + 1] * f


def _local_shift(neutral: np.ndarray, template: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How the person's skin near template points differs from the template, [N, 3]."""
    distance = np.linalg.norm(template - points.mean(0), axis=1)
    near = np.argsort(distance)[:12]
    return np.repeat((neutral[near] - template[near]).mean(0)[None], len(points), 0)


def _nearest_face(faces: np.ndarray, template: np.ndarray, point: np.ndarray) -> np.ndarray:
    return faces[int(np.argmin(np.linalg.norm(template[faces].mean(1) - point, axis=1)))]
