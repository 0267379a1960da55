"""The one list of file formats. A new format is a module with a `FORMAT` and its name here.

The command line, the Blender operators and the file browsers ask `formats` what can be read and written. The modules, which
need numpy, are imported when somebody first asks; packages that a format needs beyond numpy only when such a file is read or
written.
"""

from __future__ import annotations

import functools
import importlib
from collections.abc import Iterable
from pathlib import Path

from ..errors import FileAccessError, FileFormatError
from ..files.access import read_start
from ..files.format import Format, Holds

MODULES = [
    "splats.ply",
    "splats.compressed_ply",
    "splats.splat_file",
    "splats.ksplat",
    "splats.spz",
    "splats.sog",
    "splats.gltf_splats",
    "avatars.gaussian_avatars",
    "avatars.lam",
    "avatars.cap4d",
    "meshes.gltf_mesh",
    "meshes.obj",
    "arrays",
    "performances.arkit_json",
    "performances.live_link_csv",
    "performances.audio2face_csv",
    "performances.face_cap",
    "performances.flame_npz",
]
"""In the order in which menus show them. Of formats with one suffix that recognise their files the last is asked first."""

Kinds = Holds | tuple[Holds, ...]


@functools.cache
def _load(names: tuple[str, ...]) -> tuple[Format, ...]:
    return tuple(importlib.import_module(f".{name}", __package__).FORMAT for name in names)


def formats(holds: Kinds | None = None, *, read: bool = False, written: bool = False) -> tuple[Format, ...]:
    """Return the known formats.

    Args:
        holds: Only those that hold this, or one of these.
        read: Only those that are read.
        written: Only those that are written.
    """
    kinds = (holds,) if isinstance(holds, str) else holds
    return tuple(
        found
        for found in _load(tuple(MODULES))
        if (kinds is None or found.holds in kinds)
        and (not read or found.reader is not None)
        and (not written or found.writer is not None)
    )


def suffixes(entries: Iterable[Format], shared: bool = True) -> tuple[str, ...]:
    """Endings of formats, each once; without `shared` only those that are theirs alone."""
    return tuple(dict.fromkeys(s for one in entries for s in (*one.suffixes, *(one.shared_suffixes if shared else ()))))


def format_to_read(path: Path, holds: Kinds | None = None) -> Format:
    """Return the format of a file or folder: by its name, and by its content where several formats share a suffix.

    Args:
        path: An existing file or folder.
        holds: Only formats that hold this, or one of these. Performances are recognised by their content under any name.

    Raises:
        FileFormatError: It is of no such format.
        FileAccessError: It has to be opened and is missing or unreadable.
    """
    known = formats(holds, read=True)
    if path.is_dir():
        candidates = [one for one in known if one.folder and (one.recognises is None or one.recognises(path, b""))]
        if not candidates:
            raise FileAccessError(f"{path} is a folder; choose a file.")
        return candidates[-1]
    candidates = [one for one in known if one.fits(path) or (holds == "performance" and one.recognises is not None)]
    if len(candidates) > 1 or holds == "performance":
        start = read_start(path)
        candidates = [one for one in candidates if one.recognises is None or one.recognises(path, start)]
    if not candidates and holds == "performance" and path.suffix.lower() in _RECORDINGS:
        raise FileFormatError(f"{path} is {_RECORDINGS[path.suffix.lower()]}")
    if not candidates:
        what = _NAMES["splats" if isinstance(holds, tuple) else holds][0] if holds else "a file"
        listed = ", ".join(suffixes(known))
        raise FileFormatError(f"{path} is not {what} that can be read, by its name and content; choose one of {listed}.")
    return max(candidates, key=lambda one: (one.recognises is not None, known.index(one)))


def format_to_write(path: Path, holds: Kinds) -> Format:
    """Return the format that a file name asks for. Raises `FileFormatError` where there is none."""
    known = formats(holds, written=True)
    for one in known:
        if path.name.lower().endswith(one.written_suffixes):
            return one
        if one.folder and not path.suffix:
            return one
    listed = ", ".join(dict.fromkeys(suffix for one in known for suffix in one.written_suffixes))
    what = _NAMES[holds if isinstance(holds, str) else holds[0]][1]
    raise FileFormatError(f"{what} cannot be written as {path.suffix!r}; choose one of {listed}.")


_NAMES: dict[Holds, tuple[str, str]] = {
    "splats": ("a splat file", "Splats"), "mesh": ("a mesh", "Meshes"), "avatar": ("an avatar", "Avatars"),
    "sequence": ("a sequence", "Sequences"), "performance": ("a performance", "Performances"), "arrays": ("a file", "Arrays"),
}  # fmt: skip
_VIDEO = "a video; import it as GRMM Performance from Video, or have grmm track make a performance of it."
_SOUND = "sound; import it as GRMM Performance from Voice, or have grmm speak make a performance of it."
_RECORDINGS = dict.fromkeys((".mp4", ".mov", ".m4v", ".avi", ".mkv", ".webm"), _VIDEO)
_RECORDINGS |= dict.fromkeys((".wav", ".mp3", ".m4a", ".flac", ".ogg", ".opus", ".aac", ".aiff"), _SOUND)
