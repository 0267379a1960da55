"""MediaPipe's 478 landmarks on the open head, found by its own network in painted pictures of random people.

Every picture votes: a landmark's pixel names a triangle and a place in it, which is the same place on the mean person. Votes
are weighted by how squarely the surface faces the camera, outliers dropped, and the mean snapped to the skin. Inner lips vote
only with the mouth open. Irises are placed on the eyeballs by geometry; the network only tells their order.
"""

from __future__ import annotations

import numpy as np
import trimesh

from grmm_core.errors import NoFaceError
from grmm_core.head import HeadModel
from grmm_core.photo.faces import find_faces

from .landmarks import FrontView, brow_height

PIXEL = 0.0006  # metres
WINDOW = (-0.16, 0.16, -0.17, 0.17)
PEOPLE = 6
VARIETY = 0.7  # of the random people's coefficients
ANGLES = ((0, 0), (22, 0), (-22, 0), (10, 12), (-10, -10))  # degrees: yaw, pitch
OPENINGS = (0.0, 0.35)  # of jawOpen
SEED = 478
IRIS_RADIUS = 0.0059  # metres
PUPIL_RADIUS = 0.0022
IRIS_COUNT = 10
INNER_LIPS = (78, 191, 80, 81, 82, 13, 312, 311, 310, 415, 308, 324, 318, 402, 317, 14, 87, 178, 88, 95)
# The face's outline in MediaPipe's numbers, from the forehead's middle around: entries k and -k are mirror images.
OUTLINE = (
    10, 338, 297, 332, 284, 251, 389, 356, 454, 323, 361, 288, 397, 365, 379, 378, 400, 377, 152, 148, 176, 149, 150, 136, 172,
    58, 132, 93, 234, 127, 162, 21, 54, 103, 67, 109,
)  # fmt: skip
OUTLINE_STRAY = 0.025  # metres
SKIN, LIP, BROW, HAIR = (0.80, 0.60, 0.50), (0.68, 0.34, 0.34), (0.22, 0.15, 0.12), (0.16, 0.11, 0.09)
WHITE, IRIS, PUPIL, MOUTH, TEETH = (0.9, 0.89, 0.87), (0.3, 0.2, 0.13), (0.03, 0.03, 0.03), (0.3, 0.1, 0.1), (0.9, 0.88, 0.8)


