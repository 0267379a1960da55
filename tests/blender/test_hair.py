"""Hair as Blender's curves, through F12 of the installed extension."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender

pytestmark = pytest.mark.blender


@pytest.fixture
def hair_script(run_blender: RunBlender, weights: Path, tmp_path: Path, blender_version: str):
    """Run a script of `tests/blender/scripts/` as SCRIPT WEIGHTS FOLDER in each Blender; returns what it reported."""

    def run(script: str) -> dict:
        environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
        return run_blender(script, weights, tmp_path, python=blender_version, environment=environment, timeout=400).result

    return run


def test_hair_is_what_blender_evaluates_of_curves(hair_script):
    found = hair_script("hair_curves.py")
    print(found)


def test_curves_that_cannot_be_hair_get_a_sentence_and_the_groom_is_there_instead(hair_script):
    result = hair_script("hair_bad.py")
    print(result)
