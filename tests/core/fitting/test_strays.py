"""Strands that a bend has led astray go; partings, hairlines and coils stay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.fitting.strays import without_strays
from grmm_core.hair import library_groom
from grmm_core.hair.roots import SCALP


def scalp(name, head):
    groom = library_groom(name, head.name)
    return groom.select(groom.groups == SCALP)


@pytest.mark.parametrize("name", ["side_part", "bob", "afro", "fringe"])
def test_hair_that_is_swept_aside_as_a_whole_stays(name, head):
    groom = scalp(name, head)
    swept = groom.points + np.array([0.3, 0.0, 0.0]) * groom.points[:, 2:]
    assert len(without_strays(replace(groom, points=swept.astype(np.float32)), groom, head)) > 0.995 * len(groom)


def test_hooks_above_the_hair_around_go(head):
    groom = scalp("fringe", head)
    led = np.random.default_rng(0).choice(len(groom), 40, replace=False)
    points = groom.points.copy()
    for number in led:
        rows = slice(*groom.offsets[number : number + 2])
        points[rows, :2] *= -1.0  # the other way over the skin
    left = without_strays(replace(groom, points=points), groom, head)
    kept = {tuple(row) for row in left.weights}
    gone = [tuple(groom.weights[number]) not in kept for number in led]
    assert np.mean(gone) > 0.9
    assert len(groom) - len(left) - sum(gone) < 0.005 * len(groom)
