"""A user's FLAME file as a `HeadModel`, with what FLAME lacks: teeth, our texture islands, named regions, an ARKit map.

FLAME is licence-gated: nothing of it is in this project, and everything here is computed from the file that the user has.

Conventions. Coordinates stay FLAME's own, untouched: metres, y up, face towards +z, FLAME's origin (not between the ears as for
the open head), so shape, expression, pose and translation parameters of other tools stay valid. The first 5023 vertices
and 9976 triangles are the file's; 120 vertices and 168 triangles of teeth follow (`flame_teeth`). 300 shape and 100 expression
components, unit variance; no expression component turns a joint. Pose correctives (`posedirs`) multiply R - I of neck, jaw
and eyes. Poses are XYZ Euler angles as everywhere in the core; FLAME's files hold axis-angle vectors.

Called by `grmm info`, performances and sessions through `head.load_flame`; needs numpy only.
"""

from __future__ import annotations

import hashlib
import logging
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..geometry.triangles import closest_on_surface
from .flame_align import Correspondence, correspond
from .flame_arkit import arkit_map
from .flame_file import FLAME_FACES, FlameArrays, read_fields, read_flame_file, read_flame_masks
from .flame_regions import FlameSurface, find_surface, name_regions
from .flame_teeth import LOWER_ROWS, ROW, TEETH_FACES, TEETH_VERTICES, UPPER_ROWS, Teeth, build_teeth
from .flame_uv import lay_out
from .head_model import HeadModel
from .open_head import load_open_head
from .uv_density import face_density

_log = logging.getLogger(__name__)
_NAMES = {"generic_model": "flame2020", "flame2020": "flame2020", "flame2023_no_jaw": "flame2023_no_jaw"}
_CACHED = 2
_cache: dict[str, HeadModel] = {}
_REGIONS = ("ears", "neck", "scalp", "lips", "left_lids", "right_lids", "brows")
_REGION_DISTANCE = 0.03  # metres: beyond this a vertex has no counterpart on the open head
_LANDMARK_MEDIAN, _LANDMARK_MOST = 0.005, 0.015  # metres: worse landmarks are none
_LANDMARK_KEYS = (("full_lmk_faces_idx", "full_lmk_bary_coords"), ("lmk_face_idx", "lmk_b_coords"), ("faces", "barycentric"))


def load_flame(
    path: str | os.PathLike[str],
    masks: str | os.PathLike[str] | None = None,
    landmarks: str | os.PathLike[str] | None = None,
) -> HeadModel:
    """Read a FLAME file and complete it to a head model with teeth: 5143 vertices, 10144 triangles.

    The last two results are kept in memory by content, since the texture layout takes seconds.

    Args:
        path: ``generic_model.pkl``, ``flame2023.pkl``, ``flame2023_Open.pkl`` or an npz with the same arrays.
        masks: The user's ``FLAME_masks.pkl``: better regions of ears, scalp, neck and lips.
        landmarks: A static embedding of the 68 landmarks (.npz or .pkl): ``full_lmk_faces_idx`` and
            ``full_lmk_bary_coords``, or ``lmk_face_idx`` and ``lmk_b_coords``. Without it they are found by geometry.

    Raises:
        FileAccessError: A file is missing or unreadable.
        FileFormatError: A file is damaged or hostile, or the mesh is not FLAME's.
    """
    path = Path(path)
    arrays = read_flame_file(path)
    regions = None if masks is None else read_flame_masks(masks)
    embedding = None if landmarks is None else read_landmark_embedding(landmarks)
    name = _name(path.stem)
    key = _digest(name, arrays, regions, embedding)
    if key not in _cache:
        while len(_cache) >= _CACHED:
            _cache.pop(next(iter(_cache)))
        _cache[key] = complete_flame(arrays, name, path.name, regions, embedding)
    return _cache[key]


