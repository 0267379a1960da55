"""Performances back to files: ARKit JSON, Live Link Face CSV, FLAME npz, as the readers of this package read them.

Called by the exporter and the command line. Needs numpy only.
"""

from __future__ import annotations

import io
import json
import math
import os
from pathlib import Path

import numpy as np

from ..controls.names import ARKIT_NAMES
from ..errors import FileFormatError, ShapeError
from ..files.access import atomic_write_bytes
from ..geometry.rotations import euler_to_axis_angle
from .arkit_json import JSON_TRACKS
from .flame_npz import FLAME_EXPRESSIONS, FLAME_SHAPES
from .live_link_csv import HEAD_SIGNS
from .types import Performance, Progress

EXTENSIONS = (".json", ".csv", ".npz")
_LIVE_LINK_ORDER = (
    "eyeBlinkLeft", "eyeLookDownLeft", "eyeLookInLeft", "eyeLookOutLeft", "eyeLookUpLeft", "eyeSquintLeft", "eyeWideLeft",
    "eyeBlinkRight", "eyeLookDownRight", "eyeLookInRight", "eyeLookOutRight", "eyeLookUpRight", "eyeSquintRight",
    "eyeWideRight", "jawForward", "jawRight", "jawLeft", "jawOpen", "mouthClose", "mouthFunnel", "mouthPucker", "mouthRight",
    "mouthLeft", "mouthSmileLeft", "mouthSmileRight", "mouthFrownLeft", "mouthFrownRight", "mouthDimpleLeft",
    "mouthDimpleRight", "mouthStretchLeft", "mouthStretchRight", "mouthRollLower", "mouthRollUpper", "mouthShrugLower",
    "mouthShrugUpper", "mouthPressLeft", "mouthPressRight", "mouthLowerDownLeft", "mouthLowerDownRight", "mouthUpperUpLeft",
    "mouthUpperUpRight", "browDownLeft", "browDownRight", "browInnerUp", "browOuterUpLeft", "browOuterUpRight", "cheekPuff",
    "cheekSquintLeft", "cheekSquintRight", "noseSneerLeft", "noseSneerRight", "tongueOut",
)  # fmt: skip
_ROTATION_COUNT = 9
_PARTS = (("Head", "head_rotation"), ("LeftEye", "left_eye_rotation"), ("RightEye", "right_eye_rotation"))
_SECONDS_PER_DAY = 86400
_REPORT_EVERY = 2048


def write_performance(path: str | os.PathLike[str], performance: Performance, progress: Progress | None = None) -> None:
    """Write a performance in the format that the extension names.

    Args:
        path: A .json (ARKit weights), .csv (Live Link Face) or .npz (FLAME parameters) file.
        performance: ARKit weights for .json and .csv, expression coefficients for .npz.
        progress: Called with the fraction done; raise `CancelledError` from it to stop before anything is written.

    Raises:
        FileFormatError: Unknown extension.
        ShapeError: The performance lacks what the format holds, or has values that are not finite.
        FileAccessError: The file cannot be written.
    """
    for name in ("times", *performance.channel_names()):
        if not np.isfinite(getattr(performance, name)).all():
            raise ShapeError(f"Performance.{name} has values that are not finite; remove these frames first.")
    extension = Path(path).suffix.lower()
    if extension == ".json":
        data = _json(performance, progress)
    elif extension == ".csv":
        data = _csv(performance, progress)
    elif extension == ".npz":
        data = _npz(performance)
    else:
        raise FileFormatError(f"Performances cannot be written as {extension!r}; choose one of {', '.join(EXTENSIONS)}.")
    atomic_write_bytes(path, data)
    if progress:
        progress(1.0)


