"""Sums of small shape components: the quick way from frame to frame against the plain one."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

ROWS, LENGTH = 40, 300
CLOSE = 1e-5


@pytest.fixture(scope="module")
def sums(repository) -> ModuleType:
    """The module alone: its package needs Blender."""
    spec = importlib.util.spec_from_file_location("weighted_sums", repository / "grmm_blender" / "rig" / "weighted_sums.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def rows() -> np.ndarray:
    return np.random.default_rng(0).normal(size=(ROWS, LENGTH)).astype(np.float32)


def test_plain_sum_leaves_out_what_is_zero(sums, rows):
    weights = np.zeros(ROWS, np.float32)
    np.testing.assert_array_equal(sums.weighted_sum(weights, rows), np.zeros(LENGTH, np.float32))
    weights[:5] = 1.0, 0.0, -2.0, 0.5, 3.0
    np.testing.assert_allclose(sums.weighted_sum(weights, rows), weights @ rows, atol=CLOSE)
    np.testing.assert_allclose(sums.weighted_sum(weights[:5], rows), weights @ rows, atol=CLOSE)


def test_weights_of_one_segment_need_few_sums(sums, rows):
    """A curve between two keys: whatever its handles, weights are four vectors, mixed."""
    generator = np.random.default_rng(1)
    corners = generator.normal(size=(4, ROWS))
    recent, learned = sums.RecentSums(rows), []
    original = recent._learn
    recent._learn = lambda direction: (learned.append(1), original(direction))
    for t in generator.permutation(np.linspace(0.0, 1.0, 60)):
        mix = np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3])
        weights = (mix @ corners).astype(np.float32)
        np.testing.assert_allclose(recent(weights), weights @ rows, atol=CLOSE)
    assert len(learned) == 4


def test_anything_may_follow_anything(sums, rows):
    generator = np.random.default_rng(2)
    recent = sums.RecentSums(rows)
    for number in range(5 * sums.DIRECTIONS):
        weights = generator.normal(size=generator.integers(1, ROWS + 1)) * 10.0 ** generator.integers(-6, 2)
        if number % 7 == 0:
            weights[:] = 0.0
        found, wanted = recent(weights.astype(np.float32)), weights @ rows[: weights.size].astype(np.float64)
        np.testing.assert_allclose(found, wanted, atol=sums.NEGLIGIBLE * 20 + 2e-6 * np.abs(weights).sum())
    assert len(recent._directions) <= sums.DIRECTIONS
