"""Whether a face-recognition network takes two faces for one person's. No network comes with this project.

`load_identity` takes the user's, a TorchScript module that maps faces [B, 3, 112, 112], display sRGB scaled to -1..1, aligned
by eyes, nose and mouth as is usual for such networks, to embeddings [B, D]; or "dlib", the network of dlib (King, "Dlib-ml",
2009), whose weights a package carries. Used by `photo_fits` and the command line.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import FileAccessError, FileFormatError, RuntimeMissingError
from ..fitting.landmark_stage import similarity
from ..fitting.types import PhotoTrack
from ..geometry.camera import Camera

SIDE = 112
PLACES = np.array([[38.3, 51.7], [73.5, 51.5], [56.0, 71.7], [41.5, 92.4], [70.7, 92.2]])
"""Where the aligned face has the eyes (left in the picture first), the tip of the nose and the corners of the mouth, pixels."""
_LANDMARKS = ((33, 133), (263, 362), (1,), (61,), (291,))  # of the 478: both corners of an eye
DLIB = "dlib"
_DLIB_LANDMARKS = (263, 362, 33, 133, 2)  # outer and inner corner of each eye, base of the nose
_DLIB_WEIGHTS = Path("models") / "dlib_face_recognition_resnet_model_v1.dat"
_DLIB_SIDE, _DLIB_PADDING = 150, 0.25


class Identity(Protocol):
    """A face-recognition network."""

    def embedding(self, picture: Tensor, landmarks: np.ndarray) -> np.ndarray:
        """What it makes of the face at 478 landmarks [478, 2] in pixels of a picture [H, W, 3], display sRGB 0..1."""
        ...

    def distance(self, first: np.ndarray, second: np.ndarray) -> float:
        """How unlike two embeddings are, 0 for the same face."""
        ...


class IdentityDistance:
    """1 minus the cosine of two embeddings: 0 for the same face, about 1 for two people.

    Args:
        network: Faces [B, 3, 112, 112], -1..1, to embeddings [B, D].
    """

    def __init__(self, network: Callable[[Tensor], Tensor]) -> None:
        self.network = network

    def embedding(self, picture: Tensor, landmarks: np.ndarray) -> np.ndarray:
        """Of a face, see `Identity`."""
        with torch.no_grad():
            found: np.ndarray = self.network(aligned_face(picture, landmarks)[None] * 2.0 - 1.0)[0].cpu().numpy()
        return found

    def distance(self, first: np.ndarray, second: np.ndarray) -> float:
        """See `Identity`."""
        return float(1.0 - np.dot(first, second) / max(float(np.linalg.norm(first) * np.linalg.norm(second)), 1e-9))


class DlibDistance:
    """Euclidean distance of dlib's embeddings: its authors take 0.6 and less for one person.

    Raises:
        RuntimeMissingError: Its packages are not installed.
    """

    def __init__(self) -> None:
        weights = importlib.util.find_spec("face_recognition_models")
        if weights is None or weights.origin is None or importlib.util.find_spec("dlib") is None:
            raise RuntimeMissingError(
                "dlib is not here; run pip install --no-deps dlib-bin==20.0.1 face_recognition_models==0.3.0."
            )
        import dlib

        self._dlib: Any = dlib
        self._network = dlib.face_recognition_model_v1(str(Path(weights.origin).parent / _DLIB_WEIGHTS))

    def embedding(self, picture: Tensor, landmarks: np.ndarray) -> np.ndarray:
        """Of a face, see `Identity`."""
        pixels = (picture.detach().cpu().clamp(0, 1) * 255.0 + 0.5).to(torch.uint8).numpy()
        places = landmarks[list(_DLIB_LANDMARKS)]
        (left, top), (right, bottom) = places.min(0), places.max(0)
        box = self._dlib.rectangle(int(left), int(top), int(right), int(bottom))
        marks = self._dlib.full_object_detection(box, [self._dlib.point(int(x), int(y)) for x, y in places.round()])
        face = self._dlib.get_face_chip(np.ascontiguousarray(pixels), marks, _DLIB_SIDE, _DLIB_PADDING)
        return np.array(self._network.compute_face_descriptor(face), np.float64)

    def distance(self, first: np.ndarray, second: np.ndarray) -> float:
        """See `Identity`."""
        return float(np.linalg.norm(first - second))


def load_identity(path: str | Path) -> Identity:
    """Read a user's network, or "dlib".

    Raises:
        FileAccessError: There is no such file.
        FileFormatError: It is no TorchScript module, or gives no embeddings.
        RuntimeMissingError: dlib's packages are not installed.
    """
    if str(path) == DLIB:
        return DlibDistance()
    if not Path(path).is_file():
        raise FileAccessError(f"{path} does not exist; check the name of the face-recognition network.")
    try:
        network = torch.jit.load(str(path), map_location="cpu").eval()
        with torch.no_grad():
            shape = network(torch.zeros(2, 3, SIDE, SIDE)).shape
    except (RuntimeError, ValueError, AttributeError) as error:
        raise FileFormatError(f"{path} is not a TorchScript network for faces of {SIDE} pixels; export it as one.") from error
    if len(shape) != 2 or shape[0] != 2:
        raise FileFormatError(f"{path} gives {tuple(shape)} for two faces; it must give one embedding for each.")
    return IdentityDistance(network)


def photo_landmarks(track: PhotoTrack, camera: Camera) -> np.ndarray:
    """The photo's landmarks, [478, 2], in pixels of a picture of `camera`, which shows a part of the track's."""
    whole, marks = track.camera, np.array(track.landmarks[:, :2], np.float64)
    marks[:, 0] = (marks[:, 0] - whole.cx) / whole.fx * camera.fx + camera.cx
    marks[:, 1] = (marks[:, 1] - whole.cy) / whole.fy * camera.fy + camera.cy
    return marks


def aligned_face(picture: Tensor, landmarks: np.ndarray) -> Tensor:
    """The face at landmarks [478, 2] of a picture [H, W, 3] as most recognition networks expect it, [3, 112, 112]."""
    marks = np.array([landmarks[list(group)].mean(0) for group in _LANDMARKS], np.float64)
    depth = np.zeros((len(marks), 1))
    rotation, scale, shift = similarity(np.concatenate([PLACES, depth], 1), np.concatenate([marks, depth], 1))
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    places = np.stack([columns, rows], -1) @ (scale * rotation[:2, :2]).T + shift[:2]  # [112, 112, 2] pixels of the picture
    height, width = picture.shape[:2]
    grid = torch.tensor(places * [2.0 / width, 2.0 / height] - 1.0, dtype=picture.dtype, device=picture.device)
    planes = picture.permute(2, 0, 1)[None]
    face: Tensor = nn.functional.grid_sample(planes, grid[None], mode="bilinear", padding_mode="border", align_corners=False)
    return face[0].clamp(0, 1)
