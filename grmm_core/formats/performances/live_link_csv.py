"""Live Link Face CSV: one row a frame, ARKit weights, head and eye rotations.

Read by `reading.read_performance`. Columns are found by name whatever their order and case, since it differs between versions
of the app. Time codes are ``HH:MM:SS:FF.fff``: FF counts frames, the decimals are a part of a frame. Rows without a face have
only their first columns. The app's rotations are radians: HeadYaw positive to the subject's left, HeadPitch positive up,
HeadRoll positive with the subject's left ear up; in landscape, pitch and yaw change sign. The app does not document these
signs: `HEAD_SIGNS` is the reading that its streaming look-alikes share, and eye signs are taken from the eyeLook shapes of the
same file, which are unambiguous. Needs numpy only; Python's `csv` splits the text.
"""

from __future__ import annotations

import csv
import io
import math
import os
import re
from pathlib import Path

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...files.access import atomic_write_bytes, bad_file, read_bytes
from ...files.format import Format, Option
from ...performance.editing import range_warnings
from ...performance.types import Performance, Progress
from .repair import (
    MAX_FILE_BYTES,
    MAX_FRAMES,
    arkit_index,
    clean_times,
    fill_missing,
    median_rate,
    missing_warning,
    report_frame,
    without_mark,
)

KIND = "Live Link Face CSV"
DEFAULT_FPS = 60.0
HEAD_SIGNS = {"Pitch": -1.0, "Yaw": 1.0, "Roll": 1.0}
"""Sign that turns the app's angle into the Euler angle about x, y, z of the head's axes."""
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
_STANDARD_RATES = (24, 25, 30, 48, 50, 60, 100, 120, 240)
_TIMECODE = re.compile(r"^(\d{1,3}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:\.\d+)?)$")
_REPORT_EVERY = 4096
_MAX_RADIANS = 2.0 * np.pi  # larger numbers must be degrees
_MIN_CORRELATION = 0.2


def read_live_link_csv(
    path: Path, fps: float | None = None, landscape: bool = False, progress: Progress | None = None
) -> Performance:
    """Read a Live Link Face recording.

    Args:
        path: The file.
        fps: Frame rate of the time code, over what is guessed from it.
        landscape: The phone was held sideways, which swaps the sign of the head's pitch and yaw.
        progress: Called with the fraction done.

    Raises:
        FileFormatError: No header with ARKit names, or most rows are unreadable.
        FileAccessError: Missing, unreadable or too large.
    """
    header, codes, values = _table(path, progress)
    shapes = {i: k for k, name in enumerate(header) if (i := arkit_index(name)) is not None}
    if not shapes:
        raise bad_file(path, KIND, "its first line names no ARKit shape")
    warnings: list[str] = []
    weights = np.zeros((values.shape[0], len(ARKIT_NAMES)), np.float32)
    weights[:, list(shapes)] = values[:, list(shapes.values())]
    fill_missing(path, KIND, weights, "weights", warnings)
    rotations = {
        part: _angles(path, header, values, part, landscape, weights, warnings) for part in ("Head", "LeftEye", "RightEye")
    }
    if values.shape[0] > 0 and codes is not None:
        times, rate = _times(path, codes, fps, warnings)
        times, order = clean_times(times, warnings)
        rate = fps or median_rate(times, rate)
    else:
        rate = fps or DEFAULT_FPS
        times, order = np.arange(values.shape[0]) / rate, np.arange(values.shape[0])
        warnings.append(f"The file has no time code; {rate:g} frames per second were assumed.")
    warnings += missing_warning(set(shapes)) + range_warnings(weights)
    if progress:
        progress(1.0)
    return Performance(
        times,
        weights[order],
        rate,
        "live-link-csv",
        tuple(ARKIT_NAMES[i] for i in sorted(shapes)),
        head_rotation=_pick(rotations["Head"], order),
        left_eye_rotation=_pick(rotations["LeftEye"], order),
        right_eye_rotation=_pick(rotations["RightEye"], order),
        timecodes=tuple(codes[i] for i in order) if codes is not None else None,
        warnings=warnings,
    )


