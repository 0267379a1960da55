"""The texture layout: islands, their densities, packing, checks.

The head's skin is one island, cut along the back's midline up to the hairline and flattened into a box with the face in the
middle, at a higher density than the back of the head. Eyeballs are mapped around their pupils; teeth, tongue, mouth lining and
lashes are charted by xatlas. The small islands are packed below the head, on a raster, with a gutter.
"""

from __future__ import annotations

import numpy as np
import xatlas
from scipy.ndimage import distance_transform_edt

from grmm_core.head.uv_density import face_density, smoothstep
from grmm_core.head.uv_islands import Island, UVLayout, counter_clockwise, join_islands

from .flatten import boundary_loops, distortion, flatten
from .topology import Topology

FACE_STIFFNESS = 5.0  # how much more the face resists distortion
ASPECT = 0.69  # height of the head's box over its width
SEAM_TOP = 0.057  # metres: the seam runs from the back over the crown to this z (the hairline)
CORNER = 0.175  # metres along the seam from below: where the box's side ends and its top begins
STEPS = 220
PULL = 20.0
RASTER = 1024  # packing raster
GUTTER = 10  # raster pixels between islands: 2.5 texels at 256
PART_DENSITY = {"upper_teeth": 0.9, "lower_teeth": 0.8, "tongue": 0.5, "mouth": 0.4, "lashes": 0.9}
EYE_DENSITY = 1.75  # sets the size of the eyes' islands
EYE_FOCUS = 1.9  # how much the island's middle, the iris, gains over its rim
EYE_FRONT = np.radians(100.0)  # the front island reaches this far from the pupil


def build_uv(topology: Topology, template: np.ndarray, mouth: np.ndarray) -> UVLayout:
    """Lay out all triangles.

    Args:
        topology: The mesh.
        template: Mean person in metres, origin between the ears, [V, 3].
        mouth: Marks the vertices of the mouth's lining, [V] bool.
    """
    faces = topology.faces
    part_of = np.full(len(template), "skin", dtype=object)
    for part, indices in topology.parts.items():
        part_of[indices] = part
    face_part = part_of[faces[:, 0]]
    lining = (face_part == "skin") & mouth[faces].all(1)
    islands = [_head_island(template, faces, np.flatnonzero((face_part == "skin") & ~lining))]
    for side in ("left", "right"):
        islands += _eye_islands(template, faces, np.flatnonzero(face_part == f"{side}_eyeball"), f"{side}_eyeball")
    for part, density in PART_DENSITY.items():
        which = np.flatnonzero(lining if part == "mouth" else face_part == part)
        islands += _charts(template, faces, which, part, density)
    return _assemble(islands, len(faces))


def _head_island(template: np.ndarray, faces: np.ndarray, which: np.ndarray) -> Island:
    skin = faces[which]
    seam = _seam(template, skin)
    copies = {vertex: len(template) + i for i, vertex in enumerate(seam[:-1])}
    cut = skin.copy()
    right = template[skin].mean(1)[:, 0] < 0
    for old, new in copies.items():
        cut[right] = np.where(cut[right] == old, new, cut[right])
    positions = np.concatenate([template, template[seam[:-1]]])
    used, local = np.unique(cut, return_inverse=True)
    local = local.reshape(cut.shape)
    points = positions[used]
    row = {vertex: i for i, vertex in enumerate(used)}
    left_side = np.array([row[vertex] for vertex in seam])
    right_side = np.array([row[copies.get(vertex, vertex)] for vertex in seam])
    loop = boundary_loops(local)[0]
    bust = np.setdiff1d(loop, np.r_[left_side, right_side])
    front = bust[np.argmax(points[bust, 2])]
    loop = np.roll(loop, -int(np.flatnonzero(loop == front)[0]))
    length = np.r_[0, np.cumsum(np.linalg.norm(np.diff(points[left_side], axis=0), axis=1))]
    corner = int(np.argmin(np.abs(length - CORNER)))
    midline = np.flatnonzero((np.abs(points[:, 0]) < 3e-4) & (points[:, 2] > 0))
    midline = np.setdiff1d(midline, np.r_[left_side, right_side])

    density = face_density(points[local].mean(1))
    first, second = points[local[:, 1]] - points[local[:, 0]], points[local[:, 2]] - points[local[:, 0]]
    area = 0.5 * np.linalg.norm(np.cross(first, second), axis=1)
    width = np.sqrt((area * density**2).sum() * 1.04 / ASPECT)
    height = width * ASPECT
    sides = [
        (np.r_[bust, left_side[0], right_side[0]], 1, -height / 2),
        (left_side[: corner + 1], 0, width / 2),
        (right_side[: corner + 1], 0, -width / 2),
        (np.r_[left_side[corner:], right_side[corner:]], 1, height / 2),
        (midline, 0, 0.0),
    ]
    stiffness = 1 + (FACE_STIFFNESS - 1) * smoothstep(density, 0.5, 0.95)
    plane = flatten(points, local, density, outer=loop, sides=sides, pull=PULL, steps=STEPS, stiffness=stiffness)
    return Island("head", which, plane, local)


