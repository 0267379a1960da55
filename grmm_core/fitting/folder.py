"""The work folder of a fit: whose state it holds, what is thrown away, and what is refused before minutes are spent.

Only files that a fit has written are ever removed or replaced. Called by `api`; needs neither torch nor a model.
"""

from __future__ import annotations

import dataclasses
import json
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ..avatar import PhotoRecord
from ..errors import ConfigError, FileAccessError
from ..files.access import TEMPORARY_PATTERN, atomic_write_bytes, describe_os_error, read_bytes
from .request import FitRequest, work_folder

TRACKS_FILE, CODES_FILE, DECODERS_FILE = "tracks.safetensors", "codes.safetensors", "decoders.safetensors"
JOB_FILE, REQUEST_FILE, PREVIEW_FILE = "job.json", "request.json", "preview.png"
_STATE_FILES = (TRACKS_FILE, CODES_FILE, DECODERS_FILE, PREVIEW_FILE)


@dataclass(frozen=True)
class Job:
    """What identifies a fit in its work folder."""

    photos: tuple[PhotoRecord, ...]
    faces: tuple[int, ...]
    masks: tuple[str, ...]
    weights: str = ""
    head: str = ""

    def to_json(self) -> bytes:
        """The contents of `JOB_FILE`: JSON with sorted keys, so that equal jobs are equal files."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True).encode()


def check_photos_differ(photos: Sequence[PhotoRecord]) -> None:
    """Refuse a photo that was given twice: it would count twice. Raises `ConfigError`."""
    known: dict[str, str] = {}
    for photo in photos:
        if photo.sha256 in known:
            first = known[photo.sha256]
            names = f"{photo.name} was given twice" if first == photo.name else f"{first} and {photo.name} are the same photo"
            raise ConfigError(f"{names}; give each photo once.")
        known[photo.sha256] = photo.name


def check_writable(output: Path) -> None:
    """Refuse an output whose folder cannot be written. Raises `FileAccessError`."""
    try:
        with tempfile.TemporaryFile(dir=output.parent):
            pass
    except OSError as error:
        raise FileAccessError(
            f"Cannot write {output}: {describe_os_error(error)}; choose another folder or change its permissions."
        ) from error


def prepare(job: Job, request: FitRequest) -> Path:
    """Make the work folder; forget the state of another job, or all where nothing is to be resumed. Returns the folder.

    Raises:
        ConfigError: The folder holds something else; nothing in it is touched.
        FileAccessError: It cannot be written.
    """
    folder = request.work_folder
    try:
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / JOB_FILE
        if any(folder.iterdir()) and not path.exists() and not _only_ours(folder):
            raise ConfigError(f"{folder} holds other files; choose an empty folder, or none, for the state of the fit.")
        if not (request.resume and path.exists() and path.read_bytes() == job.to_json()):
            for name in _STATE_FILES:
                (folder / name).unlink(missing_ok=True)
        for unfinished in folder.glob(TEMPORARY_PATTERN):  # of a process that was killed
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise FileAccessError(f"Cannot write {folder}: {describe_os_error(error)}; choose another folder.") from error
    atomic_write_bytes(folder / JOB_FILE, job.to_json())
    photos, masks = (tuple(path.absolute() for path in paths) for paths in (request.photos, request.masks))
    asked = dataclasses.replace(request, photos=photos, masks=masks)
    atomic_write_bytes(folder / REQUEST_FILE, json.dumps(asked.to_json()).encode())
    return folder


def interrupted_request(output: Path, work: Path | None) -> FitRequest:
    """What the interrupted fit of an avatar's file was asked, to go on with it without naming photos and options again.

    Raises:
        ConfigError: There is none, or an earlier version left it.
    """
    folder = work if work is not None else work_folder(output)
    try:
        asked = FitRequest.from_json(json.loads(read_bytes(folder / REQUEST_FILE)))
    except (FileAccessError, ValueError) as error:
        raise ConfigError(f"{folder} holds no interrupted fit; name the photos.") from error
    return dataclasses.replace(asked, output=output, work=work, resume=True)


def can_resume(folder: Path) -> bool:
    """Whether a fit that was interrupted has left something to go on from."""
    return (folder / TRACKS_FILE).exists()


def _only_ours(folder: Path) -> bool:
    """A process may have been killed before the job's file was there."""
    return all(path.match(TEMPORARY_PATTERN) for path in folder.iterdir())
