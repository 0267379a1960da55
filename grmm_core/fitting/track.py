"""Photos to tracks: find the face, fit the head model, frame the working picture as the training pictures are.

`analyse_photo` opens a photo and finds its faces (the user may then choose); `track_photos` does the rest for one person.
Called by the fit's `api` and by the fit panel's job. Needs torch and Pillow; knows nothing of the networks that are fitted.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from ..errors import CancelledError, ConfigError, NoFaceError, ShapeError
from ..geometry.camera import Camera
from ..head.head_model import JOINT_COUNT, HeadModel
from ..head.open_head import load_open_head
from ..photo.faces import Face, find_faces, to_pixels
from ..photo.head_landmarks import head_landmarks
from ..photo.landmarks import HeadLandmarks
from ..photo.load import Photo, PhotoFile, check_proportion
from ..photo.parser import parse
from ..photo.person import person_mask
from ..photo.sharpness import BLURRED, sharpness
from .landmark_priors import FULL_FRAME
from .landmark_stage import LandmarkFit, Observation, fit_landmarks, similarity
from .photometric_stage import Appearance, refine
from .point_rig import LandmarkRig
from .types import PhotoTrack

logger = logging.getLogger(__name__)

DEFAULT_SIZE = 512
MIN_FACE = 64.0  # pixels of the face's longer side; below this nothing of a person can be seen
FRAME_TARGET = (0.0, -0.002, 0.0)  # head space: what the training pictures of the whole head look at
FRAME_HALF = 0.224  # metres from there to the picture's edge (1.1 m away, angle of view 23 degrees)
PADDING_GREY = 0.5
MOST_OUTSIDE = 0.2  # of the landmarks beyond the picture's edge: with more an eye or the mouth would be a guess
LEAST_OUTLINED = 0.25  # of the landmarks inside the person's outline: portraits have nearly all, a painting of strokes none
LEAST_SHOWN = 0.65  # likewise: where there are fewer, a thing hides half of the face
MOST_TURNED = 55.0  # degrees: of a face that is turned further in every photo, half would be a guess
_ANALYSE_SHARE, _LANDMARK_SHARE, _REFINE_SHARE = 0.4, 0.3, 0.2  # of the time, for the progress


@dataclass(frozen=True)
class AnalysedPhoto:
    """An opened photo and the faces in it.

    Attributes:
        photo: Its pixels.
        faces: The largest first.
        focal: Focal length in pixels of `photo.pixels` that the file states, or None.
    """

    photo: Photo
    faces: tuple[Face, ...]
    focal: float | None = None


def analyse_photo(source: str | os.PathLike[str] | PhotoFile) -> AnalysedPhoto:
    """Decode a photo and find the faces.

    Args:
        source: The file, or one that is open already; it is closed.

    Raises:
        FileAccessError, FileFormatError: See `PhotoFile`.
        NoFaceError: There is no face, or none is large, whole and sharp enough to be fitted.
    """
    photo = (source if isinstance(source, PhotoFile) else PhotoFile(source)).load()
    focal = photo.focal_35mm
    return _with_faces(photo, None if focal is None else focal / FULL_FRAME * max(photo.pixels.shape[:2]))


def _with_faces(photo: Photo, focal: float | None) -> AnalysedPhoto:
    name = photo.path.name
    try:
        faces = find_faces(photo.pixels)
    except NoFaceError as error:
        raise NoFaceError(
            f"No face was found in {name}; if there is one, it is turned or tilted too far, covered or not sharp: use a photo "
            "from the front or at most half from the side, where the whole face is visible."
        ) from error
    reasons = [_unusable(face, photo.pixels, name) for face in faces]
    usable = tuple(face for face, reason in zip(faces, reasons, strict=True) if not reason)
    if not usable:
        raise NoFaceError(reasons[0])
    return AnalysedPhoto(photo, usable, focal)


def _unusable(face: Face, pixels: np.ndarray, name: str) -> str:
    """Why a face in a photo [H, W, 3] gives no avatar worth having, in a sentence; empty where it may."""
    if _face_size(face) < MIN_FACE:
        return (
            f"The face in {name} is only {_face_size(face):.0f} pixels high; use a photo where it has at least {MIN_FACE:.0f}, "
            "better 200."
        )
    points, size = face.landmarks[:, :2], np.array(pixels.shape[1::-1])
    if ((points < 0) | (points >= size)).any(1).mean() > MOST_OUTSIDE:
        return f"The face in {name} is cut off by the picture's edge; use a photo that shows the whole face."
    left, top, right, bottom = np.clip(face.box.round().astype(int), 0, size[[0, 1, 0, 1]]).tolist()
    part = torch.from_numpy(pixels[top:bottom, left:right].mean(2))[None, None]
    if sharpness(part) < BLURRED:
        return f"The face in {name} is not sharp enough; use a photo where eyes and mouth have clear outlines."
    return ""


def check_turned(photos: Sequence[AnalysedPhoto], faces: Sequence[int]) -> None:
    """Refuse a person of whom every photo shows the side only, before anything is fitted.

    Args:
        photos: Of one person.
        faces: Which face of each, as in `track_photos`.

    Raises:
        NoFaceError: All faces are turned by more than `MOST_TURNED` degrees.
        ConfigError: A face was chosen that is not there.
    """
    rig = LandmarkRig(load_open_head())
    mean = rig.positions(np.zeros(rig.shape_count), np.zeros(rig.expression_count), np.zeros((JOINT_COUNT, 3)))
    degrees = [_turned(_chosen_face(item, index), mean) for item, index in zip(photos, faces, strict=True)]
    least = int(np.argmin(degrees))
    if degrees[least] > MOST_TURNED:
        raise NoFaceError(
            f"The face in {photos[least].photo.path.name} is turned by {degrees[least]:.0f} degrees; add a photo from at most "
            f"{MOST_TURNED:.0f} degrees beside the front."
        )


def _turned(face: Face, mean: np.ndarray) -> float:
    """Degrees by which a face is turned to a side: how its landmarks, with their depth, lie to the mean head's [478, 3].

    Of pictures of five avatars, turned by 0 to 60 degrees, it is 1.5 off on average, 6 at most; the landmark stage, whose
    camera and shape share what is seen, says 2 to 6 too few from 45 on.
    """
    rotation, _, _ = similarity(mean, face.landmarks.astype(np.float64))
    to_eye = -rotation[2]
    return abs(float(np.degrees(np.arctan2(to_eye[0], to_eye[2]))))


def track_photos(
    photos: Sequence[str | os.PathLike[str] | AnalysedPhoto],
    head: HeadModel,
    *,
    faces: Sequence[int] | None = None,
    masks: Sequence[np.ndarray | None] | None = None,
    size: int = DEFAULT_SIZE,
    progress: Callable[[float], None] | None = None,
    cancelled: Callable[[], bool] | None = None,
) -> list[PhotoTrack]:
    """Fit the head model to one or several photos of one person.

    Args:
        photos: Files, or photos that were analysed before.
        head: Head model with 478 landmarks.
        faces: Which face of each photo, in the order of `AnalysedPhoto.faces`; the largest (0) where not given.
        masks: The person's outline in each photo, 0..1, [H, W] of any resolution of the upright photo; None finds it.
        size: Side of the working pictures in pixels.
        progress: Called with 0..1.
        cancelled: Asked often; True ends the work.

    Returns:
        One track for each photo, all with the same shape.

    Raises:
        CancelledError: `cancelled` said so.
        NoFaceError, FileAccessError, FileFormatError: A photo cannot be used; the message names it.
        ConfigError: No photo, or a face was chosen that is not there.
        ShapeError: The head model has no 478 landmarks.
    """
    if not photos:
        raise ConfigError("No photo was given; choose at least one.")
    report = _Reporter(progress, cancelled)
    rig = LandmarkRig(head)
    analysed: list[AnalysedPhoto] = []
    for index, item in enumerate(photos):
        report(_ANALYSE_SHARE * index / len(photos))
        analysed.append(item if isinstance(item, AnalysedPhoto) else analyse_photo(item))
    chosen = [_chosen_face(item, faces[i] if faces is not None and i < len(faces) else 0) for i, item in enumerate(analysed)]
    placed = [head_landmarks(to_pixels(item.photo.pixels), face) for item, face in zip(analysed, chosen, strict=True)]
    observations = [_observation(*one) for one in zip(analysed, chosen, placed, strict=True)]
    fit = fit_landmarks(observations, rig, progress=lambda f: report(_ANALYSE_SHARE + _LANDMARK_SHARE * f))
    pictures = []
    for index, item in enumerate(analysed):
        report(_ANALYSE_SHARE + _LANDMARK_SHARE)
        mask = masks[index] if masks is not None and index < len(masks) else None
        pictures.append(_working_picture(item.photo, fit.cameras[index], size, mask))
    _check_outlined(analysed, pictures, fit, given=masks is not None)

    def tracks(fit: LandmarkFit) -> list[PhotoTrack]:
        found = zip(analysed, chosen, placed, pictures, strict=True)
        return [_track(item, face, points, fit, index, picture) for index, (item, face, points, picture) in enumerate(found)]

    pictures = [replace(picture, others=_others(one, head)) for picture, one in zip(pictures, tracks(fit), strict=True)]
    refined = tracks(refine(fit, pictures, rig, progress=lambda f: report(1.0 - _REFINE_SHARE * (1.0 - f))))
    report(1.0)
    return refined


def _check_outlined(
    photos: Sequence[AnalysedPhoto], pictures: Sequence[Appearance], fit: LandmarkFit, *, given: bool
) -> None:  # fmt: skip
    """Refuse a person of whom no photo's outline holds the face: nothing of it would be painted, or half of it.

    Half is enough where outlines were `given`, for then nothing beside them is taken for hair. Raises `NoFaceError`.
    """
    shares = []
    for picture, landmarks in zip(pictures, fit.landmarks, strict=True):
        places = (landmarks - np.array([picture.left, picture.top])) * picture.scale
        columns, rows = np.clip(places.astype(int), 0, np.array(picture.mask.shape[::-1]) - 1).T
        shares.append(float(picture.mask[rows, columns].mean()))
    name = photos[int(np.argmax(shares))].photo.path.name
    if max(shares) < LEAST_OUTLINED:
        raise NoFaceError(
            f"The person in {name} does not stand out from the background; give a picture of the outline, or use another photo."
        )
    if max(shares) < LEAST_SHOWN and not given:
        raise NoFaceError(
            f"Something hides about {100.0 * (1.0 - max(shares)):.0f} percent of the face in {name}; "
            "use a photo that shows the whole face, or give a picture of the outline."
        )


class _Reporter:
    """Forwards progress and turns a wish to cancel into the error that ends the work."""

    def __init__(self, progress: Callable[[float], None] | None, cancelled: Callable[[], bool] | None) -> None:
        self._progress, self._cancelled = progress, cancelled

    def __call__(self, fraction: float) -> None:
        if self._cancelled is not None and self._cancelled():
            raise CancelledError("The fit was cancelled.")
        if self._progress is not None:
            self._progress(min(max(fraction, 0.0), 1.0))


def _face_size(face: Face) -> float:
    return float(max(face.box[2] - face.box[0], face.box[3] - face.box[1]))


def _chosen_face(item: AnalysedPhoto, index: int) -> Face:
    if not 0 <= index < len(item.faces):
        raise ConfigError(
            f"{item.photo.path.name} shows {len(item.faces)} usable face(s), numbered from 0; there is no face {index}."
        )
    return item.faces[index]


def _observation(item: AnalysedPhoto, face: Face, placed: HeadLandmarks) -> Observation:
    height, width = item.photo.pixels.shape[:2]
    return Observation(face.landmarks.astype(np.float64), face.arkit, width, height, item.focal, placed)


def _working_picture(photo: Photo, camera: Camera, size: int, mask: np.ndarray | None) -> Appearance:
    """Cut the square around the head out of a photo, with the person's mask."""
    left, top, side = frame_of(camera)
    image = cut_square(photo.pixels, left, top, side, size, PADDING_GREY)

    def plane(values: np.ndarray) -> np.ndarray:
        return cut_square(values[:, :, None], left, top, side, size, 0.0)[:, :, 0]

    valid = plane(np.ones(photo.pixels.shape[:2], np.float32))
    outline = person_mask(image) if mask is None else plane(_fitted_mask(mask, photo))
    if photo.alpha is not None:
        outline = outline * plane(photo.alpha)
    return Appearance(image, np.clip(outline * valid, 0.0, 1.0), valid, left, top, size / side)


