"""The capture format: what is written is what is read, broken files are typed errors, jobs are shared without clashes."""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from grmm_core.data.claims import claim
from grmm_core.data.dataset import CaptureDataset, shot_record, write_manifest, write_shot, write_subject
from grmm_core.data.layers import DEPTH_UNIT, NORMAL, PART_LAYER, PARTS
from grmm_core.data.types import Manifest, Picture, Shot, View
from grmm_core.errors import ConfigError, FileAccessError, FileFormatError, ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.hair.groom import Groom

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


def test_a_capture_of_version_1_is_read(tmp_path):
    """As the first studio wrote it: no layers, no light, no displacement, arrays not compressed."""
    shot, picture = _capture(tmp_path)
    manifest = json.loads((tmp_path / "dataset.json").read_text())
    (tmp_path / "dataset.json").write_text(json.dumps({**manifest, "version": 1}))
    path = shot_record(tmp_path, "anna", 2)
    record = json.loads(path.read_text())
    del record["light"]
    path.write_text(json.dumps(record))
    np.savez(path.with_suffix(".npz"), aligned=shot.aligned, expression=shot.expression, pose=shot.pose)
    data = CaptureDataset(tmp_path)
    read, view = next(data.views())
    assert read.displacement is None
    assert view.bare is None
    assert data.groom("anna") is None
    np.testing.assert_allclose(data.picture(read, view).over(0.5), picture.over(0.5), atol=0.51 / 255)
    with pytest.raises(FileFormatError, match="no parts"):
        data.layer(read, view, PART_LAYER)


def test_layers_twin_displacement_and_groom(tmp_path):
    shot, picture = _capture(tmp_path)
    g = np.random.default_rng(1)
    parts = g.random((len(PARTS), SIZE, SIZE)).astype(np.float32)
    normal = g.normal(size=(SIZE, SIZE, 3))
    normal = (normal / np.linalg.norm(normal, axis=-1, keepdims=True) * picture.mask[..., None]).astype(np.float32)
    plain = replace(picture, rgb=1 - picture.rgb)
    view = replace(
        shot.views[0], layers={PART_LAYER: "p.png", NORMAL: "n.png"}, bare=replace(shot.views[0], image="b.png", depth="")
    )
    moved = (0.01 * g.normal(size=(50, 3))).astype(np.float32)
    full = replace(shot, views=(view,), displacement=moved, light={"strength": 0.4})
    write_shot(tmp_path, full, [replace(picture, layers={PART_LAYER: parts, NORMAL: normal}, bare=plain)])
    groom = Groom(
        np.zeros(2, np.int32), np.full((2, 3), 1 / 3, np.float32), np.array([0, 2, 5]), np.full((5, 3), 0.01, np.float32),
        np.full((2, 2), 1e-4, np.float32), np.zeros(2, np.uint8),
    )  # fmt: skip
    write_subject(tmp_path, "anna", np.ones(300), {}, groom)
    data = CaptureDataset(tmp_path)
    read, view = next(data.views())
    assert read.light == {"strength": 0.4}
    np.testing.assert_allclose(read.displacement, moved, atol=2e-5)
    np.testing.assert_allclose(data.layer(read, view, PART_LAYER), parts, atol=0.51 / 255)
    np.testing.assert_allclose(data.layer(read, view, NORMAL), normal, atol=1.1 / 255)
    bare = data.picture(read, view.bare)
    np.testing.assert_allclose(bare.over(0.5), plain.over(0.5), atol=0.51 / 255)
    assert bare.depth is None
    np.testing.assert_array_equal(data.groom("anna").offsets, groom.offsets)
    (tmp_path / "shots" / "anna" / "n.png").write_bytes((tmp_path / "shots" / "anna" / "p.png").read_bytes())
    with pytest.raises(FileFormatError, match="another size"):
        data.layer(read, view, NORMAL)


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