def _seam(template: np.ndarray, skin: np.ndarray) -> list[int]:
    """Vertices of the midline from the bust's back edge over the crown to the hairline."""
    used = np.unique(skin)
    midline = used[np.abs(template[used, 0]) < 3e-4]
    y, z = template[midline, 1], template[midline, 2]
    rest = {int(v) for v in midline[(z < SEAM_TOP) & ((y > 0.12) | (z < -0.04))]}
    edges = np.concatenate([skin[:, [0, 1]], skin[:, [1, 2]], skin[:, [2, 0]]])
    known = {(int(a), int(b)) for a, b in edges} | {(int(b), int(a)) for a, b in edges}
    seam = [min(rest, key=lambda v: template[v, 1])]
    rest.discard(seam[0])
    while rest:
        following = [v for v in rest if (seam[-1], v) in known]
        if not following:
            raise RuntimeError("The midline of the base mesh is not one path of edges.")
        seam.append(following[0])
        rest.discard(following[0])
    return seam


def _eye_islands(template: np.ndarray, faces: np.ndarray, which: np.ndarray, name: str) -> list[Island]:
    """Front: radius from the pupil grows with the angle, ever slower. Back: a small disk."""
    centre = template[np.unique(faces[which])].mean(0)
    result = []
    corners = template[faces[which]] - centre
    angle = np.arccos(np.clip(corners[..., 2] / np.linalg.norm(corners, axis=-1), -1, 1))
    front = angle.max(1) < EYE_FRONT
    radius = float(np.linalg.norm(corners, axis=-1).mean())
    for label, chosen, sign in ((name, front, 1), (f"{name}_back", ~front, -1)):
        used, local = np.unique(faces[which[chosen]], return_inverse=True)
        arms = template[used] - centre
        theta = np.arccos(np.clip(sign * arms[:, 2] / np.linalg.norm(arms, axis=1), -1, 1))
        # the iris takes half of the front's radius
        rim = EYE_DENSITY * np.arctan(theta.max()) / np.arctan(EYE_FOCUS * theta.max())
        distance = rim * np.arctan(EYE_FOCUS * theta) if sign > 0 else 0.35 * theta
        direction = arms[:, :2] * (sign, 1)
        direction = direction / np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-12)
        result.append(Island(label, which[chosen], radius * distance[:, None] * direction, local.reshape(-1, 3)))
    return result


def _charts(template: np.ndarray, faces: np.ndarray, which: np.ndarray, name: str, density: float) -> list[Island]:
    used, local = np.unique(faces[which], return_inverse=True)
    local = local.reshape(-1, 3)
    points = (template[used] * 100).astype(np.float32)  # centimetres: xatlas drops charts of tiny area
    atlas = xatlas.Atlas()
    atlas.add_mesh(points, local.astype(np.uint32))
    options = xatlas.ChartOptions()
    options.max_cost = 6.0
    options.normal_seam_weight = 1.0
    options.max_iterations = 4
    atlas.generate(chart_options=options, pack_options=xatlas.PackOptions())
    mapping, corners, plane = atlas[0]
    corners = corners.astype(int)
    scale = _mean_scale(points[mapping], corners, plane)
    plane = plane * (density * 0.01 / scale)
    result = []
    for chosen in _connected(corners):
        rows, renumbered = np.unique(corners[chosen], return_inverse=True)
        result.append(Island(name, which[chosen], plane[rows].astype(float), renumbered.reshape(-1, 3)))
    return result


def _mean_scale(points: np.ndarray, corners: np.ndarray, plane: np.ndarray) -> float:
    large, small = distortion(points.astype(float), corners, plane.astype(float))
    return float(np.sqrt(np.median(np.abs(large * small))))


def _connected(corners: np.ndarray) -> list[np.ndarray]:
    label = np.arange(corners.max() + 1)
    while True:
        low = label[corners].min(1)
        fresh = label.copy()
        np.minimum.at(fresh, corners, low[:, None])
        if (fresh == label).all():
            break
        label = fresh
    of_face = label[corners[:, 0]]
    return [np.flatnonzero(of_face == value) for value in np.unique(of_face)]


