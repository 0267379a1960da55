"""Photos to a `.grmm` file: analysis, tracking, inversion, thumbnail, provenance.

    result = fit(FitRequest(["anna.jpg"], "anna.grmm", preset="fast"), progress=show)

The work folder keeps what an interrupted fit has done; the avatar's file appears when it is complete, or not at all.
Called by the command line and by Blender's fit job. Importing this module is light; calling `fit` imports torch.
"""

from __future__ import annotations

import contextlib
import dataclasses
import datetime
import logging
import shutil
import time
from collections.abc import Callable, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..avatar import Avatar, Hair, PhotoRecord
from ..errors import CancelledError, ConfigError, FileAccessError, FileFormatError
from ..jobs.beside import beside
from ..jobs.progress import ProgressCallback, Reporter, Share, within
from ..photo.load import PhotoFile, check_proportion
from .folder import TRACKS_FILE, Job, can_resume, check_photos_differ, check_writable, prepare
from .presets import fit_stages, preset_named
from .request import FitRequest, faces_by_photo
from .types import PhotoTrack, load_tracks, save_tracks

if TYPE_CHECKING:
    from ..model.grmm import GRMM
    from ..model.weights_file import WeightsInfo


FacesCallback = Callable[[Path, np.ndarray], None]
"""Called for each photo with its path and the faces' boxes, [K, 4] pixels: left, top, right, bottom."""

_WAIT_SECONDS = 0.2  # between two looks whether the hair is found, and whether the user has cancelled
_LANDMARK_SHARE = 0.3  # of the time that tracking takes

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class FitResult:
    """A finished fit.

    Attributes:
        path: The avatar's file.
        avatar: What is in it.
        seconds: Time taken, without what an earlier, interrupted run did.
        rmse: Root mean square color error in each photo's view and light, strands and all, inside the mask.
        landmark_error: Mean landmark distance of each photo relative to the eye distance.
        tracks: What tracking found in the photos.
        warnings: Sentences about what of the photos is not painted on the person.
    """

    path: Path
    avatar: Avatar
    seconds: float
    rmse: tuple[float, ...]
    landmark_error: tuple[float, ...]
    tracks: tuple[PhotoTrack, ...] = ()
    warnings: tuple[str, ...] = ()