@pytest.mark.parametrize("name", [["a.png"], 3, None, "../a.png", "/etc/passwd", "a\0b"])
def test_pictures_of_a_record_lie_beside_it(tmp_path, name):
    _capture(tmp_path)
    path = tmp_path / "shots" / "anna" / "0002.json"
    values = json.loads(path.read_text())
    values["views"][0]["depth"] = name
    path.write_text(json.dumps(values))
    with pytest.raises(FileFormatError, match=r"0002\.json is damaged"):
        CaptureDataset(tmp_path)


def test_a_person_who_is_listed_twice_is_an_error(tmp_path):
    write_manifest(tmp_path, Manifest("open_head", ["anna", "bert", "anna"]))
    with pytest.raises(FileFormatError, match="listed twice"):
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


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("aligned", np.zeros(59), "aligned has the size 59 instead of 60"),
        ("aligned", np.full(60, np.nan), "aligned has values that are not finite"),
        ("pose", np.zeros(15), "pose has the size 15 instead of 5x3"),
        ("pose", np.full((5, 3), np.inf), "pose has values that are not finite"),
        ("expression", np.zeros((1, 100)), "expression has the size 1x100"),
        ("expression", np.zeros(0), "expression has the size 0"),
        ("expression", np.full(100, "a"), "expression has values that are not finite"),
    ],
)
def test_arrays_of_a_shot_are_checked(tmp_path, name, values, words):
    shot, _ = _capture(tmp_path)
    arrays = {"aligned": shot.aligned, "expression": shot.expression, "pose": shot.pose, name: values}
    np.savez(shot_record(tmp_path, "anna", 2).with_suffix(".npz"), **arrays)
    with pytest.raises(FileFormatError, match=rf"0002\.json is damaged \({words}"):
        CaptureDataset(tmp_path)


def test_shots_have_equally_many_coefficients(tmp_path):
    shot, picture = _capture(tmp_path)
    write_shot(tmp_path, replace(shot, number=3, expression=np.zeros(50, np.float32)), [picture])
    with pytest.raises(FileFormatError, match=r"0003\.json has 50 expression coefficients and the first shot 100"):
        CaptureDataset(tmp_path)


@pytest.mark.parametrize(
    "values", [np.zeros((2, 3)), np.zeros(0), np.float64(1), np.array([1, np.nan]), np.array(["a"]), np.zeros(1 << 18)]
)
def test_shapes_are_checked(tmp_path, values):
    _capture(tmp_path)
    np.save(tmp_path / "subjects" / "anna.npy", values)
    with pytest.raises((FileFormatError, FileAccessError), match=r"anna\.npy"):
        CaptureDataset(tmp_path).shape("anna")


def test_damaged_shapes_are_typed_errors(tmp_path):
    _capture(tmp_path)
    data, path, g = CaptureDataset(tmp_path), tmp_path / "subjects" / "anna.npy", np.random.default_rng(0)
    whole = path.read_bytes()
    damaged = [b"", b"PK\3\4 no archive", whole[:60], whole[:-1], whole.replace(b"(300,)", b"(300000000000,)")]
    for _ in range(300):
        changed = bytearray(whole)
        changed[int(g.integers(128))] = int(g.integers(256))
        damaged.append(bytes(changed))
    for content in damaged:
        path.write_bytes(content)
        with contextlib.suppress(FileFormatError):  # nothing else
            assert data.shape("anna").ndim == 1


def _several(folder: Path, places: tuple[str, ...], lengths: tuple[int, ...] = (3, 3)) -> list[CaptureDataset]:
    """Captures with a person each."""
    for place, length in zip(places, lengths, strict=True):
        (folder / place).mkdir(parents=True)
        _capture(folder / place)
        write_subject(folder / place, "anna", np.full(length, float(len(place))), {})
    return [CaptureDataset(folder / place) for place in places]


