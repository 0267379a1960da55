"""The one function that opens a performance of any format, chosen by what is in the file and not by its name alone."""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FileAccessError, FileFormatError
from ..files.access import describe_os_error
from .arkit_json import read_arkit_json
from .flame_npz import read_flame_npz
from .live_link_csv import Orientation, read_live_link_csv
from .types import Performance, Progress

_ZIP_MAGIC = b"PK"


def read_performance(
    path: str | os.PathLike[str],
    *,
    fps: float | None = None,
    orientation: Orientation = "portrait",
    progress: Progress | None = None,
) -> Performance:
    """Read an ARKit JSON, a Live Link Face CSV or a FLAME npz file.

    Args:
        path: The file.
        fps: Frame rate, over what the file states or implies.
        orientation: How the phone was held while Live Link Face recorded.
        progress: Called with the fraction done; raise `CancelledError` from it to stop.

    Returns:
        The performance; `warnings` says what was missing, repaired or assumed.

    Raises:
        FileFormatError: The file is of no known format, or damaged.
        FileAccessError: Missing, a folder, unreadable or too large.
    """
    path = Path(path)
    try:
        if path.is_dir():
            raise FileAccessError(f"{path} is a folder; choose a performance file.")
        with path.open("rb") as file:
            start = file.read(4096)
    except FileNotFoundError as error:
        raise FileAccessError(f"{path} does not exist; check the file name.") from error
    except OSError as error:
        raise FileAccessError(f"Cannot read {path}: {describe_os_error(error)}; check the file and its permissions.") from error
    except ValueError as error:  # a null character in the name
        raise FileAccessError("The file name contains a null character; choose another name.") from error
    text = start.removeprefix(b"\xef\xbb\xbf").lstrip()
    if start.startswith(_ZIP_MAGIC):
        return read_flame_npz(path, fps, progress)
    if text[:1] in (b"{", b"["):
        return read_arkit_json(path, fps, progress)
    if path.suffix.lower() in (".csv", ".txt") or b"timecode" in text.lower() or b"jawopen" in text.lower():
        return read_live_link_csv(path, fps, orientation, progress)
    raise FileFormatError(
        f"{path} is not a performance that can be read; choose an ARKit JSON, a Live Link Face CSV or a FLAME npz file."
    )
