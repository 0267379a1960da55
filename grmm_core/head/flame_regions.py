"""Finding the parts of a user's FLAME mesh from its geometry: skin, eyeballs, mouth opening, neck.

FLAME's own vertex lists may not be shipped, and need not be: the eyeballs are pieces of their own, the neck and the mouth
are boundaries of the skin. Called by `flame`; needs numpy only.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ..errors import FileFormatError
from ..geometry.triangles import vertex_normals
from .mesh_topology import boundary_loops, components

_SIZE = (0.1, 1.0)  # metres: the head's height
_MIDLINE = 0.015  # metres: the mouth's middle lies this near to the eyes' middle
_MIN_EYE = 50  # vertices
_INNER_RINGS = 6
_INNER_NORMAL = 0.1  # lips turn inwards where the normal's forward part is below this
MASK_NAMES = {"lips": ("lips",), "ears": ("left_ear", "right_ear"), "scalp": ("scalp",), "neck": ("neck", "boundary")}


@dataclass(frozen=True)
class FlameSurface:
    """Parts of a FLAME mesh.

    Attributes:
        vertices: Metres, [V, 3].
        faces: [F, 3].
        normals: [V, 3].
        skin: Vertices of the largest piece.
        left_eye: Vertices of the subject's left eyeball (+x).
        right_eye: Vertices of the right one.
        neck_loop: Boundary of the neck, in order.
        mouth_loop: Rim of the mouth opening, in order.
        inner_mouth: Vertices of the lips that look into the mouth, with the rim.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    skin: np.ndarray
    left_eye: np.ndarray
    right_eye: np.ndarray
    neck_loop: np.ndarray
    mouth_loop: np.ndarray
    inner_mouth: np.ndarray

    @property
    def eye_centres(self) -> np.ndarray:
        """Centres of the left and right eyeball in metres, [2, 3]."""
        return np.stack([self.vertices[self.left_eye].mean(0), self.vertices[self.right_eye].mean(0)])

    @property
    def mouth_corners(self) -> np.ndarray:
        """Left and right corner of the lips in metres, [2, 3]: beside the rim's ends, which may lie inside the mouth."""
        rim = self.vertices[self.mouth_loop]
        ends = np.stack([rim[np.argmax(rim[:, 0])], rim[np.argmin(rim[:, 0])]])
        outer = self.vertices[np.setdiff1d(self.skin, self.inner_mouth)]
        outer = outer[outer[:, 2] > ends[:, 2].min() - 0.01]  # not the back of the head
        for end in ends:
            end[2] = outer[np.argmin(np.linalg.norm(outer[:, :2] - end[:2], axis=1)), 2]
        return ends


def find_surface(vertices: np.ndarray, faces: np.ndarray, label: str) -> FlameSurface:
    """Take a FLAME mesh apart.

    Args:
        vertices: Template in metres, [V, 3].
        faces: [F, 3].
        label: The file's name, for messages.

    Raises:
        FileFormatError: The mesh is no head of FLAME's structure; what is missing is named.
    """
    height = float(np.ptp(vertices[:, 1]))
    if not _SIZE[0] < height < _SIZE[1]:
        raise FileFormatError(f"The head in {label} is {height:.3g} m high; FLAME is in metres, get the file again.")
    if (faces[:, 0] == faces[:, 1]).any() or (faces[:, 1] == faces[:, 2]).any() or (faces[:, 2] == faces[:, 0]).any():
        raise FileFormatError(f"{label} has triangles that use a vertex twice; get the file again.")
    piece = components(faces, len(vertices))
    names, sizes = np.unique(piece, return_counts=True)
    main = names[np.argmax(sizes)]
    skin = np.flatnonzero(piece == main)
    others = [np.flatnonzero(piece == name) for name, size in zip(names, sizes, strict=True) if name != main and size > 2]
    middle = float(np.median(vertices[skin, 0]))
    left = [part for part in others if vertices[part, 0].mean() > middle]
    right = [part for part in others if vertices[part, 0].mean() <= middle]
    left_eye, right_eye = (np.sort(np.concatenate(parts)) if parts else np.empty(0, int) for parts in (left, right))
    if min(len(left_eye), len(right_eye)) < _MIN_EYE:
        raise FileFormatError(f"{label} has no two eyeballs of their own; choose an unchanged FLAME model.")
    eyes = 0.5 * (vertices[left_eye].mean(0) + vertices[right_eye].mean(0))
    loops = [loop for loop in boundary_loops(faces[piece[faces[:, 0]] == main]) if len(loop) >= 6]
    if not loops:
        raise FileFormatError(f"The skin of {label} is closed; FLAME is open at the neck and the mouth.")
    neck = min(loops, key=lambda loop: float(vertices[loop, 1].mean()))
    normals = vertex_normals(vertices, faces)
    mouth = _mouth([loop for loop in loops if loop is not neck], vertices, eyes)
    if mouth is None:
        raise FileFormatError(f"{label} has no mouth opening below the eyes; choose an unchanged FLAME model.")
    inner = _inner_mouth(vertices, faces, normals, mouth)
    return FlameSurface(vertices, faces, normals, skin, left_eye, right_eye, neck, mouth, inner)


