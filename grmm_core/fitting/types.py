"""What tracking finds in one photo, and its file, from which an interrupted fit goes on.

Made by `track`, read by the inversion, the command line and the fit panel. Needs numpy only.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np

from ..errors import FileFormatError, ShapeError
from ..files.tensorfile import read_tensors, write_tensors
from ..geometry.camera import Camera
from ..geometry.rotations import euler_to_matrix
from ..photo.landmarks import LANDMARK_COUNT, HeadLandmarks

FORMAT = "grmm-tracks"
VERSION = 1
LABEL_COUNT = 14
_CAMERAS = ("camera", "photo_camera")
_OPTIONAL = ("placed", "placed_sigma", "labels", "identity")  # arrays that a track may lack


@dataclass(frozen=True, eq=False)
class PhotoTrack:
    """One tracked photo: the working picture, and the head model's parameters that explain it.

    The head stands still in head space; where it was in the photo is in the cameras. All photos of one person have the same
    `shape`. The inputs of the head and of the networks are `expression` and `head.pose_of(expression, pose)`.

    Attributes:
        source: File name of the photo (without folder), or "" for a picture in memory.
        image: Working picture around the head, display sRGB 0..1, float32, [H, W, 3]; mid grey where the photo ends.
        mask: How much of each pixel is the person, 0..1, float32, [H, W].
        valid: 1 where the photo has pixels, 0 beyond its edges, float32, [H, W].
        camera: Camera of the working picture in head space.
        photo_camera: The same view of the whole photo (upright, at the file's resolution), for a camera background.
        shape: Shape coefficients alpha_id, [S].
        expression: Expression coefficients alpha_exp, [E].
        pose: XYZ Euler angles in radians of root, neck, jaw and eyes, on top of what `expression` turns, [5, 3].
        landmarks: MediaPipe's 478 landmarks as found, pixels of the working picture, [478, 2].
        landmarks_fitted: The head model's, likewise.
        placed, placed_sigma: The head model's as `photo.head_landmarks` found them, likewise, and their expected errors, [478];
            None where MediaPipe's stand for them.
        arkit: The 52 ARKit coefficients as the network reported them (a start value, no measurement), [52].
        labels: What each pixel shows where that is known (of a capture), as `photo.parser.PhotoParts` orders it, 0..1,
            [14, H, W]; None asks the parser.
        identity: z_id of the quick avatar by whose pixels the photos were tracked, [Z]; None where they were not.
        presence: Confidence that the landmarks are a face's, 0..1.
    """

    source: str
    image: np.ndarray
    mask: np.ndarray
    valid: np.ndarray
    camera: Camera
    photo_camera: Camera
    shape: np.ndarray
    expression: np.ndarray
    pose: np.ndarray
    landmarks: np.ndarray
    landmarks_fitted: np.ndarray
    arkit: np.ndarray
    placed: np.ndarray | None = None
    placed_sigma: np.ndarray | None = None
    labels: np.ndarray | None = None
    identity: np.ndarray | None = None
    presence: float = 1.0

    def __post_init__(self) -> None:
        height, width = self.camera.height, self.camera.width
        wanted: dict[str, tuple[int, ...]] = {
            "image": (height, width, 3), "mask": (height, width), "valid": (height, width), "pose": (5, 3), "arkit": (52,),
            "landmarks": (LANDMARK_COUNT, 2), "landmarks_fitted": (LANDMARK_COUNT, 2), "placed": (LANDMARK_COUNT, 2),
            "placed_sigma": (LANDMARK_COUNT,),
        }  # fmt: skip
        if self.labels is not None:
            wanted["labels"] = (LABEL_COUNT, height, width)
        for item in fields(self):
            value = getattr(self, item.name)
            if not isinstance(value, np.ndarray):
                continue
            array = np.array(value, np.float32)
            if item.name in wanted and array.shape != wanted[item.name]:
                raise ShapeError(f"{item.name} of a track has shape {array.shape}; it must be {wanted[item.name]}.")
            if not np.isfinite(array).all():
                raise ShapeError(f"{item.name} of the track of {self.source!r} holds numbers that are not finite.")
            array.flags.writeable = False
            object.__setattr__(self, item.name, array)

    @property
    def eye_distance(self) -> float:
        """Distance of the outer eye corners as found, pixels of the working picture."""
        return float(np.linalg.norm(self.landmarks[263] - self.landmarks[33]))

    @property
    def turn(self) -> np.ndarray:
        """From the axes of the head, which a neck may tilt, to those of the bust, in which cameras are, [3, 3]."""
        root, neck = euler_to_matrix(self.pose[:2].astype(np.float64))
        turn: np.ndarray = root @ neck
        return turn

    @property
    def head_down(self) -> np.ndarray:
        """Where the head's down goes in the picture, [2], of a length below 1 where it nods."""
        down: np.ndarray = -(self.camera.world_to_camera[:3, :3] @ self.turn)[:2, 1]
        return down

    @property
    def placed_in_photo(self) -> HeadLandmarks | None:
        """The head model's landmarks in pixels of the photo, where a network found them."""
        if self.placed is None or self.placed_sigma is None:
            return None
        scale = self.camera.fx / self.photo_camera.fx
        middle, own = ([camera.cx, camera.cy] for camera in (self.photo_camera, self.camera))
        return HeadLandmarks((self.placed - own) / scale + middle, self.placed_sigma / scale)

    @property
    def landmark_error(self) -> float:
        """Mean distance of the 478 fitted landmarks from the found ones, relative to the distance of the outer eye corners."""
        distances = np.linalg.norm(self.landmarks_fitted - self.landmarks, axis=1)
        return float(distances.mean() / max(self.eye_distance, 1e-6))


def save_tracks(path: str | os.PathLike[str], tracks: Sequence[PhotoTrack]) -> None:
    """Write tracks as one tensor file, whole or not at all.

    Raises:
        FileAccessError: The file cannot be written.
    """
    tensors: dict[str, np.ndarray] = {}
    metadata = {"format": FORMAT, "version": str(VERSION), "count": str(len(tracks))}
    for index, track in enumerate(tracks):
        metadata[f"{index}.source"] = track.source
        tensors[f"{index}.presence"] = np.array(track.presence, np.float64)
        for item in fields(track):
            value = getattr(track, item.name)
            if isinstance(value, np.ndarray):
                tensors[f"{index}.{item.name}"] = value
        for name in _CAMERAS:
            camera: Camera = getattr(track, name)
            tensors[f"{index}.{name}.matrix"] = camera.world_to_camera
            tensors[f"{index}.{name}.numbers"] = np.array(
                [camera.fx, camera.fy, camera.cx, camera.cy, camera.width, camera.height], np.float64
            )
    write_tensors(path, tensors, metadata)


def load_tracks(path: str | os.PathLike[str]) -> list[PhotoTrack]:
    """Read the file of `save_tracks`.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Another format or version, or damaged.
    """
    tensors, metadata = read_tensors(path)
    if metadata.get("format") != FORMAT or metadata.get("version") != str(VERSION):
        raise FileFormatError(f"{path} is not a tracking result that this version reads; fit the photos again.")
    arrays = [item.name for item in fields(PhotoTrack) if item.name not in ("source", "presence", *_CAMERAS)]
    try:
        return [
            PhotoTrack(
                source=metadata[f"{index}.source"],
                presence=float(tensors[f"{index}.presence"]),
                camera=_camera(tensors, f"{index}.camera"),
                photo_camera=_camera(tensors, f"{index}.photo_camera"),
                **{name: tensors[f"{index}.{name}"] for name in arrays if name not in _OPTIONAL},
                labels=tensors.get(f"{index}.labels"),
                placed=tensors.get(f"{index}.placed"),
                placed_sigma=tensors.get(f"{index}.placed_sigma"),
                identity=tensors.get(f"{index}.identity"),
            )
            for index in range(int(metadata["count"]))
        ]
    except (KeyError, ValueError, TypeError, ShapeError) as error:
        raise FileFormatError(f"{path} is a damaged tracking result; fit the photos again.") from error


def _camera(tensors: dict[str, np.ndarray], name: str) -> Camera:
    fx, fy, cx, cy, width, height = tensors[f"{name}.numbers"].tolist()
    return Camera(tensors[f"{name}.matrix"], fx, fy, cx, cy, int(width), int(height))
