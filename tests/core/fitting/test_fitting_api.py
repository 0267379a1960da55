"""`fit` and `grmm fit` from files to a file: events, cancelling, masks. The model is tiny and random; pictures are real."""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import io
import json
import math
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from progress_checks import check_progress
from quick_fits import watching
from tiny_model import write_tiny_weights

from grmm_core import cli
from grmm_core.avatar import load_avatar, read_avatar_header
from grmm_core.avatar.library import library_path
from grmm_core.errors import CancelledError, NoFaceError
from grmm_core.fitting.api import fit
from grmm_core.fitting.folder import TRACKS_FILE
from grmm_core.fitting.request import FitRequest
from grmm_core.jobs.progress import Progress
from grmm_core.jobs.stages import FIT

pytestmark = pytest.mark.usefixtures("quick_preset")


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
def anna(photo, quick_preset, tmp_path_factory):
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
def masked(photo, weights, quick_preset, tmp_path_factory):
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
