"""Fits that are refused, or end early: photos, masks, folders and arguments that cannot be used."""

from __future__ import annotations

import dataclasses
import json
import os

import numpy as np
import pytest
from PIL import Image

from grmm_core import cli
from grmm_core.avatar import PhotoRecord
from grmm_core.errors import ConfigError, FileAccessError, FileFormatError, NoFaceError, ShapeError
from grmm_core.fitting.folder import TRACKS_FILE, Job, can_resume, prepare
from grmm_core.fitting.request import FitRequest
from grmm_core.fitting.track import analyse_photo, check_turned
from grmm_core.geometry.camera import Camera
from grmm_core.model import store

pytestmark = pytest.mark.usefixtures("quick_preset")


def test_a_face_from_the_side_is_refused_before_anything_is_tracked(make, tmp_path, capsys):
    """The library's avatar, turned by 30 and by 65 degrees."""
    from grmm_core.session import create_session
    from grmm_core.session.api import Instance, RenderOptions

    paths = {yaw: tmp_path / f"turned_{yaw}.png" for yaw in (30, 65)}
    with create_session("local") as session:
        avatar = session.open("default")
        for yaw, path in paths.items():
            camera = Camera.orbit(256, 256, yaw, 3.0, distance=1.1, fov=18.0)
            options = RenderOptions(passes=("rgb",), background=(0.6, 0.65, 0.7))
            picture = session.render([Instance(avatar.id)], camera, options)["rgb"]
            Image.fromarray((np.clip(picture, 0, 1) * 255).astype(np.uint8)).save(path)
    stages = []
    with pytest.raises(NoFaceError, match=r"turned_65\.png is turned by (6|7)\d degrees; add a photo"):
        make([paths[65]], tmp_path / "a.grmm", progress=lambda event: stages.append(event.stage))
    assert set(stages) <= {"load", "analyse"}
    analysed = [analyse_photo(path) for path in paths.values()]
    check_turned(analysed, (0, 0))  # another photo shows the front
    check_turned(analysed[:1], (0,))
    # who looks at the faces first is told then, after the pictures are drawn
    assert cli.main(["fit", str(paths[65]), "--find-faces", str(tmp_path / "found")]) == 1
    assert "is turned by" in capsys.readouterr().err
    assert (tmp_path / "found" / "found_1.png").exists()


@pytest.mark.parametrize(
    ("spoil", "error", "words"),
    [
        (lambda p: p.write_text("hello"), FileFormatError, "not a picture"),
        (lambda p: None, FileAccessError, "does not exist"),
        (lambda p: p.mkdir(), FileAccessError, "folder"),
    ],
    ids=["text", "missing", "folder"],
)
def test_photos_that_cannot_be_used_give_one_sentence(spoil, error, words, make, tmp_path):
    path = tmp_path / "x.jpg"
    spoil(path)
    with pytest.raises(error, match=words):
        make([path], tmp_path / "a.grmm")
    assert not (tmp_path / "a.grmm").exists()


def test_a_picture_without_face_is_named(make, weights, tmp_path, capsys):
    from PIL import Image

    path = tmp_path / "wall.png"
    Image.fromarray(np.full((120, 160, 3), 130, np.uint8)).save(path)
    with pytest.raises(NoFaceError, match=r"wall\.png"):
        make([path], tmp_path / "a.grmm")
    arguments = ["fit", str(path), "-o", str(tmp_path / "a.grmm"), "--preset", "fast", "--weights", str(weights), "--events"]
    assert cli.main(arguments) == 1
    captured = capsys.readouterr()
    event = json.loads(captured.out.splitlines()[-1])
    assert event["event"] == "error"
    assert captured.err.strip() == f"grmm: {event['message']}"
    assert event["message"].count("\n") == 0


def test_arguments_are_checked_before_work_begins(photo, make, tmp_path):
    wrong = [
        ({"photos": []}, ConfigError, "at least one"),
        ({"photos": [photo] * 17}, ConfigError, "at most 16"),
        ({"preset": "best"}, ConfigError, "preset"),
        ({"masks": [photo, photo]}, ConfigError, "2 masks"),
        ({"output": tmp_path / "a.png"}, ConfigError, "does not end in .grmm"),
        ({"output": tmp_path / "none" / "a.grmm"}, FileAccessError, "does not exist"),
        ({"faces": [3]}, ConfigError, "1 usable face,"),
        ({"faces": [0, 0]}, ConfigError, "2 faces"),
    ]
    for changes, error, words in wrong:
        values = {"photos": [photo], "output": tmp_path / "a.grmm"} | changes
        with pytest.raises(error, match=words):
            make(values.pop("photos"), values.pop("output"), **values)


