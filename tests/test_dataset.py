"""The capture format: what is written is what is read, broken files are typed errors, jobs are shared without clashes."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from grmm_core.camera import Camera
from grmm_core.data.dataset import (
    DEPTH_UNIT,
    CaptureDataset,
    Manifest,
    Picture,
    Shot,
    View,
    shot_record,
    write_manifest,
    write_shot,
    write_subject,
)
from grmm_core.data.jobs import TimeLeft, claim
from grmm_core.errors import FileAccessError, FileFormatError, ShapeError

SIZE = 24


def _capture(folder: Path) -> tuple[Shot, Picture]:
    g = np.random.default_rng(0)
    write_manifest(folder, Manifest("open_head", ["anna", "bert"], {"seed": 3}, ["bert"]))
    write_subject(folder, "anna", g.normal(size=300), {"age": 30})
    camera = Camera.orbit(SIZE, SIZE, 20, 5, 1.0, 20)
    view = View("c01", camera, "0002_00.png", "0002_00_z.png", "train")
    shot = Shot(
        "anna", 2, "mix", g.random(60, np.float32), g.random(100, np.float32), g.random((5, 3), np.float32), (view,), folder
    )
    mask = (g.random((SIZE, SIZE)) > 0.4).astype(np.float32)
    picture = Picture(g.random((SIZE, SIZE, 3), np.float32), mask, (mask * 1.1).astype(np.float32))
    write_shot(folder, shot, [picture])
    return shot, picture


def test_round_trip(tmp_path):
    shot, picture = _capture(tmp_path)
    data = CaptureDataset(tmp_path)
    assert data.subjects == ["anna"]
    assert data.manifest.held_out_people == ["bert"]
    assert data.facts("anna") == {"age": 30}
    assert data.shape("anna").shape == (300,)
    read, view = next(data.views("train"))
    assert not list(data.views("person"))
    np.testing.assert_array_equal(read.aligned, shot.aligned)
    np.testing.assert_array_equal(read.pose, shot.pose)
    np.testing.assert_array_equal(view.camera.world_to_camera, shot.views[0].camera.world_to_camera)
    decoded = data.picture(read, view)
    np.testing.assert_allclose(decoded.over(0.5), picture.over(0.5), atol=0.51 / 255)
    np.testing.assert_allclose(decoded.depth, picture.depth, atol=0.51 * DEPTH_UNIT)


def test_a_shot_without_record_does_not_exist(tmp_path):
    _capture(tmp_path)
    shot_record(tmp_path, "anna", 2).unlink()
    assert CaptureDataset(tmp_path).shots == []


@pytest.mark.parametrize("keep", [0, 1, 40, 200])
def test_broken_picture_is_named(tmp_path, keep):
    _capture(tmp_path)
    path = tmp_path / "shots" / "anna" / "0002_00.png"
    path.write_bytes(path.read_bytes()[:keep])
    data = CaptureDataset(tmp_path)
    with pytest.raises(FileFormatError, match=r"0002_00\.png"):
        data.picture(*next(data.views()))


def test_missing_picture_and_other_size(tmp_path):
    shot, picture = _capture(tmp_path)
    data = CaptureDataset(tmp_path)
    path = tmp_path / "shots" / "anna" / "0002_00.png"
    half = Picture(picture.rgb[:12], picture.mask[:12], None)
    from grmm_core.data.dataset import encode_rgba

    path.write_bytes(encode_rgba(half.rgb, half.mask))
    with pytest.raises(FileFormatError, match="not the RGBA picture"):
        data.picture(*next(data.views()))
    path.unlink()
    with pytest.raises(FileAccessError, match="does not exist"):
        data.picture(*next(data.views()))
    assert shot.views


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("dataset.json", "{", "damaged"),
        ("dataset.json", "[1]", "damaged"),
        ("dataset.json", '{"format": "other"}', "not a capture data set"),
        ("dataset.json", '{"format": "grmm-capture", "version": 99}', "version 99"),
        ("dataset.json", '{"format": "grmm-capture", "version": 1}', "damaged"),
        ("shots/anna/0002.json", "{", "damaged"),
        ("shots/anna/0002.json", '{"subject": "anna"}', "damaged"),
    ],
)
def test_damaged_json(tmp_path, name, text, words):
    _capture(tmp_path)
    (tmp_path / name).write_text(text)
    with pytest.raises(FileFormatError, match=words):
        CaptureDataset(tmp_path)


def test_missing_camera_is_an_error(tmp_path):
    _capture(tmp_path)
    record = shot_record(tmp_path, "anna", 2)
    values = json.loads(record.read_text())
    del values["views"][0]["camera"]
    record.write_text(json.dumps(values))
    with pytest.raises(FileFormatError, match=r"0002\.json"):
        CaptureDataset(tmp_path)


def test_not_a_capture(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        CaptureDataset(tmp_path / "nothing")


def test_pictures_with_nan_are_not_written(tmp_path):
    shot, picture = _capture(tmp_path)
    record = shot_record(tmp_path, "anna", 2)
    record.unlink()
    bad = Picture(picture.rgb * np.nan, picture.mask, picture.depth)
    with pytest.raises(ShapeError):
        write_shot(tmp_path, shot, [bad])
    assert not record.exists()


def test_claims_exclude_each_other(tmp_path):
    path = tmp_path / "locks" / "a.lock"
    with claim(path) as mine:
        assert mine
        script = (
            "import sys\nfrom pathlib import Path\nfrom grmm_core.data.jobs import claim\n"
            "with claim(Path(sys.argv[1])) as mine: print(mine)"
        )
        result = subprocess.run(
            [sys.executable, "-c", script, str(path)],
            capture_output=True,
            text=True,
            check=True,
            cwd=Path(__file__).parent.parent,
        )
        assert result.stdout.strip() == "False"
    assert not path.exists()


def test_claim_of_a_dead_process_is_taken_over(tmp_path):
    import socket

    child = subprocess.Popen([sys.executable, "-c", "pass"])
    child.wait()
    path = tmp_path / "a.lock"
    path.write_text(json.dumps({"host": socket.gethostname(), "process": child.pid}))
    with claim(path) as mine:
        assert mine
    path.write_text(json.dumps({"host": "elsewhere", "process": 1}))
    with claim(path) as mine:
        assert not mine
    old = path.stat().st_mtime - 7200
    os.utime(path, (old, old))
    with claim(path) as mine:
        assert mine


def test_time_left():
    left = TimeLeft(4)
    left.step(worked=False)
    assert left.seconds == float("inf")
    left.step(worked=True)
    assert 0 <= left.seconds < 5
