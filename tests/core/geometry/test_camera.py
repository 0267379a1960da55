"""Cameras: orbits, crops, OpenGL's matrices, what is refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.errors import ShapeError
from grmm_core.geometry.camera import Camera


def project(camera: Camera, point: tuple[float, float, float]) -> np.ndarray:
    x, y, z, _ = camera.world_to_camera @ np.array([*point, 1.0])
    if camera.orthographic:
        return np.array([camera.fx * x + camera.cx, camera.fy * y + camera.cy])
    return np.array([camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy])


def test_orbit_front_view_puts_the_subjects_left_on_the_right_and_up_above():
    camera = Camera.orbit(200, 100)
    assert project(camera, (0, 0, 0)) == pytest.approx([100, 50])
    assert project(camera, (0.1, 0, 0))[0] > 100
    assert project(camera, (0, 0.1, 0))[1] < 50
    assert camera.position == pytest.approx([0, 0, 1])


def test_orbit_yaw_walks_to_the_subjects_left_and_pitch_above():
    assert Camera.orbit(64, 64, yaw=90).position == pytest.approx([1, 0, 0])
    assert Camera.orbit(64, 64, pitch=30).position[1] == pytest.approx(0.5)


def test_orbit_field_of_view_spans_the_shorter_side():
    camera = Camera.orbit(400, 200, fov=90, distance=1)
    assert project(camera, (0, 1, 0)) == pytest.approx([200, 0])


def test_crop_and_resize_keep_the_view():
    camera = Camera.orbit(640, 480, yaw=20, pitch=10)
    point = (0.03, 0.05, 0.02)
    assert project(camera.crop(100, 50, 200, 200), point) == pytest.approx(project(camera, point) - [100, 50])
    assert project(camera.resized(320, 240), point) == pytest.approx(project(camera, point) / 2)


@pytest.mark.parametrize("orthographic", [False, True])
def test_opengl_matrices_give_the_same_pixels(orthographic):
    rng = np.random.default_rng(0)
    reference = Camera.orbit(320, 200, yaw=30, pitch=-10)
    view = np.diag([1.0, -1.0, -1.0, 1.0]) @ reference.world_to_camera
    near, far = 0.1, 10.0
    if orthographic:
        projection = np.array([[2.0, 0, 0, 0.3], [0, 3.0, 0, -0.2], [0, 0, -2 / (far - near), -1], [0, 0, 0, 1]])
    else:
        projection = np.array([[2.0, 0, 0.3, 0], [0, 3.0, -0.2, 0], [0, 0, -(far + near) / (far - near), -1], [0, 0, -1, 0]])
    camera = Camera.from_opengl(view, projection, 320, 200)
    assert camera.orthographic is orthographic
    for point in rng.uniform(-0.1, 0.1, (8, 3)):
        clip = projection @ view @ np.array([*point, 1.0])
        ndc = clip[:2] / clip[3]
        expected = [(ndc[0] + 1) * 160, (1 - ndc[1]) * 100]
        assert project(camera, tuple(point)) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("orthographic", [False, True])
def test_a_camera_that_scales_is_one_of_the_models_own_metres(orthographic):
    camera = replace(Camera.orbit(64, 48, 30, 10), orthographic=orthographic, fx=200.0, fy=180.0)
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    scaled = camera.transformed(np.diag([4.0, 4.0, 4.0, 1.0]))
    own, size = scaled.unscaled()
    assert size == pytest.approx(4.0)
    (theirs, pixels), (local, same) = scaled.project(points), own.project(points)
    np.testing.assert_allclose(same, pixels, atol=1e-9)
    np.testing.assert_allclose(local * size, theirs, atol=1e-12)
    assert camera.unscaled() == (camera, 1.0)


def test_moving_the_model_equals_moving_the_camera():
    camera = Camera.orbit(64, 64, yaw=15)
    model_to_world = np.eye(4)
    model_to_world[:3, 3] = [0.1, 0.2, 0.3]
    moved = camera.transformed(model_to_world)
    assert project(moved, (0, 0, 0)) == pytest.approx(project(camera, (0.1, 0.2, 0.3)))


@pytest.mark.parametrize(
    "change", [{"width": 0}, {"fx": float("nan")}, {"fx": 0.0}, {"world_to_camera": np.full((4, 4), np.inf)}]
)
def test_impossible_cameras_are_refused(change):
    values = {"world_to_camera": np.eye(4), "fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, "width": 4, "height": 4}
    with pytest.raises(ShapeError):
        Camera(**{**values, **change})


@pytest.mark.parametrize("orthographic", [False, True])
def test_many_points_are_projected_like_each_of_them(orthographic):
    camera = replace(Camera.orbit(64, 48, yaw=30.0, distance=0.8), orthographic=orthographic)
    points = np.array([[0.0, 0.0, 0.0], [0.05, -0.02, 0.1]])
    local, pixels = camera.project(points)
    np.testing.assert_allclose(pixels, [project(camera, tuple(point)) for point in points])
    np.testing.assert_allclose(local, (np.c_[points, [1, 1]] @ camera.world_to_camera.T)[:, :3])


def test_an_orbit_needs_finite_angles():
    for angles in ({"yaw": float("inf")}, {"pitch": float("nan")}):
        with pytest.raises(ShapeError, match="finite numbers of degrees"):
            Camera.orbit(64, 64, **angles)
