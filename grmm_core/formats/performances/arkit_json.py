"""ARKit weights as JSON.

Layouts that programs write, all understood:

* ``{"names": [...], "metadata": {"fps": 30}, "frames": [{"weights": [...], "time": 0.0}]}`` (audio-driven avatars)
* frames whose ``weights`` or ``blendShapes`` is a map from name to value
* ``{"exportFps": 30, "facsNames": [...], "weightMat": [[...]]}`` (Audio2Face, also with its 46 shapes of its own)
* a plain list of frames ``{"time": 0.0, "jawOpen": 0.3, ...}``
* MediaPipe's results: a list of ``{"categoryName": "jawOpen", "score": 0.3}`` for each frame, bare or under ``faceBlendshapes``
  and ``categories``, as its Python and its JavaScript name them; a frame without a face is interpolated

Time stamps may be seconds, milliseconds, microseconds or nanoseconds. Frames may also carry ``headRotation``,
``leftEyeRotation`` and the like, `JSON_TRACKS`: XYZ Euler angles in radians in the head's axes. Our own writer adds them; other
programs ignore what they do not know.

Needs numpy only; Python's own `json` reads the text (ten minutes at 60 frames per second parse in about a second).
"""

from __future__ import annotations

import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...files.access import atomic_write_bytes, bad_file, read_bytes
from ...files.format import Format
from ...jobs.progress import Share
from ...performance.editing import range_warnings
from ...performance.types import Performance
from .repair import (
    MAX_FILE_BYTES,
    MAX_FRAMES,
    arkit_weights,
    clean_times,
    fill_missing,
    median_rate,
    missing_warning,
    report_frame,
    scale_times,
)
from .shapes import arkit_index
from .text_table import decode_text, start_text

KIND = "ARKit JSON performance"
DEFAULT_FPS = 30.0
_NAME_KEYS = ("names", "facsNames", "blendShapeNames", "blendshapeNames", "blendshape_names")
_FRAME_KEYS = ("frames", "weightMat", "data")
_WEIGHT_KEYS = ("weights", "blendShapes", "blendshapes", "blendShapeWeights", "values", "faceBlendshapes", "face_blendshapes")
_TIME_KEYS = ("time", "timestamp", "timeStamp", "timeCode", "timestampMs", "timestamp_ms", "timeMs", "time_ms")
_CATEGORY_KEYS = ("categoryName", "category_name")
_FPS_KEYS = ("fps", "exportFps", "frameRate", "frame_rate")
_REPORT_EVERY = 4096
_MAX_TIME = 1e20  # nanoseconds since 1970 are below 1e19
JSON_TRACKS = {
    "headRotation": "head_rotation",
    "neckRotation": "neck_rotation",
    "jawRotation": "jaw_rotation",
    "leftEyeRotation": "left_eye_rotation",
    "rightEyeRotation": "right_eye_rotation",
    "headTranslation": "translation",
}
"""Key in a frame to the attribute of `Performance`."""


