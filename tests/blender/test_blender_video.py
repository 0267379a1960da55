"""Performances from videos and voices in Blender: whole ones, and captures that end in other ways."""

from __future__ import annotations

import json
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender, find_python
from videos import filmed, write_sound, write_video

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.voice.listening import Phone
from grmm_core.voice.mouth import mouth
from grmm_core.voice.sound import RATE, loudness, read_sound

pytestmark = pytest.mark.blender
FPS, COUNT = 15, 15


@pytest.fixture(scope="module")
def folder(repository: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A second of somebody who opens the mouth and turns to a side, with sound; a voice; a text; silence."""
    folder = tmp_path_factory.mktemp("videos")
    weights = np.zeros((COUNT, len(ARKIT_NAMES)), np.float32)
    weights[:, ARKIT_NAMES.index("jawOpen")] = 0.5 * np.sin(np.pi * np.arange(COUNT) / (COUNT - 1))
    frames = filmed("library:bald", weights, 0.3 * np.arange(COUNT) / (COUNT - 1))
    write_video(folder / "speech.mp4", frames, FPS, sound=1.0)
    (folder / "text.mp4").write_text("no video")
    shutil.copy(repository / "tests" / "data" / "voice" / "voice.ogg", folder)
    write_sound(folder / "silence.wav", np.zeros(RATE, np.int16), RATE, RATE, 1)
    return folder


@pytest.mark.parametrize("version", ["4.5", "5.2"])
def test_recordings_key_the_head(run_blender: RunBlender, repository: Path, folder: Path, version: str):
    find_python(version)
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    found = run_blender("video_import.py", folder, python=version, environment=environment, timeout=300.0).result
    imported = found["imported"]
    assert not imported["poll_without"]
    frames = np.arange(3, COUNT)  # from 0.2 s on
    assert np.corrcoef(imported["jaw"], np.sin(np.pi * frames / (COUNT - 1)))[0, 1] > 0.9
    assert max(imported["jaw"]) > 0.25
    turned = np.array(imported["turn"])
    assert np.abs(turned - turned[0] - 0.3 * (frames - 3) / (COUNT - 1)).max() < np.radians(4.0)
    assert imported["range"] == [11, 22]
    assert imported["action"] == "speech"
    assert imported["note"].startswith("Frames 11 to 22 are keyed, with its sound in the sequencer.")
    assert imported["sound"] == [["speech", 11, 8]]

    spoken = found["spoken"]
    assert spoken["note"].startswith("Frames 10 to ")
    assert "with its sound in the sequencer. Heard: maybe we should buy" in spoken["note"]
    samples = read_sound(folder / "voice.ogg")
    assert spoken["range"] == [10, pytest.approx(10 + 30 * len(samples) / RATE, abs=2)]
    known = json.loads((repository / "tests" / "data" / "voice" / "voice.json").read_text("utf-8"))["phones"]
    times = np.arange(len(spoken["jaw"])) / 30
    truth = mouth([Phone(*phone) for phone in known], loudness(samples), times)[:, ARKIT_NAMES.index("jawOpen")]
    assert np.corrcoef(spoken["jaw"], truth)[0, 1] > 0.85
    shut = np.array(spoken["close"])
    lips = [(begin, end) for name, begin, end in known if name in "PBM"]
    assert min(shut[round(30 * begin) : round(30 * end) + 1].max() for begin, end in lips) > 0.02
    assert spoken["turned"]
    assert spoken["keys"] < len(times)
    assert spoken["strips"] == [["music", 1, 1], ["voice", 2, 10]]
    assert spoken["text"] == [1, True]
    assert "Nobody is heard to speak in silence.wav" in spoken["silent"]
    assert "No recording is chosen" in spoken["none"]

    over = found["over_keys"]
    own = over["own"][0]
    assert over["own"][1]  # kept in the file
    assert over["first"]["note"].startswith("Frames 1 to ")
    assert f'What was keyed before is kept in the action "{own}".' in over["first"]["note"]
    assert over["seen"]
    assert over["sync"] == ["NONE", "AUDIO_SYNC"]
    assert over["first"]["strips"] == over["again"]["strips"] == [["voice", False]]  # not twice
    assert over["other"]["strips"] == [["other", False], ["voice", True]]  # one voice at a time
    assert over["part"] == [7, 7 + 36, 7 - 12, pytest.approx(7 + 36, abs=1)]  # a second and a half, at 24 frames a second
    assert over["heard"] == 1
    # A sentence behind that part, both in the scene's range; another take of it; then one that replaces all.
    assert over["next"] == [2, 7, pytest.approx(101 + 24 * len(samples) / RATE, abs=2)]
    assert over["second_take"] == ["voice.001", "other.001"]
    assert over["alone"] == ["voice.003"]
    assert over["count"] == 6  # six places, at eight imports
    assert "is kept in the action" not in over["added"]["note"]
    assert over["tracks"] == [own]
    # Keys 0.2 and 0.4 on frames 1 and 40, with what the voice does on top.
    assert over["smile"][0] == pytest.approx(0.2, abs=0.02)
    assert 0.2 < over["smile"][1] < 0.4
    assert over["smile"][2] == pytest.approx(0.4, abs=0.02)

    errors = found["errors"]
    assert "none.mp4 does not exist" in errors["missing"]
    assert "text.mp4 is not a readable video" in errors["text"]
    assert "must come after the first" in errors["backwards"]
    assert not errors["keyed"]
    assert "The head is in no scene any more; its performance is kept in" in found["gone"]["message"]
    assert found["another"]["note"].startswith("The work on speech.mp4 was cancelled, for another file was opened;")
    assert found["cancelled"] == {"polls": [False, True], "message": "The capture was cancelled.", "keyed": 0}
    assert "ended without a performance" in found["nameless"]["message"]
    assert found["failed"]["note"] == "No face was found in speech.mp4."
    assert found["own_shape"] == [[10, False, None], [11, True, "ada.grmm"]]

    scene = found["another_scene"]
    assert scene["note"].startswith("Frames 1 to ")
    assert scene["keyed"] == scene["redone"]
    assert scene["keyed"][:2] == [True, 1]
    assert scene["keyed"][2] < 250 == scene["other"]  # the range of the head's scene
    assert scene["undone"] == [False, 0, 250]
    assert scene["note_of_before"] == ""
