"""Distance of two faces as a face-recognition network sees them. The network is the user's; none comes with this project.

The file is a TorchScript module that maps faces [B, 3, 112, 112], display sRGB scaled to -1..1, aligned by eyes, nose and mouth
as is usual for such networks, to embeddings [B, D]. Used by `fitting.photo_figures` and the command line.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import FileAccessError, FileFormatError
from ..fitting.landmark_stage import similarity
from ..fitting.types import PhotoTrack
from ..geometry.camera import Camera

SIDE = 112
PLACES = np.array([[38.3, 51.7], [73.5, 51.5], [56.0, 71.7], [41.5, 92.4], [70.7, 92.2]])
"""Where the aligned face has the eyes (left in the picture first), the tip of the nose and the corners of the mouth, pixels."""
_LANDMARKS = ((33, 133), (263, 362), (1,), (61,), (291,))  # of the 478: both corners of an eye

Identity = Callable[[Tensor, Tensor, PhotoTrack, Camera], float]


class IdentityDistance:
    """1 minus the cosine of two embeddings: 0 for the same face, about 1 for two people.

    Args:
        network: Faces [B, 3, 112, 112], -1..1, to embeddings [B, D].
    """

    def __init__(self, network: Callable[[Tensor], Tensor]) -> None:
        self.network = network

    def __call__(self, first: Tensor, second: Tensor, track: PhotoTrack, camera: Camera) -> float:
        """Compare two pictures of one camera.

        Args:
            first: Display sRGB 0..1, [H, W, 3].
            second: Likewise.
            track: Where the face is in the photo.
            camera: Of both pictures, a part of the track's.
        """
        faces = torch.stack([aligned_face(picture, track, camera) for picture in (first, second)])
        with torch.no_grad():
            embeddings = self.network(faces * 2.0 - 1.0)
        return float(1.0 - nn.functional.cosine_similarity(embeddings[:1], embeddings[1:]))


def load_identity(path: str | Path) -> IdentityDistance:
    """Read a user's network.

    Raises:
        FileAccessError: There is no such file.
        FileFormatError: It is no TorchScript module, or gives no embeddings.
    """
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


def aligned_face(picture: Tensor, track: PhotoTrack, camera: Camera) -> Tensor:
    """The face of a picture [H, W, 3] as recognition networks expect it, [3, 112, 112]."""
    whole = track.camera
    marks = np.array([track.landmarks[list(group)].mean(0) for group in _LANDMARKS], np.float64)
    marks[:, 0] = (marks[:, 0] - whole.cx) / whole.fx * camera.fx + camera.cx
    marks[:, 1] = (marks[:, 1] - whole.cy) / whole.fy * camera.fy + camera.cy
    depth = np.zeros((len(marks), 1))
    rotation, scale, shift = similarity(np.concatenate([PLACES, depth], 1), np.concatenate([marks, depth], 1))
    rows, columns = np.mgrid[:SIDE, :SIDE] + 0.5
    places = np.stack([columns, rows], -1) @ (scale * rotation[:2, :2]).T + shift[:2]  # [112, 112, 2] pixels of the picture
    height, width = picture.shape[:2]
    grid = torch.tensor(places * [2.0 / width, 2.0 / height] - 1.0, dtype=picture.dtype, device=picture.device)
    planes = picture.permute(2, 0, 1)[None]
    face: Tensor = nn.functional.grid_sample(planes, grid[None], mode="bilinear", padding_mode="border", align_corners=False)
    return face[0].clamp(0, 1)
