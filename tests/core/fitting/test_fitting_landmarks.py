"""The landmark stage on people whose parameters are known: the head's own landmarks, projected."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from shape_errors import aligned, shape_error

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import ShapeError
from grmm_core.fitting import landmark_priors, landmark_stage
from grmm_core.fitting.landmark_priors import FACE_OVAL, landmark_modes
from grmm_core.fitting.landmark_stage import Observation, fit_landmarks
from grmm_core.geometry.camera import Camera
from grmm_core.head.usual_face import usual_shape
from grmm_core.photo.landmarks import HeadLandmarks

SIZE = 512


def person(seed, count=300):
    return np.random.default_rng([seed, 5]).normal(0.0, 0.8, count)


def expression(**values):
    result = np.zeros(100)
    for name, value in values.items():
        result[ARKIT_NAMES.index(name)] = value
    return result


def observe(rig, shape, coefficients, camera, pose=None, noise=0.0, seed=0, focal=None):
    """What a perfect (or noisy) landmark network would report."""
    points = rig.positions(shape, coefficients, np.zeros((5, 3)) if pose is None else pose)
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    pixels = local[:, :2] / local[:, 2:] * camera.fx + [camera.cx, camera.cy]
    depth = (local[:, 2] - local[:, 2].mean()) * camera.fx / local[:, 2].mean()
    landmarks = np.concatenate([pixels, depth[:, None]], axis=1)
    landmarks[:, :2] += np.random.default_rng(seed).normal(0.0, 1.0, (478, 2)) * noise
    return Observation(landmarks, coefficients[:52], camera.width, camera.height, focal)


def eye_distance(observation):
    return np.linalg.norm(observation.landmarks[263, :2] - observation.landmarks[33, :2])


def reprojection(fit, observation, index=0):
    return np.linalg.norm(fit.landmarks[index] - observation.landmarks[:, :2], axis=1).mean() / eye_distance(observation)


def angle_between(a, b):
    return np.degrees(np.arccos(np.clip((np.trace(a @ b.T) - 1.0) / 2.0, -1.0, 1.0)))


def test_rig_is_the_heads_landmarks(head, rig):
    g = np.random.default_rng(0)
    shape, coefficients, pose = g.normal(size=300), g.uniform(0, 0.6, 100), g.normal(size=(5, 3)) * 0.1
    vertices = head.vertices(shape, coefficients, head.pose_of(coefficients, pose))
    np.testing.assert_allclose(rig.positions(shape, coefficients, pose), head.landmark_positions(vertices, 478), atol=2e-6)


def test_derivatives_are_those_of_finite_differences(rig):
    g = np.random.default_rng(1)
    point = [g.normal(size=300), g.uniform(0, 0.6, 100), g.normal(size=(5, 3)) * 0.1]
    derivatives = rig.linearise(*point)[1:]
    for index, derivative in enumerate(derivatives):
        direction = g.normal(size=point[index].shape) * 1e-5
        high, low = ([*point[:index], point[index] + sign * direction, *point[index + 1 :]] for sign in (1, -1))
        expected = (rig.positions(*high) - rig.positions(*low)) / 2.0
        result = np.tensordot(derivative, direction, axes=direction.ndim)
        assert np.abs(result - expected).max() < 1e-6 * np.abs(expected).max() + 1e-12


def test_one_photo_of_a_known_person(head, rig):
    shape, coefficients = person(4) * 1.6, expression(jawOpen=0.5, mouthSmileLeft=0.6, mouthSmileRight=0.6, eyeBlinkLeft=0.8)
    camera = Camera.orbit(SIZE, SIZE, yaw=22.0, pitch=8.0, distance=1.2, fov=22.0)
    observation = observe(rig, shape, coefficients, camera)
    # the reported coefficients are off: they are a start value only
    fit = fit_landmarks([replace(observation, arkit=np.clip(observation.arkit * 0.7 + 0.05, 0, 1))], rig)
    assert reprojection(fit, observation) < 0.02
    assert angle_between(fit.cameras[0].world_to_camera[:3, :3], camera.world_to_camera[:3, :3]) < 4.0
    assert shape_error(head, fit.shape, shape) < 0.75 * shape_error(head, np.zeros(300), shape)
    for name, value in (("jawOpen", 0.5), ("mouthSmileLeft", 0.6), ("eyeBlinkLeft", 0.8), ("eyeBlinkRight", 0.0)):
        assert fit.views[0].expression[ARKIT_NAMES.index(name)] == pytest.approx(value, abs=0.25), name


def test_more_photos_tell_more_of_the_shape(head, rig):
    errors = {1: [], 4: []}
    for seed in range(2):
        shape = person(seed)
        cameras = [Camera.orbit(SIZE, SIZE, yaw=yaw, pitch=4.0, distance=1.2) for yaw in (0.0, 30.0, -30.0, 55.0)]
        observations = [observe(rig, shape, expression(jawOpen=0.2 * i), c, noise=1.5, seed=i) for i, c in enumerate(cameras)]
        for count, values in errors.items():
            fit = fit_landmarks(observations[:count], rig)
            assert len(fit.cameras) == count
            values.append(shape_error(head, fit.shape, shape))
    assert np.mean(errors[4]) < 0.85 * np.mean(errors[1])


def test_an_error_that_photos_share_weighs_no_more_than_in_one(head, rig, monkeypatch):
    """What the network gets wrong on a face it gets wrong in every photo: were it independent, two would bend a shape more."""

    def independent(problem, *others):
        return replace(weighed(problem, *others), shape_weight=1.0)

    weighed, errors = landmark_stage._weighed, {"one": [], "two": [], "independent": []}
    cameras = [Camera.orbit(SIZE, SIZE, yaw=yaw, pitch=4.0, distance=1.2) for yaw in (0.0, 30.0)]
    for seed in range(2):
        shape, mistaken = person(seed), person(seed) + person(seed + 10)  # landmarks of somebody else, from every side
        observations = [observe(rig, mistaken, np.zeros(100), camera, noise=1.5, seed=i) for i, camera in enumerate(cameras)]
        errors["one"].append(shape_error(head, fit_landmarks(observations[:1], rig).shape, shape))
        errors["two"].append(shape_error(head, fit_landmarks(observations, rig).shape, shape))
        with monkeypatch.context() as patch:
            patch.setattr(landmark_stage, "_weighed", independent)
            errors["independent"].append(shape_error(head, fit_landmarks(observations, rig).shape, shape))
    assert np.mean(errors["two"]) < 1.05 * np.mean(errors["one"])
    assert np.mean(errors["two"]) < 0.95 * np.mean(errors["independent"])


def test_a_photo_is_nearer_its_landmarks_than_they_are_believed_for_the_shape(rig, monkeypatch):
    camera = Camera.orbit(SIZE, SIZE, yaw=8.0, distance=1.2)
    seen = observe(rig, person(6), np.zeros(100), camera)
    modes = landmark_modes(camera.world_to_camera[:3, :3]) * eye_distance(seen)
    seen.landmarks[:, :2] += modes @ np.random.default_rng(0).normal(0.0, 1.0, modes.shape[2])
    near = fit_landmarks([seen], rig)
    monkeypatch.setattr(landmark_stage, "VIEW_NOISE", 1.0)
    alike = fit_landmarks([seen], rig)
    np.testing.assert_array_equal(near.shape, alike.shape)  # found before
    assert reprojection(near, seen) < 0.97 * reprojection(alike, seen)


def test_both_kinds_of_landmarks_tell_the_shape_and_mediapipes_where_the_face_is(head, rig):
    """What one of the networks makes longer and the other shorter is in neither's way."""
    shape, camera = person(4), Camera.orbit(SIZE, SIZE, yaw=12.0, distance=1.2)
    exact = observe(rig, shape, np.zeros(100), camera)
    lower = np.clip(exact.landmarks[:, 1] - exact.landmarks[2, 1], 0.0, None)  # pixels below the nose
    found = replace(exact, landmarks=exact.landmarks.copy())
    found.landmarks[:, 1] += 0.12 * lower
    points = exact.landmarks[:, :2] - np.stack([np.zeros(478), 0.12 * lower], 1) - [9.0, -4.0]
    told = replace(found, placed=HeadLandmarks(points, np.full(478, 0.01 * eye_distance(found))))
    alone, both = fit_landmarks([found], rig), fit_landmarks([told], rig)
    assert shape_error(head, both.shape, shape) < 0.6 * shape_error(head, alone.shape, shape)
    np.testing.assert_allclose(both.landmarks[0].mean(0), found.landmarks[:, :2].mean(0), atol=1.0)


