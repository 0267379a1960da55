"""Brows moved to a person's height."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.geometry.triangles import closest_on_surface, vertex_normals
from grmm_core.hair.brows import FULLEST_BROWS, at_height_of, lowered
from grmm_core.hair.packaged import library_groom
from grmm_core.head import load_open_head

DOWN = -0.003  # metres


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def roots_and_heights(groom, head):
    """Roots on the mean head, and how high points lie above its skin, metres."""
    vertices, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    frames = groom.frames(vertices, faces)
    points = groom.posed(frames, vertices)
    triangles, weights, _ = closest_on_surface(points, vertices, faces)
    corners, weights = faces[triangles], weights[..., None]
    off = points - (vertices[corners] * weights).sum(1)
    return frames.at(vertices)[0], (off * (vertex_normals(vertices, faces)[corners] * weights).sum(1)).sum(1)


def test_strands_stay_as_high_above_the_skin_as_they_were(head):
    groom = library_groom("natural", head.name, "brows")
    moved = lowered(groom, head, np.full(len(groom), DOWN))
    (before, heights), (after, heights_after) = (roots_and_heights(one, head) for one in (groom, moved))
    np.testing.assert_allclose(before[:, 1] - after[:, 1], DOWN, atol=0.0015)  # the skin under the ridge leans
    np.testing.assert_allclose(before[:, 0], after[:, 0], atol=0.001)
    np.testing.assert_allclose(heights_after, heights, atol=1e-4)
    np.testing.assert_array_equal(moved.offsets, groom.offsets)
    still = lowered(groom, head, np.zeros(len(groom)))
    np.testing.assert_allclose(roots_and_heights(still, head)[0], before, atol=1e-5)


def test_other_brows_stand_where_the_persons_do_each_side_for_itself(head):
    usual, thin = library_groom(FULLEST_BROWS, head.name, "brows"), library_groom("thin", head.name, "brows")
    roots = roots_and_heights(usual, head)[0]
    own = lowered(usual, head, np.where(roots[:, 0] > 0.0, DOWN, 0.0))
    own = own.select((roots[:, 0] < 0.03) & (np.arange(len(own)) % 3 > 0))  # a photo shows less of one side, and less in all
    moved = at_height_of(thin, usual, own, head)
    before, after = (roots_and_heights(one, head)[0] for one in (thin, moved))
    left = before[:, 0] > 0.0
    down = before[:, 1] - after[:, 1]
    assert down[left].mean() == pytest.approx(DOWN, abs=0.001)
    assert down[~left].mean() == pytest.approx(0.0, abs=0.0005)
