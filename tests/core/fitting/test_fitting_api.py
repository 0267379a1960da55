"""`fit` and `grmm fit` from files to a file: events, cancelling, bad input. The model is tiny and random; pictures are real."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import math
import os
import re
import shutil
import threading
from pathlib import Path

import numpy as np
import pytest
from dask_workers import address, kill_once_there_is, two_workers
from PIL import Image, ImageFile
from progress_checks import check_progress
from tiny_model import write_tiny_weights

from grmm_core import cli
from grmm_core.avatar import PhotoRecord, load_avatar, read_avatar_header
from grmm_core.avatar.library import library_path
from grmm_core.errors import CancelledError, ConfigError, FileAccessError, FileFormatError, NoFaceError, ShapeError
from grmm_core.fitting import presets
from grmm_core.fitting.api import FitResult, fit
from grmm_core.fitting.folder import TRACKS_FILE, Job, can_resume, prepare
from grmm_core.fitting.presets import CodeSettings, DecoderSettings, Preset
from grmm_core.fitting.request import FitRequest
from grmm_core.fitting.track import analyse_photo, check_turned
from grmm_core.geometry.camera import Camera
from grmm_core.jobs.progress import Progress
from grmm_core.jobs.stages import FIT
from grmm_core.model import store

QUICK = Preset("fast", CodeSettings(48, 48, 1, 1, 0, 2), DecoderSettings(((64, 4),), False))


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture(scope="module")
def photo(tmp_path_factory):
    """A picture of the embedded avatar: a face that nobody owns, found by the same networks as a real one."""
    from grmm_core.session import create_session
    from grmm_core.session.api import Instance, RenderOptions

    with create_session("local") as session:
        avatar = session.open("default")
        camera = Camera.orbit(256, 256, distance=1.1, fov=18.0)
        options = RenderOptions(passes=("rgb",), background=(0.6, 0.65, 0.7))
        picture = session.render([Instance(avatar.id)], camera, options)["rgb"]
    path = tmp_path_factory.mktemp("photos") / "face.png"
    Image.fromarray((np.clip(picture, 0, 1) * 255).astype(np.uint8)).save(path)
    return path


@pytest.fixture
def make(weights):
    """Ask for a fit by the tiny model and make it; options of the request, and of `fit`."""

    def make(photos, output, *, progress=None, on_faces=None, cancelled=None, **options) -> FitResult:
        values = {"preset": "fast", "weights": weights, "device": "cpu"} | options
        return fit(FitRequest(photos, output, **values), progress=progress, on_faces=on_faces, cancelled=cancelled)

    return make


@pytest.fixture(autouse=True, scope="module")
def quick_preset():
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(presets.PRESETS, "fast", QUICK)
        yield


@contextlib.contextmanager
def watching(*paths):
    """How often each of some files is opened, and the sizes of all pictures that are decoded, while this lasts."""
    opened, decoded = {path.name: 0 for path in paths}, []
    known = {str(path) for path in paths}
    open_file, load = os.open, ImageFile.ImageFile.load

    def count(file) -> None:
        if str(file) in known:
            opened[Path(file).name] += 1

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(os, "open", lambda file, *a, **k: (count(file), open_file(file, *a, **k))[1])
        # what is decoded already has no tiles left
        patch.setattr(
            ImageFile.ImageFile, "load", lambda self: (decoded.append(self.size) if self.tile else None, load(self))[1]
        )
        yield opened, decoded


@dataclasses.dataclass(frozen=True)
class Commanded:
    """What `grmm fit --events` wrote and said, and how often it opened and decoded the photo."""

    path: Path
    events: list[dict]
    opened: dict[str, int]
    decoded: list[tuple[int, int]]

    @property
    def progress(self) -> list[Progress]:
        return [Progress.from_json(event) for event in self.events if event["event"] == "progress"]


@pytest.fixture(scope="module")
def anna(photo, tmp_path_factory):
    """One fit for all tests that only look at what comes of it: by the command, and by weights without hair."""
    bare = write_tiny_weights(tmp_path_factory.mktemp("bare") / "bare.safetensors", hairless=True)
    output, said = tmp_path_factory.mktemp("anna") / "anna.grmm", io.StringIO()
    arguments = ["fit", str(photo), "-o", str(output), "--preset", "fast", "--weights", str(bare), "--device", "cpu"]
    with contextlib.redirect_stdout(said), watching(photo) as (opened, decoded):
        assert cli.main([*arguments, "--events"]) == 0
    return Commanded(output, [json.loads(line) for line in said.getvalue().splitlines()], opened, decoded)


def test_a_photo_becomes_a_file_that_says_so(photo, anna):
    header = read_avatar_header(anna.path)
    assert header.name == "anna"
    assert header.provenance.from_photos
    assert header.provenance.date
    (record,) = header.provenance.photos
    assert record.name == "face.png"
    assert record.sha256 == hashlib.sha256(photo.read_bytes()).hexdigest()
    assert header.thumbnail.startswith(b"\x89PNG")
    assert header.camera.width == 256
    assert load_avatar(anna.path).painting.std() > 1
    check_progress(anna.progress, FIT)
    assert list(dict.fromkeys(event.stage for event in anna.progress)) == [stage.name for stage in FIT.stages]
    assert anna.progress[-1].fraction == 1.0
    assert not math.isnan(anna.progress[0].seconds_left), "there is an estimate from the beginning"
    assert any(event.picture.endswith("preview.png") for event in anna.progress)
    assert list(anna.path.parent.iterdir()) == [anna.path], "the work folder is gone"
    assert anna.events[-1]["rmse"] == pytest.approx(load_avatar(anna.path).tracking["rmse"].tolist(), rel=1e-5)


def test_by_weights_without_hair_the_person_wears_strands(anna):
    """The photo shows the embedded avatar."""
    hair = load_avatar(anna.path).hair
    assert hair.groom is not None
    assert hair.scalp
    own = load_avatar(library_path("default")).hair.settings
    assert abs(hair.settings.melanin - own.melanin) < 0.15
    assert hair.settings.length < 1.3


def test_events_are_json_lines(photo, anna, capsys):
    assert anna.events[0]["event"] == "progress"
    assert (anna.events[-1]["event"], anna.events[-1]["avatar"]) == ("done", str(anna.path))
    (faces,) = [event for event in anna.events if event["event"] == "faces"]
    assert faces["photo"] == str(photo)
    assert np.shape(faces["boxes"]) == (1, 4)
    assert cli.main(["info", str(anna.path)]) == 0
    shown = capsys.readouterr().out
    assert "from photos: yes" in shown
    assert "face.png" in shown


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


def test_cancelling_leaves_no_avatar_and_resuming_does_not_track_again(photo, make, tmp_path):
    output, seen = tmp_path / "a.grmm", []
    with pytest.raises(CancelledError, match="it can be resumed"):
        make([photo], output, progress=seen.append, cancelled=lambda: bool(seen) and seen[-1].stage == "codes")
    assert not output.exists()
    folder = FitRequest([photo], output).work_folder
    assert (folder / TRACKS_FILE).exists()
    seen.clear()
    result = make([photo], output, resume=True, progress=seen.append)
    assert {event.stage for event in seen} == {"load", "codes", "decoders", "finish"}
    check_progress(seen, FIT)
    assert len({event.fraction for event in seen if event.stage == "finish"}) > 3  # hair, colors, pictures: a third of the time
    assert result.path.exists()
    assert not folder.exists()
    # cancelled before anything is known: nothing is left behind
    with pytest.raises(CancelledError, match="had not found the person yet"):
        make([photo], tmp_path / "b.grmm", cancelled=lambda: True)
    assert [path.name for path in tmp_path.iterdir()] == ["a.grmm"]


@pytest.mark.slow
def test_the_state_of_other_photos_is_not_resumed(photo, make, tmp_path):
    from PIL import Image

    work = tmp_path / "work"
    make([photo], tmp_path / "a.grmm", work=work)
    assert (work / TRACKS_FILE).exists(), "a folder that was asked for stays"
    other = tmp_path / "other.png"
    Image.open(photo).transpose(Image.Transpose.FLIP_LEFT_RIGHT).save(other)
    seen = []
    make([other], tmp_path / "b.grmm", resume=True, work=work, progress=seen.append)
    assert "analyse" in {event.stage for event in seen}


@pytest.fixture(scope="module")
def masked(photo, weights, tmp_path_factory):
    """A fit of two photos with a mask each, of the second one for its left half; the result, what was opened and decoded."""
    folder = tmp_path_factory.mktemp("masked")
    turned, jpeg, whole, half = (folder / name for name in ("turned.png", "face.jpg", "whole.png", "half.png"))
    exif = Image.Exif()
    exif[0x0112] = 3
    with Image.open(photo) as image:
        image.transpose(Image.Transpose.ROTATE_180).save(turned, exif=exif)
        image.save(jpeg, quality=95)
    mask = np.full((256, 256), 255, np.uint8)
    Image.fromarray(mask).save(whole)
    mask[:, 128:] = 0
    Image.fromarray(mask).save(half)
    options = {"preset": "fast", "weights": weights, "device": "cpu", "masks": [whole, half]}
    with watching(turned, jpeg, whole, half) as (opened, decoded):
        result = fit(FitRequest([turned, jpeg], folder / "a.grmm", **options))
    return result, opened, decoded


def test_photos_and_masks_are_opened_once_and_decoded_once(masked, anna):
    result, opened, decoded = masked
    assert opened == {"turned.png": 1, "face.jpg": 1, "whole.png": 1, "half.png": 1}
    assert len(decoded) == 4
    assert [record.name for record in result.avatar.provenance.photos] == ["turned.png", "face.jpg"]
    assert anna.opened == {"face.png": 1}  # nor where the outline is found
    assert len(anna.decoded) == 1


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


def test_a_mask_replaces_the_outline_that_would_be_found(masked, photo, make, tmp_path):
    track = masked[0].tracks[1]
    whole, seen = track.photo_camera, track.camera
    edge = round((whole.width / 2 - whole.cx) * seen.fx / whole.fx + seen.cx)
    assert float(track.mask[:, edge + 4 :].max()) < 0.1
    inside = track.mask[track.mask.shape[0] // 2, edge - 60 : edge - 4]
    assert float(inside.min()) > 0.9
    mask = tmp_path / "mask.png"
    Image.fromarray(np.zeros((256, 256), np.uint8)).save(mask)
    with pytest.raises(NoFaceError, match="stand out"):
        make([photo], tmp_path / "b.grmm", masks=[mask])


@pytest.mark.slow
def test_a_folder_of_photos_is_fitted_and_measured(photo, weights, tmp_path, capsys):
    folder, out = tmp_path / "photos", tmp_path / "out"
    folder.mkdir()
    (folder / "face.png").write_bytes(photo.read_bytes())
    Image.fromarray(np.full((120, 160, 3), 130, np.uint8)).save(folder / "wall.png")
    (folder / "notes.txt").write_text("no photo")
    arguments = ["evaluate", str(weights), "--data", str(folder), "--protocol", "monocular", "--fit", "fast"]
    arguments += ["--perceptual", "none"]
    assert cli.main([*arguments, "-o", str(out), "--device", "cpu", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)["photos"]["photos"]
    assert set(result) == {"face.png", "wall.png"}
    assert 0.0 < result["face.png"]["rmse"] < 1.0
    assert "No face" in result["wall.png"]["error"]
    assert {path.name for path in out.iterdir()} == {"face.grmm", "face.png", "evaluation.json", "evaluation.md"}
    assert "wall.png" in (out / "evaluation.md").read_text()
    with two_workers(PREPARE) as cluster:
        options = ["-o", str(tmp_path / "there"), "--device", "cpu", "--json", "--cluster", address(cluster)]
        assert cli.main([*arguments, *options]) == 0
    there = json.loads(capsys.readouterr().out)["photos"]["photos"]
    assert there["face.png"]["rmse"] == pytest.approx(result["face.png"]["rmse"], abs=0.01)
    assert there["wall.png"] == result["wall.png"]
    assert {path.name for path in (tmp_path / "there").iterdir()} == {path.name for path in out.iterdir()}
    assert cli.main(arguments) == 1
    assert "--output" in capsys.readouterr().err


# --- a folder of people ------------------------------------------------------------------------------------------------

SAME = 1e-2  # other processes add with other numbers of threads, and a search carries that on
PREPARE = """
import test_fitting_api
test_fitting_api.presets.PRESETS["fast"] = test_fitting_api.QUICK
"""


@pytest.fixture
def people(photo, tmp_path):
    """Two with a face, one of them in a folder, and one without."""
    folder = tmp_path / "people"
    (folder / "bob").mkdir(parents=True)
    shutil.copy(photo, folder / "anna.png")
    shutil.copy(photo, folder / "bob" / "one.png")
    Image.new("RGB", (200, 200), (90, 120, 90)).save(folder / "nobody.jpg")
    (folder / "notes.txt").write_text("no photo")
    return folder


def fit_folder(people, output, weights, capsys, *options):
    command = ["fit", people, "-o", output, "--preset", "fast", "--weights", weights, "--device", "cpu", "--threads", "1"]
    code = cli.main([str(word) for word in (*command, "--json", *options)])
    out, err = capsys.readouterr()
    return code, json.loads(out) if out else {}, err


@pytest.mark.slow
def test_a_folder_of_people_here_and_on_a_cluster(people, weights, tmp_path, capsys):
    code, result, _ = fit_folder(people, tmp_path / "here", weights, capsys)
    assert code == 1
    assert (result["fitted"], list(result["people"])) == (2, ["anna", "bob", "nobody"])
    assert "face" in result["people"]["nobody"]["error"]
    here = [load_avatar(tmp_path / "here" / name) for name in ("anna.grmm", "bob.grmm")]
    assert len(list((tmp_path / "here").iterdir())) == 2
    with two_workers(PREPARE) as cluster:
        kill = kill_once_there_is("anna.grmm.fit/*.safetensors", tmp_path / "there", cluster)
        watching = threading.Event()

        def watch():
            while not watching.wait(0.02):
                kill()

        thread = threading.Thread(target=watch)
        thread.start()
        try:
            code, result, _ = fit_folder(people, tmp_path / "there", weights, capsys, "--cluster", address(cluster))
        finally:
            watching.set()
            thread.join()
        assert kill.killed
    assert (code, result["fitted"], list(result["people"])) == (1, 2, ["anna", "bob", "nobody"])
    assert {path.name for path in (tmp_path / "there").iterdir()} == {"anna.grmm", "bob.grmm"}
    for one in here:
        other = load_avatar(tmp_path / "there" / f"{one.name}.grmm")
        for name in ("z_id", "z_exp", "shape", "expression"):
            np.testing.assert_allclose(getattr(other, name), getattr(one, name), atol=SAME, err_msg=f"{one.name} {name}")
        assert other.provenance.photos == one.provenance.photos
    (people / "nobody.jpg").unlink()
    code, result, _ = fit_folder(people, tmp_path / "here", weights, capsys, "--resume")
    assert (code, [person["seconds"] for person in result["people"].values()]) == (0, [0.0, 0.0])


def test_what_cannot_be_fitted_as_a_folder_is_explained(people, photo, weights, tmp_path, capsys):
    (tmp_path / "empty").mkdir()
    shutil.copy(photo, people / "bob.jpg")
    for folder, options, words in (
        (people, [], "Two people in .* are called bob; rename one"),
        (people, ["--name", "x"], "are for the photos of one person"),
        (tmp_path / "empty", [], "holds neither photos nor folders of photos"),
        (people / "anna.png", ["--cluster", "local:2"], "A cluster is for a folder of people"),
    ):
        code, _, err = fit_folder(folder, tmp_path / "out", weights, capsys, *options)
        assert code == 1
        assert re.search(words, err)
    assert not (tmp_path / "out").exists()
