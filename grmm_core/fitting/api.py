"""Photos to a `.grmm` file: analysis, tracking, inversion, thumbnail, provenance.

    result = fit(["anna.jpg"], "anna.grmm", preset="fast", progress=show)

The work folder keeps what an interrupted fit has done; the avatar's file appears when it is complete, or not at all.
Called by the command line and by Blender's fit job. Importing this module is light; calling `fit` imports torch.
"""

from __future__ import annotations

import dataclasses
import datetime
import hashlib
import logging
import os
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..avatar import EXTENSION, Avatar, PhotoRecord, save_avatar
from ..errors import CancelledError, ConfigError, FileAccessError, FileFormatError
from ..files.access import atomic_write_bytes, read_bytes
from ..pictures.images import encode_png
from .folder import PREVIEW_FILE, TRACKS_FILE, WORK_SUFFIX, Job, can_resume, check_photos_differ, check_writable, prepare
from .presets import Preset, preset_named
from .types import PhotoTrack, load_tracks, save_tracks

if TYPE_CHECKING:
    from ..head import HeadModel

STAGES = ("analyse", "track", "codes", "decoders")
MAX_PHOTOS = 16
MAX_PHOTO_BYTES = 1 << 30

Progress = Callable[[str, float, float, str], None]
"""Called with the stage, its share done 0..1, the seconds left (NaN while unknown) and the path of a preview or ""."""
Faces = Callable[[str, np.ndarray], None]
"""Called for each photo with its path and the faces' boxes, [K, 4] pixels: left, top, right, bottom."""

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitResult:
    """A finished fit.

    Attributes:
        path: The avatar's file.
        avatar: What is in it.
        seconds: Time taken, without what an earlier, interrupted run did.
        rmse: Root mean square color error in each photo's view, inside the mask.
        landmark_error: Mean landmark distance of each photo relative to the eye distance.
        tracks: What tracking found in the photos.
    """

    path: Path
    avatar: Avatar
    seconds: float
    rmse: tuple[float, ...]
    landmark_error: tuple[float, ...]
    tracks: tuple[PhotoTrack, ...] = ()


