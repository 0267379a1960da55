"""Live Link Face CSV: one row a frame, ARKit weights, head and eye rotations.

Columns are found by name whatever their order and case, since it differs between versions of the app. Time codes are
``HH:MM:SS:FF.fff``: FF counts frames, the decimals are a part of a frame. Rows without a face have only their first columns.

The app's rotations are radians, and it does not document their signs. `HEAD_SIGNS` is what Epic's own engine does with ARKit's
head (docs/formats.md derives it): yaw positive to the subject's right, pitch positive down, roll positive with the left ear
down; in landscape, pitch and yaw change sign. Eye signs are taken from the eyeLook shapes of the same file, which are
unambiguous. Needs numpy only.
"""

from __future__ import annotations

import io
import math
import os
import re
from pathlib import Path

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...files.access import atomic_write_bytes, bad_file
from ...files.format import Format, Option
from ...jobs.progress import Share
from ...performance.editing import range_warnings
from ...performance.types import Performance
from .repair import arkit_weights, clean_times, fill_missing, median_rate, missing_warning, report_frame
from .text_table import Table, read_table, start_text
from .turns import FLIPS, from_euler, match_eye_signs, to_euler

KIND = "Live Link Face CSV"
DEFAULT_FPS = 60.0
HEAD_SIGNS = {"Pitch": 1.0, "Yaw": -1.0, "Roll": -1.0}
"""Sign that turns the app's angle into the right-handed one about x, y, z of the head's axes."""
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
_TIMECODE = re.compile(r"^(\d{1,3}):(\d{1,2}):(\d{1,2})[:;](\d{1,3}(?:[.,]\d+)?)$")
_MAX_RADIANS = 2.0 * np.pi  # larger numbers must be degrees


def read_live_link_csv(
    path: Path,
    fps: float | None = None,
    progress: Share | None = None,
    landscape: bool = False,
    flip_pitch: bool = False,
    flip_yaw: bool = False,
    flip_roll: bool = False,
) -> Performance:
    """Read a Live Link Face recording.

    Args:
        path: The file.
        fps: Frame rate of the time code, over what is guessed from it.
        progress: Called with the fraction done.
        landscape: The phone was held sideways, which swaps the sign of the head's pitch and yaw.
        flip_pitch: Nod the other way, after `landscape`; likewise the next two.
        flip_yaw: Turn the other way.
        flip_roll: Tilt the other way.

    Raises:
        FileFormatError: No header with ARKit names, or most rows are unreadable.
        FileAccessError: Missing, unreadable or too large.
    """
    table = read_table(path, KIND, "timecode", progress)
    codes, values = table.texts, table.values
    warnings: list[str] = []
    weights, found = arkit_weights(path, KIND, table.names, values, warnings)
    signs = np.where([flip_pitch, flip_yaw, flip_roll], -1.0, 1.0) * ((-1.0, -1.0, 1.0) if landscape else 1.0)
    rotations = {
        "Head": _angles(path, table, "Head", warnings, signs),
        **{f"{side}Eye": _angles(path, table, f"{side}Eye", warnings, weights=weights) for side in ("Left", "Right")},
    }
    if values.shape[0] > 0 and codes is not None:
        times, rate = _times(path, codes, fps, warnings)
        times, order = clean_times(times, warnings)
        rate = fps or median_rate(times, rate)
    else:
        rate = fps or DEFAULT_FPS
        times, order = np.arange(values.shape[0]) / rate, np.arange(values.shape[0])
        warnings.append(f"The file has no time code; {rate:g} frames per second were assumed.")
    warnings += missing_warning(set(found)) + range_warnings(weights)
    if progress:
        progress(1.0)
    return Performance(
        times,
        weights[order],
        rate,
        "live-link-csv",
        tuple(ARKIT_NAMES[i] for i in sorted(found)),
        head_rotation=_pick(rotations["Head"], order),
        left_eye_rotation=_pick(rotations["LeftEye"], order),
        right_eye_rotation=_pick(rotations["RightEye"], order),
        timecodes=tuple(codes[i] for i in order) if codes is not None else None,
        warnings=warnings,
    )


def _pick(array: np.ndarray | None, order: np.ndarray) -> np.ndarray | None:
    return None if array is None else array[order]