def test_folders_of_one_name_stay_apart(tmp_path):
    from grmm_core.training.capture import CapturedViews

    datasets = _several(tmp_path, ("a/export", "longer/export"))
    source = CapturedViews(datasets)
    assert source.people == ("a/export/anna", "longer/export/anna")
    np.testing.assert_array_equal(source.shapes[:, 0], [8, 13])
    assert sorted(source.subjects) == [0, 1]
    assert CapturedViews(datasets, only="anna").people == ("anna",)
    assert CapturedViews(datasets[:1]).people == ("anna",)
    with pytest.raises(ConfigError, match="export is given twice"):
        CapturedViews([datasets[0], CaptureDataset(tmp_path / "a" / ".." / "a" / "export")])
    others = _several(tmp_path, ("c", "d"))
    assert CapturedViews(others).people == ("c/anna", "d/anna")


def test_shapes_of_unequal_length_are_explained(tmp_path):
    from grmm_core.training.capture import CapturedViews

    with pytest.raises(FileFormatError, match="anna has 4 shape coefficients and anna has 3"):
        CapturedViews(_several(tmp_path, ("c", "d"), (3, 4)))


def _start(script: str, *arguments: object) -> subprocess.Popen:
    command = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, cwd=Path(__file__).parents[3])


CLAIM = """
import sys
from pathlib import Path
from grmm_core.data.claims import claim
with claim(Path(sys.argv[1])) as mine:
    print(mine, flush=True)
    sys.stdin.readline()
"""


def test_claims_exclude_each_other(tmp_path):
    path = tmp_path / "locks" / "a.lock"
    with claim(path) as mine:
        assert mine
        with claim(path) as again:
            assert not again
        assert _start(CLAIM, path).communicate("\n")[0].strip() == "False"
    other = _start(CLAIM, path)
    assert other.stdout.readline().strip() == "True"
    with claim(path) as mine:
        assert not mine
    other.kill()  # a killed process keeps nothing
    other.wait()
    with claim(path) as mine:
        assert mine


@pytest.mark.parametrize("content", ["", "{", '{"host": "elsewhere", "process": 1}'])
def test_a_file_that_is_left_over_is_no_claim(tmp_path, content):
    path = tmp_path / "a.lock"
    path.write_text(content)
    with claim(path) as mine:
        assert mine


FIGHT = """
import os, sys, time
from pathlib import Path
from grmm_core.data.claims import claim
path, rounds = Path(sys.argv[1]), int(sys.argv[2])
print("ready", flush=True)
sys.stdin.readline()
won = 0
while won < rounds:
    with claim(path) as mine:
        if mine:
            os.close(os.open(path.with_suffix(".inside"), os.O_CREAT | os.O_EXCL))  # fails where two are inside
            time.sleep(0)
            path.with_suffix(".inside").unlink()
            won += 1
print(won)
"""


def test_of_processes_that_fight_for_a_claim_never_two_have_it(tmp_path):
    """A dead process's file lies there at the start; then owners come and go while others try."""
    path = tmp_path / "a.lock"
    path.write_text("{")
    fighters = [_start(FIGHT, path, 400) for _ in range(4)]
    for fighter in fighters:
        assert fighter.stdout.readline().strip() == "ready"
    for fighter in fighters:
        fighter.stdin.write("\n")
        fighter.stdin.flush()
    assert [fighter.communicate()[0].strip() for fighter in fighters] == ["400"] * 4
    assert [fighter.returncode for fighter in fighters] == [0] * 4


def test_one_of_the_processes_that_find_a_dead_ones_file_gets_it(tmp_path):
    path = tmp_path / "a.lock"
    for _ in range(3):
        path.write_text("{")
        others = [_start(CLAIM, path) for _ in range(4)]
        answers = [other.stdout.readline().strip() for other in others]
        assert sorted(answers) == ["False"] * 3 + ["True"]
        for other in others:
            other.kill()
            other.communicate()


def test_a_folder_that_cannot_be_written_is_explained(tmp_path):
    (tmp_path / "locks").write_text("a file")
    with pytest.raises(FileAccessError, match="choose another folder"), claim(tmp_path / "locks" / "a.lock"):
        pass
    (tmp_path / "subjects").write_text("a file")
    with pytest.raises(FileAccessError, match="choose another folder"):
        write_subject(tmp_path, "anna", np.zeros(3), {})