def fit(
    request: FitRequest,
    *,
    progress: ProgressCallback | None = None,
    on_faces: FacesCallback | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> FitResult:
    """Make an avatar of the person in one or several photos and write it.

    The persons in the photos must have agreed; the file says that it was made from photos and names them with their hashes.

    Args:
        request: Photos, file, and how.
        progress: Called often; the stages are `jobs.stages.FIT`'s.
        on_faces: Called when the faces of a photo are known.
        cancelled: Asked often; True ends the work with the state saved.

    Raises:
        NoFaceError, FileAccessError, FileFormatError: A photo, mask, or the output cannot be used.
        ConfigError: The photos are not those of a fit, or show other faces.
        CancelledError: `cancelled` said so; the same request with `resume` goes on.
        SessionError: Out of memory.
    """
    begin = time.monotonic()
    report = Reporter(fit_stages(preset_named(request.preset), len(request.photos)), progress, cancelled)
    request.check_output()
    with contextlib.ExitStack() as opened:
        photos, masks = (
            [opened.enter_context(PhotoFile(path)) for path in paths] for paths in (request.photos, request.masks)
        )  # fmt: skip
        job = job_of(request, photos, masks)
        check_writable(request.output)
        folder = prepare(job, request)
        done = False
        try:
            avatar, tracks, warnings = _make(request, job, photos, masks, report, on_faces)
            done = True
        except CancelledError as error:
            kept = "it can be resumed" if can_resume(folder) else "it had not found the person yet"
            raise CancelledError(f"The fit was cancelled; {kept}.") from error
        finally:
            if request.work is None and (done or not can_resume(folder)):
                shutil.rmtree(folder, ignore_errors=True)
    report("finish", 1.0)
    rmse, landmark_error = (tuple(float(value) for value in avatar.tracking[key]) for key in ("rmse", "landmark_error"))
    return FitResult(request.output, avatar, time.monotonic() - begin, rmse, landmark_error, tuple(tracks), tuple(warnings))


def _make(
    request: FitRequest, job: Job, photos: Sequence[PhotoFile], masks: Sequence[PhotoFile], report: Reporter,
    on_faces: FacesCallback | None,
) -> tuple[Avatar, list[PhotoTrack], list[str]]:  # fmt: skip
    """The avatar, which is written, what tracking found, and what is left out of the skin."""
    report.part("load")(0.0)

    from ..compute.devices import limit_rasteriser_threads, one_thread
    from ..model.torch_loader import with_deltas
    from ..photo.parser import parse
    from ..session import make_local_session
    from ..session.presenting import save_presented
    from .hair_light import unlit_hair
    from .hair_stage import person_hair
    from .hair_texture import textured
    from .hair_trim import trimmed
    from .invert import invert, photo_pictures, photo_views
    from .photo_targets import left_out
    from .root_shade import shaded_scalp
    from .settling import locally_lit, settled, worn_errors
    from .tilt import hung_free, upright

    if request.threads:
        import torch

        torch.set_num_threads(request.threads)
        limit_rasteriser_threads(request.threads)
    report.part("load")(0.5)
    session = make_local_session(request.weights or None, request.device, None, request.head or None, "torch")
    loaded = session.engine.store.default()
    head, folder = loaded.model.head_model, request.work_folder
    with beside(partial(_head_start, loaded.model)):
        tracks = _tracks(request, job, photos, masks, loaded.model, loaded.info, report, on_faces)
    tracks = [upright(track, head) for track in tracks]
    hairless = loaded.model.config.hairless
    parts = [parse(track, head) for track in tracks] if hairless else []

    coded: Future[Avatar] = Future()  # of the first stage, in the photos' lights: all that hair needs

    def find_hair(told: Share) -> tuple[Hair | None, list[PhotoTrack]]:
        with one_thread():
            hair = person_hair(tracks, parts, head, told)
            while wait([coded], _WAIT_SECONDS).not_done:
                told(1.0)
            worn = trimmed(loaded.model, dataclasses.replace(coded.result(), hair=hair), tracks, parts)
            return unlit_hair(session, worn, tracks, parts, head)

    finish = report.part("finish")
    with beside(find_hair) if hairless else contextlib.nullcontext() as found:
        avatar = invert(
            tracks, loaded.model, head, request.preset, info=loaded.info, name=request.name or request.output.stem,
            work=folder, report=report, on_codes=coded.set_result if hairless else None,
        )  # fmt: skip
        finish(0.0)
        while found is not None and wait([found], _WAIT_SECONDS).not_done:
            finish(0.0)
    person = with_deltas(loaded.model, avatar.deltas, folder)
    if found is not None:
        hair, unlit = found.result()
        avatar = shaded_scalp(person, dataclasses.replace(avatar, hair=hair), photo_views(person, tracks))
        person = with_deltas(loaded.model, avatar.deltas, folder)
        finish(0.1)
        avatar = textured(person, avatar, unlit, parts)
        avatar = dataclasses.replace(avatar, hair=hung_free(avatar.hair, tracks, head))
    finish(0.4)
    pictures = photo_pictures(person, avatar, tracks)
    several = len(tracks) > 1  # light that strands keep off the skin then is the photos' own, and no color
    aims = photo_pictures(person, avatar, tracks, lit=False) if several else pictures
    avatar = settled(session, person, avatar, tracks, aims, lit=not several)
    person = with_deltas(loaded.model, avatar.deltas, folder)
    finish(0.75)
    avatar = locally_lit(session, person, avatar, tracks)
    errors = worn_errors(session, person, avatar, tracks)
    figures = {"rmse": errors, "landmark_error": [track.landmark_error for track in tracks]}
    today = datetime.datetime.now(datetime.UTC).date().isoformat()
    avatar = dataclasses.replace(
        avatar,
        provenance=dataclasses.replace(avatar.provenance, photos=job.photos, date=today),
        tracking={**avatar.tracking, **{key: np.array(values, np.float32) for key, values in figures.items()}},
    )
    finish(0.85)
    save_presented(avatar, request.output, session)
    return avatar, tracks, left_out(tracks, head)


def _head_start(model: GRMM, told: Share) -> None:
    """Do what needs no photo while these are analysed and tracked.

    Neighbours of texels, grooms to compare, and where skin has furrows are kept for who asks.
    """
    from ..head import load_open_head
    from ..wrinkles.relief import make_canvas
    from .hair_match import make_candidates
    from .surface import texel_surface

    texel_surface(model)
    told(0.4)
    if model.config.hairless:
        make_candidates(model.head_model)
    told(0.8)
    if model.head_model.name == load_open_head().name:
        make_canvas(model.head_model, model.layout.uv, model.layout.grid)


def _tracks(
    request: FitRequest, job: Job, photos: Sequence[PhotoFile], masks: Sequence[PhotoFile], model: GRMM, info: WeightsInfo,
    report: Reporter, on_faces: FacesCallback | None,
) -> list[PhotoTrack]:  # fmt: skip
    """Track the photos, or read what an interrupted run has tracked."""
    from .pixel_stage import track_pixels
    from .track import analyse_photo, check_turned, track_photos

    path = request.work_folder / TRACKS_FILE
    if request.resume and path.exists():
        try:
            known = load_tracks(path)
            if len(known) == len(photos):
                return known
        except (FileFormatError, FileAccessError) as error:
            logger.warning("the photos are tracked anew: %s", error)
    analysed = []
    for index, photo in enumerate(photos):
        report.part("analyse")(index / len(photos))
        one = analyse_photo(photo)
        if on_faces is not None:
            on_faces(photo.path, np.stack([face.box for face in one.faces]) / one.photo.scale)
        check_face(photo.path, job.faces[index], len(one.faces))
        analysed.append(one)
    check_turned(analysed, job.faces)
    report.part("analyse")(1.0)
    outlines = [mask.load().coverage() for mask in masks] or None
    told, head = report.part("track"), model.head_model
    tracks = track_photos(analysed, head, faces=job.faces, masks=outlines, progress=within(told, 0.0, _LANDMARK_SHARE))
    tracks = track_pixels(tracks, model, info, progress=within(told, _LANDMARK_SHARE, 1.0))
    save_tracks(path, tracks)
    return tracks


def job_of(request: FitRequest, photos: Sequence[PhotoFile], masks: Sequence[PhotoFile]) -> Job:
    """What identifies a fit; its pictures are checked before torch is loaded.

    Raises:
        ConfigError: A photo was given twice.
        ShapeError: A mask has another proportion than its photo.
    """
    records = tuple(PhotoRecord(photo.path.name, photo.sha256()) for photo in photos)
    check_photos_differ(records)
    for photo, mask in zip(photos, masks, strict=False):
        check_proportion((mask.width, mask.height), (photo.width, photo.height), photo.path.name)
    return Job(records, faces_by_photo(request), tuple(mask.sha256() for mask in masks), request.weights, request.head)


def check_face(photo: Path, face: int, count: int) -> None:
    """Refuse a face, counted from 0, that a photo does not show. Raises `ConfigError`."""
    if not 0 <= face < count:
        raise ConfigError(
            f"{photo.name} shows {count} usable face{'s' * (count != 1)}, and face {face + 1} was chosen; "
            f"choose a number from 1 to {count}."
        )
