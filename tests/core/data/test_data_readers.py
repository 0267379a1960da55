"""Readers of other projects' data: small data sets of exactly their structure become the common type."""

from __future__ import annotations

import json
import sys
from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest
from foreign_data import (
    HEIGHT,
    JAW_OPEN,
    SCALE,
    SERIALS,
    WIDTH,
    flame_like_head,
    flame_parameters,
    png,
    world_camera,
    write_nersemble,
    write_renderme,
    write_vhap,
)

from grmm_core.cli import main
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.data import readers_renderme
from grmm_core.data.foreign import head_camera, nearest_arkit
from grmm_core.data.readers import is_dataset, open_dataset
from grmm_core.errors import ConfigError, FileAccessError, FileFormatError, RuntimeMissingError
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.rotations import axis_angle_to_matrix, matrix_to_euler
from grmm_core.pictures.recordings import pyav


@pytest.fixture(scope="module")
def head():
    return flame_like_head()


def pixels(camera, points):
    local = points @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    return np.stack([camera.fx * local[:, 0] / local[:, 2] + camera.cx, camera.fy * local[:, 1] / local[:, 2] + camera.cy], -1)


def in_head_space(head, dataset, shot, view):
    """Pixels of the mesh that the reader's parameters give."""
    return pixels(view.camera, head.vertices(dataset.shape(shot.subject), shot.expression, shot.pose))


def in_the_world(head, parameters, camera, scale=None):
    """Pixels of the mesh as the trackers define it: with FLAME's own root rotation, then moved."""
    turn = lambda vector: matrix_to_euler(axis_angle_to_matrix(np.asarray(vector).reshape(-1)))  # noqa: E731
    eyes = parameters["eyes_pose"].reshape(-1)
    pose = np.stack([np.zeros(3), *(turn(parameters[n]) for n in ("neck_pose", "jaw_pose")), turn(eyes[:3]), turn(eyes[3:])])
    if scale is None:  # about the root joint
        pose[0] = turn(parameters["rotation"])
        vertices = head.vertices(parameters["shape"], parameters["expr"].reshape(-1), pose)
    else:  # about the origin
        vertices = head.vertices(parameters["shape"], parameters["expr"].reshape(-1), pose)
        vertices = scale * vertices @ axis_angle_to_matrix(parameters["rotation"].reshape(-1)).T
    return pixels(camera, vertices + parameters["translation"].reshape(-1))


# --- VHAP ------------------------------------------------------------------------------------------------------------


def test_vhap_export(head, tmp_path):
    folder = write_vhap(tmp_path / "074_EMO-1")
    dataset = open_dataset(folder, head)
    assert dataset.subjects == ["074_EMO-1"]
    assert [[view.split for view in shot.views] for shot in dataset.shots] == [["train", "camera"]] * 2 + [["expression"] * 2]
    assert len(list(dataset.views("train"))) == 2
    for moment, shot in enumerate(dataset.shots):
        for number, view in enumerate(shot.views):
            expected = in_the_world(head, flame_parameters(moment), world_camera(number))
            np.testing.assert_allclose(in_head_space(head, dataset, shot, view), expected, atol=2e-3)
    picture = dataset.picture(dataset.shots[1], dataset.shots[1].views[1])
    assert picture.rgb.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(picture.rgb, 111 / 255, atol=1e-6)
    np.testing.assert_allclose(picture.mask, 0.2, atol=1e-6)
    assert picture.depth is None


def test_a_single_transforms_file_is_all_for_training(head, tmp_path):
    folder = write_vhap(tmp_path / "x")
    frames = json.loads((folder / "transforms_train.json").read_text())
    for name in ("train", "val", "test"):
        (folder / f"transforms_{name}.json").unlink()
    (folder / "transforms.json").write_text(json.dumps(frames))
    assert {view.split for _, view in open_dataset(folder, head).views()} == {"train"}


