"""Pose library, presets, menus, turntable and contact sheets of the installed extension."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender

from grmm_core.controls.names import EXPRESSION_NAMES

pytestmark = pytest.mark.blender

ENVIRONMENT = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
THUMBNAIL = 128


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


def test_pose_library(run_blender: RunBlender, blender_version: str, weights: Path, tmp_path: Path):
    result = run_blender("pose_assets.py", weights, tmp_path, python=blender_version, environment=ENVIRONMENT).result
    assert result["done"]
    assert result["count"] == len(EXPRESSION_NAMES)
    assert result["sizes"] == [[THUMBNAIL, THUMBNAIL, 4]] * 2
    assert min(result["covered"]) > 0.2
    assert result["differ"] > 0.1
    assert {"grmm", "Mouth", "Left"} <= set(result["tags"])
    assert ":Mine:Mine" in result["catalogues"]  # others' catalogues stay
    assert f"{result['catalogue']}:GRMM Expressions/Mouth:" in result["catalogues"]
    assert "ARKit" in result["description"]
    assert result["again"]
    assert result["kept"] == THUMBNAIL
    assert result["replaced"] == {"mouthSmileLeft": 1.0}
    assert result["added"] == {"jawOpen": 0.25, "mouthSmileLeft": 1.0}
    assert result["flipped"] == {"mouthSmileRight": 1.0}
    assert result["clicked"] == {"cheekPuff": 1.0}
    assert result["own"] == [True, True]
    assert result["from_library"] == {"cheekPuff": 1.0, "jawOpen": 0.3}
    assert result["code"] == pytest.approx(1.25)
    assert result["left_over"] == 0
    wanted = ("has no pose Nothing", "Cannot read", "no pose Nothing")
    assert all(text in message for text, message in zip(wanted, result["messages"], strict=True))
    assert result["keyed"] == len(EXPRESSION_NAMES)


def test_presets_menus_and_operators(run_blender: RunBlender, blender_version: str):
    result = run_blender("presets_menus.py", python=blender_version, fresh=True).result
    expressions = result["expressions"]
    assert len(expressions) >= 12
    assert expressions["kiss"] == {"cheekSquintLeft": 0.1, "cheekSquintRight": 0.1, "mouthFunnel": 0.15, "mouthPucker": 0.95}
    assert all("jawRight" not in values for values in expressions.values())  # what was there before is gone
    assert result["from_armature"] == expressions["afraid"]
    assert result["drawn_again"].pop("save_pose") == []  # sets nothing
    assert set(result["drawn_again"]) > {"random_expression", "mirror", "reset", "apply_pose", "preset"}
    for name, editors in result["drawn_again"].items():
        assert {"VIEW_3D", "PROPERTIES"} <= set(editors), name
    assert result["render"] == {"balanced": [True, "0", 8], "draft": [False, "1", 3], "final": [True, "0", 16]}
    assert result["own"] == {"mouthPucker": 0.4}
    assert result["user_file"]
    assert result["removed"]
    for name, (label, description, incomplete) in result["described"].items():
        assert label, name
        assert len(description) > 10, name
        assert not description.endswith("."), name  # Blender adds it
        # The search finds what a menu holds; buttons that mean nothing outside of their panel stay out of it.
        assert (f"grmm.{name}" in result["drawn"]) != (name in result["internal"]), name
        assert incomplete == [], name
    assert {"Cancel", "Remove"} & {result["described"][name][0] for name in result["internal"]}
    assert {"Look At", "Blinking", "Breathing", "Face Bones"} <= set(result["labels"])
    assert "GRMM_MT_expression_presets" in result["drawn"]
    assert result["places"] == [True, True]


def test_turntable_and_contact_sheets(run_blender: RunBlender, blender_version: str, weights: Path, tmp_path: Path):
    result = run_blender("turntable_sheet.py", weights, tmp_path, python=blender_version, environment=ENVIRONMENT).result
    assert result["done"]
    assert result["again"]
    assert result["range"] == [3, 10]
    # One turn around a head that is moved, turned and scaled, from its front on.
    off = [(angle - 45.0 * step + 180.0) % 360.0 - 180.0 for step, angle in enumerate(result["angles"])]
    assert off == pytest.approx([0.0] * 8, abs=0.01)
    assert result["distances"] == pytest.approx([result["distances"][0]] * 8, rel=1e-4)
    assert result["past"] < 1e-5
    assert result["kept"] == ["Own", 11, 30, [11.0, 31.0]]
    assert result["asked"] == [True, 3, 10]
    assert result["jaw"] == [2 * (32 + 18), 3 * 32, 4]
    assert result["plain"] == [2 * 32, 3 * 32, 4]
    assert result["ink"] < 100  # captions
    assert result["blank"] == 255  # the tiles that are missing in the last row
    assert result["differ"] > 5
    assert result["background"] == pytest.approx([240.0] * 3, abs=1.0)
    assert result["views"] == [64, 64, 4]
    assert result["frames"] == [48, 4 * 64, 4]
    assert result["frame"] == 3
    assert result["same"] <= 2.0  # steps of 1/255: the same picture as the engine's, rounded twice
    assert result["covered"] > 0.1
    assert "No file is chosen" in result["messages"][0]
    assert "is not a folder" in result["messages"][1]
    assert "too large" in result["messages"][2]
    assert result["left"] == []
    assert "gone.grmm does not exist" in result["failed"]
    assert result["frame_kept"] == 6
    assert result["none"]