def appearance_of(track: PhotoTrack, head: HeadModel) -> Appearance:
    """The working picture of a track, for the terms of its outline."""
    scale = track.camera.fx / track.photo_camera.fx
    left, top = (getattr(track.photo_camera, axis) - getattr(track.camera, axis) / scale for axis in ("cx", "cy"))
    return Appearance(track.image, track.mask, track.valid, left, top, scale, _others(track, head))


def _others(track: PhotoTrack, head: HeadModel) -> np.ndarray:
    """What a photo shows beside skin of face and ears, [H, W]."""
    parts = parse(track, head)
    beside = parts.hair + parts.beard + parts.neck + parts.clothes + parts.hat + parts.glasses + parts.other
    return np.clip(beside, 0.0, 1.0)


def _track(
    item: AnalysedPhoto, face: Face, placed: HeadLandmarks, fit: LandmarkFit, index: int, picture: Appearance
) -> PhotoTrack:
    """Move everything that was found into the working picture."""
    photo, view = item.photo, fit.views[index]
    height, width = photo.pixels.shape[:2]
    whole = (max(1, round(width / photo.scale)), max(1, round(height / photo.scale)))
    origin = np.array([picture.left, picture.top])
    camera = picture.camera(fit.cameras[index])
    return PhotoTrack(
        source=photo.path.name,
        image=picture.image,
        mask=picture.mask,
        valid=picture.valid,
        camera=camera,
        photo_camera=fit.cameras[index].resized(*whole),
        shape=fit.shape,
        expression=view.expression,
        pose=view.pose,
        landmarks=(face.landmarks[:, :2] - origin) * picture.scale,
        landmarks_fitted=(fit.landmarks[index] - origin) * picture.scale,
        arkit=face.arkit,
        placed=(placed.points - origin) * picture.scale,
        placed_sigma=placed.sigma * picture.scale,
        presence=face.presence,
    )


