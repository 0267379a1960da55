"""The render engine, through F12 of the installed extension: cameras, passes, film, occlusion, errors, animations.

Blender 4.5 runs the model in its own process, Blender 5.2 (which has no torch) in a worker with the tests' interpreter.
"""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender

pytestmark = pytest.mark.blender

STEP = 1.0 + 1e-3  # of an 8-bit channel: rounding on both sides


@pytest.fixture(scope="module")
def weights(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("torch")
    from tiny_model import write_tiny_weights

    return write_tiny_weights(tmp_path_factory.mktemp("weights") / "tiny.safetensors")


@pytest.fixture
def render_script(run_blender: RunBlender, weights: Path, tmp_path: Path):
    """Run a script of `tests/blender/` as SCRIPT WEIGHTS FOLDER ... and return what it reported."""

    def run(script: str, *arguments: object, python: str = "4.5", **options):
        environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
        return run_blender(script, weights, tmp_path, *arguments, python=python, environment=environment, **options).result

    return run


def test_cameras(render_script, blender_version):
    result = render_script("engine_cameras.py", python=blender_version)["cameras"]
    assert len(result) == 9
    assert result["percentage"]["size"] == [72, 60]
    for name, values in result.items():
        assert values["projection"] < 0.01, name
        assert values["picture"] <= STEP, name
        assert values["covered"] > 0.05, name
