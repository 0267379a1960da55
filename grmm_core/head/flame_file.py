"""Read a user's FLAME model file: pickle (2020, 2023, 2023 Open) or npz, into plain validated arrays.

FLAME is licence-gated, so nothing of it ships with the project; users point to the file that they obtained. `flame` builds a
`HeadModel` from what is read here. Needs numpy only and executes nothing from the file (`restricted_pickle`).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from ..files.access import read_bytes
from ..files.npz import read_npz
from .restricted_pickle import load_restricted

FLAME_VERTICES = 5023
FLAME_FACES = 9976
FLAME_JOINTS = 5
FLAME_SHAPE_COUNT = 300  # of shapedirs' 400 columns; the other 100 are expression
POSE_FEATURES = 9 * (FLAME_JOINTS - 1)
MAX_FILE_BYTES = 1 << 30  # also of arrays unpacked; FLAME takes 60 MB in double precision
_PARENTS = (-1, 0, 1, 1, 1)  # root, neck, jaw, left eye, right eye


@dataclass(frozen=True)
class FlameArrays:
    """The arrays of one FLAME file, float64, metres.

    Attributes:
        v_template: [5023, 3].
        faces: [9976, 3] int32.
        shape_dirs: [5023, 3, S], S at most 300.
        expression_dirs: [5023, 3, E], E at most 100.
        posedirs: [5023, 3, 36].
        joint_regressor: [5, 5023].
        weights: [5023, 5] skinning weights; rows sum to one.
    """

    v_template: np.ndarray
    faces: np.ndarray
    shape_dirs: np.ndarray
    expression_dirs: np.ndarray
    posedirs: np.ndarray
    joint_regressor: np.ndarray
    weights: np.ndarray


def read_flame_file(path: str | os.PathLike[str]) -> FlameArrays:
    """Read and validate a FLAME model.

    Args:
        path: ``generic_model.pkl``, ``flame2023.pkl``, ``flame2023_Open.pkl`` or an npz with the same names.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Damaged, hostile, or not a FLAME model; the reason is named.
    """
    path = Path(path)
    return _validate(read_fields(path), path.name)


def read_flame_masks(path: str | os.PathLike[str]) -> dict[str, np.ndarray]:
    """Read ``FLAME_masks.pkl``: region name to sorted vertex indices below 5023. Raises as `read_flame_file`."""
    path = Path(path)
    fields = read_fields(path)
    if not fields:
        raise FileFormatError(f"{path.name} holds no FLAME masks; choose FLAME_masks.pkl.")
    masks = {}
    for name in fields:
        array = _array(fields, name, path.name)
        if array.ndim != 1 or array.size == 0 or array.min() < 0 or array.max() >= FLAME_VERTICES:
            raise FileFormatError(f"Region {str(name)[:40]!r} of {path.name} has impossible vertex indices.")
        masks[str(name)] = np.unique(array.astype(np.int32))
    return masks


def read_fields(path: Path) -> Mapping[Any, Any]:
    """The named values of a pickle or npz, by its first bytes; nothing of it is executed.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Damaged, hostile, or not a table of names.
    """
    data = read_bytes(path, limit=MAX_FILE_BYTES)
    if data[:2] == b"PK":
        return read_npz(path, max_bytes=MAX_FILE_BYTES)[0]
    fields = load_restricted(data, path.name)
    if not isinstance(fields, Mapping):
        raise FileFormatError(f"{path.name} holds no FLAME arrays; choose generic_model.pkl, flame2023.pkl or an npz of it.")
    return fields


def is_flame_npz(path: Path) -> bool:
    """Whether an npz is meant as a FLAME model, by the names of its arrays. Raises as `read_npz`."""
    return "v_template" in read_npz(path, ())[1]


def _validate(fields: Mapping[Any, Any], label: str) -> FlameArrays:
    v_template = _array(fields, "v_template", label, (FLAME_VERTICES, 3))
    faces = _array(fields, "f", label, (FLAME_FACES, 3))
    if faces.min() < 0 or faces.max() >= FLAME_VERTICES:
        raise FileFormatError(f"The faces of {label} point outside its {FLAME_VERTICES} vertices; get the file again.")
    directions = _array(fields, "shapedirs", label)
    if directions.ndim != 3 or directions.shape[:2] != (FLAME_VERTICES, 3) or directions.shape[2] <= FLAME_SHAPE_COUNT:
        raise FileFormatError(f"'shapedirs' of {label} is {directions.shape}; FLAME has (5023, 3, 400).")
    kintree = _array(fields, "kintree_table", label, (2, FLAME_JOINTS)).astype(np.int64)
    if tuple(kintree[0, 1:]) != _PARENTS[1:]:
        raise FileFormatError(f"The joints of {label} are not FLAME's root, neck, jaw and eyes; this model cannot be used.")
    weights = _array(fields, "weights", label, (FLAME_VERTICES, FLAME_JOINTS))
    if (weights < -1e-6).any() or np.abs(weights.sum(1) - 1.0).max() > 1e-3:
        raise FileFormatError(f"The skinning weights of {label} do not sum to one; get the file again.")
    return FlameArrays(
        v_template=v_template,
        faces=faces.astype(np.int32),
        shape_dirs=directions[:, :, :FLAME_SHAPE_COUNT],
        expression_dirs=directions[:, :, FLAME_SHAPE_COUNT : FLAME_SHAPE_COUNT + 100],
        posedirs=_array(fields, "posedirs", label, (FLAME_VERTICES, 3, POSE_FEATURES)),
        joint_regressor=_array(fields, "J_regressor", label, (FLAME_JOINTS, FLAME_VERTICES)),
        weights=weights,
    )


def _array(fields: Mapping[Any, Any], name: Any, label: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
    if name not in fields:
        raise FileFormatError(f"{label} has no {name!r}; choose a FLAME model file such as generic_model.pkl or flame2023.pkl.")
    value = fields[name]
    # a list is taken only where it is flat: nested ones can share rows and grow without bound
    if not isinstance(value, np.ndarray) and not (isinstance(value, list) and all(isinstance(n, int) for n in value)):
        raise FileFormatError(f"{name!r} of {label} is not an array of numbers; get the file again.")
    try:
        array = np.asarray(value, np.float64)
    except (TypeError, ValueError) as error:
        raise FileFormatError(f"{name!r} of {label} is not an array of numbers; get the file again.") from error
    if shape is not None and array.shape != shape:
        raise FileFormatError(f"{name!r} of {label} has shape {array.shape}, FLAME {shape}; this model cannot be used.")
    if not np.isfinite(array).all():
        raise FileFormatError(f"{name!r} of {label} has values that are not numbers; get the file again.")
    return array
