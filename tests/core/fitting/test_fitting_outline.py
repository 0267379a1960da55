"""The outline refinement, on a head drawn from known parameters."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.fitting import photometric_stage
from grmm_core.fitting.landmark_stage import Observation, fit_landmarks
from grmm_core.fitting.outline import find_outline, skin_map
from grmm_core.fitting.photometric_stage import Appearance, posed, refine, shape_change
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth

SIZE = 320
SKIN = np.array([0.80, 0.58, 0.47])
BACKGROUND = np.array([0.20, 0.35, 0.55])


def projected(points, camera):
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return local[:, :2] / local[:, 2:] * camera.fx + [camera.cx, camera.cy]


def drawn(head, vertices, camera):
    """A bald person of one color, and the mask."""
    mask = (triangle_depth(vertices[head.faces], camera) < EMPTY).astype(np.float32)
    image = mask[:, :, None] * SKIN + (1.0 - mask[:, :, None]) * BACKGROUND
    return image.astype(np.float32), mask


def picture_of(image, mask):
    return Appearance(image, mask, np.ones_like(mask), 0.0, 0.0, 1.0)


def observation_of(head, vertices, camera):
    points = head.landmark_positions(vertices, 478).astype(np.float64)
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    depth = (local[:, 2] - local[:, 2].mean()) * camera.fx / local[:, 2].mean()
    landmarks = np.concatenate([projected(points, camera), depth[:, None]], axis=1)
    return Observation(landmarks, np.zeros(52), camera.width, camera.height)


@pytest.fixture(scope="module")
def person(head):
    shape = np.random.default_rng([4, 5]).normal(0.0, 1.3, 300)
    camera = Camera.orbit(SIZE, SIZE, yaw=15.0, distance=1.4, fov=15.0)
    vertices = head.vertices(shape, np.zeros(100), np.zeros((5, 3))).astype(np.float64)
    return shape, camera, vertices


def test_outline_of_the_true_head_is_where_it_is(head, person):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    found = find_outline(head, vertices, camera, image, mask, np.ones_like(mask), unit=60.0)
    assert len(found.distance) > 20
    assert np.abs(found.distance).max() < 2.5


def test_outline_finds_how_far_a_head_is_too_small(head, person):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    found = find_outline(head, vertices * 0.94, camera, image, mask, np.ones_like(mask), unit=60.0)
    # an ear is about 8 cm from the middle: 6% are 5 mm
    expected = 0.06 * 0.08 * camera.fx / 1.4
    assert np.median(found.distance) == pytest.approx(expected, rel=0.6)


def beside(head, vertices, camera, mask):
    """Pixels over the left ear of the picture and beyond it, [H, W] bool."""
    ears = projected(vertices[head.regions["ears"]], camera)
    ear = int(ears[:, 0].min())
    pixels = np.zeros_like(mask, bool)
    pixels[int(ears[:, 1].min()) - 20 : int(ears[:, 1].max()) + 20, ear - 8 : ear + 12] = True
    return pixels


def test_hair_is_no_outline(head, person):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    hair = beside(head, vertices, camera, mask)
    image[hair], mask[hair] = [0.07, 0.05, 0.04], 1.0
    found = find_outline(head, vertices, camera, image, mask, np.ones_like(mask), unit=60.0)
    columns, rows = found.target.astype(int).T
    inside = np.logical_and.reduce([np.roll(hair, step, axis) for step in (-3, 3) for axis in (0, 1)])
    assert not inside[rows, columns].any()
    assert len(found.distance) > 10


def test_hair_of_the_skins_color_is_no_outline_once_it_is_known(head, person):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    hair = beside(head, vertices, camera, mask)
    image[hair], mask[hair] = SKIN, 1.0
    taken, told = (
        find_outline(head, vertices, camera, image, mask, np.ones_like(mask), 60.0, others)
        for others in (None, hair.astype(np.float32))
    )
    assert taken.distance.max() > 4.0  # by its color it is an ear that is too small
    assert np.abs(told.distance).max() < 2.5
    assert len(told.distance) > 10


def test_nothing_is_matched_beyond_the_photo(head, person):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    valid = np.ones_like(mask)
    valid[:, : SIZE // 2] = 0.0
    found = find_outline(head, vertices, camera, image, mask, valid, unit=60.0)
    assert (found.target[:, 0] > SIZE // 2 - 1).all()


def test_refinement_brings_the_mesh_onto_the_outline(head, rig, person):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    fit = fit_landmarks([observation_of(head, vertices, camera)], rig)
    refined = refine(fit, [picture_of(image, mask)], rig)
    ears = head.regions["ears"]
    truth = projected(vertices[ears], camera)
    errors = [np.linalg.norm(projected(posed(f, 0, rig)[ears], f.cameras[0]) - truth, axis=1).mean() for f in (fit, refined)]
    assert errors[1] < 0.8 * errors[0]
    wanted = fit.problem.photos[0].terms[0].target
    before, after = (np.linalg.norm(f.landmarks[0] - wanted, axis=1).mean() for f in (fit, refined))
    assert after < before + 0.004 * fit.units[0]


def test_outlines_that_change_the_shape_beyond_belief_are_dropped(head, rig, person, monkeypatch):
    _, camera, vertices = person
    image, mask = drawn(head, vertices, camera)
    fit = fit_landmarks([observation_of(head, vertices, camera)], rig)
    refined = refine(fit, [picture_of(image, mask)], rig)
    change = shape_change(head, fit.shape, refined.shape)
    assert 0.0 < change < photometric_stage.MAX_SHAPE_CHANGE
    monkeypatch.setattr(photometric_stage, "MAX_SHAPE_CHANGE", 0.5 * change)
    assert refine(fit, [picture_of(image, mask)], rig) is fit


def test_shape_change_is_the_mean_distance_in_metres(head):
    shape = np.zeros(head.shape_count)
    assert shape_change(head, shape, shape) < 1e-9
    changes = []
    for amount in (0.5, 1.0):
        shape[3] = amount
        changes.append(shape_change(head, np.zeros(head.shape_count), shape))
    assert changes[1] == pytest.approx(2.0 * changes[0], rel=0.05)
    assert 1e-5 < changes[1] < 5e-3


def test_without_a_person_nothing_changes(head, rig, person):
    _, camera, vertices = person
    fit = fit_landmarks([observation_of(head, vertices, camera)], rig)
    image = np.full((SIZE, SIZE, 3), 0.5, np.float32)
    assert refine(fit, [picture_of(image, np.zeros((SIZE, SIZE), np.float32))], rig) is fit


def test_skin_map_knows_skin_from_other_colors():
    image = np.zeros((40, 60, 3), np.float32)
    image[:, :20], image[:, 20:40], image[:, 40:] = SKIN, SKIN * 0.7, BACKGROUND
    g = np.random.default_rng(0)
    points = g.uniform([1, 1], [19, 39], (200, 2))
    result = skin_map(np.clip(image + g.normal(0, 0.01, image.shape), 0, 1), points)
    assert result[:, :20].mean() > 0.9
    assert result[:, 20:40].mean() > 0.9  # the same skin in shade
    assert result[:, 40:].mean() < 0.1


def test_pictures_cameras_agree():
    camera = Camera.orbit(640, 480)
    picture = replace(picture_of(np.zeros((100, 100, 3)), np.zeros((100, 100))), left=20.0, top=30.0, scale=0.5)
    point = np.array([[0.02, 0.03, 0.08]])
    np.testing.assert_allclose(projected(point, picture.camera(camera)), (projected(point, camera) - [20, 30]) * 0.5)