def test_broken_vhap_exports_are_explained(head, tmp_path):
    folder = write_vhap(tmp_path / "x")
    with pytest.raises(ConfigError, match="--head FILE"):
        open_dataset(folder)
    path = folder / "transforms_train.json"
    original = path.read_text()
    for key in ("transform_matrix", "flame_param_path", "fl_x"):
        values = json.loads(original)
        del values["frames"][0][key]
        path.write_text(json.dumps(values))
        with pytest.raises(FileFormatError, match=key):
            open_dataset(folder, head)
    for text in ("{", "[]", '{"frames": 3}'):
        path.write_text(text)
        with pytest.raises(FileFormatError, match="transforms_train"):
            open_dataset(folder, head)
    path.write_text(original)
    dataset = open_dataset(folder, head)
    shot = dataset.shots[0]
    image = folder / "images" / "00000_00.png"
    image.write_bytes(image.read_bytes()[:40])
    with pytest.raises(FileFormatError, match=r"00000_00\.png is a damaged picture"):
        dataset.picture(shot, shot.views[0])
    image.unlink()
    with pytest.raises(FileAccessError, match="does not exist"):
        dataset.picture(shot, shot.views[0])
    np.savez(folder / "flame_param" / "00000.npz", expr=np.zeros((1, 100)))
    with pytest.raises(FileFormatError, match="translation"):
        open_dataset(folder, head)


def test_grey_pictures_of_an_export(head, tmp_path):
    folder = write_vhap(tmp_path / "x")
    (folder / "images" / "00000_00.png").write_bytes(png(102, "L"))
    dataset = open_dataset(folder, head)
    shot = dataset.shots[0]
    picture = dataset.picture(shot, shot.views[0])
    assert picture.rgb.shape == (HEIGHT, WIDTH, 3)
    np.testing.assert_allclose(picture.rgb, 0.4, atol=1e-6)
    np.testing.assert_allclose(picture.mask, 0.2, atol=1e-6)
    path = folder / "transforms_train.json"
    values = json.loads(path.read_text())
    for frame in values["frames"]:
        del frame["fg_mask_path"]
    path.write_text(json.dumps(values))
    dataset = open_dataset(folder, head)
    shot = dataset.shots[0]
    with pytest.raises(FileFormatError, match=r"00000_00\.png has no mask"):
        dataset.picture(shot, shot.views[0])
    (folder / "images" / "00000_00.png").write_bytes(png(51, "LA"))  # grey with a mask of its own
    np.testing.assert_allclose(dataset.picture(shot, shot.views[0]).mask, 0.2, atol=1e-6)


@pytest.mark.parametrize("value", ["first", None, [0], 0.5, float("inf"), float("nan")])
def test_moments_of_an_export_are_whole_numbers(head, tmp_path, value):
    folder = write_vhap(tmp_path / "x")
    path = folder / "transforms_train.json"
    values = json.loads(path.read_text())
    values["frames"][1]["timestep_index"] = value
    path.write_text(json.dumps(values))
    with pytest.raises(FileFormatError, match=r"transforms_train\.json: the timestep_index of frame 1 is not a whole number"):
        open_dataset(folder, head)


def test_training_on_an_export(head, tmp_path):
    from grmm_core.training.capture import capture_views
    from grmm_core.training.config import train_config
    from grmm_core.training.trainer import Trainer

    source, used = capture_views([write_vhap(tmp_path / "x")], head=head)
    assert used is head
    config = train_config({"preset": "tiny"}, {"preview_every": 0, "checkpoint_every": 0}, {"perceptual": 0.0})
    trainer = Trainer(config, head, source, tmp_path / "run")
    trainer.start()
    assert np.isfinite(trainer.step()["loss"])
    assert set(trainer.evaluate(4)) >= {"val_psnr_camera", "val_psnr_expression"}


# --- RenderMe-360 ----------------------------------------------------------------------------------------------------


def test_renderme(head, tmp_path):
    dataset = open_dataset(write_renderme(tmp_path / "RenderMe"), head)
    assert dataset.subjects == ["0026"]
    assert len(dataset.shots) == 2  # the hair part has no FLAME parameters
    assert not dataset.shape("0026")[100:].any()
    for frame, shot in enumerate(dataset.shots):
        parameters = flame_parameters(frame)
        parameters["shape"], parameters["expr"] = parameters["shape"][:100], parameters["expr"][:, :50]
        for number, view in enumerate(shot.views):
            expected = in_the_world(head, parameters, world_camera(number))
            np.testing.assert_allclose(in_head_space(head, dataset, shot, view), expected, atol=2e-3)
    picture = dataset.picture(dataset.shots[1], dataset.shots[1].views[0])
    np.testing.assert_allclose(picture.rgb, 80 / 255, atol=1e-6)
    np.testing.assert_allclose(picture.mask, 1.0)


