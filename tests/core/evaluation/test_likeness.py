"""Likeness of an avatar at rest and turned, by a network of our own making."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from grmm_core.evaluation.cleanliness import Shot
from grmm_core.evaluation.photo_fits import drawn_landmarks, likeness
from grmm_core.head.open_head import load_open_head
from grmm_core.photo.faces import find_faces
from grmm_core.photo.load import load_photo


class Brightness:
    """Embedding: the mean of a picture; keeps the landmarks that it was asked about."""

    def __init__(self):
        self.landmarks = []

    def embedding(self, picture, landmarks):
        self.landmarks.append(np.asarray(landmarks))
        return np.array([float(picture.mean())])

    def distance(self, first, second):
        return float(np.abs(first - second).sum())


class Person:
    """At rest, the darker the farther from the front, and more so on one side."""

    def __init__(self, head):
        self.head = head

    def shot(self, controls, camera):
        assert not np.any(controls.aligned)
        x, _, z = camera.position
        yaw = float(np.degrees(np.arctan2(x, z)))
        rgb = np.full((camera.height, camera.width, 3), 1.0 - abs(yaw) / 100.0 - (0.1 if yaw > 1.0 else 0.0), np.float32)
        return Shot(np.asarray(self.head.v_template, np.float64), camera, rgb, rgb[..., 0], rgb[..., 0])


def test_figures_are_of_a_face_at_rest_from_the_front_and_both_sides():
    track = SimpleNamespace(image=np.ones((8, 8, 3), np.float32), landmarks=np.zeros((478, 3), np.float32))
    network = Brightness()
    found = likeness(track, Person(load_open_head()), network)
    expected = {"identity_rest": 0.0, "identity_30": 0.35, "identity_60": 0.65}
    assert found == pytest.approx(expected, abs=0.01)
    front = network.landmarks[-1]
    left, right = front[33], front[263]  # outer corners of the eyes, in the picture's middle
    assert front.shape == (478, 2)
    assert 0 < left[0] < right[0] < 512
    assert abs(left[1] - right[1]) < 5.0


def test_landmarks_of_the_drawn_avatar_are_compared_with_those_of_the_photo(photo_file):
    image = load_photo(photo_file("astronaut")).pixels
    face = find_faces(image)[0]
    track = SimpleNamespace(image=image, mask=np.ones(image.shape[:2], np.float32), landmarks=face.landmarks, camera=None)
    moved = int(face.eye_distance / 20)  # pixels

    def off(picture):
        return drawn_landmarks(track, SimpleNamespace(photo=lambda camera: SimpleNamespace(rgb=picture)))["landmarks_drawn"]

    assert off(image) == 0.0
    assert off(np.roll(image, moved, axis=1)) == pytest.approx(moved / face.eye_distance, rel=0.15)
