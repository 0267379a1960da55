"""Avatars composited into a scene of another engine: pixels in front and behind, both node systems, undo, removal."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender
from tolerances import CHANNEL_STEP

pytestmark = pytest.mark.blender

MERGED = ["Group"]
EEVEE_PATIENCE = 900.0  # seconds


def test_pixels_in_front_and_behind(run_blender: RunBlender, blender_version: str, tmp_path: Path):
    from tiny_model import write_tiny_weights

    weights = write_tiny_weights(tmp_path / "tiny.safetensors")
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    result = run_blender("composite_render.py", weights, tmp_path, python=blender_version, environment=environment).result
    assert result["done"]
    assert result["solid"] > 0.05
    # The avatar is the engine's own picture, not the mesh rendered by Cycles; the scene stands around it.
    assert result["behind_avatar"] <= CHANNEL_STEP
    assert result["behind_wall"] <= CHANNEL_STEP
    # An object added later hides its half of the face.
    assert result["front_left"] <= CHANNEL_STEP
    assert result["front_right"] <= CHANNEL_STEP
    assert result["half_size"] == [40, 48]
    # Without the meshes' help only comparing depths hides the avatar.
    assert result["unseen"] <= 2 * CHANNEL_STEP  # where the avatar is not quite solid, green shines through
    assert result["compared_left"] <= CHANNEL_STEP
    assert result["compared_right"] <= CHANNEL_STEP
    assert result["failed"] == [0, 0, 0]
    assert result["failed_color"] == [255, 0, 255]
    assert result["before"]["scenes"] == 1
    assert result["before"]["camera"] == [True]
    assert result["first"]["scenes"] == 2
    assert result["first"]["camera"] == [False]
    assert result["second"] == result["first"]
    assert result["two"] == [False, False]
    bob, crop, again = result["hair"]
    assert bob[:2] == crop[:2] == [1, 1]
    assert bob[2] > 100
    assert bob[2] != crop[2]
    assert crop == again
    assert not crop[3]
    assert result["hair_left"] == 0
    assert result["removed"]["scenes"] == 1
    assert result["removed"]["nodes"] == 0
    assert result["removed"]["camera"] == [True, True]


@pytest.mark.slow
def test_pixels_in_front_and_behind_in_eevee(run_blender: RunBlender, tmp_path: Path):
    """On 5.2 only: there Blender's module draws without a window; on Blender's software device each picture takes seconds."""
    from tiny_model import write_tiny_weights

    weights = write_tiny_weights(tmp_path / "tiny.safetensors")
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    result = run_blender(
        "composite_render.py", weights, tmp_path, "BLENDER_EEVEE", python="5.2", environment=environment, timeout=EEVEE_PATIENCE
    ).result
    for name in ("behind_avatar", "behind_wall", "front_left", "front_right", "compared_left", "compared_right"):
        assert result[name] <= CHANNEL_STEP, name
    assert result["solid"] > 0.05
    assert result["half_size"] == [40, 48]
    assert result["removed"]["camera"] == [True, True]


def test_beside_the_users_nodes_undone_and_saved(run_blender: RunBlender, blender_version: str, tmp_path: Path):
    result = run_blender("composite_trees.py", tmp_path, python=blender_version).result
    assert "no GRMM avatar" in result["no_avatar"]
    assert "renders this scene already" in result["grmm"]
    assert "no composite" in result["none"]
    assert "go to that scene" in result["inside"]
    mine = ["Invert", "RLayers"]
    assert result["before"] == mine
    assert result["inserted"] == [*MERGED, *mine]
    assert result["after"] == mine
    assert (result["handed"], result["visible"]) == (False, True)
    assert result["hidden"] == [False, False]
    assert result["lit"][:2] == ["STUDIO", "SCENE"]
    assert "No avatar of the scene has the studio's light" in result["lit"][2]
    assert result["children"] == ["Excluded", "Shown"]
    assert result["excluded"] == [False, True]
    assert result["camera"]
    assert result["marker"] == [[7, True]]
    assert result["size"] == 321
    assert not result["settled"]
    assert result["reopened"] == [True, [*MERGED, *mine]]
    assert result["again"] == [2, [*MERGED, *mine]]
    assert result["last"] == [1, mine]
    assert result["undone"] == [1, mine, True]
    assert result["redone"] == [2, [*MERGED, *mine], True]