def test_lens_distortion_is_removed():
    from grmm_core.data.readers_renderme import undistorted

    camera = Camera(np.eye(4), 300.0, 310.0, 81.0, 59.0, 160, 120)
    coefficients = np.array([-0.2, 0.05, 0.002, -0.003, 0.01])
    columns = np.broadcast_to(np.arange(160, dtype=np.float32) + 0.5, (120, 160))
    rows = np.broadcast_to(np.arange(120, dtype=np.float32)[:, None] + 0.5, (120, 160))
    result = undistorted(np.stack([columns, rows], -1), camera, coefficients)
    k1, k2, p1, p2, k3 = coefficients
    for row, column in ((20, 30), (60, 80), (100, 140)):
        x, y = (column + 0.5 - 81.0) / 300.0, (row + 0.5 - 59.0) / 310.0
        r2 = x * x + y * y
        radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
        u = x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v = y * radial + p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
        np.testing.assert_allclose(result[row, column], [300 * u + 81.0, 310 * v + 59.0], atol=2e-3)
    assert undistorted(result, camera, np.zeros(5)) is result


def test_broken_renderme_is_explained(head, tmp_path):
    import h5py

    folder = write_renderme(tmp_path / "data")
    raw, anno = (folder / kind / "0026" / f"0026_e0_{kind}.smc" for kind in ("raw", "anno"))
    dataset = open_dataset(folder, head)
    shot = dataset.shots[0]
    dataset._files._open.clear()
    with h5py.File(raw, "a") as file:
        del file["Camera/00/color/0"]
        file["Camera/00/color/0"] = np.frombuffer(png(3)[:30], np.uint8)
    with pytest.raises(FileFormatError, match="00/color/0 is a damaged picture"):
        dataset.picture(shot, shot.views[0])
    with h5py.File(anno, "a") as file:
        del file["Calibration/01/RT"]
    with pytest.raises(FileFormatError, match="01/RT"):
        open_dataset(folder, head)
    anno.write_bytes(anno.read_bytes()[:500])
    with pytest.raises(FileFormatError, match="not a complete SMC file"):
        open_dataset(folder, head)
    raw.unlink()
    with pytest.raises(FileAccessError, match="0026_e0_raw"):
        open_dataset(folder, head)


def test_missing_libraries_are_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(RuntimeMissingError, match="pip install h5py"):
        readers_renderme._h5py()
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(RuntimeMissingError, match="pip install av"):
        pyav()


# --- NeRSemble -------------------------------------------------------------------------------------------------------


def test_nersemble(head, tmp_path):
    folder = write_nersemble(tmp_path / "nersemble")
    dataset = open_dataset(folder, head)
    assert dataset.subjects == ["393"]
    assert len(dataset.shots) == 6
    first = dataset.shots[0]
    assert [(view.name, view.split) for view in first.views] == [(SERIALS[0], "train"), (SERIALS[1], "camera")]
    assert {view.split for shot in dataset.shots[3:] for view in shot.views} == {"expression"}
    for moment in (0, 2):
        shot = dataset.shots[moment]
        for number, view in enumerate(shot.views):
            expected = in_the_world(head, flame_parameters(moment), world_camera(number), SCALE)
            np.testing.assert_allclose(in_head_space(head, dataset, shot, view), expected, atol=2e-3)
            rotation = view.camera.world_to_camera[:3, :3]
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
    for moment in (2, 0, 1):  # in any order
        picture = dataset.picture(dataset.shots[moment], dataset.shots[moment].views[1])
        np.testing.assert_allclose(picture.rgb.mean() * 255, 40 + 50 * moment, atol=4)
        assert picture.mask.mean() > 0.97
    assert open_dataset(folder / "mono_flame_avatar" / "393", head).subjects == ["393"]


def test_broken_nersemble_is_explained(head, tmp_path):
    folder = write_nersemble(tmp_path / "nersemble")
    person = folder / "mono_flame_avatar" / "393"
    dataset = open_dataset(folder, head)
    video = person / "sequences" / "EXP-4-lips" / "images" / f"cam_{SERIALS[0]}.mp4"
    with pytest.raises(FileFormatError, match="no frame 99"):
        dataset._videos.frame(video, 99)
    calibration = person / "calibration" / "camera_params.json"
    values = json.loads(calibration.read_text())
    del values["world_2_cam"][SERIALS[1]]
    calibration.write_text(json.dumps(values))
    with pytest.raises(FileFormatError, match=f"lacks the camera {SERIALS[1]}"):
        open_dataset(folder, head)
    calibration.write_text("{")
    with pytest.raises(FileFormatError, match="camera_params"):
        open_dataset(folder, head)
    for path in person.glob("sequences/*/tracking/*.npz"):
        path.unlink()
    calibration.write_text(json.dumps({"world_2_cam": {}, "intrinsics": {}}))
    with pytest.raises(FileFormatError, match="VHAP"):
        open_dataset(folder, head)


