"""The cache of a session: what is asked often stays, and a head that plays does not fill it."""

from __future__ import annotations

import functools
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from grmm_core.session.cache import FEW, MANY, SHARE, ArrayCache

LIMIT = 64_000


def _value(size: int) -> tuple[np.ndarray, ...]:
    return (np.zeros(size, np.uint8),)


def test_what_is_known_is_not_made_again():
    cache, made = ArrayCache(LIMIT), []
    for _ in range(3):
        cache.get((1, "mesh", "rest"), lambda: made.append(1) or _value(10))
    assert (len(made), cache.size) == (1, 10)


@pytest.mark.parametrize("size", [10, 900, 10_000], ids=["small", "middling", "large"])
def test_frames_that_are_played_leave_only_the_latest(size):
    cache = ArrayCache(LIMIT)
    cache.get((1, "skin"), lambda: _value(2000))
    for frame in range(500):
        cache.get((1, "skin"), lambda: pytest.fail("the skin was forgotten"))
        cache.get((1, "geometry", frame), lambda: _value(size))
    kept = (cache.size - 2000) // size
    assert FEW <= kept <= MANY
    assert kept == FEW or kept * size <= SHARE * LIMIT
    for frame in range(500 - kept, 500):
        cache.get((1, "geometry", frame), lambda: pytest.fail("a late frame was forgotten"))


def test_other_avatars_and_other_kinds_are_counted_apart():
    cache = ArrayCache(LIMIT)
    for frame in range(MANY):
        for avatar in (1, 2):
            for kind in ("mesh", "strands"):
                cache.get((avatar, kind, frame), lambda: _value(10))
    assert cache.size == 4 * MANY * 10
    cache.drop(1)
    assert cache.size == 2 * MANY * 10


def test_all_kinds_together_stay_within_the_limit():
    cache = ArrayCache(LIMIT)
    for kind in range(100):
        cache.get((1, f"kind {kind}"), lambda: _value(3000))
        assert cache.size <= LIMIT


def test_threads_that_ask_at_a_time_leave_the_count_right():
    cache = ArrayCache(LIMIT)

    def play(avatar):
        for frame in range(400):
            size = 100 + frame % 90
            assert cache.get((avatar % 2, "mesh", size), functools.partial(_value, size))[0].nbytes == size

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(play, range(4)))
    held = sum(value[0].nbytes for value in cache._entries.values())
    assert cache.size == held == sum(kind.held for kind in cache._kinds.values()) > 0
