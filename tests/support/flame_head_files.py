"""A stand-in for a FLAME file whose mesh is a head: FLAME's counts and structure, the open head's shape.

5023 vertices (3931 of skin, open at the neck and the mouth, and two closed eyeballs of 546) and 9976 triangles. The surface,
its directions and its weights are taken from the open head in FLAME-like coordinates of their own, the expression space is
mixed by a random rotation as FLAME's is without names. Vertex numbers have nothing to do with the real model's.
"""

from __future__ import annotations

import functools

import numpy as np
from scipy.spatial import ConvexHull, cKDTree

from grmm_core.head import load_open_head

SKIN, EYE = 3931, 546
RIM, NECK = 30, 32
INNER = 2 * RIM  # the lips' inner side: two more rows behind the rim of the slit
SHIFT = np.array([0.002, -0.031, -0.042])  # FLAME's origin is another one than the open head's
SCALE = 1.05
_CENTRE = np.array([0.0, 0.025, 0.005])
_MOUTH = np.array([0.0, -0.033, 0.1])


@functools.lru_cache(maxsize=1)
def flame_head_fields() -> dict[str, np.ndarray]:
    """Arrays with FLAME's names; do not change them in place."""
    rng = np.random.default_rng(7)
    head = load_open_head()
    sphere, skin_faces = _skin_sphere()
    outer = np.unique(np.concatenate([head.regions[name] for name in ("face", "scalp", "neck", "ears")]))
    source = head.v_template[outer].astype(float)
    skin, mix = _drape(sphere, source)
    skin, mix, skin_faces = _inner_lips(skin, mix, skin_faces)
    eye, eye_faces = _ball(EYE)
    parts, faces = [skin], [skin_faces]
    for side in ("left", "right"):
        ball = head.v_template[head.regions[f"{side}_eyeball"]].astype(float)
        centre = ball.mean(0)
        radius = np.linalg.norm(ball - centre, axis=1).mean()
        faces.append(eye_faces + sum(map(len, parts)))
        parts.append(centre + 0.97 * radius * eye)
    vertices = np.concatenate(parts)

    def carried(directions: np.ndarray) -> np.ndarray:
        result = [np.einsum("nk,nkxc->nxc", mix[1], directions[outer][mix[0]])]
        for side in ("left", "right"):
            result.append(np.broadcast_to(directions[head.regions[f"{side}_eyeball"]].mean(0), (EYE, 3, directions.shape[2])))
        return np.concatenate(result) * SCALE

    rotation = np.linalg.qr(rng.normal(size=(100, 100)))[0]
    expressions = carried(head.expression_dirs.astype(float)) @ rotation
    directions = np.concatenate([carried(head.shape_dirs.astype(float)), expressions], 2)
    weights = np.zeros((5023, 5))
    weights[:SKIN] = np.einsum("nk,nkj->nj", mix[1], head.weights[outer][mix[0]])
    weights[SKIN : SKIN + EYE, 3] = weights[SKIN + EYE :, 4] = 1.0
    vertices = vertices * SCALE + SHIFT
    waves = np.sin(vertices @ rng.normal(0.0, 20.0, (3, 36)) + rng.uniform(0, 6, 36))  # [V, 36], smooth
    return {
        "v_template": vertices,
        "f": np.concatenate(faces).astype(np.uint32),
        "shapedirs": directions,
        "posedirs": 5e-4 * waves[:, None, :] * rng.normal(size=(1, 3, 36)),
        "J_regressor": _regressor(vertices, head.joint_template * SCALE + SHIFT, rng),
        "kintree_table": np.array([[4294967295, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.int64),
        "weights": weights / weights.sum(1, keepdims=True),
    }


def _ball(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a unit sphere and its 2 count - 4 triangles."""
    points = _spread(count)
    return points, _hull(points)


def _hull(points: np.ndarray) -> np.ndarray:
    faces = ConvexHull(points).simplices.astype(int)
    a, b, c = (points[faces[:, k]] for k in range(3))
    inward = (np.cross(b - a, c - a) * (a + b + c)).sum(1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return faces


def _skin_sphere() -> tuple[np.ndarray, np.ndarray]:
    """A sphere of `SKIN` points, open at two circles: the mouth, and the neck below."""
    mouth = (_MOUTH - _CENTRE) / np.linalg.norm(_MOUTH - _CENTRE)
    neck = np.array([0.0, -0.94, -0.34]) / np.hypot(0.94, 0.34)
    rims, holes = [], []
    for axis, half, count in ((mouth, 0.19, RIM), (neck, 0.5, NECK)):
        side = np.cross([1.0, 0.0, 0.0], axis)
        side /= np.linalg.norm(side)
        angle = 2 * np.pi * np.arange(count) / count
        ring = np.cos(angle)[:, None] * [1.0, 0.0, 0.0] + np.sin(angle)[:, None] * side
        rims.append(np.cos(half) * axis + np.sin(half) * ring)
        holes.append((axis, half * 1.06))
    fill = SKIN - INNER - RIM - NECK
    points = _spread(int(fill * 1.09))
    for axis, half in holes:
        points = points[np.arccos(np.clip(points @ axis, -1, 1)) > half]
    kept = points[np.sort(np.random.default_rng(1).permutation(len(points))[:fill])]
    points = np.concatenate([*rims, kept])
    faces = _hull(points)
    closed = (faces < RIM).all(1) | ((faces >= RIM) & (faces < RIM + NECK)).all(1)
    return points, faces[~closed]


def _spread(count: int) -> np.ndarray:
    """Evenly spread points of the unit sphere, [count, 3]."""
    index = np.arange(count) + 0.5
    height, angle = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    radius = np.sqrt(1 - height**2)
    return np.stack([radius * np.cos(angle), height, radius * np.sin(angle)], 1)


def _drape(sphere: np.ndarray, source: np.ndarray) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Pull the sphere over the head; the mouth's circle becomes a slit between the lips."""
    axis = (_MOUTH - _CENTRE) / np.linalg.norm(_MOUTH - _CENTRE)
    side = np.cross([1.0, 0.0, 0.0], axis)
    side /= np.linalg.norm(side)
    angle = np.arccos(np.clip(sphere @ axis, -1, 1))
    plane = np.stack([sphere[:, 0], sphere @ -side], 1)
    plane *= (angle / np.maximum(np.linalg.norm(plane, axis=1), 1e-12))[:, None]
    z = plane[:, 0] + 1j * plane[:, 1]
    # Joukowsky's map takes the circle of 0.19 to a flat ellipse and leaves what is far away in its place
    rim = 0.19
    fade = np.exp(-((angle / 0.8) ** 2))
    warped = z + fade * 0.96 * rim**2 / np.where(np.abs(z) < 1e-9, 1e-9, z)
    warped = np.where(angle < 2.5, 0.62 * fade * warped + (1 - fade) * warped, z)
    length = np.abs(warped)
    tangent = (warped.real[:, None] * [1.0, 0.0, 0.0] - warped.imag[:, None] * side) / np.maximum(length, 1e-12)[:, None]
    directions = np.cos(length)[:, None] * axis + np.sin(length)[:, None] * tangent
    arms = source - _CENTRE
    radii = np.linalg.norm(arms, axis=1)
    near, index = cKDTree(arms / radii[:, None]).query(directions, k=6)
    weight = 1.0 / (near + 0.004) ** 2
    weight /= weight.sum(1, keepdims=True)
    radius = (weight * radii[index]).sum(1)
    return _CENTRE + radius[:, None] * directions, (index, weight)


def _inner_lips(
    skin: np.ndarray, mix: tuple[np.ndarray, np.ndarray], faces: np.ndarray
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Two rows behind the mouth's rim, moving with it."""
    row = np.arange(RIM)
    ahead = (row + 1) % RIM
    edges = {(int(a), int(b)) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    first, second = (row, ahead) if (0, 1) in edges else (ahead, row)  # the direction of the triangles outside
    for depth in (0.004, 0.008):
        start = len(skin)
        last = 0 if depth == 0.004 else start - RIM
        skin = np.concatenate([skin, skin[:RIM] - (0.0, 0.0, depth)])
        mix = (np.concatenate([mix[0], mix[0][:RIM]]), np.concatenate([mix[1], mix[1][:RIM]]))
        faces = np.concatenate([
            faces,
            np.stack([last + second, last + first, start + first], 1),
            np.stack([last + second, start + first, start + second], 1),
        ])  # fmt: skip
    return skin, mix, faces


def _regressor(vertices: np.ndarray, joints: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Affine mixtures of eighty vertices that give each joint."""
    regressor = np.zeros((5, len(vertices)))
    for joint, position in enumerate(joints):
        chosen = rng.choice(len(vertices), 80, replace=False)
        system = np.concatenate([vertices[chosen].T, np.ones((1, 80))])
        regressor[joint, chosen] = np.linalg.lstsq(system, np.r_[position, 1.0], rcond=None)[0]
    return regressor