def place_landmarks478(head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles [478] and barycentric coordinates [478, 3]. Raises `RuntimeError` where too few pictures had a face."""
    generator = np.random.default_rng(SEED)
    triangles = np.flatnonzero(~np.isin(head.faces, head.regions["lashes"]).any(1))
    points: list[np.ndarray] = []
    weights: list[np.ndarray] = []
    jaws: list[np.ndarray] = []
    iris_offsets = np.zeros((IRIS_COUNT, 2))
    for person in range(PEOPLE):
        shape = VARIETY * generator.standard_normal(head.shape_count) * (person > 0)
        for opening in OPENINGS:
            expression = np.zeros(head.expression_count, np.float32)
            expression[head.expression_index("jawOpen")] = opening
            vertices = head.vertices(shape, expression, head.pose_of(expression)).astype(np.float64)
            for yaw, pitch in ANGLES:
                vote = _vote(head, vertices, triangles, yaw, pitch)
                if vote is None:
                    continue
                point, weight, jaw, irises = vote
                if opening == 0.0:
                    weight[list(INNER_LIPS)] = 0.0
                points.append(point)
                weights.append(weight)
                jaws.append(jaw)
                if yaw == pitch == 0:
                    iris_offsets += irises
    if len(points) < 20:
        raise RuntimeError(f"A face was found in only {len(points)} pictures.")
    mean, jaw = _robust_mean(np.array(points), np.array(weights), np.array(jaws))
    found, barycentric = _snap(head, balance_outline(mean), jaw)
    for index, position in enumerate(_irises(head, iris_offsets), start=478 - IRIS_COUNT):
        found[index], barycentric[index] = _nearest(head, position, _whole(head, ("left_eyeball", "right_eyeball")))
    return found.astype(np.int32), barycentric.astype(np.float32)


def _vote(
    head: HeadModel, vertices: np.ndarray, triangles: np.ndarray, yaw: float, pitch: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray] | None:
    """One picture: template positions [478, 3], weights and jaw weights [478], iris ring directions [10, 2]."""
    a, b = np.radians((yaw, pitch))
    turn_y = np.array([[np.cos(a), 0, np.sin(a)], [0, 1, 0], [-np.sin(a), 0, np.cos(a)]])
    turn_x = np.array([[1, 0, 0], [0, np.cos(b), -np.sin(b)], [0, np.sin(b), np.cos(b)]])
    turned = vertices @ (turn_x @ turn_y).T
    view = FrontView(turned, head.faces[triangles], PIXEL, WINDOW)
    seen = view.triangle >= 0
    owner = np.where(seen, triangles[view.triangle], -1)
    corners = head.faces[owner]
    place = np.einsum("hwk,hwkx->hwx", view.barycentric, head.v_template[corners].astype(np.float64))
    edges = turned[head.faces]
    normal = np.cross(edges[:, 1] - edges[:, 0], edges[:, 2] - edges[:, 0])
    facing = np.clip(normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-15), 0, 1)
    picture = _paint(head, seen, owner, place, facing)
    try:
        face = find_faces(picture[::-1].copy())[0]
    except NoFaceError:
        return None
    column = np.clip(face.landmarks[:, 0].astype(int), 0, view.width - 1)
    row = np.clip((view.height - face.landmarks[:, 1]).astype(int), 0, view.height - 1)
    skin = _whole(head, ("face", "neck", "scalp", "ears", "lips"))
    usable = seen & skin[owner]
    rows, columns = np.nonzero(usable)
    distance = (rows[None] - row[:, None]) ** 2 + (columns[None] - column[:, None]) ** 2
    nearest = distance.argmin(1)
    near = distance[np.arange(478), nearest]
    row, column = rows[nearest], columns[nearest]
    jaw = (head.weights[corners[row, column], 2] * view.barycentric[row, column]).sum(1)
    weight = facing[owner[row, column]] ** 2 / (1 + near / 9.0)
    # ring directions: the picture's rows run down in the landmarks
    irises = face.landmarks[478 - IRIS_COUNT :, :2].reshape(2, 5, 2)
    offsets = (irises - irises[:, :1]) * (1, -1)
    return place[row, column], weight, jaw, offsets.reshape(IRIS_COUNT, 2)


def _whole(head: HeadModel, regions: tuple[str, ...]) -> np.ndarray:
    """Triangles all of whose corners are in one of the regions, [F] bool."""
    return np.isin(head.faces, np.concatenate([head.regions[name] for name in regions])).all(1)


def _paint(head: HeadModel, seen: np.ndarray, owner: np.ndarray, place: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """A plausible face for the network: flat colors by place on the mean person, shaded by the angle. [H, W, 3] 0..1."""
    color = np.full((*seen.shape, 3), SKIN)
    for regions, value in (
        (("lips",), LIP), (("scalp",), HAIR), (("mouth_interior",), MOUTH), (("tongue",), LIP),
        (("upper_teeth", "lower_teeth"), TEETH), (("left_eyeball", "right_eyeball"), WHITE),
    ):  # fmt: skip
        color[_whole(head, regions)[owner]] = value
    x, y, z = np.moveaxis(place, -1, 0)
    brow = (np.abs(y - brow_height(x)) < 0.0035) & (np.abs(x) > 0.009) & (np.abs(x) < 0.051) & (z > 0.04)
    color[brow & _whole(head, ("face",))[owner]] = BROW
    eyes = _whole(head, ("left_eyeball", "right_eyeball"))[owner]
    for joint in (3, 4):
        centre = head.joints(np.zeros(0))[joint]
        radial = np.hypot(x - centre[0], y - centre[1])
        front = eyes & (z > centre[2]) & (np.abs(x - centre[0]) < 0.02)
        color[front & (radial < IRIS_RADIUS)] = IRIS
        color[front & (radial < PUPIL_RADIUS)] = PUPIL
    shaded = color * (0.35 + 0.65 * facing[owner])[..., None]
    return np.where(seen[..., None], shaded, 0.55).astype(np.float32)


def _robust_mean(points: np.ndarray, weights: np.ndarray, jaws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean of the votes nearest to their median, and their mean jaw weight. [n, 478, 3] to [478, 3], [478]."""
    strong = np.where(weights > 0.15, weights, 0.0)
    strong = np.where(strong.sum(0) > 0, strong, weights + 1e-9)
    median = np.stack([
        np.median(points[strong[:, i] > 0, i], axis=0) for i in range(points.shape[1])
    ])  # fmt: skip
    distance = np.linalg.norm(points - median, axis=2)
    limit = 1.5 * np.stack([np.median(distance[strong[:, i] > 0, i]) for i in range(points.shape[1])]) + 5e-4
    kept = np.where(distance <= limit, strong, 0.0)
    total = kept.sum(0)
    return (kept[..., None] * points).sum(0) / total[:, None], (kept * jaws).sum(0) / total


def balance_outline(points: np.ndarray) -> np.ndarray:
    """Average outline points [478, 3] with their mirror images: seen at a grazing angle, they are the least certain.

    A point that strays far from between its neighbours on the outline is put between them.
    """
    outline = np.array(OUTLINE)
    partner = np.roll(outline[::-1], 1)
    result = points.copy()
    result[outline] = 0.5 * (points[outline] + points[partner] * (-1, 1, 1))
    between = 0.5 * (result[np.roll(outline, 1)] + result[np.roll(outline, -1)])
    distance = np.linalg.norm(result[outline] - between, axis=1)
    # a stray point drags its neighbours' middle along: only the worst of three is moved
    astray = (distance > OUTLINE_STRAY) & (distance >= np.maximum(np.roll(distance, 1), np.roll(distance, -1)))
    result[outline[astray]] = between[astray]
    return result


def _snap(head: HeadModel, points: np.ndarray, jaws: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest places on outer skin that follows the jaw as the votes did (so that upper lips stay upper lips)."""
    skin = _whole(head, ("face", "neck", "scalp", "ears", "lips"))
    jaw_of = head.weights[head.faces, 2].mean(1)
    found, barycentric = np.zeros(478, int), np.zeros((478, 3))
    for i, point in enumerate(points):
        found[i], barycentric[i] = _nearest(head, point, skin & (np.abs(jaw_of - jaws[i]) < 0.3))
    return found, barycentric


def _nearest(head: HeadModel, point: np.ndarray, allowed: np.ndarray) -> tuple[int, np.ndarray]:
    candidates = np.flatnonzero(allowed)
    corners = head.v_template[head.faces[candidates]].astype(np.float64)
    order = np.argsort(((corners.mean(1) - point) ** 2).sum(1))[:80]
    closest = trimesh.triangles.closest_point(corners[order], np.tile(point, (len(order), 1)))
    best = int(((closest - point) ** 2).sum(1).argmin())
    weights = trimesh.triangles.points_to_barycentric(corners[order[best]][None], closest[best][None])[0]
    weights = np.clip(weights, 0, 1)
    return int(candidates[order[best]]), weights / weights.sum()


def _irises(head: HeadModel, directions: np.ndarray) -> list[np.ndarray]:
    """Positions of the ten iris landmarks: the subject's right eye first, centre and four ring points each."""
    result = []
    for eye, joint in enumerate((4, 3)):
        centre = head.joints(np.zeros(0))[joint].astype(np.float64)
        part = head.v_template[head.regions["right_eyeball" if joint == 4 else "left_eyeball"]]
        radius = float(np.linalg.norm(part - centre, axis=1).mean())
        for k in range(5):
            offset = np.zeros(2)
            if k:
                direction = directions[5 * eye + k]
                axis = int(np.abs(direction).argmax())
                offset[axis] = np.sign(direction[axis]) * IRIS_RADIUS
            result.append(centre + np.array([*offset, np.sqrt(radius**2 - offset @ offset)]))
    return result
