"""Avatars under Blender's own commands: transforms applied, hair hidden or deleted, heads without size, instances, tracks."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from blender_process import RunBlender
from tolerances import RIG_PARITY

pytestmark = pytest.mark.blender


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def edits(request: pytest.FixtureRequest, run_blender: RunBlender, weights: Path) -> dict:
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    return run_blender("object_edits.py", weights, python=request.param, environment=environment, timeout=600).result


@pytest.mark.parametrize("kind", ["location", "rotation", "scale"])
def test_transforms_that_are_applied_to_the_rig_change_nothing(edits, kind):
    """The head was drawn at the world's origin, beside its mesh and its hair."""
    place, hair, note, joints, mesh, looking, moved = edits["applied"][kind]
    assert place < 1e-5
    assert hair < 1e-4
    assert note == ""
    assert joints < 1e-5
    assert mesh < RIG_PARITY
    assert looking == "" if kind != "rotation" else "A rotation was applied" in looking
    assert moved == pytest.approx(0.14 if kind == "scale" else 0.14 * 1.4, abs=1e-4)  # the bone's own units


def test_hidden_curves_stay_on_a_head_that_moves(edits):
    note, away = edits["hidden"]
    assert note == ""
    assert 0.0 <= away < 1e-5


def test_a_head_whose_curves_are_deleted_wears_its_groom(edits):
    assert edits["deleted"] == [True, True, "groom:bob", ""]


def test_a_head_without_size_is_not_there(edits):
    assert edits["without_size"] == [1, True]


def test_instances_alone_have_light_nodes_and_passes(edits):
    found = edits["instanced"]
    assert found["place"] < 1e-5
    assert found["lit"]
    assert found["hair"] < 1e-4
    assert found["passes"]
    assert found["alone"] == []


def test_an_action_that_is_pushed_down_keeps_its_influence(edits):
    """It had become 0: Blender keys the influence that a strip has at the moment."""
    assert edits["pushed"] == pytest.approx(0.5, abs=1e-5)
