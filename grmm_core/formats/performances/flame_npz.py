"""FLAME parameter tracks as `.npz`: GaussianAvatars' `flame_param.npz`, VHAP's `tracked_flame_params_*.npz`, EMOCA, DECA.

Read by `reading.read_performance`. The coefficients belong to the user's FLAME model and stay in `Performance.expression`;
`retarget` turns them into ARKit weights where both head models are at hand. Rotations are axis-angle in FLAME's axes, which are
the head's axes here. Needs numpy only.
"""

from __future__ import annotations

import io
import os
from pathlib import Path

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...errors import GrmmError, ShapeError
from ...files.access import atomic_write_bytes, bad_file
from ...files.format import Format
from ...files.npz import read_npz
from ...geometry.rotations import axis_angle_to_euler, euler_to_axis_angle
from ...jobs.progress import Share
from ...performance.types import Performance
from .repair import MAX_FRAMES, fill_missing

KIND = "FLAME parameter file"
FLAME_EXPRESSIONS = 100
FLAME_SHAPES = 300
DEFAULT_FPS = 25.0
_ALIASES = {
    "expr": ("expr", "expression", "exp", "expcode", "expression_params"),
    "rotation": ("rotation", "global_orient", "global_pose", "rot"),
    "neck_pose": ("neck_pose", "neck", "neck_rot"),
    "jaw_pose": ("jaw_pose", "jaw", "jaw_rot"),
    "eyes_pose": ("eyes_pose", "eyes", "eye_pose", "eye_rot"),
    "pose": ("pose", "posecode"),
    "translation": ("translation", "transl", "tra"),
    "shape": ("shape", "shapecode", "betas", "shape_params"),
    "static_offset": ("static_offset",),
    "fps": ("fps", "frame_rate", "mocap_frame_rate"),
}
_VERTEX_COUNTS = (5023, 5143)  # FLAME without and with the added teeth
_MAX_COEFFICIENT = 100.0  # standard deviations; larger ones are no faces


def read_flame_npz(path: Path, fps: float | None = None, progress: Share | None = None) -> Performance:
    """Read a track of FLAME parameters.

    Args:
        path: The file.
        fps: Frame rate; 25 where neither this nor the file says.
        progress: Called with the fraction done.

    Raises:
        FileFormatError: Not an npz file, no expression coefficients, or arrays of other shapes than FLAME's.
        FileAccessError: Missing or unreadable.
    """
    arrays, available = read_npz(path, [name for names in _ALIASES.values() for name in names])
    fields = {key: arrays[name] for key, names in _ALIASES.items() for name in names[::-1] if name in arrays}
    if "expr" not in fields:
        listed = ", ".join(available[:8]) or "nothing"
        raise bad_file(path, KIND, f"it has no expression coefficients but {listed}")
    if any(array.dtype.kind not in "fiu" for array in fields.values()):
        raise bad_file(path, KIND, "an array does not hold numbers")
    warnings: list[str] = []
    expression = _expression(path, fields["expr"], warnings)
    count = expression.shape[0]
    if progress:
        progress(0.5)

    if "eye_rot" in arrays and arrays["eye_rot"].shape[-1:] == (3,):  # CAP4D has one rotation for both eyes
        fields["eyes_pose"] = np.concatenate([arrays["eye_rot"]] * 2, -1)
    if "tra" in arrays:
        warnings.append("CAP4D's head rotation and movement are those before its camera, read in FLAME's axes.")
    tracks = {name: _track(path, fields, name, count, width, warnings) for name, width in _TRACKS.items()}
    pose = tracks.pop("pose")
    if pose is not None:
        tracks["rotation"] = pose[:, :3] if tracks["rotation"] is None else tracks["rotation"]
        tracks["jaw_pose"] = pose[:, 3:] if tracks["jaw_pose"] is None else tracks["jaw_pose"]
    eyes, translation = tracks.pop("eyes_pose"), tracks.pop("translation")
    euler = {name: None if track is None else axis_angle_to_euler(track) for name, track in tracks.items()}
    left, right = (None, None) if eyes is None else (axis_angle_to_euler(eyes[:, :3]), axis_angle_to_euler(eyes[:, 3:]))
    rate = fps if fps is not None else _rate(fields.get("fps"), warnings)
    if progress:
        progress(1.0)
    return Performance(
        np.arange(count) / rate,
        np.zeros((count, len(ARKIT_NAMES)), np.float32),
        rate,
        "flame-npz",
        head_rotation=euler["rotation"],
        neck_rotation=euler["neck_pose"],
        jaw_rotation=euler["jaw_pose"],
        left_eye_rotation=left,
        right_eye_rotation=right,
        expression=expression,
        translation=translation,
        shape=_shape(path, fields.get("shape"), warnings),
        static_offset=_static_offset(path, fields.get("static_offset")),
        head_model="flame",
        warnings=warnings,
    )


