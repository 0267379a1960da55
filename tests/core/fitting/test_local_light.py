"""What of a photo's light no lamp explains: it is told from the person's colors, and lies on the skin."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.fitting.chin import below_chin
from grmm_core.fitting.local_light import local_lights, more_fine, more_local, on_face
from grmm_core.fitting.photo_light import FINE_MOST, FINE_STEP, Seen
from grmm_core.head import load_open_head
from grmm_core.light.relight import to_display, to_linear
from grmm_core.light.resting import Texels

SKIN = np.array([0.4, 0.25, 0.18])
SURE, DOUBTFUL = 0.03, 0.3


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def texels(head):
    """Points of the face, four on a triangle, as an avatar has about five."""
    faces = np.flatnonzero(head.marked("face")[head.faces].all(1)).astype(np.int32)
    within = np.concatenate([np.full((1, 3), 1.0 / 3.0), 0.5 * np.eye(3) + 1.0 / 6.0]).astype(np.float32)
    return Texels.of(head, np.repeat(faces, 4), np.tile(within, (len(faces), 1)))


@pytest.fixture(scope="module")
def places(head, texels):
    return texels.at(head.v_template)


@pytest.fixture(scope="module")
def bare(head, texels):
    """How much photos show of the points: no lips and lids."""
    return (~head.marked("lips", "lids")[texels.corners].any(1)).astype(float)


def logs(texels, local, where):
    return np.log(texels.factor(local)[where]).mean(1)


def photos(shades, bare):
    return [Seen(np.asarray(to_display(SKIN * shade[:, None])), bare) for shade in shades]


def test_a_shadow_in_one_doubtful_light_is_light_and_no_color(head, texels, places, bare):
    forehead = places[:, 1] > np.percentile(places[:, 1], 70)
    shadow, even = np.where(forehead, 0.5, 1.0), np.ones(len(places))
    (first, second), told = local_lights(
        head, texels, photos([even, shadow], bare), [np.ones((len(places), 3))] * 2, SKIN * np.ones((len(places), 1)),
        np.array([SURE, DOUBTFUL]),
    )  # fmt: skip
    middle = places[:, 1] > np.percentile(places[:, 1], 80)
    np.testing.assert_allclose(logs(texels, first, middle), 0.0, atol=0.02)
    np.testing.assert_allclose(np.median(logs(texels, second, middle)), np.log(0.5), atol=0.04)
    assert np.percentile(told[:, middle], 5) > 0.9


def test_what_all_photos_show_alike_is_color(head, texels, places, bare):
    red = np.where(places[:, 0] > 0.02, 0.85, 1.0)
    found, _ = local_lights(
        head, texels, photos([red, red, red], bare), [np.ones((len(places), 3))] * 3, SKIN * np.ones((len(places), 1)),
        np.full(3, SURE),
    )  # fmt: skip
    middle = places[:, 0] > 0.035
    for local in found:
        assert np.abs(logs(texels, local, middle)).max() < 0.2 * abs(np.log(0.85))


def test_a_highlight_is_no_color_and_a_light_mark_is_one(head, texels, places, bare):
    """On a cheek that both photos show."""
    spot = (np.linalg.norm(places - places[(places[:, 2] + 0.5 * np.abs(places[:, 0])).argmax()], axis=1) < 0.004) & (bare > 0)
    assert spot.any()
    bright, even = np.where(spot, 2.4, 1.0), np.ones(len(places))
    given = [np.ones((len(places), 3))] * 2, SKIN * np.ones((len(places), 1)), np.full(2, SURE)
    told = [
        local_lights(head, texels, photos(shades, bare), *given)[1][0, spot] for shades in ([bright, even], [bright, bright])
    ]
    assert told[0].mean() < 0.5
    assert told[1].min() > 0.9


def test_a_shadow_in_a_doubtful_light_makes_no_highlight_of_lit_skin(head, texels, places, bare):
    spot = (np.linalg.norm(places - places[(places[:, 2] + 0.5 * np.abs(places[:, 0])).argmax()], axis=1) < 0.004) & (bare > 0)
    dark, even = np.where(spot, 0.4, 1.0), np.ones(len(places))
    told = [
        local_lights(
            head, texels, photos([even, dark], bare), [np.ones((len(places), 3))] * 2, SKIN * np.ones((len(places), 1)),
            np.array([SURE, doubt]),
        )[1][0, spot]
        for doubt in (DOUBTFUL, SURE)
    ]  # fmt: skip
    assert told[0].min() > 0.9
    assert told[1].mean() < 0.5


def test_tint_that_two_photos_show_is_color_and_that_of_their_gloss_is_light(head, texels, places, bare):
    cheek = places[:, 0] > 0.035
    given = [np.ones((len(places), 3))] * 2, SKIN * np.ones((len(places), 1)), np.full(2, DOUBTFUL)
    for tint, light in (([0.04, -0.02, -0.02], np.zeros(3)), ([0.2, 0.3, 0.4], np.array([0.2, 0.3, 0.4]))):
        seen = Seen(np.asarray(to_display(SKIN * np.where(cheek[:, None], np.exp(tint), 1.0))), bare)
        for local in local_lights(head, texels, [seen, seen], *given)[0]:
            found = np.log(texels.factor(local))[cheek & (bare > 0)]
            np.testing.assert_allclose(np.median(found, 0), light, rtol=0.2, atol=0.01)


def alone(head, texels, bare, shade, doubt):
    """`Lighting.local` of one photo of skin times a shade, [N, 3]."""
    seen = Seen(np.asarray(to_display(SKIN * shade)), bare)
    even = np.ones_like(shade)
    (local,), told = local_lights(head, texels, [seen], [even], SKIN * even, np.array([doubt]))
    np.testing.assert_array_equal(told, 1.0)
    return local


def test_of_one_photo_wide_shade_is_light_where_its_light_is_doubtful_and_color_where_it_is_not(head, texels, places, bare):
    shade = np.where(places[:, 1] > np.percentile(places[:, 1], 70), 0.6, 1.0)[:, None] * np.ones(3)
    middle = places[:, 1] > np.percentile(places[:, 1], 90)
    assert np.median(logs(texels, alone(head, texels, bare, shade, DOUBTFUL), middle)) < 0.85 * np.log(0.6)
    assert np.median(logs(texels, alone(head, texels, bare, shade, SURE), middle)) > 0.3 * np.log(0.6)


def test_of_one_photo_a_fold_stays_in_the_colors(head, texels, places, bare):
    fold = np.abs(places[:, 1] - np.percentile(places[:, 1], 75)) < 0.0015
    shade = np.where(fold, 0.5, 1.0)[:, None] * np.ones(3)
    assert np.abs(logs(texels, alone(head, texels, bare, shade, DOUBTFUL), bare > 0)).max() < 0.3 * -np.log(0.5)


def test_of_one_photo_slight_tint_is_color_and_the_tint_of_gloss_is_light(head, texels, places, bare):
    cheek = places[:, 0] > 0.035
    red = np.where(cheek[:, None], np.exp([0.05, -0.025, -0.025]), 1.0)
    local = np.log(texels.factor(alone(head, texels, bare, red, DOUBTFUL))[cheek & (bare > 0)])
    assert np.abs(np.median(local, 0)).max() < 0.01
    pale = np.where(cheek[:, None], np.exp([0.2, 0.3, 0.4]), 1.0)
    amid = (places[:, 0] > 0.05) & (bare > 0)  # at its rim, as far as a feature is wide, half of it is taken for one
    local = np.log(texels.factor(alone(head, texels, bare, pale, DOUBTFUL))[amid])
    np.testing.assert_allclose(np.median(local, 0), [0.2, 0.3, 0.4], atol=0.06)


def test_an_eye_has_one_light_and_what_no_photo_shows_has_none(head, texels, places):
    faces = np.flatnonzero(head.marked("left_eyeball")[head.faces].all(1)).astype(np.int32)
    eye = Texels.of(head, faces, np.full((len(faces), 3), 1.0 / 3.0, np.float32))
    drawn = np.full((len(faces), 3), 0.5)
    colors = np.asarray(to_display(0.5 * to_linear(drawn)))
    seen, even = Seen(colors, (eye.at(head.v_template)[:, 0] > 0.03).astype(float)), np.ones((head.vertex_count, 3), np.float32)
    local = more_local(head, eye, seen, drawn, even)
    np.testing.assert_allclose(local[head.marked("left_eyeball")], 0.5, atol=0.05)
    np.testing.assert_array_equal(local[head.v_template[:, 2] < 0.0], 1.0)


def test_light_on_lips_is_that_of_the_skin_around(head, texels, places, bare):
    """They tell none, having a color of their own; without it a shaded mouth took the shade for dark lips."""
    lips = head.marked("lips")[texels.corners].all(1)
    low = places[:, 1] < places[lips, 1].max() + 0.01
    (local,), _ = local_lights(
        head, texels, photos([np.where(low, 0.6, 1.0)], bare), [np.ones((len(places), 3))], SKIN * np.ones((len(places), 1)),
        np.array([DOUBTFUL]),
    )  # fmt: skip
    chin = low & (bare > 0) & (np.abs(places[:, 0]) < 0.03)
    assert lips.sum() > 100
    assert np.median(logs(texels, local, chin)) < -0.2
    np.testing.assert_allclose(np.median(logs(texels, local, lips)), np.median(logs(texels, local, chin)), rtol=0.2)


def test_burnt_out_and_black_pixels_tell_no_light(head, texels, places, bare):
    half = places[:, 0] > 0.0
    colors = np.where(half[:, None], 1.0, np.asarray(to_display(SKIN)))
    drawn, even = np.asarray(to_display(SKIN * np.ones((len(places), 1)))), np.ones((head.vertex_count, 3), np.float32)
    local = more_local(head, texels, Seen(colors, bare), drawn, even)
    np.testing.assert_allclose(texels.factor(local), 1.0, atol=0.01)


def test_shade_of_a_fold_becomes_fine_light_where_skin_is_seen(texels, places, bare):
    fold = np.abs(places[:, 1] - np.percentile(places[:, 1], 75)) < 0.0015
    even = np.asarray(to_display(SKIN * np.ones((len(places), 1))))
    colors = np.asarray(to_display(SKIN * np.where(fold, 0.5, 1.0)[:, None]))
    colors[::50], shown = 1.0, bare * (places[:, 0] > 0.0)  # burnt out here and there
    fine = more_fine(Seen(colors, shown), even, np.zeros((len(places), 3), np.float32))
    told = (shown > 0) & (np.arange(len(places)) % 50 > 0)
    np.testing.assert_allclose(FINE_STEP * fine[fold & told], np.log(0.5), atol=0.6 * FINE_STEP)
    assert not fine[~fold].any()
    assert not fine[~told].any()
    np.testing.assert_array_equal(fine, np.round(fine))
    again = more_fine(Seen(colors, shown), even, fine)
    np.testing.assert_allclose(again, 2.0 * fine, atol=1.0)
    assert np.abs(more_fine(Seen(colors, shown), even, 60.0 * fine)).max() <= FINE_MOST


def test_black_channels_ask_for_no_light_that_makes_the_third_glow():
    """Deep folds and lids are drawn as a red that no light makes brown: it glowed in the photo's light."""
    drawn, brown = np.array([[0.08, 0.001, 0.001]]), np.array([[0.04, 0.02, 0.016]])
    seen = Seen(np.asarray(to_display(brown)), np.ones(1))
    factor = np.ones((1, 3))
    for _ in range(2):
        shown = np.asarray(to_display(drawn * factor))
        factor = np.exp(FINE_STEP * more_fine(seen, shown, np.log(factor) / FINE_STEP))
    assert factor[0, 0] < 0.7, "the red is twice as bright as in the photo"
    assert (factor[0, 1:] < 3.0).all()