def _assemble(islands: list[Island], count: int) -> UVLayout:
    for island in islands:
        island.plane = counter_clockwise(island.plane, island.corners)
    low = float(np.ptp(islands[0].plane[:, 0])) / (1 - 4 * GUTTER / RASTER / 2)
    high = 1.6 * low
    best = _place(islands, high)
    if best is None:
        raise RuntimeError("The islands do not fit; lower the densities.")
    for _ in range(7):
        middle = 0.5 * (low + high)
        placed = _place(islands, middle)
        if placed is None:
            low = middle
        else:
            best, high = placed, middle
    return join_islands(islands, best, count)


def _place(islands: list[Island], side: float) -> list[np.ndarray] | None:
    """Place all islands in a square of the given side (density metres); None where they do not fit."""
    free = np.ones((RASTER, RASTER), bool)
    edge = GUTTER // 2
    free[:edge], free[-edge:], free[:, :edge], free[:, -edge:] = False, False, False, False
    placed: list[np.ndarray | None] = [None] * len(islands)
    head = islands[0].plane / side
    head = head + (0.5 - 0.5 * (head.min(0) + head.max(0))) * (1, 0) + (0, 1 - (edge + 1) / RASTER - head[:, 1].max())
    if head.min() < 0:
        return None
    placed[0] = head
    free &= ~_dilate(coverage(head, islands[0].corners, RASTER) > 0, GUTTER)
    order = sorted(range(1, len(islands)), key=lambda i: -float(np.ptp(islands[i].plane, axis=0).max()))
    for index in order:
        best: tuple[int, int, np.ndarray, np.ndarray] | None = None
        for turn in (np.eye(2), np.array([[0.0, -1.0], [1.0, 0.0]])):
            if best is not None and not islands[index].name.startswith(("upper", "lower", "tongue", "mouth", "lashes")):
                break  # eyes stay upright
            plane = islands[index].plane @ turn.T / side
            plane = plane - plane.min(0)
            size = np.ceil(plane.max(0) * RASTER).astype(int) + 2
            if (size >= RASTER).any():
                continue
            mask = coverage(plane + 1 / RASTER, islands[index].corners, RASTER)[: size[1] + 1, : size[0] + 1] > 0
            spot = _first_fit(free, mask)
            if spot is not None and (best is None or spot[0] + mask.shape[0] < best[0] + best[3].shape[0]):
                best = (*spot, plane, mask)
        if best is None:
            return None
        row, column, plane, mask = best
        placed[index] = plane + (np.array([column, row]) + 1) / RASTER
        occupied = np.zeros_like(free)
        occupied[row : row + mask.shape[0], column : column + mask.shape[1]] = mask
        free &= ~_dilate(occupied, GUTTER)
    return [plane for plane in placed if plane is not None]


def _first_fit(free: np.ndarray, mask: np.ndarray) -> tuple[int, int] | None:
    """Lowest, then leftmost place of a mask in the free area, by correlation."""
    shape = free.shape
    blocked = np.fft.irfft2(np.fft.rfft2(~free) * np.conj(np.fft.rfft2(mask, shape)), shape)
    allowed = blocked[: shape[0] - mask.shape[0], : shape[1] - mask.shape[1]] < 0.5
    spots = np.flatnonzero(allowed)
    if not len(spots):
        return None
    return int(spots[0] // allowed.shape[1]), int(spots[0] % allowed.shape[1])


def _dilate(mask: np.ndarray, radius: int) -> np.ndarray:
    return distance_transform_edt(~mask) <= radius


def coverage(uv: np.ndarray, corners: np.ndarray, size: int) -> np.ndarray:
    """How many triangles cover each texel centre, [size, size], row 0 at v = 0."""
    count = np.zeros((size, size), np.int32)
    for triangle in uv[corners] * size - 0.5:
        low = np.maximum(np.ceil(triangle.min(0) - 1e-9), 0).astype(int)
        high = np.minimum(np.floor(triangle.max(0) + 1e-9), size - 1).astype(int)
        if (high < low).any():
            continue
        x, y = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
        (ax, ay), (bx, by), (cx, cy) = triangle
        first = (bx - ax) * (y - ay) - (by - ay) * (x - ax)
        second = (cx - bx) * (y - by) - (cy - by) * (x - bx)
        third = (ax - cx) * (y - cy) - (ay - cy) * (x - cx)
        # strict: a centre on a shared edge belongs to nobody rather than to two
        count[low[1] : high[1] + 1, low[0] : high[0] + 1] += (first > 1e-9) & (second > 1e-9) & (third > 1e-9)
    return count