_TRACKS = {"rotation": 3, "neck_pose": 3, "jaw_pose": 3, "eyes_pose": 6, "translation": 3, "pose": 6}


def is_track(path: Path) -> bool:
    """Whether a file is an npz with expression coefficients and no FLAME model. Raises nothing for other files."""
    try:
        return bool(set(read_npz(path, ())[1]) & set(_ALIASES["expr"]))
    except GrmmError:
        return False


def _expression(path: Path, array: np.ndarray, warnings: list[str]) -> np.ndarray:
    """Coefficients [T, 100] float32, padded with zeros where there are fewer."""
    array = array[None] if array.ndim == 1 else array
    if array.ndim == 3 and array.shape[1] == 1:
        array = array[:, 0]
    if array.ndim != 2 or not 1 <= array.shape[1] <= FLAME_EXPRESSIONS or not 1 <= array.shape[0] <= MAX_FRAMES:
        raise bad_file(path, KIND, f"its expression has shape {array.shape} and not (frames, {FLAME_EXPRESSIONS})")
    values = np.zeros((array.shape[0], FLAME_EXPRESSIONS), np.float32)
    with np.errstate(over="ignore", invalid="ignore"):
        values[:, : array.shape[1]] = array
    values[~(np.abs(values) < _MAX_COEFFICIENT)] = np.nan
    fill_missing(path, KIND, values, "expression coefficients", warnings)
    if array.shape[1] < FLAME_EXPRESSIONS:
        count = array.shape[1]
        warnings.append(f"The file has {count} of FLAME's {FLAME_EXPRESSIONS} expression coefficients; the rest are zero.")
    return values


def _track(
    path: Path, fields: dict[str, np.ndarray], name: str, count: int, width: int, warnings: list[str]
) -> np.ndarray | None:
    """Per-frame values [T, width] float64, or None. One row stands for all frames."""
    if name not in fields:
        return None
    array = fields[name]
    array = array[None] if array.ndim == 1 else array
    if array.ndim != 2 or array.shape[1] != width or array.shape[0] not in (1, count):
        raise bad_file(path, KIND, f"its {name} has shape {array.shape} and not ({count}, {width})")
    with np.errstate(invalid="ignore"):  # a signalling NaN
        values = np.array(np.broadcast_to(array, (count, width)), np.float64)
    values[~(np.abs(values) < 1e6)] = np.nan
    return fill_missing(path, KIND, values, name, warnings)


def _shape(path: Path, array: np.ndarray | None, warnings: list[str]) -> np.ndarray | None:
    if array is None:
        return None
    if array.ndim == 2 and array.shape[0] > 1:
        array = array.mean(0)
        warnings.append("The file has a shape for every frame; their mean is used.")
    array = array.reshape(-1)
    if not 1 <= array.size <= FLAME_SHAPES or not np.isfinite(array).all():
        raise bad_file(path, KIND, f"its shape has {array.size} coefficients or values that are not finite")
    return array.astype(np.float32)