def test_light_on_the_throat_has_no_lines_and_the_face_keeps_its_edges(head):
    """Every column of faces was told otherwise than the next."""
    points, nothing = Texels.of_vertices(head), Seen(np.full((head.vertex_count, 3), 0.5), np.zeros(head.vertex_count))
    stripes = np.where(np.arange(head.vertex_count) % 2, 1.2, 0.8)[:, None] * np.ones(3, np.float32)
    local = more_local(head, points, nothing, np.full((head.vertex_count, 3), 0.5), stripes)
    inside = head.marked("neck")
    for _ in range(3):  # away from the rim of the throat
        outside = head.faces[~inside[head.faces].all(1)]
        inside[outside] = False
    edges = np.concatenate([head.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    edges = edges[inside[edges].all(1)]
    assert len(edges) > 100
    before, after = (np.abs(np.diff(np.log(light.mean(1))[edges], axis=1)).mean() for light in (stripes, local))
    assert after < 0.15 * before
    face = head.marked("face") & ~head.marked("neck")
    np.testing.assert_allclose(local[face], stripes[face], rtol=1e-5)
    tells = on_face(head, points)
    assert tells[inside].max() < 0.01
    assert tells[face].min() > 0.99


def test_features_of_a_face_are_color_in_any_light_and_what_is_wide_is_light(head, texels, places, bare):
    """As sockets, which are a centimetre or two wide; one photo or several."""
    middle = places[(places[:, 2] + 0.5 * np.abs(places[:, 0])).argmax()]
    distance = np.linalg.norm(places - middle, axis=1)
    feature = distance < 0.006
    assert feature.sum() > 10
    shade = np.exp(-0.5 * np.exp(-0.5 * (distance / 0.006) ** 2))
    light = alone(head, texels, bare, shade[:, None] * np.ones(3), DOUBTFUL)
    assert np.abs(logs(texels, light, feature)).max() < 0.4 * 0.5
    given = [np.ones((len(places), 3))] * 2, SKIN * np.ones((len(places), 1)), np.full(2, DOUBTFUL)
    for local in local_lights(head, texels, photos([shade, shade], bare), *given)[0]:
        assert np.abs(logs(texels, local, feature)).max() < 0.4 * 0.5


def test_a_narrow_shade_at_the_edge_of_a_hard_light_is_light(head, texels, places, bare):
    """As that of the nose, which lamps alone do not throw."""
    middle = places[(places[:, 2] + 0.5 * np.abs(places[:, 0])).argmax()]
    distance = np.linalg.norm(places - middle, axis=1)
    shade = np.exp(-0.5 * np.exp(-0.5 * (distance / 0.006) ** 2))[:, None] * np.ones(3)
    feature, left = distance < 0.006, []
    for dark in (1.0, 0.1):
        ratio = np.where(places[:, :1] < middle[0], dark, 1.0) * np.ones(3)
        seen = Seen(np.asarray(to_display(SKIN * shade * ratio)), bare)
        (local,), _ = local_lights(head, texels, [seen], [ratio], SKIN * np.ones((len(places), 1)), np.array([DOUBTFUL]))
        left.append(float(np.median(logs(texels, local, feature))))
    assert left[1] < 1.5 * left[0] < 0.0


def test_light_at_the_end_of_a_neck_that_is_seen_goes_over_into_that_of_the_bust(head):
    faces = np.flatnonzero(head.marked("face", "neck")[head.faces].all(1)).astype(np.int32)
    whole = Texels.of(head, faces, np.full((len(faces), 3), 1.0 / 3.0, np.float32))
    heights, below = whole.at(head.v_template)[:, 1], whole.at(below_chin(head)[:, None])[:, 0]
    collar = np.percentile(heights[below > 0.9], 70)
    shown = np.where((below > 0.5) & (heights < collar + 0.02), 1.5, 1.0)  # the last of the neck that shows is bright
    seen = Seen(np.asarray(to_display(SKIN * shown[:, None])), (heights > collar).astype(float))
    drawn = np.asarray(to_display(SKIN * np.ones((len(faces), 3))))
    light = logs(whole, more_local(head, whole, seen, drawn, np.ones((head.vertex_count, 3))), slice(None))
    rim, bust = (below > 0.9) & (heights > collar) & (heights < collar + 0.01), heights < np.percentile(heights, 10)
    assert float(np.median(light[rim])) > 0.6 * np.log(1.5)
    assert float(np.median(np.abs(light[bust]))) < 0.2 * np.log(1.5)
    assert float(np.median(np.abs(light[heights < np.percentile(heights, 3)]))) < 0.02
    assert float(np.abs(light[(heights > collar) & (below == 0.0)]).mean()) < 0.03