def test_bad_pictures_are_refused_before_anything_is_written(photo, make, tmp_path):
    from PIL import Image

    copy, mask, text = tmp_path / "copy.png", tmp_path / "mask.png", tmp_path / "mask.txt"
    copy.write_bytes(photo.read_bytes())
    Image.fromarray(np.zeros((100, 300), np.uint8)).save(mask)
    text.write_text("no picture")
    names = sorted(path.name for path in tmp_path.iterdir())
    wrong = [
        ({"photos": [photo, copy]}, ConfigError, r"face\.png and copy\.png are the same photo"),
        ({"photos": [photo, photo]}, ConfigError, "given twice"),
        ({"masks": [mask]}, ShapeError, "300x100 pixels, another proportion than face.png with 256x256"),
        ({"masks": [text]}, FileFormatError, "mask.txt is not a picture"),
        ({"work": photo}, FileAccessError, "choose another folder"),
    ]
    for changes, error, words in wrong:
        values = {"photos": [photo]} | changes
        with pytest.raises(error, match=words) as caught:
            make(values.pop("photos"), tmp_path / "a.grmm", **values)
        assert "\n" not in str(caught.value)
        assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_a_work_folder_with_other_files_is_left_alone(photo, make, tmp_path):
    work = tmp_path / "mine"
    work.mkdir()
    (work / "codes.safetensors").write_text("my own weights")
    (work / "preview.png").write_text("my own picture")
    with pytest.raises(ConfigError, match="holds other files"):
        make([photo], tmp_path / "a.grmm", work=work)
    assert {path.name: path.read_text() for path in work.iterdir()} == {
        "codes.safetensors": "my own weights", "preview.png": "my own picture",
    }  # fmt: skip
    folder = tmp_path / "state"
    job = Job((PhotoRecord("a.png", "1"),), (0,), ())
    asked = FitRequest([photo], tmp_path / "a.grmm", work=folder)
    prepare(job, asked)
    for name in (TRACKS_FILE, "notes.txt", "mine.safetensors", ".grmm-x.tmp"):
        (folder / name).write_text(name)
    asked = dataclasses.replace(asked, resume=True)
    prepare(job, asked)  # the same job goes on; what a killed process was writing is removed
    assert can_resume(folder)
    assert not (folder / ".grmm-x.tmp").exists()
    prepare(dataclasses.replace(job, weights="others"), asked)
    assert not can_resume(folder)
    assert (folder / "mine.safetensors").exists()
    assert (folder / "notes.txt").exists()


def test_a_head_file_reaches_the_model(photo, weights, tmp_path, capsys):
    arguments = ["fit", str(photo), "-o", str(tmp_path / "a.grmm"), "--preset", "fast", "--weights", str(weights)]
    seen = []
    original = store.ModelStore.__init__
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(store.ModelStore, "__init__", lambda self, *a, **k: (seen.append(a[2]), original(self, *a, **k))[1])
        cli.main([*arguments, "--head", str(tmp_path / "flame.npz"), "--face", "9"])
    assert [str(path) for path in seen] == [str(tmp_path / "flame.npz")]
    assert "choose a number from 1 to 1" in capsys.readouterr().err


def test_looking_names_a_face_that_is_not_there_after_drawing_those_that_are(photo, tmp_path, capsys):
    assert cli.main(["fit", str(photo), "--find-faces", str(tmp_path / "found"), "--face", "3"]) == 1
    assert "choose a number from 1 to 1" in capsys.readouterr().err
    assert (tmp_path / "found" / "found_1.png").exists()
    assert cli.main(["fit", str(photo), "--find-faces", str(tmp_path / "found"), "--face", "1", "--face", "1"]) == 1
    assert "2 faces were chosen for 1 photos" in capsys.readouterr().err


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="needs a folder that this user cannot write")
def test_a_folder_that_cannot_be_written_is_named(photo, make, tmp_path):
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(FileAccessError, match="choose another folder"):
            make([photo], tmp_path / "a.grmm")
    finally:
        tmp_path.chmod(0o700)


def test_a_full_disk_leaves_nothing_half_written(photo, make, tmp_path, monkeypatch):
    import errno

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    output = tmp_path / "a.grmm"
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(FileAccessError, match="no space left"):
        make([photo], output)
    assert not output.exists()
    assert not list(tmp_path.rglob("*.tmp"))