def _static_offset(path: Path, array: np.ndarray | None) -> np.ndarray | None:
    if array is None:
        return None
    array = array[0] if array.ndim == 3 and array.shape[0] == 1 else array
    if array.ndim != 2 or array.shape[0] not in _VERTEX_COUNTS or array.shape[1] != 3 or not np.isfinite(array).all():
        raise bad_file(path, KIND, f"its static_offset has shape {array.shape} or values that are not finite")
    return array.astype(np.float32)


def _rate(array: np.ndarray | None, warnings: list[str]) -> float:
    if array is not None and array.size == 1 and 1.0 <= float(array.reshape(-1)[0]) <= 1000.0:
        return float(array.reshape(-1)[0])
    warnings.append(f"The file states no frame rate; {DEFAULT_FPS:g} frames per second were assumed.")
    return DEFAULT_FPS


def write_flame_npz(
    path: str | os.PathLike[str], performance: Performance, progress: Share | None = None, vertex_count: int = 0
) -> None:
    """Write GaussianAvatars' `flame_param.npz`: axis-angle rotations, 300 shape and 100 expression coefficients.

    Args:
        path: Target file.
        performance: With expression coefficients.
        progress: Not used; a track is written at once.
        vertex_count: Of the mesh, for files of an avatar, whose loader also wants an offset of each vertex, for all frames
            and for each; 0 leaves out what the performance does not have.

    Raises:
        ShapeError: The performance has ARKit weights, or more coefficients than FLAME.
        FileAccessError: The file cannot be written.
    """
    if performance.expression is None:
        raise ShapeError(
            "A FLAME file holds expression coefficients and this performance has ARKit weights; retarget it to FLAME first."
        )
    count, width = performance.expression.shape
    if width > FLAME_EXPRESSIONS:
        raise ShapeError(
            f"FLAME has {FLAME_EXPRESSIONS} expression coefficients and this performance {width}; retarget it first."
        )
    expression = np.zeros((count, FLAME_EXPRESSIONS), np.float32)
    expression[:, :width] = performance.expression
    shape = np.zeros(FLAME_SHAPES, np.float32)
    if performance.shape is not None:
        shape[: performance.shape.size] = performance.shape
    arrays: dict[str, np.ndarray] = {"shape": shape, "expr": expression, "fps": np.array(performance.fps, np.float32)}
    for key, name in (("rotation", "head_rotation"), ("neck_pose", "neck_rotation"), ("jaw_pose", "jaw_rotation")):
        arrays[key] = _axis_angle(getattr(performance, name), count)
    eyes = (performance.left_eye_rotation, performance.right_eye_rotation)
    arrays["eyes_pose"] = np.concatenate([_axis_angle(eye, count) for eye in eyes], 1)
    translation = performance.translation
    arrays["translation"] = np.zeros((count, 3), np.float32) if translation is None else np.asarray(translation, np.float32)
    if performance.static_offset is not None:
        arrays["static_offset"] = np.asarray(performance.static_offset, np.float32)[None]
    if vertex_count:
        arrays.setdefault("static_offset", np.zeros((1, vertex_count, 3), np.float32))
        arrays["dynamic_offset"] = np.broadcast_to(np.float32(0.0), (count, vertex_count, 3))
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    atomic_write_bytes(path, buffer.getvalue())


def _axis_angle(euler: np.ndarray | None, count: int) -> np.ndarray:
    return np.zeros((count, 3), np.float32) if euler is None else euler_to_axis_angle(euler).astype(np.float32)


FORMAT = Format(
    "flame-npz", "FLAME (.npz)",
    "FLAME's expression coefficients and joint rotations, as GaussianAvatars and VHAP store them", "performance",
    (".npz",), read_flame_npz, write_flame_npz, lambda path, start: start.startswith(b"PK"),
)  # fmt: skip
