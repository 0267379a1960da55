"""What animators do with a rig beside moving sliders: saved codes, calibration, files of the day, FLAME, no runtime."""

from __future__ import annotations

from pathlib import Path

import pytest
from blender_process import RunBlender, find_python
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from performance_files import write_performances
from tolerances import RIG_PARITY

from grmm_core.controls.names import EXPRESSION_NAMES

pytestmark = pytest.mark.blender

SINGLE = 1e-5  # sums of single-precision codes
KEY = 2e-4  # rounded to four digits


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def edits(request: pytest.FixtureRequest, run_blender: RunBlender) -> dict:
    find_python(request.param)
    return run_blender("rig_edits.py", python=request.param).result


def test_saved_codes_blend(edits):
    codes = edits["codes"]
    for name in ("only", "saved", "sliders", "blended", "animated", "applied", "identity"):
        assert codes[name] < SINGLE, name
    assert codes["added"] == pytest.approx(2.0, abs=SINGLE)
    assert codes["left"] == []
    assert codes["after_reset"] == [[], 0.0, 0.0]


def test_random_detail_is_that_of_its_seed(edits):
    detail = edits["detail"]
    assert detail["same"] == 0.0
    assert detail["other"] > 0.01
    assert detail["half"] < SINGLE
    assert detail["none"] == 0.0
    assert 0.5 < detail["spread"] < 1.5  # as wide as the trained codes


def test_components_are_named(edits):
    names = edits["names"]
    assert names["indices"] == {"z_id": True, "z_exp": True}
    assert all(names["labels"]["z_id"])
    assert not any("Against" in label for label in names["labels"]["z_exp"])  # one that is seen in no part has no name
    assert len(names["shape"]) == 8
    assert len(set(names["shape"])) > 4
    assert all(len(label.split()) in (2, 3) for label in names["shape"])  # such as "Jaw wider"
    # Of skin and scalp one standard deviation changes the color by a few times what can be seen.
    assert {label.split()[0] for label in names["labels"]["z_id"]} >= {"Skin", "Scalp"}
    assert 1.0 < max(names["effects"]) < 20.0
    assert names["foreign"] == [""] * 7


def test_neutral_calibration(edits):
    neutral = edits["neutral"]
    # jawOpen, mouthSmileLeft, cheekPuff, neck pitch, jaw pitch
    assert neutral["rest"] == pytest.approx([0.0] * 5, abs=KEY)
    assert neutral["last"] == pytest.approx([1.0, 0.7 / 0.9, 0.0, -0.3, 0.0], abs=KEY)
    assert neutral["parity"] < RIG_PARITY
    first, last = neutral["frames"]
    assert first[:2] == pytest.approx([0.0, 0.0], abs=KEY)  # never below rest
    assert 0.0 < last[0] <= 1.0
    assert last[3] == pytest.approx(-0.3, abs=KEY)  # rotations were not asked for
    assert "frame" in neutral["bad"]


def test_one_region_at_a_time(edits):
    regions = edits["regions"]
    assert regions["mirrored"] == [0.7, 0.0, 0.0]
    assert regions["swapped"] == [0.4, 0.0, 0.5]
    assert regions["brows"] == [True, True]
    assert regions["kept"] == [0.0, 0.4]


def test_edits_are_keyed_and_undone(edits):
    assert edits["keys"] == ['["tongueOut"]']
    undo = edits["undo"]
    assert undo["moved"] > 1e-3
    assert undo["undone"] < RIG_PARITY
    assert undo["saved"] is False
    assert undo["redone"] < RIG_PARITY
    assert undo["again"] is True


def test_animated_shapes(run_blender: RunBlender, blender_version: str, tmp_path: Path):
    result = run_blender("rig_frames.py", tmp_path, python=blender_version).result
    assert max(result["frames"]) < RIG_PARITY
    assert result["waiting"] is True
    assert max(result["small"]) < RIG_PARITY
    for name in ("copied", "edited", "stored", "saved", "opened"):
        assert result[name] < RIG_PARITY, name
    assert max(result["layers"]) < RIG_PARITY
    assert result["waiting_for_render"] is True
    assert sorted(result["rendered"]) == ["15", "16", "17", "9"]
    assert max(result["rendered"].values()) < RIG_PARITY


