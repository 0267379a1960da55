"""Blinks and breaths from a seed."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.performance.idle import LOOP, blinks, breaths


@pytest.mark.parametrize("make", [blinks, breaths])
@pytest.mark.parametrize("rate", [1.0, 15.0, 60.0])
def test_a_loop_repeats_without_a_step(make, rate):
    keys = make(rate, 3)
    assert np.array_equal(keys, make(rate, 3))
    assert not np.array_equal(keys, make(rate, 4))
    assert (np.diff(keys[:, 0]) > 0).all()
    assert keys[0].tolist() == [0.0, 0.0]
    assert keys[-1] == pytest.approx([LOOP, 0.0])
    closed = (np.diff(keys[:, 1], prepend=0.0) > 0).sum()
    assert closed == rate * LOOP / 60.0


def test_blinks_are_uneven_and_most_close_the_eye():
    keys = blinks(15.0, 1)
    starts = keys[1:-1:4, 0]
    assert np.diff(starts).std() > 0.5
    assert np.diff(starts).min() > 0.4
    assert np.mean(keys[2:-1:4, 1] == 1.0) > 0.7
