"""The names of an animation's files, one for every frame."""

from __future__ import annotations

import os
from pathlib import Path

_DIGITS = 4


def frame_path(pattern: str | os.PathLike[str], frame: int) -> Path:
    """`head_####.ply` or `head.ply` with the frame number put in: `head_0012.ply`."""
    path = Path(pattern)
    hashes = path.name.count("#")
    sign, number = ("-" if frame < 0 else ""), abs(frame)
    if hashes and "#" * hashes in path.name:
        return path.with_name(path.name.replace("#" * hashes, f"{sign}{number:0{hashes}d}"))
    return path.with_name(f"{path.stem}_{sign}{number:0{_DIGITS}d}{path.suffix}")