def describe_flame(path: str | os.PathLike[str]) -> dict[str, object]:
    """What a FLAME file holds, without completing it (`grmm info`). Raises as `load_flame`."""
    path = Path(path)
    flame = read_flame_file(path)
    surface = find_surface(flame.v_template, flame.faces, path.name)
    return {
        "file": str(path),
        "kind": "flame-head",
        "name": _name(path.stem),
        "vertices": len(flame.v_template),
        "triangles": len(flame.faces),
        "shape components": flame.shape_dirs.shape[2],
        "expression components": flame.expression_dirs.shape[2],
        "mouth opening vertices": len(surface.mouth_loop),
        "with teeth": f"{len(flame.v_template) + TEETH_VERTICES} vertices, {len(flame.faces) + TEETH_FACES} triangles",
    }


def complete_flame(
    flame: FlameArrays,
    name: str,
    label: str,
    masks: Mapping[str, np.ndarray] | None = None,
    landmarks: tuple[np.ndarray, np.ndarray] | None = None,
) -> HeadModel:
    """Add teeth, texture islands, regions, landmarks and the ARKit map to FLAME's arrays.

    Args:
        flame: The file's arrays.
        name: Name of the head model.
        label: The file's name, for messages.
        masks: Region name to vertices, or None.
        landmarks: Triangles [68] and barycentric coordinates [68, 3], or None.

    Raises:
        FileFormatError: The mesh is not FLAME's; the reason is named.
    """
    open_head = load_open_head()
    surface = find_surface(flame.v_template, flame.faces, label)
    rim = surface.mouth_loop
    teeth = build_teeth(flame.v_template[rim], flame.shape_dirs[rim])
    found = correspond(surface, flame.weights[:, 2], open_head, label)
    vertices = np.concatenate([flame.v_template, teeth.vertices])
    faces = np.concatenate([flame.faces, teeth.faces + len(flame.v_template)]).astype(np.int32)
    layout = lay_out(surface, vertices, faces, face_density(found.to_open(vertices)))
    # the map is solved on the model itself, so it is made twice: without and with it
    parts: dict[str, Any] = _arrays(flame, teeth) | {
        "name": name, "v_template": vertices.astype(np.float32), "faces": faces,
        "uv": layout.uv, "uv_faces": layout.faces, "uv_islands": layout.islands,
        "regions": _regions(surface, found, open_head, masks),
        "landmarks68": landmarks if landmarks is not None else _landmarks(surface, found, open_head),
    }  # fmt: skip
    count = flame.expression_dirs.shape[2]
    bare = HeadModel(**parts, arkit_to_expression=np.zeros((52, count), np.float32))
    coefficients, pose = arkit_map(surface, found, bare, open_head)
    return HeadModel(**parts, arkit_to_expression=coefficients, arkit_pose=pose)


def read_landmark_embedding(path: str | os.PathLike[str]) -> tuple[np.ndarray, np.ndarray]:
    """Read 68 landmarks on FLAME's triangles from .npz or .pkl: triangles [68], barycentric coordinates [68, 3].

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Damaged, hostile, or not 68 landmarks on FLAME.
    """
    path = Path(path)
    fields = read_fields(path)
    for face_key, weight_key in _LANDMARK_KEYS:
        if face_key in fields and weight_key in fields:
            return _checked_landmarks(fields[face_key], fields[weight_key], path.name)
    raise FileFormatError(f"{path.name} holds no landmark embedding (lmk_face_idx and lmk_b_coords); choose another file.")


def _checked_landmarks(faces: object, weights: object, label: str) -> tuple[np.ndarray, np.ndarray]:
    if not (isinstance(faces, np.ndarray) and isinstance(weights, np.ndarray)):
        raise FileFormatError(f"The landmarks in {label} are not arrays; choose another file.")
    try:
        triangles = np.asarray(faces, np.float64).reshape(-1)
        coordinates = np.asarray(weights, np.float64).reshape(-1, 3)
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"The landmarks in {label} are not numbers; choose another file.") from error
    if triangles.shape != (68,) or coordinates.shape != (68, 3):
        raise FileFormatError(f"{label} has {triangles.size} landmarks; the full set of 68 is needed.")
    good = np.isfinite(coordinates).all() and np.abs(coordinates.sum(1) - 1.0).max() < 1e-2
    if not good or not (np.isfinite(triangles).all() and triangles.min() >= 0 and triangles.max() < FLAME_FACES):
        raise FileFormatError(f"The landmarks in {label} do not lie on FLAME's triangles; choose another file.")
    return triangles.astype(np.int32), coordinates.astype(np.float32)


