"""Heads in files: saved and opened with and without the extension, appended, linked, overridden, given another person."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender, find_python
from tolerances import CHANNEL_STEP, RIG_PARITY

from grmm_core.head import load_open_head

pytestmark = pytest.mark.blender

ENVIRONMENT = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def saved(request: pytest.FixtureRequest, run_blender: RunBlender, tmp_path_factory: pytest.TempPathFactory):
    """A folder with a saved head, and a function that runs a script on it."""
    find_python(request.param)
    from tiny_model import write_tiny_weights

    folder = tmp_path_factory.mktemp("files")
    weights = write_tiny_weights(folder / "tiny.safetensors")

    def run(script: str, *arguments: object, **options) -> dict:
        return run_blender(script, weights, folder, *arguments, python=request.param, environment=ENVIRONMENT, **options).result

    made = run("files_make.py")
    assert made["stored"] == "//person.grmm"
    assert Path(made["source"]) == folder / "person.grmm"
    return folder, run


def test_reopened_in_a_new_process(saved):
    folder, run = saved
    result = run("files_open.py", "head.blend")
    assert result["opened"] < RIG_PARITY
    assert max(result["errors"].values()) < RIG_PARITY
    assert len(result["avatars"]) == 1
    assert Path(result["source"][0]) == folder / "person.grmm"
    assert result["picture"] <= CHANNEL_STEP


def test_opened_without_the_extension(saved):
    _, run = saved
    result = run("files_open.py", "head.blend", "without.blend", enable=False)
    assert result["extension"] is False
    assert result["opened"] < RIG_PARITY  # what the extension keeps up to date was saved
    assert result["polygons"] == len(load_open_head().faces)
    assert result["valid"]
    assert max(result["native_errors"].values()) < RIG_PARITY  # exact but for the learned detail, which stays as saved
    assert max(result["errors"].values()) > RIG_PARITY
    assert min(result["moved"].values()) > 1e-3

    # saved there, the file is an avatar again where the extension is
    again = run("files_open.py", "without.blend")
    assert len(again["avatars"]) == 1
    assert max(again["errors"].values()) < RIG_PARITY
    assert again["picture"] <= CHANNEL_STEP


def test_libraries_and_persons(saved):
    _, run = saved
    result = run("files_libraries.py")

    assert result["appended"] == {"parity": pytest.approx(0.0, abs=RIG_PARITY), "source": "person.grmm"}

    linked = result["linked"]
    assert "linked" in linked["message"]
    assert linked["poll"] is False
    assert linked["source"] is True  # relative to the library, not to the file that links it
    assert linked["parity"] < RIG_PARITY

    overridden = result["overridden"]
    assert overridden["source"] is True  # likewise
    assert overridden["moved"] > 1e-3
    assert "override" in overridden["message"]
    assert overridden["kept"] == [0.9, 0.2]
    assert overridden["reloaded"] < RIG_PARITY

    person = result["person"]
    assert person["other"]["parity"] < RIG_PARITY
    assert person["other"]["changed"] > 1e-3
    assert "gone.grmm does not exist" in person["missing"]["message"]
    assert person["missing"]["mesh"] == 0.0
    assert "still_gone.grmm does not exist" in person["missing"]["relink"]
    assert person["back"]["mesh"] < RIG_PARITY
    assert person["back"]["message"] == ""

    collection = result["collection"]
    assert all(hairy > 1.2 * bald for hairy, bald in collection["caches"]), collection["caches"]
    assert collection["left"][0] == collection["left"][1]
    assert collection["note"] == ""
    assert collection["strands"][0] == collection["strands"][1]

    for case, right in result["elsewhere"].items():
        assert all(right), case

    gone, broken, nothing, objects = result["bad"]
    assert "gone.grmm does not exist" in gone
    assert "broken.grmm" in broken
    assert "choose a .grmm file" in nothing
    assert objects == "0"