@pytest.mark.parametrize("version", ["4.5", pytest.param("5.2", marks=pytest.mark.slow)])
def test_heads_in_a_working_file(run_blender: RunBlender, version: str, tmp_path: Path):
    find_python(version)
    result = run_blender("rig_lifecycle.py", tmp_path, python=version, fresh=True).result
    assert result["renamed"] == {"parity": pytest.approx(0.0, abs=RIG_PARITY), "again": True}
    assert result["parented"] < RIG_PARITY
    assert result["added"][0] == 2
    assert result["added"][1] == 0
    assert result["redo"]["undone"] > 1e-3
    assert result["redo"]["redone"] < RIG_PARITY
    assert result["redo"]["parity"] < RIG_PARITY
    assert max(result["deleted"]["both"]) < RIG_PARITY
    assert result["deleted"]["left"] == ["Ada"]
    assert result["deleted"]["parity"] < RIG_PARITY
    assert result["saved"]["opened"] < RIG_PARITY
    assert result["saved"]["parity"] < RIG_PARITY
    off = result["off"]
    assert off["gone"]
    assert off["moved"] > 1e-3  # drivers need no extension
    assert off["back"] == ["Ada"]
    assert off["parity"] < RIG_PARITY


@pytest.mark.parametrize("version", ["4.5", pytest.param("5.2", marks=pytest.mark.slow)])
def test_a_users_flame_head(run_blender: RunBlender, version: str, tmp_path: Path):
    find_python(version)
    file = tmp_path / "flame2023.pkl"
    write_flame_pickle(file, flame_head_fields())
    result = run_blender("flame_rig.py", file, python=version, fresh=True).result
    assert "choose generic_model.pkl" in result["none"]
    assert "gone.pkl does not exist" in result["gone"]
    assert result["source"] == f"flame:{file}"
    assert result["counts"] == [5143, 5143, 100]
    assert result["codes"] == []
    assert result["network"] is False
    assert result["rest"] < RIG_PARITY
    assert set(result["turning"]) >= {"jaw", "left_eye", "right_eye"}
    for name, (error, effect) in result["single"].items():
        assert error < RIG_PARITY, name
        assert effect > 1e-3, name
    assert max(result["everything"]) < RIG_PARITY
    assert result["reset"] < RIG_PARITY
    assert result["detail_poll"] is False
    assert {"Skin", "Eyes", "Irises", "Pupils", "Lips", "Hair", "Teeth", "Back Teeth"} <= set(result["parts"])
    assert result["drawn"] == 0
    assert result["masks"] == []


def test_without_a_runtime(run_blender: RunBlender, tmp_path: Path):
    """On Blender 5.2 with its own Python, which has no torch, as every stock Blender."""
    find_python("5.2")
    write_performances(tmp_path)
    environment = {"GRMM_WORKER_PYTHON": ""}
    result = run_blender("no_runtime.py", tmp_path / "speech.json", python="5.2", environment=environment).result
    assert result["available"] is False
    assert "install the one for this platform" in result["message"]
    assert result["sliders"] < RIG_PARITY
    assert result["panel"] == ""
    assert max(result["playback"]) < RIG_PARITY
    assert result["moved"] > 1e-3
    assert result["edited"] < RIG_PARITY
    message, error, change = result["random_person"]
    assert message == ""
    assert error < RIG_PARITY
    assert change > 1e-3  # another shape than the default head's
    assert result["plain"]  # a Blender that can draw the person paints them
    assert {"Skin", "Eyes", "Irises", "Pupils", "Lips", "Hair"} <= set(result["parts"])
    assert "install the one for this platform" in result["render"]
    assert result["heavy"] == []


def test_everything_registered_is_described(run_blender: RunBlender, blender_version: str):
    result = run_blender("ui_audit.py", python=blender_version).result
    assert result["problems"] == []
    assert len(result["operators"]) > 15
    assert {"GRMM_AST_poses", "GRMM_OT_reset"} <= set(result["asked"])
    assert {"GRMM_OT_reset", "GRMM_OT_mirror", "GRMM_OT_save_code", "GRMM_OT_calibrate_neutral"} <= set(result["undoing"])
    panels = result["panels"]
    assert panels["head"] == panels["armature"]
    assert "GRMM_PT_expression" in panels["head"]
    assert "GRMM_PT_expression" not in panels["empty"]


def test_all_controls_are_keyed_at_once_in_groups(run_blender: RunBlender, blender_version: str):
    result = run_blender("keying.py", python=blender_version).result
    assert result["selected"] == [["head", "rig"], ["jaw", "left_eye", "neck", "right_eye", "root"], "GRMM Controls"]
    assert result["paths"] == len(EXPRESSION_NAMES) + 1 + 5 + 1  # the strength, the bones' rotations, the root's place
    assert result["keyed"] == [len(EXPRESSION_NAMES) + 1, 18]
    assert result["with_face_bones"] > result["paths"]
    assert set(result["groups"]) >= {"Brows", "Eyelids", "Lips", "Mouth", "Mixtures"}
    assert result["by_hand"] == {"jawOpen": "Jaw", "noseSneerLeft": "Nose", "own": None}
    assert result["automatic"] == {"mouthSmileLeft": "Mouth"}