def _arrays(flame: FlameArrays, teeth: Teeth) -> dict[str, object]:
    """FLAME's arrays with the teeth's rows appended; expressions and pose correctives do not move teeth."""

    def extend(array: np.ndarray, rows: np.ndarray | None = None) -> np.ndarray:
        tail = np.zeros((TEETH_VERTICES, *array.shape[1:])) if rows is None else rows
        return np.concatenate([array, tail]).astype(np.float32)

    shapes, expressions = flame.shape_dirs.shape[2], flame.expression_dirs.shape[2]
    return {
        "shape_dirs": extend(flame.shape_dirs, teeth.shape_dirs),
        "expression_dirs": extend(flame.expression_dirs),
        "posedirs": extend(flame.posedirs),
        "J_regressor": extend(flame.joint_regressor.T).T.copy(),
        "parents": np.array([-1, 0, 1, 1, 1], np.int32),
        "weights": extend(flame.weights, teeth.weights),
        "shape_names": tuple(f"shape{i}" for i in range(shapes)),
        "expression_names": tuple(f"expression{i}" for i in range(expressions)),
        "expression_pose": np.zeros((expressions, 5, 3), np.float32),
    }


def _regions(
    surface: FlameSurface, correspondence: Correspondence, head: HeadModel, masks: Mapping[str, np.ndarray] | None
) -> dict[str, np.ndarray]:
    near = correspondence.distance < _REGION_DISTANCE
    labels = {}
    for name in _REGIONS:
        labels[name] = np.zeros(len(surface.vertices), bool)
        labels[name][surface.skin] = (correspondence.carry(head.marked(name).astype(float)) > 0.5) & near
    first = len(surface.vertices)
    teeth = {
        name: np.sort(np.concatenate([first + row * ROW + np.arange(ROW) for row in rows]))
        for name, rows in (("upper_teeth", UPPER_ROWS), ("lower_teeth", LOWER_ROWS))
    }
    return name_regions(surface, labels, masks, teeth)


def _landmarks(surface: FlameSurface, correspondence: Correspondence, head: HeadModel) -> tuple[np.ndarray, np.ndarray] | None:
    """The open head's 68 landmarks where the warp puts them; None where that is not credible."""
    skin = np.flatnonzero(np.isin(surface.faces[:, 0], surface.skin))
    points = head.landmark_positions(correspondence.warped)
    triangles, coordinates, gaps = closest_on_surface(points, surface.vertices, surface.faces[skin])
    if np.median(gaps) > _LANDMARK_MEDIAN or gaps.max() > _LANDMARK_MOST:
        _log.warning("The 68 landmarks could not be found on this FLAME mesh; give a landmark embedding file.")
        return None
    return skin[triangles].astype(np.int32), coordinates.astype(np.float32)


def _name(stem: str) -> str:
    stem = stem.lower()
    if stem in _NAMES:
        return _NAMES[stem]
    if "2023" in stem:
        return "flame2023_open" if "open" in stem else "flame2023"
    return "flame"


def _digest(
    name: str, flame: FlameArrays, masks: Mapping[str, np.ndarray] | None, landmarks: tuple[np.ndarray, np.ndarray] | None
) -> str:
    digest = hashlib.blake2b(name.encode())
    arrays = [*vars(flame).values(), *(landmarks or ())]
    for region in sorted(masks or {}):
        digest.update(region.encode())
        arrays.append((masks or {})[region])
    for array in arrays:
        digest.update(str((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()
