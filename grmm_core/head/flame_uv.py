"""Texture layout of a user's FLAME mesh with teeth: islands that do not overlap, the face finer than the back.

The skin is one island, cut from the back of the neck over the crown to the hairline. The lips' inner side, the fronts and
backs of the eyeballs and both rows of teeth have islands of their own. Everything is computed from the user's file with numpy
alone and without random numbers, so that the same file has the same layout everywhere but for the last digits: trained weights
depend on it. Called by `flame`.
"""

from __future__ import annotations

import numpy as np

from ..errors import FileFormatError
from ..geometry.triangles import face_areas
from .flame_regions import FlameSurface
from .flame_teeth import LOWER_ROWS, ROW, TEETH_FACES, TEETH_VERTICES, UPPER_ROWS
from .flatten_disk import fill_holes, flatten_disk, outline
from .mesh_topology import boundary_loops, components, cut_along, directed_edges, is_disk, shortest_path
from .uv_density import BACK
from .uv_islands import Island, UVLayout, counter_clockwise, join_islands, signed_areas

GUTTER = 10 / 1024  # between islands: 2.5 texels at 256
SKIN_ASPECT = 0.72  # height of the skin's island over its width
EYE_DENSITY, IRIS_DENSITY, EYE_BACK_DENSITY = 1.3, 2.4, 0.3
TEETH_DENSITY, MOUTH_DENSITY = 0.9, 0.4
_EYE_FRONT = np.radians(100.0)  # the front island reaches this far from the pupil
_IRIS = np.radians(35.0)
_MIDLINE = 0.01  # metres; how much the seam prefers the midline
_FIT_STEPS = 24
_MAX_SPLITS = 40


