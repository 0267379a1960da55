"""What compiled kernels read of grids and clouds of points, against scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial import KDTree

from grmm_core.hair.grids import nearest, sample, smooth_grid


def test_values_between_cells_and_beyond_the_last_ones():
    rng = np.random.default_rng(0)
    grid = rng.normal(size=(7, 5, 6, 2))
    at = rng.uniform(-2.0, 9.0, (500, 3))
    inside = np.clip(at, 0, np.array(grid.shape[:3]) - 1)
    expected = [ndimage.map_coordinates(grid[..., k], inside.T, order=1) for k in range(2)]
    np.testing.assert_allclose(sample(grid, at), np.stack(expected, 1), atol=0.01)  # the last cell ends a thousandth early
    between = (at > 0).all(1) & (at < np.array(grid.shape[:3]) - 1.01).all(1)
    np.testing.assert_allclose(sample(grid, at)[between], np.stack(expected, 1)[between], atol=1e-5)


def test_a_blurred_grid_keeps_what_is_in_it():
    grid = np.random.default_rng(1).normal(size=(4, 1, 6))
    expected = grid
    for axis in range(3):
        expected = ndimage.convolve1d(expected, [0.25, 0.5, 0.25], axis, mode="nearest")
    blurred = smooth_grid(grid)
    np.testing.assert_allclose(blurred, expected, atol=1e-12)
    np.testing.assert_allclose(blurred.sum(), grid.sum(), atol=1e-12)


@pytest.mark.parametrize(("points", "places", "count"), [(400, 1000, 5), (3, 50, 8), (1, 4, 1), (20, 0, 2)])
def test_the_nearest_points(points, places, count):
    rng = np.random.default_rng(2)
    cloud, asked = rng.normal(size=(points, 3)), rng.normal(size=(places, 3))
    number, apart = nearest(cloud, asked, count)
    assert number.shape == apart.shape == (places, min(count, points))
    if places:
        far, which = KDTree(cloud).query(asked, min(count, points))
        np.testing.assert_array_equal(number, which.reshape(places, -1))
        np.testing.assert_allclose(apart, far.reshape(places, -1), rtol=1e-12)
