"""Face bones, Look At, blinking and breathing: they add to sliders and keys, follow a target, and go without a trace."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender, find_python
from tolerances import RIG_PARITY

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def found(request: pytest.FixtureRequest, run_blender: RunBlender, tmp_path_factory: pytest.TempPathFactory) -> dict:
    find_python(request.param)
    return run_blender("motion_rig.py", tmp_path_factory.mktemp("motion"), python=request.param, timeout=400).result


def test_adding_and_removing_leaves_no_trace(found):
    assert all(found["round"]["same"].values()), found["round"]["same"]
    assert found["round"]["mesh"] < RIG_PARITY
    assert found["round"]["rest"] < 1e-3  # the eyes turn to the new target; the face does not move


def test_each_face_bone_drives_its_expressions_alone(found):
    bones = found["face"]["bones"]
    assert {name: moved for name, (right, moved) in bones.items() if not right} == {}
    assert len(bones) > 30


def test_bones_and_sliders_add_up_by_hand_and_by_keys(found):
    face = found["face"]
    assert face["sums"] == pytest.approx([0.55, 0.4, 0.3], abs=1e-4)
    assert face["parity"] < RIG_PARITY
    assert face["beyond"] == pytest.approx(1.3, abs=1e-4)  # the bone's limit holds, the slider counts on top
    assert face["keyed"] == pytest.approx([0.3, 0.45, 0.6], abs=1e-4)
    assert face["left"] == [pytest.approx(0.1, abs=1e-4), []]  # the slider's keys stay, the bones' go


def test_mirror_and_reset_take_face_bones_along(found):
    assert np.allclose(found["face"]["swapped"], [[0.0, 0.0, 0.0], [0.0, -0.006, 0.0]], atol=1e-6)
    assert found["face"]["reset"] == [0.0, 0.0]


def test_eyes_and_neck_follow_a_target(found):
    look = found["look"]
    for name in ("straight", "side", "down"):
        assert max(look[name][1]) < 0.1, name  # degrees between each eye's axis and the target
    pose = np.array(look["side"][0])
    assert 5.0 < pose[1, 1] < pose[4, 1]
    assert pose[3, 1] < pose[4, 1]  # the nearer eye turns less
    assert look["down"][2] > 0.3  # the upper lids go with the eyes
    assert look["off"][0] == pytest.approx(np.zeros((5, 3)), abs=1e-3)
    assert look["keyed"] == pytest.approx([0.0, pose[1, 1]], abs=0.02)
    assert max(look["parity"], look["both"]) < RIG_PARITY


def test_look_at_stays_within_natural_ranges(found):
    pose = np.array(found["look"]["behind"][0])
    assert np.abs(pose[3:, 1]).max() <= 35.01
    assert pose[3:, 0].min() >= -25.01


def test_own_rotations_add_to_look_at_and_a_lost_target_is_nothing(found):
    assert found["look"]["nudged"] == pytest.approx([0.0, 5.73, 0.0], abs=0.02)
    assert found["look"]["lost"] == [True, pytest.approx(np.zeros((5, 3)), abs=1e-3)]


def test_blinks_come_from_a_seed_over_keys(found):
    idle = found["idle"]
    assert max(idle["first"]) == pytest.approx(1.0, abs=1e-3)
    assert min(idle["first"]) == 0.0
    assert idle["again"]
    assert not idle["other"]
    assert idle["half"] == pytest.approx(0.5, abs=1e-3)
    assert idle["keyed"] == pytest.approx([0.2, 1.0], abs=1e-3)  # a blink closes the eye, and no further
    assert idle["far"] == pytest.approx(1.0, abs=1e-3)
    assert idle["parity"] < RIG_PARITY


def test_breathing_moves_neck_shoulders_and_nostrils(found):
    neck, height, nostrils = found["idle"]["breath"]
    assert 0.3 < neck < 1.0  # degrees
    assert 0.001 < height < 0.003  # metres
    assert nostrils > 0.03


def test_baked_keys_do_the_same(found):
    idle = found["idle"]
    assert idle["baked"] < 2e-3
    assert idle["mesh"] < 2e-4
    assert idle["tracks"] == idle["layers"] == []
    assert '["eyeBlinkLeft"]' in idle["curves"]


def test_several_heads_look_at_each_other_and_duplicates_are_their_own(found):
    several = found["several"]
    assert several["bones"] == ["MCH-face", "MCH-face"]
    assert several["mutual"] == pytest.approx([63.0, -63.0], abs=0.1)  # they stand side by side: both at the end of the range
    assert several["apart"] == pytest.approx([0.0, 0.5], abs=1e-2)
    assert several["blinks"][0] != several["blinks"][1]


def test_saved_files_reopen_and_deleted_heads_leave_nothing(found):
    several = found["several"]
    assert several["reopened"] < RIG_PARITY
    assert several["deleted"][2] == [[], 0, 0]


def test_it_is_rendered_in_background_and_undone(run_blender: RunBlender, blender_version: str, weights: Path, tmp_path: Path):
    environment = {"GRMM_WORKER_PYTHON": sys.executable}
    done = run_blender("motion_render.py", weights, tmp_path, python=blender_version, environment=environment).result
    assert done["jaw"] == pytest.approx(1.0, abs=1e-3)
    assert done["mode"] == "POSE"
    assert done["moved"] > 0.1
    assert done["same"] < 2.0 / 255.0
    assert done["parity"] < RIG_PARITY
    assert done["bones"] == 18  # those of a head without face bones
    assert done["tracks"] == 0
    assert done["undone"] < 1.0 / 255.0
