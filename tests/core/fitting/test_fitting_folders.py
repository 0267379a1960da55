"""Folders of people and of photos, here and on a cluster."""

from __future__ import annotations

import json
import re
import shutil
import threading

import numpy as np
import pytest
from dask_workers import address, kill_once_there_is, two_workers
from PIL import Image
from quick_fits import PREPARE

from grmm_core import cli
from grmm_core.avatar import load_avatar

pytestmark = pytest.mark.usefixtures("quick_preset")


SAME = 1e-2  # other processes add with other numbers of threads, and a search carries that on


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