def _angles(
    path: Path,
    table: Table,
    part: str,
    warnings: list[str],
    signs: np.ndarray | None = None,
    weights: np.ndarray | None = None,
) -> np.ndarray | None:
    """Euler angles of the head (with `signs` [3]) or an eye (with the ARKit `weights` [T, 52]), [T, 3], None without any."""
    columns = [table.column(f"{part}{axis}") for axis in HEAD_SIGNS]
    if all(column is None for column in columns):
        return None
    angles = np.zeros((table.values.shape[0], 3))
    for axis, column in enumerate(columns):
        if column is not None:
            angles[:, axis] = table.values[:, column]
    fill_missing(path, KIND, angles, f"{part} rotation", warnings)
    if np.abs(angles).max() > _MAX_RADIANS:
        angles = np.deg2rad(angles)
        warnings.append(f"The {part} rotation is too large for radians and was read as degrees.")
    angles *= list(HEAD_SIGNS.values())
    if signs is not None:
        angles *= signs
    if weights is not None:
        match_eye_signs(angles, part.removesuffix("Eye"), weights)
    return to_euler(angles)


def _times(path: Path, codes: list[str], fps: float | None, warnings: list[str]) -> tuple[np.ndarray, float]:
    """Seconds of each time code [T] (NaN-free) and the rate of its frame count."""
    matches = [_TIMECODE.match(code) for code in codes]
    bad = [i for i, match in enumerate(matches) if match is None]
    if len(bad) > len(codes) / 2:
        raise bad_file(path, KIND, f"its time code {codes[bad[0]][:40]!r} is not of the form HH:MM:SS:FF.fff")
    fields = [[part.replace(",", ".") for part in match.groups()] if match else ["nan"] * 4 for match in matches]
    parts = np.array(fields, np.float64)  # [T, 4]
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


def write_live_link_csv(path: str | os.PathLike[str], performance: Performance, progress: Share | None = None) -> None:
    """Write 63 columns in the app's order. Raises `FileAccessError`.

    The time code counts frames of a rate that `read_live_link_csv` finds again, with a decimal part.
    """
    order = [ARKIT_NAMES.index(name) for name in _LIVE_LINK_ORDER]
    angles = np.zeros((performance.frame_count, _ROTATION_COUNT))
    columns = []
    for part, (prefix, name) in enumerate(_PARTS):
        euler = getattr(performance, name)
        for k, axis in enumerate(("Yaw", "Pitch", "Roll")):
            columns.append(f"{prefix}{axis}")
            if euler is not None:
                angles[:, 3 * part + k] = from_euler(euler)[:, list(HEAD_SIGNS).index(axis)] * HEAD_SIGNS[axis]
    text = io.StringIO()
    names = [name[0].upper() + name[1:] for name in _LIVE_LINK_ORDER]
    text.write(",".join(["Timecode", "BlendShapeCount", *names, *columns]) + "\n")
    rate = _written_rate(performance)
    count = len(order) + _ROTATION_COUNT
    table = np.concatenate([performance.weights[:, order].astype(np.float64), angles], 1).tolist()
    for i, (time, row) in enumerate(zip(performance.times.tolist(), table, strict=True)):
        text.write(f"{_timecode(time, rate)},{count},{','.join(f'{value:.7g}' for value in row)}\n")
        report_frame(progress, i, performance.frame_count)
    atomic_write_bytes(path, text.getvalue().encode("ascii"))


def _written_rate(performance: Performance) -> int:
    """The usual rate above the recording's; within one second that by which `_timecode_rate` reads it."""
    if performance.times[0] // 1.0 == performance.times[-1] // 1.0:
        return int(DEFAULT_FPS)
    slowest = performance.fps - 0.01
    return next((rate for rate in _STANDARD_RATES if rate >= slowest), math.ceil(slowest))


def _timecode(seconds: float, rate: int) -> str:
    """HH:MM:SS:FF.fff with FF below `rate`; times before zero count from midnight."""
    thousandths = round((seconds % _SECONDS_PER_DAY) * rate * 1000)
    frames, part = divmod(thousandths, 1000)
    whole, frame = divmod(frames, rate)
    return f"{whole // 3600:02d}:{whole // 60 % 60:02d}:{whole % 60:02d}:{frame:02d}.{part:03d}"


def _recognises(path: Path, start: bytes) -> bool:
    text = start_text(start)
    if text[:1] in ("{", "[") or start.startswith(b"PK"):
        return False
    return path.suffix.lower() in (".csv", ".txt") or "timecode" in text or "jawopen" in text


FORMAT = Format(
    "live-link", "Live Link Face (.csv)", "As the Live Link Face app writes it", "performance",
    (".csv",), read_live_link_csv, write_live_link_csv, _recognises, (".txt",),
    reading=(
        Option("landscape", "Held in Landscape", "The phone was held sideways while Live Link Face recorded", False),
        *FLIPS,
    ),
)  # fmt: skip
