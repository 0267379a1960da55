"""Lips that touch in a recording touch after calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.head import load_open_head
from grmm_core.performance import CleanOptions, Performance, clean
from grmm_core.performance.closures import keep_lips_closed, lip_model

JAW, SMILE = ARKIT_NAMES.index("jawOpen"), [ARKIT_NAMES.index(f"mouthSmile{side}") for side in ("Left", "Right")]


def speech() -> Performance:
    """A constant smile and a jaw that opens and closes; it is closed in frames 40 to 43 and 70 to 100."""
    weights = np.zeros((120, 52), np.float32)
    weights[:, SMILE] = 0.6
    weights[:, JAW] = 0.15
    weights[40:44, JAW] = 0.015
    weights[70:101, JAW] = 0.0
    return Performance(np.arange(120) / 30, weights, 30.0, recorded_shapes=ARKIT_NAMES)


@pytest.fixture(scope="module")
def lips():
    return lip_model(load_open_head(), np.ones(52))


def test_the_model_of_the_lips_is_that_of_the_head(lips):
    head = load_open_head()
    weights = np.zeros(52, np.float32)
    weights[JAW], weights[SMILE] = 0.1, 0.5
    expression = head.arkit_to_expression.T @ weights
    marks = head.landmark_positions(head.vertices(np.zeros(1), expression, head.pose_of(expression)))
    assert lips.distance(weights[None])[0] == pytest.approx(marks[62, 1] - marks[66, 1], abs=3e-4)


def test_a_learned_displacement_counts(lips):
    """It parts the lips further the more the mouth smiles, which the head model does not know."""
    head = load_open_head()
    lower = head.faces[head.landmarks68[0][66]]

    def posed(weights):
        expression = head.arkit_to_expression.T @ weights
        vertices = head.vertices(np.zeros(1), expression, head.pose_of(expression)).copy()
        vertices[lower, 1] -= 2e-3 * weights[SMILE[0]] + 5e-4
        return vertices

    learned = lip_model(head, np.ones(52), posed=posed)
    assert learned.rest == pytest.approx(lips.rest + 5e-4, abs=1e-6)
    assert learned.slopes[SMILE[0]] == pytest.approx(lips.slopes[SMILE[0]] + 2e-3, abs=1e-5)
    assert learned.slopes[JAW] == pytest.approx(lips.slopes[JAW], abs=1e-5)


def test_short_closures_survive_calibration(lips):
    recorded = speech()
    cleaned = clean(recorded, CleanOptions(neutral=range(75, 95)))
    before, after = lips.distance(cleaned.weights), lips.distance(keep_lips_closed(cleaned, recorded, lips).weights)
    touching = lips.rest + 1.1e-4
    assert lips.distance(recorded.weights)[40:44].max() <= touching
    assert before[40:44].min() > touching + 2e-4
    assert after[40:44].max() <= touching
    assert after[:36] == pytest.approx(before[:36])  # open frames stay as they are
    assert np.abs(np.diff(after[44:50])).max() < np.abs(after[44:50] - after[43]).max() + 1e-9


def test_frames_may_stand_elsewhere(lips):
    recorded = speech()
    cleaned = clean(recorded, CleanOptions(neutral=range(75, 95), fps=24.0))
    closed = (cleaned.times > 40 / 30 - 1e-6) & (cleaned.times < 43 / 30 + 1e-6)
    after = lips.distance(keep_lips_closed(cleaned, recorded, lips).weights)
    assert closed.sum() >= 2
    assert after[closed].max() <= lips.rest + 1.1e-4


def test_nothing_happens_where_nothing_was_lost(lips):
    recorded = speech()
    assert keep_lips_closed(recorded, recorded, lips) is recorded
    numb = replace(lips, slopes=np.zeros(52))
    cleaned = clean(recorded, CleanOptions(neutral=[80]))
    assert keep_lips_closed(cleaned, recorded, numb) is cleaned