def _pick(array: np.ndarray | None, order: np.ndarray) -> np.ndarray | None:
    return None if array is None else array[order]


def _table(path: Path, progress: Progress | None) -> tuple[list[str], list[str] | None, np.ndarray]:
    """Column names, time codes and all cells as numbers [T, columns]; cells that are missing or no number are NaN."""
    text = _decode(path)
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    rows = csv.reader(io.StringIO(text), delimiter=delimiter)
    try:
        header = [name.strip() for name in next(rows, [])]
        if len(header) < 2 or len(header) > 1000:
            raise bad_file(path, KIND, "its first line does not name columns")
        code_column = next((k for k, name in enumerate(header) if name.lower() == "timecode"), None)
        estimate = max(text.count("\n"), 1)
        codes: list[str] = []
        blocks: list[np.ndarray] = []
        block: list[list[str]] = []
        count = 0
        for row in rows:
            if not any(row):
                continue
            if len(row) > len(header):
                raise bad_file(path, KIND, f"row {count + 2} has {len(row)} cells for {len(header)} columns")
            row += [""] * (len(header) - len(row))
            if code_column is not None:
                codes.append(row[code_column].strip())
                row[code_column] = ""
            block.append(row)
            count += 1
            if count > MAX_FRAMES:
                raise bad_file(path, KIND, f"it has more than {MAX_FRAMES} frames")
            if len(block) == _REPORT_EVERY:
                blocks.append(_to_floats(block))
                block = []
                if progress:
                    progress(min(0.1 + 0.8 * count / estimate, 0.9))
    except csv.Error as error:
        raise bad_file(path, KIND, "it is not comma-separated text") from error
    if block:
        blocks.append(_to_floats(block))
    if not blocks:
        raise bad_file(path, KIND, "it has no frames")
    return header, codes if code_column is not None else None, np.concatenate(blocks)


def _decode(path: Path) -> str:
    data = read_bytes(path, MAX_FILE_BYTES)
    if b"\0" in data:
        raise bad_file(path, KIND, "it is not text")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise bad_file(path, KIND, "it is not text") from error


def _to_floats(rows: list[list[str]]) -> np.ndarray:
    """Cells to numbers, [rows, columns]; what is empty, no number or absurdly large is NaN."""
    flat = [cell or "nan" for row in rows for cell in row]
    try:
        values = np.fromiter(map(float, flat), np.float64, len(flat))
    except ValueError:
        values = np.fromiter(map(_float_or_nan, flat), np.float64, len(flat))
    values[~(np.abs(values) < 1e6)] = np.nan
    return values.reshape(len(rows), -1)


def _float_or_nan(cell: str) -> float:
    try:
        return float(cell)
    except ValueError:
        return float("nan")


def _angles(
    path: Path,
    header: list[str],
    values: np.ndarray,
    part: str,
    landscape: bool,
    weights: np.ndarray,
    warnings: list[str],
) -> np.ndarray | None:
    """Euler angles of the head or an eye in head axes, [T, 3], or None where the file has none."""
    lower = [name.lower() for name in header]
    columns = [lower.index(f"{part}{axis}".lower()) if f"{part}{axis}".lower() in lower else None for axis in HEAD_SIGNS]
    if all(column is None for column in columns):
        return None
    angles = np.zeros((values.shape[0], 3))
    for axis, column in enumerate(columns):
        if column is not None:
            angles[:, axis] = values[:, column]
    fill_missing(path, KIND, angles, f"{part} rotation", warnings)
    if np.abs(angles).max() > _MAX_RADIANS:
        angles = np.deg2rad(angles)
        warnings.append(f"The {part} rotation is too large for radians and was read as degrees.")
    angles *= list(HEAD_SIGNS.values())
    if part == "Head":
        if landscape:
            angles[:, :2] *= -1.0
    else:
        _match_eye_signs(angles, part.removesuffix("Eye"), weights)
    return angles