def read_arkit_json(path: Path, fps: float | None = None, progress: Share | None = None) -> Performance:
    """Read ARKit weights from JSON.

    Args:
        path: The file.
        fps: Frame rate, over what the file says; 30 where neither says.
        progress: Called with the fraction done.

    Raises:
        FileFormatError: Not JSON, no known layout, no ARKit name, or unreadable frames.
        FileAccessError: Missing, unreadable or too large.
    """
    try:
        document = json.loads(decode_text(path, KIND, read_bytes(path, MAX_FILE_BYTES)))
    except (ValueError, RecursionError) as error:
        raise bad_file(path, KIND, "it is not JSON text") from error
    if progress:
        progress(0.4)
    frames = _first(document, _FRAME_KEYS) if isinstance(document, dict) else document
    if not isinstance(frames, list) or not frames:
        raise bad_file(path, KIND, "it has no list of frames")
    if len(frames) > MAX_FRAMES:
        raise bad_file(path, KIND, f"it has more than {MAX_FRAMES} frames")
    names = _names(path, document, frames)
    values, times = _values(path, frames, names, progress)

    warnings: list[str] = []
    weights, found = arkit_weights(path, KIND, names, values, warnings)

    tracks: dict[str, Any] = {name: _track(path, frames, key, warnings) for key, name in JSON_TRACKS.items()}
    stated = fps if fps is not None else _stated_fps(document)
    if fps is None and np.isfinite(times).all() and times.size > 1 and np.ptp(times) > 0:
        times, order = clean_times(scale_times(times, stated or DEFAULT_FPS, warnings), warnings)
        weights = weights[order]
        tracks = {name: None if track is None else track[order] for name, track in tracks.items()}
        rate = stated if stated is not None else median_rate(times, DEFAULT_FPS)
    else:
        rate = stated if stated is not None else DEFAULT_FPS
        times = np.arange(len(frames)) / rate
        if stated is None:
            warnings.append(f"The file states no frame rate; {DEFAULT_FPS:g} frames per second were assumed.")
    warnings += missing_warning(set(found)) + range_warnings(weights)
    if progress:
        progress(1.0)
    shapes = tuple(ARKIT_NAMES[i] for i in sorted(found))
    return Performance(times, weights, rate, "arkit-json", shapes, warnings=warnings, **tracks)


def _first(mapping: dict[str, Any], keys: tuple[str, ...]) -> Any:
    return next((mapping[key] for key in keys if key in mapping), None)


def _names(path: Path, document: Any, frames: list[Any]) -> list[str]:
    """Names of the weights' columns: the file's list, or the keys of the first frame that has any."""
    names = _first(document, _NAME_KEYS) if isinstance(document, dict) else None
    if names is None:
        row = next((row for row in map(_row, frames) if row), None)
        if isinstance(row, dict):
            keys = [key for key in row if isinstance(key, str)]
            numbers = [key for key in keys if isinstance(row[key], (int, float)) and key not in _TIME_KEYS]
            names = [key for key in keys if arkit_index(key) is not None] or numbers
        elif isinstance(row, list) and len(row) == len(ARKIT_NAMES):
            names = list(ARKIT_NAMES)
    if not isinstance(names, list) or not names or not all(isinstance(name, str) for name in names):
        raise bad_file(path, KIND, "it has no list of names")
    if len(names) > 10_000:
        raise bad_file(path, KIND, f"it has {len(names)} names")
    return names


def _row(frame: Any) -> Any:
    """Weights of a frame as a list or a map from name to value; MediaPipe's lists of categories become maps."""
    row = _first(frame, _WEIGHT_KEYS) if isinstance(frame, dict) else frame
    row = frame if row is None else row
    face = row
    if isinstance(face, list) and len(face) == 1 and not _is_category(face[0]):
        face = face[0]  # the only face of a list of faces
    if isinstance(face, dict) and "categories" in face:
        face = face["categories"]
    if isinstance(face, list) and face and all(map(_is_category, face)):
        return {_first(category, _CATEGORY_KEYS): category["score"] for category in face}
    return None if face == [] else row


def _is_category(value: Any) -> bool:
    return isinstance(value, dict) and "score" in value and isinstance(_first(value, _CATEGORY_KEYS), str)