def test_mediapipes_landmarks_tell_no_shape_along_the_outline(rig):
    camera = Camera.orbit(SIZE, SIZE, yaw=30.0, distance=1.2)
    facing = rig.facing(camera.world_to_camera[:3, :3])
    placed = observe(rig, person(4), np.zeros(100), camera).landmarks[:, :2]
    slid = np.where(facing[:, None] < 0.2, [9.0, 11.0], [9.0, -4.0])  # all of them beside, the slanted ones otherwise
    assert 50 < (facing < 0.2).sum() < 200
    np.testing.assert_allclose(landmark_stage._of_both(placed, placed + slid, facing), placed, atol=1e-9)
    front = facing > 0.7
    apart = np.where(front[:, None], [4.0, 0.0], 0.0)
    moved = landmark_stage._of_both(placed, placed + apart, facing) - placed
    assert 50 < front.sum() < 239, "less than half: these are no shift of all"
    np.testing.assert_allclose(moved, 0.5 * apart, atol=1e-9)


def test_of_several_photos_both_kinds_of_landmarks_tell_where_each_face_is(rig):
    shape, camera, beside = person(4), Camera.orbit(SIZE, SIZE, yaw=12.0, distance=1.2), np.array([9.0, -4.0])
    found = observe(rig, shape, np.zeros(100), camera)
    places = found.landmarks[:, :2].copy()
    found.landmarks[:, :2] += beside
    told = replace(found, placed=HeadLandmarks(places, np.full(478, 0.01 * eye_distance(found))))
    fit = fit_landmarks([told, told], rig)
    np.testing.assert_allclose(fit.landmarks[1].mean(0) - places.mean(0), 0.5 * beside, atol=1.0)


