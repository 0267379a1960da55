"""What the mean of the open head's people lacks of people's: corners of mouths that are not sullen."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grmm_core.head import load_open_head
from grmm_core.head.resting_mouth import usual_shape


def test_corners_of_the_mouth_are_higher_and_what_is_farther_stays():
    head = load_open_head()
    before, after = head.shaped(np.zeros(300)), head.shaped(usual_shape(head))
    points = [head.landmark_positions(vertices, 478) * 1e3 for vertices in (before, after)]
    droop = [p[[13, 14], 1].mean() - p[[61, 291], 1].mean() for p in points]
    assert 1.0 < droop[0] - droop[1] < 1.6, "millimetres"
    wider = [np.linalg.norm(p[61] - p[291]) for p in points]
    assert 0.5 < wider[1] - wider[0] < 2.0
    far = np.linalg.norm(before - points[0][[13, 14]].mean(0) / 1e3, axis=1) > 0.08
    moved = np.linalg.norm(after - before, axis=1)[far]
    assert moved.mean() < 1e-4
    assert moved.max() < 1e-3


def test_heads_without_a_smile_of_that_name_are_those_of_people():
    head = load_open_head()
    other = replace(head, expression_names=tuple(f"expression{index}" for index in range(100)))
    assert not usual_shape(other).any()
