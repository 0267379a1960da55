"""The rig in Blender: the same controls give the same vertices as the core, whatever sets them and however heads are copied."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender
from tolerances import RIG_PARITY

from grmm_core.controls.names import JOINT_NAMES
from grmm_core.controls.table import CONTROLS
from grmm_core.head import load_open_head

pytestmark = pytest.mark.blender

ANGLE = 1e-6  # radians


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


def test_mesh_agrees_with_the_core(run_blender: RunBlender, blender_version: str, weights: Path):
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    result = run_blender("rig_parity.py", weights, python=blender_version, environment=environment).result
    assert result["rest"] < RIG_PARITY
    assert max(result["model"]) < RIG_PARITY
    assert max(result["head"]) < RIG_PARITY
    assert max(result["frames"]) < RIG_PARITY
    assert result["moved"] < 2 * RIG_PARITY  # the armature is scaled by two
    assert max(result["controls"]) < ANGLE
    for name, (error, effect) in result["single"].items():
        assert error < RIG_PARITY, name
        assert effect > 3 * RIG_PARITY, name


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def structure(request: pytest.FixtureRequest, run_blender: RunBlender) -> dict:
    from blender_process import find_python

    find_python(request.param)
    return run_blender("rig_structure.py", python=request.param).result


def test_a_head_has_named_controls_with_ranges(structure):
    found = structure["structure"]
    head = load_open_head()
    assert {name for name, control in CONTROLS.items() if control.source == "property"} == set(found["properties"])
    assert set(head.expression_names) | {"shape.0", "residual", "visemeAA"} <= set(found["keys"])
    assert found["keys"].index("residual") == len(found["keys"]) - 1
    assert found["bones"] == sorted(JOINT_NAMES)
    assert found["limits"]["jawOpen"] == [-1.0, 2.0, 0.0, 1.0, True]
    assert all(limits[4] for limits in found["limits"].values())
    assert found["overridable"]


def test_the_mesh_alone_is_painted_as_a_face(structure):
    first, second, random = (structure["painted"][who] for who in ("first", "second", "random"))
    for look in (first, second, random):
        assert {"Skin", "Eyes", "Irises", "Pupils", "Lips", "Hair", "Teeth", "Back Teeth", "Mouth", "Lashes"} == set(
            look["parts"]
        )
        assert look["one_image"]
        assert look["size"] == ([512, 512] if look is random and not structure["painted"]["runtime"] else [256, 256])
        assert min(look["faces"].values()) > 4
        red = {part: color[0] for part, color in look["parts"].items()}
        assert red["Hair"] < 0.5 * red["Skin"]
        assert red["Pupils"] < red["Eyes"]
        reddish = {part: color[0] / color[1] for part, color in look["parts"].items()}
        assert reddish["Lips"] > 1.2 * reddish["Skin"]
    dimmest, brightest = first["over_painting"]  # the studio's light, which comes from above, is taken off
    assert dimmest < 0.9 < 1.05 < brightest
    assert max(abs(a - b) for a, b in zip(first["pixels"], second["pixels"], strict=True)) > 0.03
    assert structure["painted"]["kept"] == "of the user"
    assert structure["painted"]["plain"] != structure["painted"]["runtime"]  # drawn by the model where it can be
    assert structure["painted"]["by_timer"] == [True, True, not structure["painted"]["runtime"]]
    added, by_thread, when_opened = structure["painted"]["light"]
    assert added[0]
    assert added[1] > 0.03
    for lit, off in (by_thread, when_opened):
        assert not lit
        assert off < 1e-6
    before, after = structure["painted"]["left"]
    assert before == after  # a new painting takes the place of the old one


def test_drivers_need_no_scripts(structure):
    assert structure["structure"]["driver_types"] == ["SUM"]
    assert structure["structure"]["valid"]
    assert not structure["structure"]["preserve_volume"]


def test_hand_and_slider_add_up(structure):
    assert structure["added"] < RIG_PARITY


def test_keyed_values_stay_in_range(structure):
    assert structure["clamped"] == 2.0


def test_a_nan_control_is_a_message(structure):
    message, after, error = structure["nan"]
    assert "jawOpen" in message
    assert message.count(".") == 1
    assert after == ""
    assert error < RIG_PARITY


def test_undo_takes_mesh_and_joints_back(structure):
    undo = structure["undo"]
    assert undo["changed"] > 1e-3
    assert undo["back"] < RIG_PARITY
    assert undo["parity"] < RIG_PARITY


def test_a_full_duplicate_is_independent(structure):
    full = structure["full"]
    assert full["own_rig"]
    assert full["first"] == 0.0
    assert full["second"] < RIG_PARITY
    assert full["apart"] > 1e-3


def test_a_linked_duplicate_says_what_it_shares(structure):
    linked = structure["linked"]
    assert "make this head independent" in linked["message"]
    assert linked["first"] < RIG_PARITY  # the copy's values do not reach the mesh that they share
    assert linked["after"] == ""
    assert linked["third"] < RIG_PARITY
    assert linked["first_after"] < RIG_PARITY


def test_deleting_parts(structure):
    assert structure["deleted"] == {"left": 2, "parity": pytest.approx(0.0, abs=RIG_PARITY)}
    assert "armature is missing" in structure["no_rig"]["message"]
    assert structure["no_rig"]["pose"] == 0.0


def test_adding_heads_in_odd_places(structure):
    assert structure["elsewhere"]["pose_mode"] is False
    assert structure["elsewhere"]["second"] is True