def test_the_surer_of_the_heads_landmarks_count_more(head, rig):
    shape, camera, sure = person(5), Camera.orbit(SIZE, SIZE, yaw=-8.0, distance=1.2), np.arange(478) % 2 == 0
    found = observe(rig, shape, np.zeros(100), camera)
    other = observe(rig, person(11), np.zeros(100), camera).landmarks
    points = np.where(sure[:, None], found.landmarks, other)[:, :2]
    low, high = 0.01 * eye_distance(found), 0.1 * eye_distance(found)
    errors = [
        shape_error(head, fit_landmarks([replace(found, placed=HeadLandmarks(points, sigma))], rig).shape, shape)
        for sigma in (np.where(sure, low, high), np.where(sure, high, low))
    ]
    assert errors[0] < 0.5 * errors[1]


def test_a_mouth_is_as_wide_as_it_looks_where_the_network_reports_no_expression(rig, monkeypatch):
    """It could be a narrow one that smiles: nothing but what is reported tells the two apart."""

    def width(shape):
        left, right = rig.positions(shape, np.zeros(100), np.zeros((5, 3)))[[61, 291]]
        return np.linalg.norm(left - right)

    usual = usual_shape(rig.head)
    mean = width(usual)
    wider = np.array([width(usual + step) for step in np.eye(300) * 0.1]) - mean
    shape = usual + 2.0 * wider / np.linalg.norm(wider)
    seen, found = observe(rig, shape, np.zeros(100), Camera.orbit(SIZE, SIZE, yaw=6.0, distance=1.2)), []
    for sigma in (landmark_priors._SHAPE_SIGMA, 1.0):
        monkeypatch.setattr(landmark_priors, "_SHAPE_SIGMA", sigma)
        found.append((width(fit_landmarks([seen], rig).shape) - mean) / (width(shape) - mean))
    assert found[0] > 1.1 * found[1]


