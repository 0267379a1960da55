"""Face Cap recordings: text with a line `bs,NAME,...` that names the shapes and a line `k,...` for each frame.

A frame has a time stamp in milliseconds, the head's position, its rotation about x, y and z in degrees, two angles of each eye
and a weight for each shape. The app documents neither the axes nor the signs of the angles: they are read as right-handed turns
about the head's axes, and single axes can be turned round. Eyes are taken from the eyeLook shapes, which say the same thing.
Needs numpy only.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ...controls.names import ARKIT_NAMES
from ...files.access import bad_file, read_bytes
from ...files.format import Format
from ...geometry.rotations import unwrap_euler
from ...jobs.progress import Share
from ...performance.editing import range_warnings
from ...performance.types import Performance
from .repair import MAX_FILE_BYTES, MAX_FRAMES, arkit_weights, fill_missing, missing_warning, times_of_stamps
from .text_table import decode_text, split_rows, start_text, to_floats
from .turns import FLIPS

KIND = "Face Cap recording"
DEFAULT_FPS = 60.0
_ROTATION = slice(4, 7)  # behind the time stamp and the position
_WEIGHTS = 11  # columns before the weights


def read_face_cap(
    path: Path,
    fps: float | None = None,
    progress: Share | None = None,
    flip_pitch: bool = False,
    flip_yaw: bool = False,
    flip_roll: bool = False,
) -> Performance:
    """Read a Face Cap recording.

    Args:
        path: The file.
        fps: Frame rate, over that of the time stamps.
        progress: Called with the fraction done.
        flip_pitch: Nod the other way.
        flip_yaw: Turn the other way.
        flip_roll: Tilt the other way.

    Raises:
        FileFormatError: No names, or frames of another length.
        FileAccessError: Missing, unreadable or too large.
    """
    text = decode_text(path, KIND, read_bytes(path, MAX_FILE_BYTES))
    names: list[str] = []
    frames: list[list[str]] = []
    for number, row in enumerate(split_rows(path, KIND, text)):
        tag, cells = row[0].strip().lower(), row[1:]
        if tag == "bs":
            names = [name.strip() for name in cells if name.strip()]
        elif tag == "k":
            if len(cells) < _WEIGHTS + len(names) or len(frames) >= MAX_FRAMES:
                raise bad_file(path, KIND, f"line {number + 1} has {len(cells)} values for {len(names)} shapes")
            frames.append(cells[: _WEIGHTS + len(names)])
    if not names or not frames:
        raise bad_file(path, KIND, "it has no line that names its shapes, or no frames")
    if progress:
        progress(0.5)
    values = to_floats(frames)
    warnings: list[str] = []
    weights, found = arkit_weights(path, KIND, names, values[:, _WEIGHTS:], warnings)
    turns = fill_missing(path, KIND, np.deg2rad(values[:, _ROTATION]), "head rotation", warnings)
    turns = unwrap_euler(turns * np.where([flip_pitch, flip_yaw, flip_roll], -1.0, 1.0))
    stamps = fill_missing(path, KIND, values[:, :1], "time stamp", warnings)[:, 0]
    times, order, rate = times_of_stamps(stamps, fps, DEFAULT_FPS, warnings, say_unit=False)
    warnings += missing_warning(set(found)) + range_warnings(weights[order])
    if progress:
        progress(1.0)
    used = tuple(ARKIT_NAMES[i] for i in sorted(found))
    return Performance(times, weights[order], rate, "face-cap", used, head_rotation=turns[order], warnings=warnings)


def _recognises(path: Path, start: bytes) -> bool:
    text = start_text(start)
    return text.startswith(("info,", "bs,", "k,")) and ("\nbs," in text or text.startswith("bs,"))


FORMAT = Format(
    "face-cap", "Face Cap (.txt)", "As the Face Cap app writes it", "performance",
    (), read_face_cap, recognises=_recognises, shared_suffixes=(".txt", ".csv"), reading=FLIPS,
)  # fmt: skip
