"""Tracking by all pixels: pictures that a small model drew, with landmarks that err as the network's do."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from photo_parts import parts_of

from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES
from grmm_core.fitting import photo_targets, pixel_stage
from grmm_core.fitting.landmark_stage import restarted
from grmm_core.fitting.photo_targets import project
from grmm_core.fitting.pixel_stage import track_pixels
from grmm_core.fitting.point_rig import LandmarkRig
from grmm_core.fitting.presets import CodeSettings
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM
from grmm_core.model.weights_file import WeightsInfo

SIZE = 256


@pytest.fixture(scope="module")
def person(head):
    """A model of people with spots of centimetres, and what its file says."""
    torch.manual_seed(3)
    model = GRMM(head, PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True))
    with torch.no_grad():
        places = model.anchor(model.head.v_template).positions * 150.0
        model.decoders.appearance_mean[:, :3] = 0.5 + 0.15 * torch.sin(places @ torch.randn(3, 3))
    codes = np.zeros((3, model.z_id_size), np.float32)
    info = WeightsInfo(
        "small", head.name, "", model.config, people=tuple("abc"), z_id=codes,
        shapes=np.zeros((3, 4), np.float32), default_z_id=codes[0], default_shape=np.zeros(4, np.float32),
    )  # fmt: skip
    return model.requires_grad_(False).eval(), info


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    """Few steps, and no parser, which knows people only."""
    monkeypatch.setattr(pixel_stage, "QUICK", CodeSettings(96, 48, 1, 1, 0, 2))
    for module in (photo_targets, pixel_stage):
        monkeypatch.setattr(module, "parse", lambda track, head: parts_of(1.0 - track.mask))


def drawn(model, shape, expression, camera):
    """A picture with exact tracking."""
    head = model.head_model
    pose, aligned = np.zeros((5, 3), np.float32), np.zeros(len(ALIGNED_NAMES), np.float32)
    turned = head.pose_of(expression, pose)
    frame = (np.zeros(model.z_id_size, np.float32), shape, expression, turned, aligned)
    picture = model.render(camera, model.performed(*(torch.tensor(array) for array in frame)))
    mask = picture.alpha.numpy()
    marks = project(head.landmark_positions(head.vertices(shape, expression, turned), LANDMARK_COUNT), camera)
    return PhotoTrack(
        source="drawn.png", image=np.clip(picture.image.numpy() + 0.5 * (1 - mask[..., None]), 0, 1), mask=mask,
        valid=np.ones_like(mask), camera=camera, photo_camera=camera, shape=shape, expression=expression, pose=pose,
        landmarks=marks, landmarks_fitted=marks, arkit=np.clip(expression[:52], 0, 1),
    )  # fmt: skip


@pytest.fixture(scope="module")
def truth(person):
    head = person[0].head_model
    rng = np.random.default_rng(5)
    shape, expression = np.zeros(head.shape_count, np.float32), np.zeros(head.expression_count, np.float32)
    shape[:20] = rng.normal(size=20)
    expression += 0.4 * head.arkit_to_expression[ARKIT_NAMES.index("jawOpen")]
    return drawn(person[0], shape, expression, Camera.orbit(SIZE, SIZE, yaw=8.0, distance=1.1, fov=23.0))


def misled(track, pixels):
    """A track as landmarks that lie by so many pixels would have it: another shape, too little jaw."""
    rng = np.random.default_rng(6)
    shape = track.shape + np.where(np.arange(len(track.shape)) < 20, 0.7 * rng.normal(size=len(track.shape)), 0.0)
    wrong = track.landmarks + pixels * np.sin(track.landmarks / 40.0)
    return dataclasses.replace(
        track, shape=shape.astype(np.float32), expression=0.7 * track.expression, landmarks=wrong, landmarks_fitted=wrong
    )


def places(track, head, which=None):
    """Where the face's vertices, or others, are in the picture, [V, 2]."""
    vertices = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))
    return project(vertices[head.regions["face"] if which is None else which], track.camera)


