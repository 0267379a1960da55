"""Hair behind a head is as flat as the photo made it before."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from grmm_core.fitting.hidden_hair import as_flat
from grmm_core.geometry.camera import Camera
from grmm_core.hair import library_groom
from grmm_core.hair.roots import SCALP


def scalp(name, head):
    groom = library_groom(name, head.name)
    groom = groom.select(groom.groups == SCALP)
    return groom.resampled(int(groom.counts.max()))


def photo(head, yaw=0.0):
    return SimpleNamespace(camera=Camera.orbit(160, 160, yaw, 0.0), vertices=np.asarray(head.v_template, np.float64))


def heights(groom):
    return groom.points.reshape(len(groom), -1, 3)[..., 2].max(1)


def turned(groom, head):
    """How far the skin below each strand is turned to the front, -1..1."""
    out = groom.frames(np.asarray(head.v_template, np.float64), head.faces).at(np.asarray(head.v_template))[1][:, 2]
    return out[:, 2]


def flattened(groom, rows, share):
    points = groom.points.reshape(len(groom), -1, 3).copy()
    points[rows, :, 2] *= share
    return replace(groom, points=points.reshape(-1, 3))


def test_short_hair_behind_is_as_flat_as_it_became_before(head):
    before = scalp("buzz", head)
    front = turned(before, head)
    groom = flattened(before, front > -0.2, 0.5)
    found = as_flat(groom, before, 1.0, [photo(head)], head)
    np.testing.assert_allclose(heights(found)[front < -0.6], 0.5 * heights(before)[front < -0.6], rtol=0.02)
    np.testing.assert_allclose(heights(found)[front > 0.1], heights(groom)[front > 0.1], rtol=1e-5)
    assert np.median(heights(as_flat(groom, before, 1.0, [photo(head), photo(head, 180.0)], head)) / heights(groom)) == 1.0


@pytest.mark.parametrize(("name", "share"), [("buzz", 1.5), ("bob", 0.5)], ids=["raised", "long"])
def test_hair_that_stands_off_and_long_hair_are_left(name, share, head):
    before = scalp(name, head)
    groom = flattened(before, turned(before, head) > -0.2, share)
    assert np.array_equal(as_flat(groom, before, 1.0, [photo(head)], head).points, groom.points)