@pytest.mark.parametrize(
    ("name", "values"),
    [("frames", np.arange(2)), ("scale", np.zeros(0)), ("jaw", np.float32(0)), ("expression", np.float32(0))],
)
def test_arrays_of_nersemble_are_checked(head, tmp_path, name, values):
    folder = write_nersemble(tmp_path / "nersemble")
    path = folder / "mono_flame_avatar" / "393" / "sequences" / "EXP-4-lips" / "tracking" / "flame2023_tracking.npz"
    with np.load(path) as arrays:
        changed = dict(arrays) | {name: values}
    np.savez(path, **changed)
    with pytest.raises(FileFormatError, match="has a wrong shape"):
        open_dataset(folder, head)


def test_videos_without_times_are_explained(tmp_path):
    from grmm_core.data.readers_nersemble import _Videos

    for rate, words in ((None, "how many frames a second"), (25, "frames without a time")):
        stream = SimpleNamespace(average_rate=rate, time_base=Fraction(1, 25), start_time=None)
        container = SimpleNamespace(
            streams=SimpleNamespace(video=[stream]), seek=lambda *_, **__: None, decode=lambda _: [SimpleNamespace(pts=None)]
        )
        videos = _Videos()
        videos._open[tmp_path / "a.mp4"] = container
        with pytest.raises(FileFormatError, match=words):
            videos.frame(tmp_path / "a.mp4", 0)


# --- all of them -----------------------------------------------------------------------------------------------------


def test_nearest_arkit_weights(head):
    expression, pose = np.zeros(100, np.float32), np.zeros((5, 3))
    smile = ARKIT_NAMES.index("mouthSmileLeft")
    expression[smile], pose[2, 0] = 1.5 * 0.7, 0.4 * 0.5
    aligned = nearest_arkit(head, expression, pose)
    assert aligned[smile] == pytest.approx(0.7, abs=1e-3)
    assert aligned[JAW_OPEN] == pytest.approx(0.5, abs=1e-2)
    assert np.delete(aligned, [smile, JAW_OPEN]).max() < 1e-3
    assert nearest_arkit(head, -expression, pose)[smile] == 0.0  # weights are not negative


def test_a_scaled_head_keeps_the_picture():
    camera, move = world_camera(1), np.diag([2.0, 2.0, 2.0, 1.0])
    move[:3, 3] = [0.01, 0.02, -0.03]
    points = np.random.default_rng(0).normal(0, 0.03, (20, 3))
    moved = head_camera(camera, move)
    np.testing.assert_allclose(pixels(moved, points), pixels(camera, points @ move[:3, :3].T + move[:3, 3]), atol=1e-9)


def test_data_sets_are_told_from_other_folders(tmp_path):
    assert not is_dataset(tmp_path)
    assert not is_dataset(tmp_path / "none")
    (tmp_path / "photo.jpg").write_bytes(b"x")
    assert not is_dataset(tmp_path)
    assert is_dataset(write_vhap(tmp_path / "vhap"))


def test_unknown_folders_are_explained(tmp_path, capsys):
    with pytest.raises(FileAccessError, match="does not exist"):
        open_dataset(tmp_path / "none")
    (tmp_path / "holiday.jpg").write_bytes(b"x")
    with pytest.raises(FileFormatError, match="RenderMe-360"):
        open_dataset(tmp_path)
    out = tmp_path / "run"
    assert main(["train", "small", "--data", str(tmp_path), "--out", str(out)]) == 1
    assert "no data set that is known here" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("value", ["x", "", {}, None])
def test_a_camera_matrix_that_is_no_number_is_named(head, tmp_path, value):
    folder = write_nersemble(tmp_path / "data", frames=1)
    path = folder / "mono_flame_avatar" / "393" / "calibration" / "camera_params.json"
    values = json.loads(path.read_text())
    values["intrinsics"][SERIALS[0]][0][0] = value
    path.write_text(json.dumps(values))
    with pytest.raises(FileFormatError, match=r"camera|camera_params"):
        open_dataset(folder, head)