def _json(performance: Performance, progress: Progress | None) -> bytes:
    rows = []
    tracks = {key: getattr(performance, name) for key, name in JSON_TRACKS.items() if getattr(performance, name) is not None}
    for i, (time, weights) in enumerate(zip(performance.times.tolist(), performance.weights.tolist(), strict=True)):
        extra = "".join(f',"{key}":[{_numbers(track[i].tolist())}]' for key, track in tracks.items())
        rows.append(f'{{"weights":[{_numbers(weights)}],"time":{time:.9g}{extra}}}')
        _report(progress, i, performance.frame_count)
    # Written row by row: `json` would print every weight with the seventeen digits of double precision.
    metadata = {"fps": performance.fps, "frame_count": performance.frame_count}
    head = json.dumps({"names": list(ARKIT_NAMES), "metadata": metadata})
    return (head[:-1] + ',"frames":[\n' + ",\n".join(rows) + "\n]}\n").encode("ascii")


def _numbers(values: list[float]) -> str:
    return ",".join(f"{value:.7g}" for value in values)


def _csv(performance: Performance, progress: Progress | None) -> bytes:
    """63 columns in the app's order. The time code counts frames of the nearest whole rate, with a decimal part."""
    order = [ARKIT_NAMES.index(name) for name in _LIVE_LINK_ORDER]
    angles = np.zeros((performance.frame_count, _ROTATION_COUNT))
    columns = []
    for part, (prefix, name) in enumerate(_PARTS):
        euler = getattr(performance, name)
        for k, axis in enumerate(("Yaw", "Pitch", "Roll")):
            columns.append(f"{prefix}{axis}")
            if euler is not None:
                angles[:, 3 * part + k] = euler[:, list(HEAD_SIGNS).index(axis)] * HEAD_SIGNS[axis]
    text = io.StringIO()
    names = [name[0].upper() + name[1:] for name in _LIVE_LINK_ORDER]
    text.write(",".join(["Timecode", "BlendShapeCount", *names, *columns]) + "\n")
    rate = max(1, math.ceil(performance.fps - 0.01))
    count = len(order) + _ROTATION_COUNT
    table = np.concatenate([performance.weights[:, order].astype(np.float64), angles], 1).tolist()
    for i, (time, row) in enumerate(zip(performance.times.tolist(), table, strict=True)):
        text.write(f"{_timecode(time, rate)},{count},{','.join(f'{value:.7g}' for value in row)}\n")
        _report(progress, i, performance.frame_count)
    return text.getvalue().encode("ascii")


def _timecode(seconds: float, rate: int) -> str:
    """HH:MM:SS:FF.fff with FF below `rate`; times before zero count from midnight."""
    thousandths = round((seconds % _SECONDS_PER_DAY) * rate * 1000)
    frames, part = divmod(thousandths, 1000)
    whole, frame = divmod(frames, rate)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}:{frame:02d}.{part:03d}"


def _npz(performance: Performance) -> bytes:
    """GaussianAvatars' `flame_param.npz`: axis-angle rotations, 300 shape and 100 expression coefficients."""
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
    arrays = {"shape": shape, "expr": expression, "fps": np.float32(performance.fps)}
    for key, name in (("rotation", "head_rotation"), ("neck_pose", "neck_rotation"), ("jaw_pose", "jaw_rotation")):
        arrays[key] = _axis_angle(getattr(performance, name), count)
    eyes = (performance.left_eye_rotation, performance.right_eye_rotation)
    arrays["eyes_pose"] = np.concatenate([_axis_angle(eye, count) for eye in eyes], 1)
    translation = performance.translation
    arrays["translation"] = np.zeros((count, 3), np.float32) if translation is None else np.asarray(translation, np.float32)
    if performance.static_offset is not None:
        arrays["static_offset"] = np.asarray(performance.static_offset, np.float32)[None]
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def _axis_angle(euler: np.ndarray | None, count: int) -> np.ndarray:
    return np.zeros((count, 3), np.float32) if euler is None else euler_to_axis_angle(euler).astype(np.float32)


def _report(progress: Progress | None, i: int, count: int) -> None:
    if progress and i % _REPORT_EVERY == 0:
        progress(0.95 * i / count)
