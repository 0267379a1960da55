"""Performances as keyframes, and the operators that edit an avatar's controls."""

from __future__ import annotations

import pytest
from blender_process import RunBlender, find_python
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from performance_files import write_performances
from tolerances import RIG_PARITY

pytestmark = pytest.mark.blender

SINGLE = 1e-5  # keys hold single precision


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def imported(request: pytest.FixtureRequest, run_blender: RunBlender, tmp_path_factory: pytest.TempPathFactory) -> dict:
    find_python(request.param)
    folder = tmp_path_factory.mktemp("performances")
    write_performances(folder)
    write_flame_pickle(folder / "flame2023.pkl", flame_head_fields())
    return run_blender("performance_import.py", folder, python=request.param).result


def test_every_frame_is_what_was_recorded(imported):
    speech = imported["speech"]
    assert speech["error"] < SINGLE
    assert speech["parity"] < RIG_PARITY
    assert speech["range"] == [5, 245]
    assert speech["groups"] == ["Brows", "Cheeks", "Eyelids", "Gaze", "Jaw", "Lips", "Mouth", "Nose", "Tongue"]
    assert speech["curves"] == 52
    assert speech["action"] == "speech"


def test_scene_rate_gain_and_a_second_take(imported):
    rate = imported["rate"]
    assert rate["half"] == pytest.approx(0.5, abs=0.03)  # the peak rule may move a frame
    assert rate["last"] == 1 + 8 * 24
    assert rate["kept"] == rate["half"]
    assert rate["full"] == pytest.approx(1.0, abs=0.05)
    assert rate["end"] == rate["last"]


def test_a_recording_gets_an_action_of_its_own_and_the_present_one_stays(imported):
    takes = imported["takes"]
    assert takes["named"] == "speech"
    assert takes["own"] == [True, 1]
    assert takes["rig"] == ['pose.bones["neck"].rotation_euler'] * 3  # the file turns no bones: those keys play on
    assert takes["tracks"] == [[["speech", 1.0]]]
    assert takes["second"] == "live_link"
    assert len(takes["rig_tracks"]) == 1
    assert takes["shared"]
    assert takes["smile"] == pytest.approx(0.0, abs=1e-4)


def test_reduced_keys_keep_to_their_error(imported):
    reduced = imported["reduced"]
    assert reduced["error"] < 0.021
    assert reduced["keys"] < reduced["all"] / 5


def test_cleaning_options_do_what_the_core_does(imported):
    cleaned = imported["cleaned"]
    assert cleaned["error"] < SINGLE
    assert cleaned["range"] == [16, 16 + 90]


def test_flame_parameters_play_on_the_open_head(imported):
    flame = imported["flame"]
    assert flame["error"] < SINGLE
    assert flame["moved"] > 0.2
    assert flame["neck"] < SINGLE


def test_live_link_turns_neck_and_eyes(imported):
    found = imported["live_link"]
    assert found["neck"] < 1e-4
    assert found["eyes"] < 1e-6  # the eyeLook shapes turn the eyes; the recorded rotations would do it twice
    assert found["smile"] == pytest.approx(0.25, abs=SINGLE)
    assert len(found["slots"]) == 2
    assert found["shared"]
    assert found["samples"] == 120
    assert found["eye_bones"] < 1e-4
    assert found["eye_shapes"] == 0.0
    assert found["no_neck"] < 1e-6


def test_unusable_files_are_one_sentence(imported):
    messages = imported["messages"]["messages"]
    assert "does not exist" in messages["gone.json"]
    assert "no list of frames" in messages["empty.json"]
    assert "unknown.csv" in messages["unknown.csv"]
    assert "truncated.json" in messages["truncated.json"]
    assert "FLAME" in messages["flame.npz"]
    for text in ("", "x", "5-2"):
        assert "write something like" in messages[f"neutral {text}"]
    assert "Neutral frames must be" in messages["neutral 9999"]
    assert "choose a file" in messages[""]
    assert "beyond Blender's last" in messages["far"]
    for message in messages.values():
        assert message.endswith(".")
        assert "Traceback" not in message
    assert imported["messages"]["untouched"]
    assert imported["messages"]["poll"] is False


def test_mirror_reset_and_random(imported):
    edits = imported["edits"]
    assert edits["copied"] == pytest.approx([0.8, 0.0, 0.3, 0.1, -0.2, 0.0, 0.4, 0.4, 0.3])
    assert edits["swapped"] == pytest.approx([0.1, 0.8, 0.3, 0.1, -0.3, 0.1])
    assert edits["reset"] == pytest.approx([0.0, 0.3])
    assert edits["rest"] == pytest.approx([0.0, 0.0, 1.0], abs=1e-6)
    assert edits["keyed"]
    assert edits["same"] == 0.0
    assert edits["other"] > 0.05
    assert edits["largest"] <= 0.7
    assert edits["shape"] > 0.5
    assert edits["parity"] < RIG_PARITY


def test_the_file_browser_shows_every_option_once(imported):
    assert imported["drawn_options"] == {"missing": [], "twice": 0}