def off(track, truth, head):
    """Mean distance in pixels of the face's vertices from where they are in truth."""

    return float(np.linalg.norm(places(track, head) - places(truth, head), axis=1).mean())


def test_pixels_bring_the_head_to_where_the_picture_shows_it(person, truth):
    model, info = person
    start, told = misled(truth, 1.5), []
    (found,) = track_pixels([start], model, info, progress=lambda share, message="": told.append(share))
    assert off(found, truth, model.head_model) < 0.6 * off(start, truth, model.head_model)
    assert found.image is start.image or np.array_equal(found.image, start.image)
    assert found.labels is None  # what the parser said stays the parser's
    np.testing.assert_allclose(found.camera.fx / found.photo_camera.fx, start.camera.fx / start.photo_camera.fx, rtol=1e-6)
    assert told == sorted(told)
    assert 0.0 <= told[0] <= told[-1] <= 1.0


def test_ears_are_brought_to_where_skin_ends(person, truth, monkeypatch):
    """What pixels show inside a head says little of how wide it is."""
    model, info = person
    head, colors = model.head_model, model.decoders.appearance_mean
    spots = colors[:, :3] - 0.5
    monkeypatch.setattr(colors, "data", torch.cat([torch.tensor([0.8, 0.58, 0.47]) + 0.2 * spots, colors[:, 3:]], 1))
    seen = drawn(model, truth.shape, truth.expression, truth.camera)
    start, ears = misled(seen, 1.5), head.regions["ears"]
    errors = []
    for use in (True, False):
        if not use:
            monkeypatch.setattr(pixel_stage, "outline_terms", lambda *_: ())
        (found,) = track_pixels([start], model, info)
        errors.append(float(np.linalg.norm(places(found, head, ears) - places(seen, head, ears), axis=1).mean()))
    assert errors[0] < 0.8 * errors[1]


def test_the_best_round_is_kept_where_the_last_is_worse(person, truth, monkeypatch):
    model, info = person
    start, solved, solve = misled(truth, 1.5), [], pixel_stage.solve

    def spoiled(*arguments):
        solved.append(solve(*arguments))
        if len(solved) < len(pixel_stage.BLURS):
            return solved[-1]
        return dataclasses.replace(solved[-1], shape=solved[-1].shape + np.where(np.arange(len(start.shape)) < 20, 2.0, 0.0))

    monkeypatch.setattr(pixel_stage, "solve", spoiled)
    monkeypatch.setattr(pixel_stage, "with_shape", lambda problem, solution, limit: solution)
    (found,) = track_pixels([start], model, info)
    assert len(solved) == len(pixel_stage.BLURS)
    np.testing.assert_allclose(found.shape, solved[-2].shape, atol=1e-5)


def test_pixels_that_contradict_the_landmarks_are_not_believed(person, truth, monkeypatch):
    model, info = person
    start = misled(truth, 1.5)
    monkeypatch.setattr(pixel_stage, "MOST_LANDMARK_LOSS", -1.0)
    (kept,) = track_pixels([start], model, info)
    assert kept is start


def test_a_picture_without_a_face_keeps_its_track(person, truth):
    model, info = person
    empty = dataclasses.replace(truth, mask=np.zeros_like(truth.mask))
    assert track_pixels([empty], model, info)[0] is empty


def test_the_landmarks_problem_starts_again_where_the_track_is(head, person, truth):
    fit = restarted([truth, truth], LandmarkRig(head))
    np.testing.assert_allclose(fit.landmarks[1], truth.landmarks, atol=0.05)
    np.testing.assert_allclose(fit.cameras[0].world_to_camera, truth.photo_camera.world_to_camera, atol=1e-6)
    np.testing.assert_allclose(fit.shape, truth.shape, atol=1e-6)
