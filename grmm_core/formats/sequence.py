"""A file for every frame: numbered splat files of an animation.

Called by the exporters. Every file appears whole or not at all; after a cancel those already written stay. Needs numpy only.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from ..errors import FileAccessError
from ..jobs.progress import Share
from . import write_splats
from .splats.cloud import SplatCloud

_DIGITS = 4


def frame_path(pattern: str | os.PathLike[str], frame: int) -> Path:
    """`head_####.ply` or `head.ply` with the frame number put in: `head_0012.ply`."""
    path = Path(pattern)
    hashes = path.name.count("#")
    sign, number = ("-" if frame < 0 else ""), abs(frame)
    if hashes and "#" * hashes in path.name:
        return path.with_name(path.name.replace("#" * hashes, f"{sign}{number:0{hashes}d}"))
    return path.with_name(f"{path.stem}_{sign}{number:0{_DIGITS}d}{path.suffix}")


def write_sequence(
    pattern: str | os.PathLike[str],
    frames: Iterable[int],
    splats_of: Callable[[int], SplatCloud],
    progress: Share | None = None,
    **options: object,
) -> list[Path]:
    """Write one splat file a frame.

    Args:
        pattern: File name with `####` for the frame number (or without: four digits are added); the extension names the format.
        frames: Frame numbers.
        splats_of: Gives the splats of a frame.
        progress: Called with the fraction done; raise `CancelledError` from it to stop.
        options: Passed to `write_splats`.

    Returns:
        The files written.

    Raises:
        FileAccessError: The folder does not exist or cannot be written.
        FileFormatError: Unknown extension.
    """
    folder = Path(pattern).parent
    if not folder.is_dir():
        raise FileAccessError(f"{folder} is not a folder; create it or choose another.")
    numbers = list(frames)
    written: list[Path] = []
    for i, frame in enumerate(numbers):
        if progress:
            progress(i / len(numbers))
        path = frame_path(pattern, frame)
        write_splats(path, splats_of(frame), **options)
        written.append(path)
    if progress:
        progress(1.0)
    return written
