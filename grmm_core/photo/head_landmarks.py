"""Where the head model's 478 landmarks are in a photo, by a network that learned from heads of which that is known.

MediaPipe's landmarks are where people and a network of theirs put them: of synthetic people they are 4 percent of the eyes'
distance off the points of the head model that stand for them, alike in all photos of a person, so that they bend its shape. The
same network, trained on with pictures of random people of the package (`tools.head_landmarks`; after Wood et al. 2022, "3D face
reconstruction with dense landmarks"), says where the model's points are, and how sure it is of each.

Called by tracking, once a photo.
"""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from ..errors import FileFormatError
from ..files.tensorfile import read_tensors
from .faces import LANDMARK_SIZE, Face, Region
from .landmarks import LANDMARK_COUNT, HeadLandmarks
from .networks import NetworkName, ProgramNetwork, load_program

ASSET = Path(__file__).resolve().parent.parent / "assets" / "head_landmarks.safetensors"
FORMAT, VERSION = "grmm-head-landmarks", "1"
PROGRAM: NetworkName = "face_landmarks_detector"
SIGMAS = (-6.0, 1.0)  # least and largest logarithm of an expected error, eye distances
EYE_DISTANCE = 78.0
"""Pixels of the network's picture between the outer corners of the eyes, in the mean: the unit of its errors."""


def head_landmarks(pixels: Tensor, face: Face) -> HeadLandmarks:
    """Find the head model's landmarks of a face that was found.

    Args:
        pixels: [1, 3, H, W] float 0..1, display sRGB.
        face: As `find_faces` found it there.

    Raises:
        FileAccessError, FileFormatError: The asset is missing or damaged.
    """
    network, mirror = _network()
    region = Region.around(face.landmarks)
    seen = region.cut(pixels)
    own, other = (
        network(picture.permute(0, 2, 3, 1))[0].reshape(LANDMARK_COUNT, 3).numpy().astype(np.float64)
        for picture in (seen, seen.flip(3))
    )
    # a face in a mirror is a face, but the network errs otherwise on it
    mean = (own + other[mirror] * [-1.0, 1.0, 1.0] + [LANDMARK_SIZE, 0.0, 0.0]) / 2.0
    sigma = np.exp(mean[:, 2].clip(*SIGMAS)) * EYE_DISTANCE
    return HeadLandmarks(region.placed(mean[:, :2]), sigma * region.side / LANDMARK_SIZE)


@lru_cache(maxsize=1)
def _network() -> tuple[ProgramNetwork, np.ndarray]:
    """The network, and the landmark on the other side of the face of each, [478]."""
    tensors, metadata = read_tensors(ASSET)
    mirror = tensors.pop("mirror", np.zeros(0))
    if (metadata.get("format"), metadata.get("version")) != (FORMAT, VERSION) or mirror.shape != (LANDMARK_COUNT,):
        raise FileFormatError(f"{ASSET} does not hold this version's landmark network; install the project again.")
    weights = {int(name): torch.from_numpy(array).float() for name, array in tensors.items() if name.isdigit()}
    return load_program(PROGRAM, weights), mirror.astype(np.int64)