def test_a_mouth_that_is_seen_smiling_rests_as_peoples_do(rig, monkeypatch):
    """No photo of a smile shows how it rests: people's mean tells, whose lips are thinner and corners higher."""

    def mouth(shape):
        """How far the corners droop and how thick the lips are, millimetres."""
        points = rig.positions(shape, np.zeros(100), np.zeros((5, 3)))[:, 1] * 1e3
        return np.array([points[[13, 14]].mean() - points[[61, 291]].mean(), points[0] - points[17]])

    shape = usual_shape(rig.head)
    smile = expression(mouthSmileLeft=0.7, mouthSmileRight=0.7, mouthUpperUpLeft=0.3, mouthUpperUpRight=0.3)
    smile[ARKIT_NAMES.index("mouthRollLower")] = -0.35  # people's lower lips stay as thick as they are, the model's do not
    seen = observe(rig, shape, smile, Camera.orbit(SIZE, SIZE, yaw=6.0, distance=1.2))
    usual = mouth(fit_landmarks([seen], rig).shape)
    monkeypatch.setattr(landmark_stage, "usual_shape", lambda head: np.zeros(head.shape_count))
    pouting = mouth(fit_landmarks([seen], rig).shape)
    assert np.abs(usual - mouth(shape)).max() < 0.2
    assert (pouting - mouth(shape) > [0.3, 0.7]).all()
    monkeypatch.undo()
    monkeypatch.setattr(landmark_stage, "photo_priors", lambda head, priors: priors)
    assert mouth(fit_landmarks([seen], rig).shape)[1] - mouth(shape)[1] > 0.3, "without it a lip is thick at rest"


def test_wrong_landmarks_do_little_harm(head, rig):
    shape, camera = person(7), Camera.orbit(SIZE, SIZE, yaw=-10.0, distance=1.2)
    clean = observe(rig, shape, np.zeros(100), camera)
    spoilt = clean.landmarks.copy()
    spoilt[np.random.default_rng(0).permutation(478)[:40], :2] += 0.8 * eye_distance(clean)
    result = fit_landmarks([replace(clean, landmarks=spoilt)], rig)
    assert reprojection(result, clean) < 0.012


def test_systematic_errors_of_the_network_are_not_taken_for_shape(head, rig, monkeypatch):
    monkeypatch.setattr(landmark_priors, "NOISE_SHARE", 0.5)  # nearly what it errs by on synthetic pictures
    shape, camera = person(6), Camera.orbit(SIZE, SIZE, yaw=8.0, distance=1.2)
    clean = observe(rig, shape, np.zeros(100), camera)
    modes = landmark_modes(camera.world_to_camera[:3, :3]) * eye_distance(clean)  # [478, 2, K]
    errors = {"known": [], "ignored": []}
    for seed in range(2):
        spoilt = clean.landmarks.copy()
        spoilt[:, :2] += modes @ np.random.default_rng(seed).normal(0.0, 1.5, modes.shape[2])
        observation = replace(clean, landmarks=spoilt)
        errors["known"].append(shape_error(head, fit_landmarks([observation], rig).shape, shape))
        with monkeypatch.context() as patch:
            patch.setattr(landmark_priors, "_stored_modes", lambda placed: np.zeros((16, 478, 2)))
            errors["ignored"].append(shape_error(head, fit_landmarks([observation], rig).shape, shape))
    assert np.mean(errors["known"]) < 0.9 * np.mean(errors["ignored"])


