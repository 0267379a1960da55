"""What the mean of the open head's people lacks of people's: thin lips, high corners of the mouth, low brows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grmm_core.head import load_open_head
from grmm_core.head.usual_face import usual_shape


def test_lips_are_thinner_corners_higher_brows_lower_and_what_is_farther_stays():
    head = load_open_head()
    before, after = head.shaped(np.zeros(300)), head.shaped(usual_shape(head))
    points = [head.landmark_positions(vertices, 478) * 1e3 for vertices in (before, after)]
    upper, gap, lower = (
        points[1][above, 1] - points[1][below, 1] - points[0][above, 1] + points[0][below, 1]
        for above, below in ((0, 13), (13, 14), (14, 17))
    )
    assert -2.2 < upper < -1.7, "millimetres"
    assert -2.2 < lower < -1.7
    assert abs(gap) < 0.05
    droop = [p[[13, 14], 1].mean() - p[[61, 291], 1].mean() for p in points]
    assert 0.8 < droop[0] - droop[1] < 1.2
    brows = [p[[66, 105, 296, 334], 1].mean() - p[[33, 133, 263, 362], 1].mean() for p in points]
    assert 1.4 < brows[0] - brows[1] < 1.9
    opened = [p[[159, 386], 1].mean() - p[[145, 374], 1].mean() for p in points]
    assert abs(opened[0] - opened[1]) < 0.05
    moved = np.linalg.norm(after - before, axis=1)
    far = np.linalg.norm((before - points[0][[13, 14, 66, 296]].mean(0) / 1e3) * [1, 1, 0], axis=1) > 0.08
    assert moved[far].max() < 8e-4
    assert moved[far].mean() < 2e-4


def test_heads_of_other_expressions_are_those_of_people():
    head = load_open_head()
    other = replace(head, expression_names=tuple(f"expression{index}" for index in range(100)))
    assert not usual_shape(other).any()