def frame_of(camera: Camera) -> tuple[float, float, float]:
    """Square around the head as the training pictures are framed: left, top and side in pixels of the camera's picture."""
    x, y, z = camera.world_to_camera[:3, :3] @ np.array(FRAME_TARGET) + camera.world_to_camera[:3, 3]
    half = camera.fx * FRAME_HALF / z
    return camera.fx * x / z + camera.cx - half, camera.fy * y / z + camera.cy - half, 2.0 * half


def cut_square(picture: np.ndarray, left: float, top: float, side: float, size: int, outside: float) -> np.ndarray:
    """Resample a square of a picture, averaging where it shrinks.

    Args:
        picture: [H, W, C] float32.
        left: Left edge in pixels; may lie outside, as may the others.
        top: Upper edge.
        side: Side in pixels.
        size: Side of the result in pixels.
        outside: Value beyond the picture.

    Returns:
        [size, size, C] float32, 0..1.
    """
    from PIL import Image

    height, width = picture.shape[:2]
    margin = 4  # the resampling filter looks a little beyond the square
    x0, y0 = int(np.floor(left)) - margin, int(np.floor(top)) - margin
    x1, y1 = int(np.ceil(left + side)) + margin, int(np.ceil(top + side)) + margin
    part = picture[max(y0, 0) : max(y1, 0), max(x0, 0) : max(x1, 0)]
    pads = ((max(-y0, 0), max(y1 - max(height, y0), 0)), (max(-x0, 0), max(x1 - max(width, x0), 0)), (0, 0))
    part = np.pad(part, pads, constant_values=outside)
    box = (left - x0, top - y0, left - x0 + side, top - y0 + side)
    planes = [
        np.asarray(Image.fromarray(np.ascontiguousarray(part[:, :, c])).resize((size, size), Image.Resampling.BICUBIC, box))
        for c in range(part.shape[2])
    ]
    return np.clip(np.stack(planes, axis=2), 0.0, 1.0).astype(np.float32)


def _fitted_mask(mask: np.ndarray, photo: Photo) -> np.ndarray:
    """A user's mask at the photo's resolution, [H, W]."""
    from PIL import Image

    values = np.asarray(mask, np.float32)
    if values.ndim != 2 or not np.isfinite(values).all():
        raise ShapeError(f"The mask has shape {values.shape}; give one channel (H, W) with values 0 to 1.")
    height, width = photo.pixels.shape[:2]
    if values.shape == (height, width):
        return values
    check_proportion((values.shape[1], values.shape[0]), (width, height), photo.path.name)
    return np.asarray(Image.fromarray(values).resize((width, height), Image.Resampling.BILINEAR))