def _match_eye_signs(angles: np.ndarray, side: str, weights: np.ndarray) -> None:
    """Flip an eye's pitch and yaw where they contradict the eyeLook shapes of the same frames, in place."""
    ways = ("Up", "Down", "In", "Out")
    look = {way: weights[:, ARKIT_NAMES.index(f"eyeLook{way}{side}")].astype(np.float64) for way in ways}
    outward = look["Out"] - look["In"]
    directions = (look["Down"] - look["Up"], outward if side == "Left" else -outward)  # positive x down, positive y to the left
    for axis, direction in enumerate(directions):
        spread = angles[:, axis].std() * direction.std()
        if spread > 0:
            correlation = np.mean((angles[:, axis] - angles[:, axis].mean()) * (direction - direction.mean())) / spread
            if correlation < -_MIN_CORRELATION:
                angles[:, axis] *= -1.0


def _times(path: Path, codes: list[str], fps: float | None, warnings: list[str]) -> tuple[np.ndarray, float]:
    """Seconds of each time code [T] (NaN-free) and the rate of its frame count."""
    matches = [_TIMECODE.match(code) for code in codes]
    bad = [i for i, match in enumerate(matches) if match is None]
    if len(bad) > len(codes) / 2:
        raise bad_file(path, KIND, f"its time code {codes[bad[0]][:40]!r} is not of the form HH:MM:SS:FF.fff")
    parts = np.array([match.groups() if match else ("nan",) * 4 for match in matches], np.float64)  # [T, 4]
    good = np.isfinite(parts[:, 0])
    rate = fps or _timecode_rate(parts[good])
    times = parts @ np.array([3600.0, 60.0, 1.0, 1.0 / rate])
    if bad:
        index = np.arange(times.size)
        times[~good] = np.interp(index[~good], index[good], times[good])
        warnings.append(f"{len(bad)} frames had no valid time code (the first is frame {bad[0]}); their time was interpolated.")
    if fps is None and parts[good, 2].min() == parts[good, 2].max():
        warnings.append(f"The recording is too short to tell its frame rate; {rate:g} frames per second were assumed.")
    return times, rate


def _timecode_rate(parts: np.ndarray) -> float:
    """Rate of the frame count: the smallest usual one above the largest count; 60 where the file is within one second."""
    highest = float(parts[:, 3].max())
    rate = next((r for r in _STANDARD_RATES if r > highest), None)
    if rate is None:
        return float(np.ceil(highest + 1.0))
    whole_second_seen = parts[:, 2].min() != parts[:, 2].max()
    return float(rate if whole_second_seen else max(rate, DEFAULT_FPS))


def write_live_link_csv(path: str | os.PathLike[str], performance: Performance, progress: Progress | None = None) -> None:
    """Write 63 columns in the app's order. Raises `FileAccessError`.

    The time code counts frames of the nearest whole rate, with a decimal part.
    """
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
        report_frame(progress, i, performance.frame_count)
    atomic_write_bytes(path, text.getvalue().encode("ascii"))


def _timecode(seconds: float, rate: int) -> str:
    """HH:MM:SS:FF.fff with FF below `rate`; times before zero count from midnight."""
    thousandths = round((seconds % _SECONDS_PER_DAY) * rate * 1000)
    frames, part = divmod(thousandths, 1000)
    whole, frame = divmod(frames, rate)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}:{frame:02d}.{part:03d}"


def _recognises(path: Path, start: bytes) -> bool:
    text = without_mark(start).lower()
    if text[:1] in (b"{", b"[") or text.startswith(b"pk"):
        return False
    return path.suffix.lower() in (".csv", ".txt") or b"timecode" in text or b"jawopen" in text


FORMAT = Format(
    "live-link", "Live Link Face (.csv)", "As the Live Link Face app writes it", "performance",
    (".csv",), read_live_link_csv, write_live_link_csv, _recognises, (".txt",),
    reading=(
        Option("landscape", "Held in Landscape", "The phone was held sideways while Live Link Face recorded", False),
    ),
)  # fmt: skip
