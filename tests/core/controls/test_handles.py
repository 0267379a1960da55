"""Handles on the face: every one is whole, has its twin, and its directions give and take what they say."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.handles import HANDLES
from grmm_core.controls.table import CONTROLS, REGIONS
from grmm_core.head import load_open_head


@pytest.mark.parametrize("handle", HANDLES.values(), ids=lambda handle: handle.name)
def test_a_handle_is_whole_and_has_its_twin(handle):
    assert all(CONTROLS[name].section == "EXPRESSION" for name in handle.expressions)
    assert handle.region in REGIONS
    partner = HANDLES[handle.partner]
    assert partner.partner == handle.name
    assert {CONTROLS[name].partner for name in handle.expressions} == set(partner.expressions)
    marks = load_open_head().landmark_positions(load_open_head().v_template)
    here, there = (marks[list(each.landmarks)].mean(0) for each in (handle, partner))
    assert np.allclose(here * [-1, 1, 1], there, atol=2e-3)
    assert here[0] > 0.002 or not handle.name.endswith("_left")  # the subject's left is +x


def test_handles_stand_apart():
    marks = load_open_head().landmark_positions(load_open_head().v_template)
    points = np.array([marks[list(h.landmarks)].mean(0) + np.array([0, h.offset, 0]) for h in HANDLES.values()])
    apart = np.linalg.norm(points[:, None] - points[None], axis=2) + np.eye(len(points))
    assert apart.min() > 0.006


def test_a_drag_gives_and_takes_back():
    corner = HANDLES["mouth_corner_left"]
    rest = dict.fromkeys(corner.expressions, 0.0)
    smiling = corner.weights(rest, 0.0, 0.5 * corner.reach)
    assert smiling == pytest.approx(rest | {"mouthSmileLeft": 0.5})
    assert corner.weights(smiling, 0.0, -0.3 * corner.reach) == pytest.approx(rest | {"mouthSmileLeft": 0.2})
    assert corner.weights(smiling, 0.0, -0.9 * corner.reach) == pytest.approx(rest | {"mouthFrownLeft": 0.4})
    assert corner.weights(rest, 0.0, 9.0)["mouthSmileLeft"] == 1.0
    both = corner.weights(rest, 0.5 * corner.reach, 0.5 * corner.reach)
    assert min(both["mouthSmileLeft"], both["mouthStretchLeft"]) > 0.4


def test_a_hand_that_strays_moves_one_thing():
    jaw = HANDLES["jaw"]
    rest = dict.fromkeys(jaw.expressions, 0.0)
    found = jaw.weights(rest, 0.05 * jaw.reach, -0.5 * jaw.reach)
    assert found["jawLeft"] == found["jawRight"] == 0.0
    assert found["jawOpen"] == pytest.approx(0.49, abs=0.01)


def test_what_is_beyond_a_full_weight_stays():
    lid = HANDLES["upper_lid_left"]
    assert lid.weights({"eyeWideLeft": 0.0, "eyeBlinkLeft": 1.4}, 0.0, -0.01)["eyeBlinkLeft"] == 1.4
