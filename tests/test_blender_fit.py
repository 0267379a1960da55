"""Avatars from photos in Blender: the job that it follows, the choice of photos, errors, and a whole fit."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from blender_process import RunBlender, find_python

from grmm_core.camera import Camera
from grmm_core.controls import Controls
from grmm_core.images import encode_png, quantize

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A photo of nobody: the default avatar, rendered."""
    pytest.importorskip("torch")
    from grmm_core.session import Instance, RenderOptions, create_session

    folder = tmp_path_factory.mktemp("photos")
    with create_session("local") as session:
        info = session.open("default")
        camera = Camera.orbit(512, 512, 8.0, 2.0, 1.1, 20.0)
        buffers = session.render([Instance(info.id, Controls())], camera, RenderOptions())
    image = buffers["rgb"] + (1.0 - buffers["alpha"]) * 0.6
    (folder / "face.png").write_bytes(encode_png(quantize(image)))
    (folder / "text.jpg").write_text("no picture")
    return folder


def environment() -> dict[str, str]:
    return {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}


@pytest.mark.parametrize("version", ["4.5", "5.2"])
def test_photos_are_looked_at(run_blender: RunBlender, folder: Path, version: str):
    find_python(version)
    done = run_blender("fit_panel.py", folder, "look", python=version, environment=environment(), timeout=400.0)
    said = done.result["statuses"]
    assert said["done"] == ["done", "a.grmm", 1.0, [["a.jpg", 2]], "p.png"]
    assert said["failed"] == ["failed", "No face was found."]
    assert said["crashed"][0] == "failed"
    assert "memory" in said["crashed"][1]
    assert said["crashed"][2] == pytest.approx(0.35)
    assert said["lacking"][0] == "failed"
    assert "nothing_of_this_name" in said["lacking"][1]
    assert said["cancelled"][0] == "cancelled"
    assert "resumed" in said["cancelled"][1]
    look = done.result["look"]
    assert not look["poll_without"]
    assert look["photos"] == 1  # the same file is not added twice
    assert look["faces"] == 1
    assert look["found"] > 20_000
    assert "text.jpg" in look["broken"]
    assert "folder" in look["no_folder"]


@pytest.mark.slow
def test_a_fit_puts_the_avatar_into_the_scene(run_blender: RunBlender, folder: Path):
    done = run_blender("fit_panel.py", folder, "fit", python="4.5", environment=environment(), timeout=900.0)
    said = done.result["fit"]
    assert said["avatar"]
    assert said["background"]
    assert Path(said["source"]).name == "person.grmm"
    from grmm_core.fitting.track import analyse_photo

    face = analyse_photo(folder / "face.png").faces[0]
    irises = face.landmarks[[468, 473], :2] / 512.0  # the subject's right and left
    eyes = np.array(said["eyes"])[::-1]
    assert np.abs(irises - eyes).max() < 0.03
