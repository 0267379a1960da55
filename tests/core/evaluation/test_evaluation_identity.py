"""Identity distance with a network of our own making: which face it is shown, and files that are none."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.errors import FileAccessError, FileFormatError, RuntimeMissingError
from grmm_core.evaluation.identity import PLACES, SIDE, IdentityDistance, aligned_face, load_identity, photo_landmarks
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.geometry.camera import Camera

CORNERS = (33, 133, 263, 362, 1, 61, 291)
MARKS = np.array([[60, 80], [80, 80], [140, 80], [120, 80], [100, 110], [85, 140], [115, 140]], np.float32)


class Mean(torch.nn.Module):
    """Embedding: the mean color."""

    def forward(self, faces: torch.Tensor) -> torch.Tensor:
        return faces.mean((2, 3))


@pytest.fixture
def track():
    landmarks = np.zeros((LANDMARK_COUNT, 2), np.float32)
    landmarks[list(CORNERS)] = MARKS
    camera = Camera.orbit(200, 200)
    flat = np.zeros((200, 200), np.float32)
    return PhotoTrack(
        source="", image=np.zeros((200, 200, 3)), mask=flat, valid=flat, camera=camera, photo_camera=camera, shape=np.zeros(1),
        expression=np.zeros(1), pose=np.zeros((5, 3)), landmarks=landmarks, landmarks_fitted=landmarks, arkit=np.zeros(52),
    )  # fmt: skip


def marked(size=200, offset=(0.0, 0.0)):
    """A picture with a white spot at the tip of the nose."""
    picture = torch.zeros(size, size, 3)
    scale = size / 200
    x, y = (MARKS[4] - offset) * scale
    picture[int(y) - 3 : int(y) + 3, int(x) - 3 : int(x) + 3] = 1.0
    return picture


def test_the_face_is_aligned_by_its_features(track):
    def face_of(picture, camera):
        return aligned_face(picture, photo_landmarks(track, camera))

    face = face_of(marked(), track.camera)
    assert face.shape == (3, SIDE, SIDE)
    rows, columns = torch.nonzero(face[0] > 0.5, as_tuple=True)
    assert abs(float(columns.float().mean()) + 0.5 - PLACES[2, 0]) < 3.0
    assert abs(float(rows.float().mean()) + 0.5 - PLACES[2, 1]) < 6.0
    enlarged = face_of(marked(400), track.camera.resized(400, 400))
    assert float((enlarged - face).abs().mean()) < 0.01
    part = face_of(marked(200, (20.0, 30.0))[:150, :160], track.camera.crop(20, 30, 160, 150))
    assert float((part - face).abs().mean()) < 0.01


def test_the_distance_is_that_of_the_embeddings(track, tmp_path):
    path = tmp_path / "network.pt"
    torch.jit.script(Mean()).save(str(path))

    own = load_identity(path)

    def distance(first, second, network=own):
        return network.distance(*(network.embedding(picture, track.landmarks) for picture in (first, second)))

    red, blue = (torch.tensor(color).expand(200, 200, 3) for color in ([1.0, 0.5, 0.5], [0.5, 0.5, 1.0]))
    assert distance(red, red) == pytest.approx(0.0, abs=1e-6)
    assert distance(red, blue) == pytest.approx(1.0, abs=1e-5)
    assert distance(red, red * 0.0, IdentityDistance(Mean())) > 1.0


def test_dlib_is_named_where_it_is_not_installed(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    with pytest.raises(RuntimeMissingError, match="pip install --no-deps dlib-bin"):
        load_identity("dlib")


def test_files_that_are_no_networks_are_named(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        load_identity(tmp_path / "missing.pt")
    path = tmp_path / "text.pt"
    path.write_text("no network")
    with pytest.raises(FileFormatError, match="TorchScript"):
        load_identity(path)
    torch.jit.script(torch.nn.ReLU()).save(str(path))
    with pytest.raises(FileFormatError, match="one embedding"):
        load_identity(path)
