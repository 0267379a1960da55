"""What strands stay outside of: heights above the skin, the hull of the ears, hair pushed out of other people's heads."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from grmm_core.hair import join, library_groom
from grmm_core.hair.body import BURIED, Body, Rim, outside, worn
from grmm_core.hair.roots import BROWS, SCALP
from grmm_core.hair.strands import blocks_of
from grmm_core.head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def body(head) -> Body:
    return Body.of(head, np.asarray(head.v_template, float))


def test_heights_are_distances_near_the_scalp(head, body):
    template = np.asarray(head.v_template, float)
    top = np.asarray(head.regions["scalp"])
    top = top[
        np.linalg.norm(template[top, None] - template[head.regions["ears"]], axis=2).min(1) > 0.03
    ]  # not in the ears' hull
    middle = template[head.regions["scalp"]].mean(0)
    out = (template[top] - middle) / np.linalg.norm(template[top] - middle, axis=1, keepdims=True)
    for distance in (-0.01, 0.0, 0.004, 0.015):
        heights, up = body.heights(template[top] + distance * out)
        assert np.median(np.abs(heights - distance)) < 0.0015
        assert np.median((up * out).sum(1)) > 0.8
    far, _ = body.heights(np.array([[0.0, 0.0, 2.0], [-9.0, 0.0, 0.0]]))
    assert (far > 0.02).all()


def test_hair_lies_over_ears(head, body):
    """What was between the folds of an ear, or went through it, is outside of all of it."""
    ears = np.asarray(head.v_template, float)[head.regions["ears"]]
    left = ears[ears[:, 0] > 0]
    middle = left.mean(0)
    x = left[:, 0].max() - 0.008
    ends = np.array([[x, left[:, 1].max() + 0.02, middle[2]], [x, left[:, 1].min() - 0.02, middle[2]]])
    strand = ends[0] + np.linspace(0, 1, 24)[:, None] * (ends[1] - ends[0])
    pushed = body.pushed(strand[None])[0]
    beside = np.abs(pushed[:, 1] - middle[1]) < 0.012
    assert pushed[beside, 0].min() > left[:, 0].max() - 0.004
    np.testing.assert_array_equal(pushed[0], strand[0].astype(np.float32))


def test_hair_leans_out_before_an_ear_and_does_not_break_there(head, body):
    ears = np.asarray(head.v_template, float)[head.regions["ears"]]
    left = ears[ears[:, 0] > 0]
    top, middle = left[:, 1].max(), left.mean(0)
    heights = np.linspace(top + 0.055, top - 0.015, 36)
    strand = np.stack([np.full(36, 0.074), heights, np.full(36, middle[2])], 1)
    pushed = body.pushed(strand[None])[0][8:]  # behind the first fifth, which begins in the skin
    out = np.diff(pushed[:, 0]) / -np.diff(pushed[:, 1])
    assert pushed[-1, 0] - pushed[0, 0] > 0.008  # the ear stands out
    assert out.max() < 0.8
    assert np.diff(pushed[:, 1]).max() < 0.0


def test_hair_that_lies_over_an_ear_has_the_light_of_where_it_lies(head, body):
    template = np.asarray(head.v_template, float)
    groom = library_groom("long").level(0.3)
    recorded, lying = (
        blocks_of(groom, template, head.faces, lies)[0] for lies in (None, functools.partial(outside, head, template))
    )
    origin, axes = recorded.frames.at(template)
    points = np.matmul(recorded.points, axes) + origin[:, None]
    inside = body.heights(points.reshape(-1, 3))[0].reshape(points.shape[:2]) < -0.004
    inside[:, : points.shape[1] // 5] = False
    assert inside.sum() > 50
    assert lying.light[inside, 0].mean() > 1.3 * recorded.light[inside, 0].mean()


def test_hair_of_the_mean_head_is_pushed_out_of_a_larger_one(head):
    template = np.asarray(head.v_template, float)
    larger = template * 1.0
    larger[head.regions["scalp"]] *= 1.06
    groom = library_groom("slick_back").level(0.1).resampled(16)
    points = groom.posed(groom.frames(template, head.faces), template).reshape(-1, 16, 3)
    body = Body.of(head, larger)
    before, after = (body.heights(part[:, 5:].reshape(-1, 3))[0] for part in (points, body.pushed(points)))
    assert (before < 0).mean() > 0.1
    assert (after < -0.0005).mean() < 0.005


def test_pushing_is_what_heights_say(body):
    """The compiled loop against heights: up along their slope, three times, less near the root."""
    g = np.random.default_rng(1)
    strands = np.cumsum(g.normal(0, 0.01, (300, 12, 3)), 1) + np.array([0.0, 0.05, 0.0])
    t = np.minimum(np.arange(12) / 2.2, 1.0)
    wanted = np.tile(0.001 * (2.0 * t * t * (3.0 - 2.0 * t) - 1.0), (300, 1))[:, 1:].ravel()
    expected = strands[:, 1:].reshape(-1, 3)
    for _ in range(3):
        heights, up = body.heights(expected)
        expected = expected + np.where(heights > -BURIED, np.maximum(wanted - heights, 0.0), 0.0)[:, None] * up
    np.testing.assert_allclose(body.pushed(strands)[:, 1:].reshape(-1, 3), expected, atol=2e-5)


def test_heights_near_given_points_are_those_of_the_whole(head, body):
    template = np.asarray(head.v_template, float)
    points = template[head.regions["scalp"]] * 1.05
    some = Body.of(head, template, near=points)
    assert (some.field[..., 0] != body.field[..., 0]).any()
    np.testing.assert_allclose(some.heights(points)[0], body.heights(points)[0], atol=1e-6)
    np.testing.assert_allclose(some.heights(points)[1], body.heights(points)[1], atol=1e-5)


def test_hair_ends_at_the_rim_of_the_bust(head):
    rim = Rim.of(head, np.asarray(head.v_template, float))
    t = np.linspace(0, 1, 20)[:, None]
    down = np.array([[[0.0, 0.1, -0.13]], [[0.11, 0.1, 0.0]], [[0.0, 0.1, 0.07]]]) + t * [0.0, -0.4, 0.0]
    short = down[:, :6]
    ended = rim.ended(np.concatenate([down, down]), np.array([-1.0, -1.0, -1.0, 1.0, 1.0, 1.0]))
    assert (ended[:, -1, 1] > -0.18).all()
    assert (ended[:, -1, 1] < -0.1).all()
    assert (ended[3:, -1, 1] > ended[:3, -1, 1] + 0.01).all()
    np.testing.assert_allclose(ended[:, 0], np.concatenate([down, down])[:, 0])
    np.testing.assert_array_equal(rim.ended(short, np.zeros(3)), short)


def test_a_groom_worn_by_somebody_is_outside_of_their_skin_and_ends_at_the_rim(head):
    template = np.asarray(head.v_template, float)
    larger = template.copy()
    larger[head.regions["scalp"]] *= 1.06
    groom, brows = library_groom("long").level(0.05), library_groom("natural", part="brows")
    groom = replace(groom, points=1.25 * groom.points)  # so long that it gets into the back and below the rim
    made = worn(head, larger, join([groom, brows]))
    np.testing.assert_array_equal(made.select(made.groups == BROWS).points, brows.points)
    count = int(groom.counts[0])
    before, after = (
        some.posed(some.frames(template, head.faces), larger).reshape(-1, count, 3)
        for some in (groom, made.select(made.groups == SCALP))
    )
    body, low = Body.of(head, larger), Rim.of(head, larger).heights.min()
    inside = [(body.heights(part[:, 5:].reshape(-1, 3))[0] < -0.0005).mean() for part in (before, after)]
    assert inside[1] < 0.005 < 0.02 < inside[0]
    assert after[..., 1].min() > low - 0.005 > before[..., 1].min()


def test_a_strand_that_goes_through_the_head_ends_where_it_enters(body):
    """Pushed out of it, what was inside would lie across the face in long straight lines."""
    beside = np.array([[0.064, y, 0.048] for y in np.linspace(0.07, 0.02, 10)])
    inwards = np.array([[x, 0.018, 0.046] for x in np.linspace(0.056, 0.014, 6)])
    strands = np.stack(
        [
            np.concatenate([beside, inwards]),
            np.concatenate([beside, beside[-1] - [[0.0, 0.005, 0.0]] * np.arange(1, 7)[:, None]]),
        ]
    )
    pushed = body.pushed(strands)
    ended = body.untorn(strands, pushed)
    longest = [np.linalg.norm(np.diff(part[0], axis=0), axis=1).max() for part in (strands, pushed, ended)]
    assert longest[1] > 2 * longest[0]
    assert longest[2] < 1.5 * longest[0]
    np.testing.assert_array_equal(ended[0, 0], pushed[0, 0])
    np.testing.assert_array_equal(ended[1], pushed[1])


def test_a_strand_that_turns_into_the_head_does_not_come_out_elsewhere(body):
    """Its segments keep their lengths when they are pushed out, and would lie across the cheek."""
    beside = np.array([[0.062, y, 0.048] for y in np.linspace(0.072, 0.022, 6)])
    inwards = 1e-3 * np.array([[49.0, 20, 46], [39, 18, 45], [29, 16, 44], [24, 8, 42], [22, -1, 40]])
    strands = np.concatenate([beside, inwards])[None]
    pushed = body.pushed(strands)
    ended = body.untorn(strands, pushed)
    assert pushed[0, :, 2].max() > 0.056
    assert ended[0, :, 2].max() < 0.054
    np.testing.assert_array_equal(ended[0, 0], pushed[0, 0])


def test_tied_hair_passes_above_ears_on_the_skin_and_loose_hair_leans_out_before_them(head):
    template = np.asarray(head.v_template, float)
    ears = template[head.regions["ears"]]
    skin = Body.of(head, template, ears=False)

    def above_ears(name: str) -> np.ndarray:
        """Heights above the skin of what lies within 2 cm above the ears, behind the first fifth of the strands."""
        groom = library_groom(name).level(0.2)
        made = worn(head, template, groom.select(groom.groups == SCALP))
        points = made.posed(made.frames(template, head.faces), template).reshape(len(made), -1, 3)[:, 4:].reshape(-1, 3)
        low, high = ears.min(0), ears.max(0)
        near = (points[:, 1] > high[1]) & (points[:, 1] < high[1] + 0.02) & (points[:, 2] > low[2]) & (points[:, 2] < high[2])
        return skin.heights(points[near & (np.abs(points[:, 0]) > 0.05)])[0]

    assert np.percentile(above_ears("ponytail"), 90) < 0.006
    assert np.percentile(above_ears("bob"), 50) > 0.008


@pytest.mark.parametrize("name", ["bob", "curtains", "layered", "long", "fringe"])
def test_the_packages_straight_hair_does_not_stand_over_its_parting(head, name):
    """Single wisps that rise higher than the others are a row of arcs, seen from the side."""
    template = np.asarray(head.v_template, float)
    groom = library_groom(name).level(0.3)
    groom = groom.select(groom.groups == SCALP).resampled(40)
    points = groom.posed(groom.frames(template, head.faces), template).reshape(len(groom), 40, 3)
    points = points[points[:, 0, 1] > 0.12]  # of the crown
    along = np.cumsum(np.linalg.norm(np.diff(points, axis=1, prepend=points[:, :1]), axis=2), 1)
    heights = Body.of(head, template, near=points.reshape(-1, 3)).heights(points.reshape(-1, 3))[0].reshape(along.shape)
    highest = np.where(along < 0.06, heights, 0.0).max(1)
    assert np.percentile(highest, 95) < 0.0095
