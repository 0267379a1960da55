"""Cameras, controls and tensor files: what every part agrees on."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest

from grmm_core.controls.frame import ALIGNED_TO_ARKIT, Controls, parse_assignments, resolve
from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES, MIXTURES
from grmm_core.errors import ControlError, FileAccessError, FileFormatError, ShapeError
from grmm_core.files.tensorfile import read_metadata, read_tensors, write_tensors
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


class Basis:
    arkit_to_expression = np.eye(52, 100, dtype=np.float32)
    expression_pose = np.zeros((100, 5, 3), np.float32)


Basis.expression_pose[ARKIT_NAMES.index("jawOpen"), 2, 0] = 0.4


def test_mixtures_are_their_recipes():
    for name, recipe in MIXTURES.items():
        mixture = resolve(Controls().set_named({name: 0.5}), Basis())
        parts = resolve(Controls().set_named({k: 0.5 * v for k, v in recipe.items()}), Basis())
        np.testing.assert_allclose(mixture.expression, parts.expression, atol=1e-6)
        np.testing.assert_allclose(mixture.pose, parts.pose, atol=1e-6)
        assert mixture.aligned[ALIGNED_NAMES.index(name)] == 0.5
    assert ALIGNED_TO_ARKIT.shape == (60, 52)


def test_pose_is_the_sum_of_control_and_expression():
    resolved = resolve(Controls().set_named({"jaw.x": 0.1, "jawOpen": 0.5, "expression.24": 0.25, "eyes.yaw": 0.2}), Basis())
    assert ARKIT_NAMES[24] == "jawOpen"
    assert resolved.pose[2, 0] == pytest.approx(0.1 + 0.4 * 0.75)
    assert resolved.pose[3:, 1] == pytest.approx([0.2, 0.2])


def test_setting_controls_leaves_the_original_alone():
    controls = Controls()
    controls.set_named({"jawOpen": 1.0, "shape.3": 1.0})
    assert not controls.aligned.any()
    assert controls.shape.size == 0


@pytest.mark.parametrize("name", ["jawopen", "shape.300", "shape.-1", "nose.x", "eyes.roll", "", "z_id.512", "z_id.²"])
def test_unknown_controls_are_named(name):
    with pytest.raises(ControlError, match="no control named"):
        Controls().set_named({name: 0.0})


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_controls_that_are_not_numbers_are_named(value):
    with pytest.raises(ControlError, match="jawOpen"):
        Controls().set_named({"jawOpen": value})
    controls = Controls()
    controls.pose[2, 0] = value
    with pytest.raises(ControlError, match=r"jaw\.x"):
        resolve(controls, Basis())


def test_assignments_of_the_command_line():
    assert parse_assignments(["jawOpen=0.5", "jaw.x = -1e-1"]) == {"jawOpen": 0.5, "jaw.x": -0.1}
    for text in ("jawOpen", "jawOpen=wide"):
        with pytest.raises(ControlError, match="NAME=NUMBER"):
            parse_assignments([text])


def sample_tensors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "a": rng.normal(size=(3, 4)).astype(np.float32),
        "b": rng.integers(-9, 9, (5,), np.int16),
        "scalar": np.float64(3.5),
        "empty": np.zeros((0, 3), np.float16),
        "flags": np.array([True, False]),
    }


def test_tensor_files_round_trip_and_open_in_the_independent_library(tmp_path):
    path = tmp_path / "файл.tensors"
    write_tensors(path, sample_tensors(), {"note": "näme"})
    tensors, metadata = read_tensors(path)
    other = pytest.importorskip("safetensors.numpy").load_file(path)
    assert metadata == read_metadata(path) == {"note": "näme"}
    for name, array in sample_tensors().items():
        np.testing.assert_array_equal(tensors[name], array)
        np.testing.assert_array_equal(other[name], array)
        assert tensors[name].dtype == array.dtype


def test_every_damage_of_a_tensor_file_gives_a_typed_error(tmp_path):
    path = tmp_path / "x.tensors"
    write_tensors(path, sample_tensors(), {"note": "n"})
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    refused = 0
    for trial in range(600):
        data = bytearray(whole)
        if trial % 2:
            data = data[: rng.integers(0, len(data))]
        else:
            for position in rng.integers(0, min(len(data), 400), rng.integers(1, 4)):
                data[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        try:
            read_tensors(path)
        except FileFormatError:
            refused += 1
    assert refused > 400


@pytest.mark.parametrize(
    "header",
    [
        {"a": {"dtype": "F32", "shape": [1 << 40], "data_offsets": [0, 1 << 42]}},
        {"a": {"dtype": "F32", "shape": [-1, -4], "data_offsets": [0, 16]}},
        {"a": {"dtype": "F32", "shape": [True, 4], "data_offsets": [0, 16]}},
        {"a": {"dtype": "O", "shape": [4], "data_offsets": [0, 16]}},
        {str(i): {"dtype": "F32", "shape": [4], "data_offsets": [0, 16]} for i in range(9)},
        {"__metadata__": {"a": 1}},
        [],
    ],
)
def test_headers_that_lie_are_refused(tmp_path, header):
    encoded = json.dumps(header).encode()
    path = tmp_path / "hostile"
    path.write_bytes(struct.pack("<Q", len(encoded)) + encoded + bytes(16))
    with pytest.raises(FileFormatError):
        read_tensors(path)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "x.tensors"
    write_tensors(path, {"a": np.zeros(3, np.float32)})
    before = path.read_bytes()
    with pytest.raises(ShapeError):
        write_tensors(path, {"a": np.array(["text"])})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.tensors"]


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        read_tensors(tmp_path / "none")
    with pytest.raises(FileAccessError, match="Cannot write"):
        write_tensors(tmp_path / "no folder" / "x", {})