def _values(path: Path, frames: list[Any], names: list[str], progress: Share | None) -> tuple[np.ndarray, np.ndarray]:
    """Weights [T, len(names)] and times [T]; what is missing is NaN."""
    count = len(names)
    rows: list[list[Any]] = []
    times = np.full(len(frames), np.nan)
    blank = [math.nan] * count
    values = np.empty((len(frames), count), np.float32)
    for i, frame in enumerate(frames):
        row = _row(frame)
        if isinstance(frame, dict):
            time = _first(frame, _TIME_KEYS)
            if isinstance(time, (int, float)) and abs(time) < _MAX_TIME:
                times[i] = time
        if isinstance(row, dict):
            row = [row.get(name, 0.0) for name in names]
        if not isinstance(row, list):
            row = blank
        elif len(row) != count:
            raise bad_file(path, KIND, f"frame {i} has {len(row)} weights for {count} names")
        rows.append(row)
        if len(rows) == _REPORT_EVERY or i == len(frames) - 1:
            start = i + 1 - len(rows)
            values[start : i + 1] = _to_floats(path, rows, start)
            rows.clear()
            if progress:
                progress(0.4 + 0.5 * (i + 1) / len(frames))
    return values, times


def _track(path: Path, frames: list[Any], key: str, warnings: list[str]) -> np.ndarray | None:
    """Three numbers of every frame, [T, 3], or None where the first frame has none; gaps are interpolated."""
    if not isinstance(frames[0], dict) or key not in frames[0]:
        return None
    found = [frame.get(key) if isinstance(frame, dict) else None for frame in frames]
    rows = [row if isinstance(row, list) and len(row) == 3 else [math.nan] * 3 for row in found]
    return fill_missing(path, KIND, _to_floats(path, rows, 0).astype(np.float64), key, warnings)


def _to_floats(path: Path, rows: list[list[Any]], start: int) -> np.ndarray:
    """Turn rows of JSON numbers to float32; null becomes NaN, text and lists are refused."""
    try:
        block = np.array(rows, np.float64)  # raises for text that is no number, lists and huge integers
    except (ValueError, TypeError, OverflowError) as error:
        raise bad_file(path, KIND, f"a weight in frames {start} to {start + len(rows) - 1} is not a number") from error
    if block.ndim != 2:
        raise bad_file(path, KIND, f"a weight in frames {start} to {start + len(rows) - 1} is not a number")
    block[np.abs(block) > 1e6] = np.nan
    return block.astype(np.float32)


def _stated_fps(document: Any) -> float | None:
    if not isinstance(document, dict):
        return None
    metadata = document.get("metadata")
    for place in (document, metadata if isinstance(metadata, dict) else {}):
        value = _first(place, _FPS_KEYS)
        if isinstance(value, (int, float)) and not isinstance(value, bool) and 1.0 <= value <= 1000.0:
            return float(value)
    return None


def write_arkit_json(path: str | os.PathLike[str], performance: Performance, progress: Share | None = None) -> None:
    """Write weights with a time and the rotations of every frame. Raises `FileAccessError`."""
    rows = []
    tracks = {key: getattr(performance, name) for key, name in JSON_TRACKS.items() if getattr(performance, name) is not None}
    for i, (time, weights) in enumerate(zip(performance.times.tolist(), performance.weights.tolist(), strict=True)):
        extra = "".join(f',"{key}":[{_numbers(track[i].tolist())}]' for key, track in tracks.items())
        rows.append(f'{{"weights":[{_numbers(weights)}],"time":{time:.9g}{extra}}}')
        report_frame(progress, i, performance.frame_count)
    # Written row by row: `json` would print every weight with the seventeen digits of double precision.
    metadata = {"fps": performance.fps, "frame_count": performance.frame_count}
    head = json.dumps({"names": list(ARKIT_NAMES), "metadata": metadata})
    text = head[:-1] + ',"frames":[\n' + ",\n".join(rows) + "\n]}\n"
    atomic_write_bytes(path, text.encode("ascii"))


def _numbers(values: list[float]) -> str:
    return ",".join(f"{value:.7g}" for value in values)


FORMAT = Format(
    "arkit-json", "ARKit JSON (.json)", "Weights of the 52 ARKit shapes, with head, jaw and eye rotations", "performance",
    (".json",), read_arkit_json, write_arkit_json, lambda path, start: start_text(start)[:1] in ("{", "["),
)  # fmt: skip
