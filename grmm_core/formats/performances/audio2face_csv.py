"""NVIDIA Audio2Face-3D CSV: a time stamp in seconds, then a column `blendShapes.NAME` for each ARKit shape.

As NVIDIA's client writes it (`animation_frames.csv`). Columns of row numbers and of emotions are left alone; there is no head
rotation. Needs numpy only.
"""

from __future__ import annotations

from pathlib import Path

from ...controls.names import ARKIT_NAMES
from ...files.access import bad_file
from ...files.format import Format
from ...jobs.progress import Share
from ...performance.editing import range_warnings
from ...performance.types import Performance
from .repair import arkit_weights, fill_missing, missing_warning, times_of_stamps
from .text_table import read_table, start_text, to_floats

KIND = "Audio2Face-3D CSV"
DEFAULT_FPS = 30.0
_PREFIX = "blendshapes."


def read_audio2face_csv(path: Path, fps: float | None = None, progress: Share | None = None) -> Performance:
    """Read an Audio2Face-3D recording.

    Args:
        path: The file.
        fps: Frame rate, over that of the time stamps.
        progress: Called with the fraction done.

    Raises:
        FileFormatError: No ARKit shape, or most rows are unreadable.
        FileAccessError: Missing, unreadable or too large.
    """
    table = read_table(path, KIND, "timecode", progress)
    if table.texts is None:
        raise bad_file(path, KIND, "it has no column timeCode")
    warnings: list[str] = []
    columns = [k for k, name in enumerate(table.names) if name.lower().startswith(_PREFIX)]
    weights, found = arkit_weights(path, KIND, [table.names[k] for k in columns], table.values[:, columns], warnings)
    stamps = fill_missing(path, KIND, to_floats([[text] for text in table.texts]), "time stamp", warnings)[:, 0]
    times, order, rate = times_of_stamps(stamps, fps, DEFAULT_FPS, warnings)
    warnings += missing_warning(set(found)) + range_warnings(weights[order])
    if progress:
        progress(1.0)
    names = tuple(ARKIT_NAMES[i] for i in sorted(found))
    return Performance(times, weights[order], rate, "audio2face-csv", names, warnings=warnings)


FORMAT = Format(
    "audio2face", "Audio2Face-3D (.csv)", "Speech that NVIDIA's Audio2Face-3D turned into ARKit shapes", "performance",
    (".csv",), read_audio2face_csv, recognises=lambda path, start: _PREFIX in start_text(start),
)  # fmt: skip