def test_error_modes_roll_with_the_head():
    upright, c, s = np.diag([1.0, -1.0, -1.0]), np.cos(0.7), np.sin(0.7)
    turn = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    expected = np.einsum("ij,ljk->lik", turn[:2, :2], landmark_modes(upright))
    np.testing.assert_allclose(landmark_modes(turn @ upright), expected, atol=1e-9)


def test_gaze_follows_the_irises(head, rig):
    pose = np.zeros((5, 3))
    pose[3:, 1], pose[3:, 0] = 0.25, 0.1  # to the subject's left, down
    camera = Camera.orbit(SIZE, SIZE, yaw=5.0, distance=1.2)
    fit = fit_landmarks([observe(rig, person(2) * 0.5, np.zeros(100), camera, pose)], rig)
    view = fit.views[0]
    gaze = head.pose_of(view.expression, view.pose)[3:]
    np.testing.assert_allclose(gaze[:, :2], pose[3:, :2], atol=0.08)


def test_a_stated_focal_length_gives_the_distance(rig):
    camera = Camera.orbit(SIZE, SIZE, distance=2.4, fov=11.0)
    fit = fit_landmarks([observe(rig, np.zeros(300), np.zeros(100), camera, focal=camera.fx)], rig)
    assert np.linalg.norm(fit.cameras[0].position) == pytest.approx(2.4, rel=0.12)
    assert fit.cameras[0].fx == pytest.approx(camera.fx, rel=0.12)


def test_profile_relies_on_the_visible_side(rig):
    shape, camera = person(5), Camera.orbit(SIZE, SIZE, yaw=65.0, distance=1.2)
    observation = observe(rig, shape, np.zeros(100), camera)
    landmarks = observation.landmarks.copy()
    far_side = [i for i in FACE_OVAL if landmarks[i, 2] > 0.3 * np.abs(landmarks[:, 2]).max()]
    landmarks[far_side, :2] += 0.15 * np.ptp(landmarks[:, 1])  # what hides there is a guess of the network
    fit = fit_landmarks([replace(observation, landmarks=landmarks)], rig)
    assert angle_between(fit.cameras[0].world_to_camera[:3, :3], camera.world_to_camera[:3, :3]) < 6.0


def test_expressions_stay_in_their_range(rig):
    g = np.random.default_rng(4)
    observation = observe(rig, person(1), expression(jawOpen=1.0, mouthPucker=1.0), Camera.orbit(SIZE, SIZE), noise=12.0)
    fit = fit_landmarks([replace(observation, arkit=g.uniform(0, 1, 52))], rig)
    coefficients = fit.views[0].expression[:52]
    rolled = coefficients[ARKIT_NAMES.index("mouthRollLower")]
    assert rolled >= -0.55, "lower lips unroll in smiles"
    assert np.delete(coefficients, ARKIT_NAMES.index("mouthRollLower")).min() >= 0.0
    assert coefficients.max() <= 1.1


def test_unusable_landmarks_are_refused(rig):
    observation = observe(rig, np.zeros(300), np.zeros(100), Camera.orbit(SIZE, SIZE))
    with pytest.raises(ShapeError, match="478"):
        fit_landmarks([replace(observation, landmarks=observation.landmarks[:68])], rig)
    with pytest.raises(ShapeError, match="No photo"):
        fit_landmarks([], rig)


def test_alignment_undoes_a_similarity():
    points = np.random.default_rng(0).normal(size=(50, 3))
    c, s = np.cos(0.4), np.sin(0.4)
    turned = 1.3 * points @ np.array([[c, s, 0], [-s, c, 0], [0, 0, 1]]) + [1.0, -2.0, 0.5]
    np.testing.assert_allclose(aligned(points, turned), turned, atol=1e-12)


def test_shape_error_does_not_see_the_size_of_a_head(head):
    assert shape_error(head, np.zeros(300), np.zeros(300)) < 1e-6
    assert shape_error(head, person(1), person(2)) > 1.0
