"""Photo analysis: the converted networks against LiteRT, and faces in real photos."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from photos import two_people
from PIL import Image

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import NoFaceError
from grmm_core.photo.faces import find_faces
from grmm_core.photo.networks import load_networks

INPUT_SCALE = {"face_detector": 1.0, "face_landmarks_detector": 1.0, "face_blendshapes": 256.0, "selfie_segmentation": 1.0}


@pytest.mark.parametrize("name", INPUT_SCALE)
def test_networks_answer_as_litert_does(name, repository):
    reference = np.load(repository / "tests" / "data" / "photo_networks_reference.npz")
    network = load_networks()[name]
    value = np.random.default_rng(0).uniform(0.0, INPUT_SCALE[name], network.input_shape).astype(np.float32)
    for index, output in enumerate(network(torch.from_numpy(value))):
        expected = reference[f"{name}.{index}"]
        result = output.numpy()[:, ::4, ::4] if name == "selfie_segmentation" else output.numpy()
        np.testing.assert_allclose(result, expected, atol=1e-5 * max(1.0, float(np.abs(expected).max())))


@pytest.fixture(scope="module")
def photos(photo_file):
    return lambda name: np.asarray(Image.open(photo_file(name)).convert("RGB"))


def arkit(face, name):
    return face.arkit[ARKIT_NAMES.index(name)]


def test_a_smiling_portrait(photos):
    (face,) = find_faces(photos("astronaut"))
    assert face.presence > 0.9
    assert face.landmarks.shape == (478, 3)
    assert arkit(face, "mouthSmileLeft") > 0.5
    assert arkit(face, "jawOpen") < 0.2
    # the nose tip (1) lies between the eyes (33, 263) and the chin (152), on the picture's face
    assert face.landmarks[33, 1] < face.landmarks[1, 1] < face.landmarks[152, 1]
    assert face.landmarks[33, 0] < face.landmarks[1, 0] < face.landmarks[263, 0]


def test_two_people_are_two_faces(photo_file):
    faces = find_faces(two_people(photo_file))
    assert len(faces) == 2
    assert faces[0].box[2] - faces[0].box[0] >= faces[1].box[2] - faces[1].box[0]


@pytest.mark.parametrize("scale", [1, 24])
def test_nothing_and_what_only_the_detector_takes_for_a_face_are_refused(photos, scale):
    """One color; and a portrait in so few squares that the first network still sees a face and the second does not."""
    small = Image.fromarray(photos("astronaut")).resize((scale, scale), Image.Resampling.BICUBIC)
    with pytest.raises(NoFaceError, match="No face"):
        find_faces(np.asarray(small.resize((512, 512), Image.Resampling.NEAREST)))


def test_a_small_face_is_found_by_tiles(photos):
    portrait = photos("astronaut")[::2, ::2]
    large = np.full((2400, 2400, 3), 90, np.uint8)
    large[1500:1756, 400:656] = portrait
    (face,) = find_faces(large)
    (alone,) = find_faces(portrait)
    np.testing.assert_allclose(face.landmarks[:, :2] - [400, 1500], alone.landmarks[:, :2], atol=3.0)


def test_no_face_of_a_row_is_missed(photos):
    """At once the detector sees the middle ones only."""
    names = ("astronaut", "admiral", "astronaut", "admiral", "astronaut")
    picture = np.full((400, 1500, 3), 90, np.uint8)
    for place, name in enumerate(names):
        one = Image.fromarray(photos(name))
        one.thumbnail((300, 400))
        picture[: one.height, 300 * place : 300 * place + one.width] = np.asarray(one)
    places = sorted(int(face.landmarks[1, 0] // 300) for face in find_faces(picture))
    assert places == [0, 1, 2, 3, 4]


def test_landmarks_follow_a_turned_photo(photos):
    image, angle = photos("admiral"), 25.0
    (face,) = find_faces(image)
    turned = np.asarray(Image.fromarray(image).rotate(angle, resample=Image.Resampling.BICUBIC))
    (result,) = find_faces(turned)
    c, s = np.cos(np.radians(-angle)), np.sin(np.radians(-angle))
    middle = np.array([image.shape[1], image.shape[0]]) / 2.0
    expected = (face.landmarks[:, :2] - middle) @ np.array([[c, s], [-s, c]]) + middle
    assert np.linalg.norm(result.landmarks[:, :2] - expected, axis=1).mean() < 0.04 * face.eye_distance


def test_landmarks_of_a_mirrored_photo_are_mirrored(photos):
    image = photos("admiral")
    (face,) = find_faces(image)
    (mirrored,) = find_faces(np.ascontiguousarray(image[:, ::-1]))
    middle_line = [1, 152]  # nose tip, chin
    expected = np.array([image.shape[1], 0.0]) + face.landmarks[middle_line, :2] * [-1.0, 1.0]
    np.testing.assert_allclose(mirrored.landmarks[middle_line, :2], expected, atol=0.04 * face.eye_distance)
