"""One face through the frames of a video: its landmarks and reported coefficients. Needs torch."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from ..errors import NoFaceError
from ..jobs.progress import Share
from ..photo.faces import MIN_PRESENCE, Face, find_faces, follow_face, to_pixels

SEARCH_LEVELS = 3  # of the detector: it finds faces from a fortieth of the picture's longer side on, which are too small anyway
LOOK_AGAIN = 0.2  # seconds between searches while the face is away, which cost far more than following it
LEAST_FACE = 48.0  # pixels of the face's longer side
LEAST_SEEN = 5  # frames
_JUMP = 1.0  # face sizes: a face that is found so far from where it was is another one, unless it was away


@dataclass(frozen=True)
class Followed:
    """A face in the frames of a video.

    Attributes:
        times: Seconds from the first frame, [T].
        seen: Whether the face is there, [T] bool.
        landmarks: Pixels and relative depth (see `photo.faces.Face`), [T, 478, 3]; zeros where it is not seen.
        arkit: Reported ARKit coefficients, [T, 52]; zeros likewise.
        width, height: Of the frames in pixels.
    """

    times: np.ndarray
    seen: np.ndarray
    landmarks: np.ndarray
    arkit: np.ndarray
    width: int
    height: int


def follow(
    frames: Iterable[tuple[float, np.ndarray]],
    name: str,
    *,
    face: int = 0,
    expected: int | None = None,
    progress: Share | None = None,
) -> Followed:
    """Follow one face.

    Args:
        frames: Seconds and pixels [H, W, 3] uint8, all of one size.
        name: Of the video, for messages.
        face: Which one of the first frame that shows any, the largest is 0.
        expected: About how many frames there are, for the progress.
        progress: Called with the share done; may raise to cancel.

    Raises:
        NoFaceError: There is none, it is too small, or the chosen one is not there.
    """
    times: list[float] = []
    found: list[Face | None] = []
    last: Face | None = None
    width = height = 0
    searched = -math.inf
    for time, pixels in frames:
        if progress is not None:  # also where it is not known how long the video is: it may raise
            progress(len(times) / expected if expected else 0.0)
        if width and (width, height) != (pixels.shape[1], pixels.shape[0]):
            break  # a video whose frames change size has been cut together from others
        height, width = pixels.shape[:2]
        there = None
        if found and found[-1] is not None:
            there = _still_there(pixels, found[-1])
        if there is None and time - searched >= (LOOK_AGAIN if last is not None or times else 0.0):
            searched = time
            there = _search(pixels, last, face, name, was_there=bool(found) and found[-1] is not None)
        times.append(time)
        found.append(there)
        last = there or last
    faces = [item for item in found if item is not None]
    if len(faces) < LEAST_SEEN:
        raise NoFaceError(f"No face was found in {name}; use a video where one face is seen from the front, upright and sharp.")
    size = float(np.median([max(item.box[2:] - item.box[:2]) for item in faces]))
    if size < LEAST_FACE:
        raise NoFaceError(
            f"The face in {name} is only {size:.0f} pixels high; use a video where it has {LEAST_FACE:.0f}, better 200."
        )
    empty = Face(np.zeros_like(faces[0].landmarks), np.zeros_like(faces[0].arkit), 0.0, 0.0, np.zeros(4))
    return Followed(
        np.array(times), np.array([item is not None for item in found]),
        np.stack([(item or empty).landmarks for item in found]), np.stack([(item or empty).arkit for item in found]),
        width, height,
    )  # fmt: skip


def _still_there(pixels: np.ndarray, face: Face) -> Face | None:
    """The face of the frame before in this one, or None."""
    there = follow_face(to_pixels(pixels), face)
    return there if there.presence >= MIN_PRESENCE and np.isfinite(there.landmarks).all() else None


def _search(pixels: np.ndarray, last: Face | None, choice: int, name: str, *, was_there: bool) -> Face | None:
    """A face anywhere in a frame: the chosen one to begin with, later the one nearest to where it was."""
    try:
        faces = find_faces(pixels, SEARCH_LEVELS)
    except NoFaceError:
        return None
    if last is None:
        if choice >= len(faces):
            raise NoFaceError(f"{name} begins with {len(faces)} face{'s' * (len(faces) > 1)}; there is no number {choice + 1}.")
        return faces[choice]
    far = [_apart(face, last) for face in faces]
    nearest = int(np.argmin(far))
    return None if was_there and far[nearest] > _JUMP else faces[nearest]


def _apart(face: Face, other: Face) -> float:
    """Distance of two faces' middles in sizes of the second."""
    middles = [(item.box[:2] + item.box[2:]) / 2.0 for item in (face, other)]
    return float(np.linalg.norm(middles[0] - middles[1]) / max(max(other.box[2:] - other.box[:2]), 1.0))