def lay_out(surface: FlameSurface, vertices: np.ndarray, faces: np.ndarray, density: np.ndarray) -> UVLayout:
    """Texture layout of FLAME with teeth.

    Args:
        surface: Parts of the mesh without teeth.
        vertices: With teeth, metres, [V, 3].
        faces: With teeth; those are the last ones, [F, 3].
        density: Wanted density on the skin, 1 on the face, per vertex, [V]; see `uv_density`.

    Raises:
        FileFormatError: The triangles do not form surfaces that can be laid flat.
    """
    own = len(faces) - TEETH_FACES
    eyes = [np.flatnonzero(np.isin(faces[:own, 0], part)) for part in (surface.left_eye, surface.right_eye)]
    inner = np.isin(faces[:own], surface.inner_mouth).all(1)
    skin = np.isin(faces[:own, 0], surface.skin)
    islands = _skin_islands(surface, vertices, faces, density, np.flatnonzero(skin & ~inner), np.flatnonzero(inner))
    for name, which in zip(("left_eyeball", "right_eyeball"), eyes, strict=True):
        islands += _eye_islands(vertices, faces, which, name)
    rest = np.setdiff1d(np.arange(own), np.concatenate([island.triangles for island in islands]))
    islands += _pieces(vertices, faces, rest, "other", np.full(len(vertices), BACK))
    count = len(vertices) - TEETH_VERTICES
    for name, rows, first in (("upper_teeth", UPPER_ROWS, own), ("lower_teeth", LOWER_ROWS, own + TEETH_FACES // 2)):
        which = np.arange(first, first + TEETH_FACES // 2)
        islands.append(_teeth_island(vertices, faces, which, name, rows, count))
    return _assemble(islands, len(faces))


def _skin_islands(
    surface: FlameSurface, vertices: np.ndarray, faces: np.ndarray, density: np.ndarray, skin: np.ndarray, inner: np.ndarray
) -> list[Island]:
    """One island for the skin and some for the lips' inner side; if that side cannot be taken off, all is skin."""
    lips_density = np.full(len(vertices), MOUTH_DENSITY)
    for outer, lips in ((skin, inner), (np.sort(np.concatenate([skin, inner])), inner[:0])):
        island = _skin_island(surface, vertices, faces, density, outer)
        if island is not None:
            return [island, *_pieces(vertices, faces, lips, "mouth_interior", lips_density)]
    # a skin of unknown topology (handles, slits): several islands, still without overlaps
    return _pieces(vertices, faces, np.sort(np.concatenate([skin, inner])), "skin", density)


def _skin_island(
    surface: FlameSurface, vertices: np.ndarray, faces: np.ndarray, density: np.ndarray, which: np.ndarray
) -> Island | None:
    seam = _seam(surface, vertices, faces[which])
    if seam is None:
        return None
    cut = [(seam[i], seam[i + 1]) for i in range(len(seam) - 1)]
    corners, origin = cut_along(faces[which], cut)
    loops = boundary_loops(corners)
    if not is_disk(corners, loops):
        return None
    front = _on_midline(surface, vertices, 1.0)
    outer = next((loop for loop in loops if (origin[loop] == front).any() and (origin[loop] == seam[-1]).any()), None)
    if outer is None:
        return None
    points, filled = fill_holes(vertices[origin], corners, [loop for loop in loops if loop is not outer])
    wanted = density[origin]
    wanted = np.r_[wanted, np.full(len(points) - len(origin), BACK)]
    outer = np.roll(outer, -int(np.flatnonzero(origin[outer] == front)[0]))
    tip = int(np.flatnonzero(origin[outer] == seam[-1])[0])
    step = np.linalg.norm(np.diff(points[np.r_[outer, outer[0]]], axis=0), axis=1)
    length = np.r_[0.0, np.cumsum(step)]
    share = np.where(
        np.arange(len(outer)) <= tip,
        0.5 * length[:-1] / length[tip],
        0.5 + 0.5 * (length[:-1] - length[tip]) / (length[-1] - length[tip]),
    )
    rim = outline(share, 1.0, SKIN_ASPECT)
    face_density = wanted[filled].mean(1)
    plane = flatten_disk(points, filled, outer, rim, face_density)
    return None if plane is None else _scaled("skin", which, points, plane, filled, corners, face_density)


def _seam(surface: FlameSurface, vertices: np.ndarray, faces: np.ndarray) -> list[int] | None:
    """Vertices along edges from the neck's back over the crown to the hairline."""
    edges = np.unique(np.sort(directed_edges(faces), axis=1), axis=0)
    start = _on_midline(surface, vertices, -1.0)
    on_boundary = np.unique(np.concatenate(boundary_loops(faces)))
    used = np.setdiff1d(np.unique(faces), on_boundary)
    middle = float(surface.eye_centres[:, 0].mean())
    off = np.abs(vertices[used, 0] - middle)
    band = used[off < np.sort(off)[max(len(off) // 20, 1)]]
    goal = int(band[np.argmax(vertices[band, 1] + vertices[band, 2])])
    blocked = np.setdiff1d(on_boundary, [start])
    edges = edges[~np.isin(edges, blocked).any(1)]
    length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
    aside = (vertices[edges, 0].mean(1) - middle) / _MIDLINE
    return shortest_path(edges, length * (1 + aside**2), start, goal)


def _on_midline(surface: FlameSurface, vertices: np.ndarray, forward: float) -> int:
    """The neck boundary's foremost vertex near the midline, or its hindmost."""
    rim = vertices[surface.neck_loop]
    aside = np.abs(rim[:, 0] - surface.eye_centres[:, 0].mean())
    return int(surface.neck_loop[np.argmax(forward * rim[:, 2] - 2 * aside)])


def _eye_islands(vertices: np.ndarray, faces: np.ndarray, which: np.ndarray, name: str) -> list[Island]:
    corners = vertices[faces[which]]
    arms = corners - vertices[np.unique(faces[which])].mean(0)
    angle = np.arccos(np.clip(arms[..., 2] / np.maximum(np.linalg.norm(arms, axis=-1), 1e-12), -1, 1))
    front = angle.max(1) < _EYE_FRONT
    density = np.full(len(vertices), EYE_DENSITY)
    density[faces[which][angle < _IRIS]] = IRIS_DENSITY
    back = np.full(len(vertices), EYE_BACK_DENSITY)
    return [
        *_pieces(vertices, faces, which[front], name, density),
        *_pieces(vertices, faces, which[~front], f"{name}_back", back),
    ]


def _teeth_island(
    vertices: np.ndarray, faces: np.ndarray, which: np.ndarray, name: str, rows: tuple[int, ...], first: int
) -> Island:
    """The four rows as a grid: along the arch, and around the teeth from the front's root to the back's."""
    ids = first + np.array(rows)[:, None] * ROW + np.arange(ROW)  # [4, 15]
    along = np.linalg.norm(np.diff(vertices[ids], axis=1), axis=2).mean(0)
    around = np.linalg.norm(np.diff(vertices[ids], axis=0), axis=2).mean(1)
    u, v = np.r_[0.0, np.cumsum(along)], np.r_[0.0, np.cumsum(around)]
    plane = np.stack(np.broadcast_arrays(u[None, :], v[:, None]), -1).reshape(-1, 2)
    row_of = {int(vertex): i for i, vertex in enumerate(ids.reshape(-1))}
    corners = np.array([[row_of[int(vertex)] for vertex in face] for face in faces[which]])
    return Island(name, which, counter_clockwise(plane, corners) * TEETH_DENSITY, corners)


def _pieces(vertices: np.ndarray, faces: np.ndarray, which: np.ndarray, name: str, density: np.ndarray) -> list[Island]:
    """Islands of any triangles: what is no disk is halved until it is."""
    result: list[Island] = []
    stack = [(part, 0) for part in _connected(faces, which)]
    while stack:
        part, depth = stack.pop()
        island = _disk_island(vertices, faces, part, name, density)
        if island is not None:
            result.append(island)
            continue
        if depth > _MAX_SPLITS or len(part) < 2:
            raise FileFormatError("The triangles of this FLAME file are no surface that can be laid flat; get the file again.")
        centres = vertices[faces[part]].mean(1)
        axis = int(np.argmax(np.ptp(centres, axis=0)))
        order = np.argsort(centres[:, axis], kind="stable")
        for half in (order[: len(part) // 2], order[len(part) // 2 :]):
            stack += [(piece, depth + 1) for piece in _connected(faces, np.sort(part[half]))]
    return result


def _connected(faces: np.ndarray, which: np.ndarray) -> list[np.ndarray]:
    if not len(which):
        return []
    corners, _ = cut_along(faces[which])
    label = components(corners, int(corners.max()) + 1)[corners[:, 0]]
    return [which[label == value] for value in np.unique(label)]


def _disk_island(vertices: np.ndarray, faces: np.ndarray, which: np.ndarray, name: str, density: np.ndarray) -> Island | None:
    corners, origin = cut_along(faces[which])
    loops = boundary_loops(corners)
    if not is_disk(corners, loops) or len(loops) > 1:
        return None
    points = vertices[origin]
    loop = np.roll(loops[0], -int(np.argmin(points[loops[0], 1])))  # the lowest point goes to the bottom
    length = np.r_[0.0, np.cumsum(np.linalg.norm(np.diff(points[np.r_[loop, loop[0]]], axis=0), axis=1))]
    centred = points - points.mean(0)
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(centred.T @ centred)[::-1], 1e-20))
    aspect = float(np.clip(spread[1] / spread[0], 0.25, 1.0))
    width, height = (1.0, aspect) if np.ptp(points[:, 0]) >= np.ptp(points[:, 1]) else (aspect, 1.0)
    rim = outline(length[:-1] / length[-1], width, height, 2.0)
    wanted = density[origin][corners].mean(1)
    plane = flatten_disk(points, corners, loop, rim, wanted)
    return None if plane is None else _scaled(name, which, points, plane, corners, corners, wanted)


def _scaled(
    name: str,
    which: np.ndarray,
    points: np.ndarray,
    plane: np.ndarray,
    filled: np.ndarray,
    corners: np.ndarray,
    density: np.ndarray,
) -> Island:
    """Give an island the size that its density asks for."""
    wanted = float((face_areas(points, filled) * density**2).sum())
    covered = float(signed_areas(plane, filled).sum())
    used = int(corners.max()) + 1
    return Island(name, which, plane[:used] * np.sqrt(wanted / covered), corners)


def _assemble(islands: list[Island], count: int) -> UVLayout:
    for island in islands:
        island.plane = island.plane - island.plane.min(0)
    sizes = np.array([island.plane.max(0) for island in islands])  # [n, 2]
    high = (1 - 2 * GUTTER) / float(sizes[0, 0])
    places = _place(sizes, high)
    low = 0.0
    if places is None:
        for _ in range(_FIT_STEPS):
            middle = 0.5 * (low + high)
            tried = _place(sizes, middle)
            if tried is None:
                high = middle
            else:
                low, places = middle, tried
    else:
        low = high
    if places is None:
        raise FileFormatError("The triangles of this FLAME file are no surface that can be laid flat; get the file again.")
    return join_islands(islands, [island.plane * low + corner for island, corner in zip(islands, places, strict=True)], count)


def _place(sizes: np.ndarray, scale: float) -> np.ndarray | None:
    """Lower left corners of boxes in the unit square, [n, 2]: the first on top, the others on shelves below by height."""
    boxes = sizes * scale
    room = 1 - 2 * GUTTER
    if (boxes > room).any():
        return None
    corners = np.zeros_like(boxes)
    corners[0] = (0.5 - boxes[0, 0] / 2, 1 - GUTTER - boxes[0, 1])
    top = corners[0, 1] - GUTTER
    x, shelf = GUTTER, 0.0
    # rounded: islands of the same height keep their order whatever the last digits are on this machine
    for index in sorted(range(1, len(boxes)), key=lambda i: (-round(float(boxes[i, 1]), 3), i)):
        if x + boxes[index, 0] > 1 - GUTTER:
            top -= shelf + GUTTER
            x, shelf = GUTTER, 0.0
        shelf = max(shelf, boxes[index, 1])
        corners[index] = (x, top - boxes[index, 1])
        if corners[index, 1] < GUTTER:
            return None
        x += boxes[index, 0] + GUTTER
    return corners
