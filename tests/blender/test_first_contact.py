"""What somebody meets first: a head in Blender's startup scene, F12, files, deleting."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender
from tiny_model import write_tiny_weights

pytestmark = pytest.mark.blender


def test_a_head_is_seen_moved_opened_and_deleted_as_expected(run_blender: RunBlender, blender_version: str, tmp_path: Path):
    weights = write_tiny_weights(tmp_path / "tiny.safetensors")
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    found = run_blender(
        "first_contact.py", weights, tmp_path, python=blender_version, environment=environment, fresh=True
    ).result
    assert found["objects"] == ["Camera", "Cube", "Light"]
    assert (found["as_started"], found["started_again"]) == (True, False)
    assert found["seen"]
    assert (found["unseen"], found["screens"] > 5) == ([], True)  # nor in any other workspace
    # What is selected can be moved and deleted as a whole; it stands on the cube and fills the picture.
    assert found["active"]
    assert found["moves_instead"]  # what a window says where only the locked head is selected
    assert found["selected"]
    assert found["stands"] == pytest.approx(1.0, abs=1e-3)
    assert found["engine"] == "GRMM"
    assert found["graded"] == "Standard"  # as solid view shows it
    assert found["covered"] > 0.1
    assert 0.5 < found["height"] <= 1.0
    assert found["edges"][1] == 0.0
    engine_kept, camera, lowest = found["moved"]
    assert engine_kept
    assert camera == [7.359, -6.926, 4.958]
    assert lowest == pytest.approx(0.0, abs=1e-3)  # on the floor
    assert found["scripted"] == [True, [7.359, -6.926, 4.958], [0.0, 0.0, 0.0]]
    assert found["portrait"] == ["Portrait Camera", ["Camera", "Portrait Camera"], "GRMM"]
    # The head keeps its size, and stays whole, where the picture gets another format after the camera has been placed.
    shares = [share for share, _ in found["formats"]]
    assert shares == pytest.approx([shares[0]] * 3, rel=1e-3)
    assert shares[0] > 0.6
    assert max(away for _, away in found["formats"]) < 0.5
    assert found["sensor"] == pytest.approx(24.0 * 16 / 9, rel=1e-4)
    assert found["dropped"] == [True, ".grmm", "person.grmm"]
    assert "No avatar file is chosen" in found["none_chosen"]
    assert found["rig_deleted"] == [True, True, True, False, False]
    assert found["deleted"] == {
        "head": [False, True, False],
        "cube": [False, False, True],
        "with a hat": [False, True, True],
        "with another bone": [False, True, True],
    }


def test_blender_does_not_wait_for_another_threads_picture(run_blender: RunBlender, blender_version: str):
    """The first picture compiles for half a minute: meanwhile the mesh is there, and what the model adds comes later."""
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    found = run_blender("busy_model.py", python=blender_version, environment=environment, fresh=True).result
    assert (found["window_waits"], found["render_waits"]) == (False, [True, False, True])
    assert found["seconds"] < 20.0
    assert found["vertices"] > 1000
    assert found["while_busy"] == 0.0
    assert found["again"] is not None
    assert found["corner"].startswith("Loading splats; ")
    assert found["caught_up"]
    assert found["after"] > 1e-4
    assert found["message"] == ""
    assert found["refused"]
    assert found["why"] == "There is no default today; look elsewhere."
    assert found["recovered"]
    assert found["still"] == ""
    for_open, for_new = found["waits"]
    assert for_new < 0.2 < for_open
