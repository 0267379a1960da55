"""Distances between many points."""

from __future__ import annotations

import numpy as np

from grmm_core.geometry.points import squared_distances


def test_squared_distances_are_those_of_differences():
    rng = np.random.default_rng(3)
    points, others = rng.normal(size=(40, 3)).astype(np.float32), rng.normal(size=(70, 3)).astype(np.float32)
    expected = ((points[:, None].astype(float) - others) ** 2).sum(2)
    np.testing.assert_allclose(squared_distances(points, others), expected, atol=1e-12)
    same = squared_distances(points, points)
    assert same.min() >= 0.0  # not just below, where a root would not be a number
    np.testing.assert_allclose(np.diag(same), 0.0, atol=1e-14)