def fit(
    photos: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    *,
    preset: str = "standard",
    faces: Sequence[int] = (0,),
    masks: Sequence[str | os.PathLike[str]] = (),
    weights: str | os.PathLike[str] | None = None,
    head: str | os.PathLike[str] | None = None,
    device: str = "auto",
    threads: int | None = None,
    work: str | os.PathLike[str] | None = None,
    resume: bool = False,
    name: str = "",
    progress: Progress | None = None,
    on_faces: Faces | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> FitResult:
    """Make an avatar of the person in one or several photos and write it.

    The persons in the photos must have agreed; the file says that it was made from photos and names them with their hashes.

    Args:
        photos: Files, the one whose light the avatar shall have first.
        output: `.grmm` file to write.
        preset: "fast", "standard" or "high".
        faces: Which face of each photo, counted from 0, the largest first; a single number counts for all photos.
        masks: Pictures of the person's outline (white on black), one for each photo, in its order; empty finds the outline.
        weights: Name of installed weights, or a file; None for the embedded ones.
        head: Head file for weights of another head model than the open one.
        device: "auto", "cpu", "cuda" or "mps".
        threads: CPU threads; None leaves it to the libraries.
        work: Folder for the state; None is a folder beside the output. It is removed when the avatar is written, unless given.
        resume: Go on from the state in the work folder, if it is of the same photos; otherwise it is overwritten.
        name: Display name of the avatar; the output's file name when empty.
        progress: Called often.
        on_faces: Called when the faces of a photo are known.
        cancelled: Asked often; True ends the work with the state saved.

    Raises:
        NoFaceError, FileAccessError, FileFormatError: A photo, mask, or the output cannot be used.
        ConfigError: Wrong arguments.
        CancelledError: `cancelled` said so; the same call with `resume` goes on.
        SessionError: Out of memory.
    """
    output, faces = Path(output), tuple(faces) or (0,)
    settings = preset_named(preset)
    _check(photos, output, masks, faces)
    chosen = faces if len(faces) == len(photos) else faces * len(photos)
    job = Job(
        tuple(PhotoRecord(Path(photo).name, _hash(photo)) for photo in photos), chosen, tuple(_hash(mask) for mask in masks),
        os.fspath(weights or ""), os.fspath(head or ""),
    )  # fmt: skip
    check_photos_differ(job.photos)
    _check_pictures(photos, masks)
    check_writable(output)
    begin = time.monotonic()
    folder = Path(work) if work is not None else output.with_name(output.name + WORK_SUFFIX)
    prepare(folder, job, resume)
    relay = _Relay(progress, cancelled, folder)
    done = False
    try:
        avatar, tracks = _make(
            photos, job, masks, name or output.stem, settings, weights, head, device, threads, folder, resume, relay, on_faces
        )
        save_avatar(avatar, output)
        done = True
    except CancelledError as error:
        kept = "what it has done is kept for --resume" if can_resume(folder) else "it had not found the person yet"
        raise CancelledError(f"The fit was cancelled; {kept}.") from error
    finally:
        if work is None and (done or not can_resume(folder)):
            shutil.rmtree(folder, ignore_errors=True)
    figures = [tuple(float(value) for value in avatar.tracking[key]) for key in ("rmse", "landmark_error")]
    return FitResult(output, avatar, time.monotonic() - begin, *figures, tuple(tracks))


def _make(
    photos: Sequence[str | os.PathLike[str]], job: Job, masks: Sequence[str | os.PathLike[str]], name: str, settings: Preset,
    weights: str | os.PathLike[str] | None, head_file: str | os.PathLike[str] | None, device: str, threads: int | None,
    folder: Path, resume: bool, relay: _Relay, on_faces: Faces | None,
) -> tuple[Avatar, list[PhotoTrack]]:  # fmt: skip
    """The avatar, complete but not written, and what tracking found."""
    relay.check()

    from ..compute.devices import choose_device, limit_rasteriser_threads
    from ..model.portrait import thumbnail
    from ..model.store import ModelStore, with_deltas
    from .invert import invert, photo_errors

    if threads is not None:
        import torch

        torch.set_num_threads(threads)
        limit_rasteriser_threads(threads)
    loaded = ModelStore(weights, choose_device(device), head_file).default()
    head = loaded.model.head_model
    tracks = _tracks(photos, job, head, masks, folder, resume, relay, on_faces)
    avatar = invert(
        tracks, loaded.model, head, settings, info=loaded.info, name=name, work=folder, progress=relay.with_picture,
        cancelled=relay.wants_to_stop,
    )  # fmt: skip
    person = with_deltas(loaded.model, avatar.deltas, folder)
    figures = {"rmse": photo_errors(person, avatar, tracks), "landmark_error": [track.landmark_error for track in tracks]}
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    avatar = dataclasses.replace(
        avatar,
        provenance=dataclasses.replace(avatar.provenance, photos=job.photos, date=today),
        tracking={**avatar.tracking, **{key: np.array(values, np.float32) for key, values in figures.items()}},
        thumbnail=thumbnail(person, avatar),
    )
    relay.check()
    return avatar, tracks


class _Relay:
    """Forwards progress, writes previews, and turns a wish to cancel into the error that ends the work."""

    def __init__(self, progress: Progress | None, cancelled: Callable[[], bool] | None, folder: Path) -> None:
        self._progress, self._cancelled, self._folder = progress, cancelled, folder
        self._preview = ""

    def check(self) -> None:
        """Raise `CancelledError` if the user has cancelled."""
        if self.wants_to_stop():
            raise CancelledError("The fit was cancelled.")

    def wants_to_stop(self) -> bool:
        """Whether the user has cancelled."""
        return self._cancelled is not None and self._cancelled()

    def __call__(self, stage: str, share: float) -> None:
        """Report a stage without picture or time."""
        self.check()
        if self._progress is not None:
            self._progress(stage, min(max(share, 0.0), 1.0), float("nan"), self._preview)

    def with_picture(self, stage: str, share: float, left: float, picture: np.ndarray | None) -> None:
        """Report a stage of the inversion."""
        if self._progress is None:
            return
        if picture is not None:
            path = self._folder / PREVIEW_FILE
            atomic_write_bytes(path, encode_png(picture))
            self._preview = str(path)
        self._progress(stage, min(max(share, 0.0), 1.0), left, self._preview)


def _tracks(
    photos: Sequence[str | os.PathLike[str]], job: Job, head: HeadModel, masks: Sequence[str | os.PathLike[str]], folder: Path,
    resume: bool, relay: _Relay, on_faces: Faces | None,
) -> list[PhotoTrack]:  # fmt: skip
    """Track the photos, or read what an interrupted run has tracked."""
    from .track import analyse_photo, track_photos

    path = folder / TRACKS_FILE
    if resume and path.exists():
        try:
            known = load_tracks(path)
            if len(known) == len(photos):
                return known
        except (FileFormatError, FileAccessError) as error:
            logger.warning("the photos are tracked anew: %s", error)
    analysed = []
    for index, photo in enumerate(photos):
        relay("analyse", index / len(photos))
        found = analyse_photo(photo)
        if on_faces is not None:
            on_faces(os.fspath(photo), np.stack([one.box for one in found.faces]) / found.photo.scale)
        check_face(photo, job.faces[index], len(found.faces))
        analysed.append(found)
    relay("analyse", 1.0)
    outlines = [read_mask(mask) for mask in masks] or None
    tracks = track_photos(
        analysed, head, faces=job.faces, masks=outlines,
        progress=lambda share: relay("track", share), cancelled=relay.wants_to_stop,
    )  # fmt: skip
    save_tracks(path, tracks)
    return tracks


def _check(
    photos: Sequence[str | os.PathLike[str]], output: Path, masks: Sequence[str | os.PathLike[str]], faces: Sequence[int]
) -> None:  # fmt: skip
    """Refuse what cannot work before minutes are spent."""
    _check_photos(photos, masks, faces)
    if output.suffix != EXTENSION:
        raise ConfigError(f"{output.name} does not end in {EXTENSION}; name the avatar's file NAME{EXTENSION}.")
    if not output.parent.is_dir():
        raise FileAccessError(f"The folder {output.parent} does not exist; make it or choose another one.")
    if output.is_dir():
        raise FileAccessError(f"{output} is a folder; give a file name.")


def _check_pictures(photos: Sequence[str | os.PathLike[str]], masks: Sequence[str | os.PathLike[str]]) -> None:
    """Refuse files that are no pictures, and masks of another proportion than their photos, before torch is loaded."""
    from ..photo.load import check_proportion, picture_size

    sizes = [picture_size(photo) for photo in photos]
    for photo, size, mask in zip(photos, sizes, masks, strict=False):
        check_proportion(picture_size(mask), size, Path(photo).name)


def check_masks(photos: Sequence[str | os.PathLike[str]], masks: Sequence[str | os.PathLike[str]]) -> None:
    """Refuse a number of outlines that is not the photos'. Raises `ConfigError`."""
    if masks and len(masks) != len(photos):
        raise ConfigError(f"{len(masks)} masks were given for {len(photos)} photos; give one for each, or none.")


def check_faces(photos: Sequence[str | os.PathLike[str]], faces: Sequence[int]) -> None:
    """Refuse a number of chosen faces that is neither none, one, nor the photos'. Raises `ConfigError`."""
    if len(faces) not in (0, 1, len(photos)):
        raise ConfigError(f"{len(faces)} faces were chosen for {len(photos)} photos; choose one for each, or one for all.")


def _check_photos(
    photos: Sequence[str | os.PathLike[str]], masks: Sequence[str | os.PathLike[str]], faces: Sequence[int]
) -> None:
    if not photos:
        raise ConfigError("No photo was given; choose at least one.")
    if len(photos) > MAX_PHOTOS:
        raise ConfigError(f"{len(photos)} photos were given; use at most {MAX_PHOTOS}.")
    check_masks(photos, masks)
    check_faces(photos, faces)


def check_face(photo: str | os.PathLike[str], face: int, count: int) -> None:
    """Refuse a face, counted from 0, that a photo does not show. Raises `ConfigError`."""
    if not 0 <= face < count:
        raise ConfigError(
            f"{Path(photo).name} shows {count} usable face{'s' * (count != 1)}, and face {face + 1} was chosen; "
            f"choose a number from 1 to {count}."
        )


def _hash(path: str | os.PathLike[str]) -> str:
    return hashlib.sha256(read_bytes(path, limit=MAX_PHOTO_BYTES)).hexdigest()


def read_mask(path: str | os.PathLike[str]) -> np.ndarray:
    """A mask picture as coverage 0..1, [H, W]: its alpha where it has one, else its brightness. Raises as `load_photo`."""
    from ..photo.load import load_photo

    photo = load_photo(path)
    if photo.alpha is not None and photo.alpha.min() < 1.0:
        return photo.alpha
    return photo.pixels.mean(-1)
