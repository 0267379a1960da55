"""What the mean of the open head's people lacks of people's: thin lips, high corners of the mouth, low brows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from grmm_core.head import load_open_head
from grmm_core.head.usual_face import rested, usual_shape


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


def test_lips_that_stand_apart_beside_the_middle_are_brought_together():
    """Others are left alone; little moves beside the mouth."""
    head = load_open_head()
    rng, pairs = np.random.default_rng(3), ((311, 402), (81, 178), (310, 318), (80, 88))

    def gaps(shape):
        points = head.landmark_positions(head.shaped(shape), 478) * 1e3
        return np.array([points[above, 1] - points[below, 1] for above, below in pairs])

    usual = usual_shape(head)
    wide = shut = 0
    for _ in range(40):
        drawn = rng.standard_normal(head.shape_count) * 0.7
        shape = rested(head, drawn)
        before, after = gaps(drawn + usual) - gaps(usual), gaps(shape) - gaps(usual)
        if before.mean() > 0.6:
            wide += 1
            assert after.mean() < 0.5 * before.mean()
            moved = np.linalg.norm(head.shaped(shape) - head.shaped(drawn + usual), axis=1) * 1e3
            assert moved.mean() < 0.3, "millimetres"
        elif (before < 0.2).all():
            shut += 1
            assert after.mean() < 0.3
    assert wide > 3
    assert shut > 0