def _mouth(loops: list[np.ndarray], vertices: np.ndarray, eyes: np.ndarray) -> np.ndarray | None:
    """The loop in front, on the midline, below the eyes; the widest where there are several."""
    candidates = []
    for loop in loops:
        rim = vertices[loop]
        centre = 0.5 * (rim.min(0) + rim.max(0))
        if abs(centre[0] - eyes[0]) < _MIDLINE and centre[1] < eyes[1]:
            candidates.append((float(np.ptp(rim[:, 0])), loop))
    return max(candidates, key=lambda item: item[0])[1] if candidates else None


def _inner_mouth(vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """The rim and what is joined to it and looks away from the front, a few rings far."""
    chosen = np.zeros(len(vertices), bool)
    chosen[rim] = True
    inwards = normals[:, 2] < _INNER_NORMAL
    width = float(np.ptp(vertices[rim, 0]))
    near = np.abs(vertices - vertices[rim].mean(0)).max(1) < 0.75 * width
    for _ in range(_INNER_RINGS):
        ring = np.unique(faces[chosen[faces].any(1)])
        grown = chosen.copy()
        grown[ring] |= inwards[ring] & near[ring]
        if (grown == chosen).all():
            break
        chosen = grown
    return np.flatnonzero(chosen)


def name_regions(
    surface: FlameSurface,
    labels: Mapping[str, np.ndarray],
    masks: Mapping[str, np.ndarray] | None,
    teeth: Mapping[str, np.ndarray],
) -> dict[str, np.ndarray]:
    """Regions with the open head's names.

    Args:
        surface: The mesh.
        labels: Region to a mark for each vertex that correspondence with the open head gives it, [V] bool.
        masks: The user's FLAME masks; they count more than correspondence.
        teeth: Regions of the added vertices.

    Returns:
        Sorted vertex indices. scalp, face, neck, ears, mouth_interior, the eyeballs and the teeth cover the head without
        overlap; lips, lids and brows are parts of the face.
    """
    count = len(surface.vertices)
    marks = {name: np.array(mark) for name, mark in labels.items()}
    for name, sources in MASK_NAMES.items():
        given = [masks[source] for source in sources if masks is not None and source in masks]
        if given:
            marks[name] = np.zeros(count, bool)
            marks[name][np.concatenate(given)] = True
    free = np.zeros(count, bool)
    free[surface.skin] = True
    inner = np.zeros(count, bool)
    inner[surface.inner_mouth] = True
    result = {"left_eyeball": surface.left_eye, "right_eyeball": surface.right_eye}
    for name, mark in (("mouth_interior", inner), *((name, marks[name]) for name in ("ears", "neck", "scalp"))):
        result[name] = np.flatnonzero(mark & free)
        free &= ~mark
    result["face"] = np.flatnonzero(free)
    for name in ("lips", "left_lids", "right_lids", "brows"):
        result[name] = np.flatnonzero(marks[name] & free)
    result["lids"] = np.union1d(result["left_lids"], result["right_lids"])
    return {name: np.asarray(part, np.int32) for name, part in {**result, **teeth}.items()}
