"""Performances as keyframes, and the operators that edit an avatar's controls."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender, find_python
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields

from grmm_core.controls.names import ARKIT_NAMES

pytestmark = pytest.mark.blender

PARITY = 1e-5  # metres
SINGLE = 1e-5  # keys hold single precision


def write_files(folder: Path) -> None:
    """A talking face as ARKit JSON, a Live Link Face CSV, and files that cannot be used."""
    generator = np.random.default_rng(5)
    time = np.arange(241) / 30
    phase, speed = generator.uniform(0, 6, 52), generator.uniform(1, 6, 52)
    weights = 0.35 + 0.3 * np.sin(phase + speed * time[:, None])
    weights[:, 3] = 1.2  # out of range
    frames = [{"weights": [round(float(w), 5) for w in row], "time": float(t)} for row, t in zip(weights, time, strict=True)]
    text = json.dumps({"names": list(ARKIT_NAMES), "metadata": {"fps": 30}, "frames": frames})
    (folder / "speech.json").write_text(text)
    (folder / "truncated.json").write_text(text[: len(text) // 2])
    (folder / "empty.json").write_text(json.dumps({"names": list(ARKIT_NAMES), "frames": []}))

    names = [name[0].upper() + name[1:] for name in ARKIT_NAMES]
    parts = [f"{part}{axis}" for part in ("Head", "LeftEye", "RightEye") for axis in ("Yaw", "Pitch", "Roll")]
    rows = [",".join(["Timecode", "BlendShapeCount", *names, *parts])]
    for k in range(120):
        values = [0.25 if name.startswith("MouthSmile") else 0.1 for name in names]
        angles = [0.01 * k, 0.05, 0.0] + [0.1, -0.05, 0.0] * 2
        rows.append(f"10:00:{k // 60:02d}:{k % 60:02d}.000,61," + ",".join(f"{v:.5f}" for v in values + angles))
    (folder / "live_link.csv").write_text("\n".join(rows))
    (folder / "unknown.csv").write_text("Timecode,Wobble\n10:00:00:00.000,0.5\n")
    zeros = np.zeros((10, 3), np.float32)
    generator = np.random.default_rng(6)
    np.savez(
        folder / "talk.npz",
        expr=generator.normal(0, 0.5, (10, 100)).astype(np.float32),
        rotation=generator.normal(0, 0.1, (10, 3)),
        neck_pose=generator.normal(0, 0.1, (10, 3)),
        jaw_pose=np.abs(generator.normal(0, 0.1, (10, 3))) * [1, 0, 0],
    )
    np.savez(folder / "flame.npz", expr=np.ones((10, 100), np.float32), rotation=zeros, neck_pose=zeros, jaw_pose=zeros)


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def imported(request: pytest.FixtureRequest, run_blender: RunBlender, tmp_path_factory: pytest.TempPathFactory) -> dict:
    find_python(request.param)
    folder = tmp_path_factory.mktemp("performances")
    write_files(folder)
    write_flame_pickle(folder / "flame2023.pkl", flame_head_fields())
    return run_blender("performance_import.py", folder, python=request.param).result


def test_every_frame_is_what_was_recorded(imported):
    speech = imported["speech"]
    assert speech["error"] < SINGLE
    assert speech["parity"] < PARITY
    assert speech["range"] == [5, 245]
    assert speech["groups"] == ["Brows", "Cheeks and nose", "Eyes", "Jaw", "Mouth", "Tongue"]
    assert speech["curves"] == 52
    assert speech["action"] == "speech"


def test_scene_rate_gain_and_a_second_take(imported):
    rate = imported["rate"]
    assert rate["half"] == pytest.approx(0.5, abs=0.03)  # the peak rule may move a frame
    assert rate["last"] == 1 + 8 * 24
    assert rate["kept"] == rate["half"]
    assert rate["full"] == pytest.approx(1.0, abs=0.05)
    assert rate["end"] == rate["last"]


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
    assert edits["parity"] < PARITY
