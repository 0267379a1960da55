"""The rendered viewport: the thread that makes its pictures, and drawing them on a real (software) graphics device."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender

pytestmark = pytest.mark.blender


def test_pictures_are_made_on_a_thread_and_the_newest_request_wins(run_blender: RunBlender, blender_version):
    found = run_blender("engine_view_jobs.py", python=blender_version).result
    assert found["rest"] == ["begin preview a 320x240", "begin final a 640x480"]
    assert found["pictures"] == ["preview a turned", "final a turned"]
    assert found["ended"]
    assert found["moving"] == ["begin preview a 320x240", "begin preview c 320x240"]
    assert found["shown"] == ["preview a turned", "preview c turned"]
    assert found["superseded"] == ["begin final c 640x480", "cancelled final c 640x480", "begin preview d 320x240"]
    assert found["gave_way"] == ["begin final d 640x480", "cancelled final d 640x480", "begin final d 640x480"]
    assert found["afterwards"] == "final d turned"
    large, fewer, cheap = "512x512", "384x384", "277x277"
    assert found["playing"] == [
        *(f"begin playing {name} {large}" for name in "pqr"), f"begin playing s {fewer}", f"begin preview o {cheap}",
        f"begin preview stop {cheap}", "begin final stop 1024x1024", f"begin playing t {large}", f"begin playing u {large}",
        f"begin playing v {fewer}", f"begin preview i {cheap}",
    ]  # fmt: skip
    assert found["playing_levels"] == [
        *(f"playing {name} turned" for name in "pqrs"), "preview o turned", "preview stop turned", "final stop turned",
        *(f"playing {name} turned" for name in "tuv"), "preview i turned",
    ]  # fmt: skip
    assert found["ahead"] == [
        "begin playing w 512x512", "announce x", "begin playing x 512x512", "begin playing z 512x512",
    ]  # fmt: skip
    assert found["ahead_drawn"] == ["playing w turned", "playing x turned", "playing z turned"]
    assert found["errors"][0] == "The model worker ended."
    assert found["errors"][1] == ""
    assert "ZeroDivisionError" in found["errors"][2]
    assert found["closed"] == ["begin preview g 320x240", "cancelled preview g 320x240"]
    assert found["closed_ended"]
    assert found["closed_picture"]
    assert not found["closed_busy"]


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


def test_viewport_shows_what_f12_renders(run_blender: RunBlender, weights: Path, tmp_path: Path):
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    found = run_blender("engine_view_draw.py", weights, tmp_path, python="5.2", environment=environment).result
    assert found["statuses"] == ["Loading the model; the first time after installing can take a minute", "Preview", ""]
    # The good picture is that of F12 up to 16-bit storage and F12's 8-bit file; the preview is smaller and unrefined.
    assert found["covered"] > 0.05
    assert found["final_error"] < 0.004
    assert 0.004 < found["preview_error"] < 0.2
    # The wall in front takes the left half away.
    assert found["wall_left"] == 0.0
    assert found["wall_right_error"] < 0.004
    # What changes is seen, what does not is not drawn again.
    assert found["redrawn_for_nothing"] is False
    assert found["pose_changed"] > 0.001
    # Overlays are seen beside the avatar, and on it where they are nearer.
    behind, beside, near = found["overlays"]
    assert behind < 0.001
    assert beside == 1.0
    assert near == 1.0
    assert found["world"] == pytest.approx([0.1, 0.2, 0.05, 1.0], abs=2e-3)
    assert "missing.grmm" in found["error"]
    assert found["panoramic"] == ""
