"""Curves of a host become grooms, or one sentence; grooms survive being packed small; settings are continuous."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from grmm_core.errors import ControlError, ShapeError
from grmm_core.hair import SETTINGS, Groom, HairSettings, groom_from_curves, groom_names, library_groom
from grmm_core.hair.attach import groups_at
from grmm_core.hair.compact import MAX_BYTES, compact, restored
from grmm_core.hair.groom import MAX_POINTS, TINTS
from grmm_core.hair.pigment import albedos
from grmm_core.hair.roots import GROUPS
from grmm_core.hair.strands import blocks_of
from grmm_core.head.open_head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def curves(head):
    """Points, offsets and surface coordinates of a thinned groom of the package, as a host has them."""
    groom = library_groom("crop").level(0.05)
    points = groom.posed(groom.frames(head.v_template, head.faces), np.asarray(head.v_template, float))
    corners = np.asarray(head.uv, float)[np.asarray(head.uv_faces)[groom.triangles]]
    return groom, points, groom.offsets, (corners * groom.weights[..., None]).sum(1)


def test_curves_are_bound_where_they_stand(head, curves):
    groom, points, offsets, uv = curves
    made = groom_from_curves(head, head.v_template, points, offsets, uv, np.full(len(points), 1e-4))
    assert (made.triangles == groom.triangles).mean() > 0.98  # a root on an edge may go to either side
    placed = made.posed(made.frames(head.v_template, head.faces), np.asarray(head.v_template, float))
    np.testing.assert_allclose(placed, points, atol=1e-5)
    np.testing.assert_allclose(made.widths, 2e-4)


def test_curves_without_a_radius_are_as_wide_as_the_others(head, curves):
    _, points, offsets, uv = curves
    tapered = np.full(len(points), 1e-4)
    tapered[offsets[1:] - 1] = 0.0
    tapered[: offsets[3]] = 0.0  # of three hairs
    made = groom_from_curves(head, head.v_template, points, offsets, uv, tapered)
    np.testing.assert_allclose(made.widths, np.tile([2e-4, 1e-6], (len(made), 1)))  # points of hairs keep a least width
    plain = groom_from_curves(head, head.v_template, points, offsets, uv)
    np.testing.assert_array_equal(
        groom_from_curves(head, head.v_template, points, offsets, uv, 0 * tapered).widths, plain.widths
    )


def test_own_colors_of_strands_go_through_the_points_of_curves(head, curves):
    groom, points, offsets, uv = curves
    ends = np.random.default_rng(0).uniform(-0.3, 0.3, (2, len(groom), 1, 3))
    places = np.linspace(0.0, 1.0, TINTS)[:, None]
    tinted = replace(groom, tints=(ends[0] * (1 - places) + ends[1] * places).astype(np.float32))
    made = groom_from_curves(head, head.v_template, points, offsets, uv, tints=tinted.point_tints)
    np.testing.assert_allclose(made.tints, tinted.tints, atol=1e-5)
    assert groom_from_curves(head, head.v_template, points, offsets, uv, tints=0.0 * tinted.point_tints).tints is None


@pytest.mark.parametrize("part", GROUPS)
def test_roots_tell_brows_beard_and_lashes_from_scalp_hair_unless_a_curve_says_what_it_is(head, part):
    for name in groom_names(part):
        groom = library_groom(name, part=part).level(0.1)
        assert (groups_at(head, groom.triangles, groom.weights) == GROUPS.index(part)).all(), name
    points = groom.posed(groom.frames(head.v_template, head.faces), np.asarray(head.v_template, float))
    uv = (np.asarray(head.uv, float)[np.asarray(head.uv_faces)[groom.triangles]] * groom.weights[..., None]).sum(1)
    said = np.full(len(groom), -1)
    said[0] = 3 - GROUPS.index(part)
    made = groom_from_curves(head, head.v_template, points, groom.offsets, uv, groups=said)
    assert made.groups[0] == said[0]
    assert (made.groups[1:] == GROUPS.index(part)).mean() > 0.99


def test_wrong_curves_get_one_sentence(head, curves):
    _, points, offsets, uv = curves
    bad = points.copy()
    bad[7] = np.nan
    many = np.broadcast_to(np.zeros(3), (MAX_POINTS + 1, 3))
    cases = [
        (points, offsets, None, "attach them"), (bad, offsets, uv, "not finite"), (many, offsets, uv, "at most"),
        (points[: len(uv)], np.arange(len(uv) + 1), uv, "two points"), (points + 0.2, offsets, uv, "this head"),
        (points, offsets, uv + 5.0, "this head"), (points, offsets, uv[:-1], "one pair"),
    ]  # fmt: skip
    for places, rows, where, words in cases:
        with pytest.raises(ShapeError, match=words) as error:
            groom_from_curves(head, head.v_template, places, rows, where)
        assert str(error.value).count(". ") == 0


@pytest.mark.parametrize("name", ["bob", "ringlets", "buzz"])
def test_a_groom_survives_being_packed(name):
    groom = library_groom(name)
    again = restored(compact(groom))
    assert sum(array.nbytes for array in compact(groom).values()) <= MAX_BYTES
    assert np.percentile(np.linalg.norm(again.points - groom.points, axis=1), 99) < 5e-4
    broken = compact(groom) | {"off": np.zeros((3, 4), np.int8)}
    with pytest.raises(ShapeError, match="fit together"):
        restored(broken)


def test_a_large_groom_is_thinned_to_fit():
    groom = library_groom("long")
    twice = Groom(*(np.concatenate([part, part]) for part in (groom.triangles, groom.weights)),
                  np.concatenate([groom.offsets, groom.offsets[1:] + len(groom.points)]),
                  *(np.concatenate([part, part]) for part in (groom.points, groom.widths, groom.groups)))  # fmt: skip
    arrays = compact(twice, 300_000)
    assert sum(array.nbytes for array in arrays.values()) <= 300_000
    assert restored(arrays).widths.mean() > 1.5 * groom.widths.mean()


def test_there_are_grooms_for_everybody():
    assert len(groom_names()) >= 16
    for name in groom_names():
        assert len(library_groom(name)) > 2000


def test_settings_change_strands_continuously(head):
    block = blocks_of(library_groom("bob"), head.v_template, head.faces)[0]
    for name in ("length", "curl", "frizz"):
        row = next(row for row in SETTINGS if row.name == name)
        shapes = [block.styled(HairSettings(**{name: value})) for value in np.linspace(row.low, row.high, 41)]
        steps = [float(np.abs(b - a).max()) for a, b in itertools.pairwise(shapes)]
        assert max(steps) < 0.02
        assert float(np.abs(shapes[-1] - shapes[0]).max()) > 0.003
    np.testing.assert_array_equal(block.styled(HairSettings()), block.points)
    for share in (0.1, 0.4, 0.99):
        one, other = (block.level(s, HairSettings()) for s in (share, share * 1.002))
        covers = [float((radii * there[:, None]).sum()) for radii, there in (one, other)]
        assert covers[0] == pytest.approx(covers[1], rel=0.02)


def test_strands_of_many_hairs_are_alike(head):
    half, count = HairSettings(grey=0.5, variation=1.0), 2000
    chance = np.random.default_rng(3).random((count, 2))
    shown = {hairs: albedos(half, np.zeros(count), chance, hairs, 1.0 / hairs)[:, 0, 1] for hairs in (1.0, 4.0, 16.0)}
    spread = {hairs: float(values.std() / values.mean()) for hairs, values in shown.items()}
    assert spread[1.0] > 1.7 * spread[4.0] > 2.9 * spread[16.0]
    assert shown[1.0].mean() == pytest.approx(shown[16.0].mean(), rel=0.03)
    block = blocks_of(library_groom("crop"), head.v_template, head.faces)[0]
    few, many = (block.level(share, HairSettings()) for share in (0.1, 0.9))
    assert few[1].max() < 0.5 < 0.8 < many[1].max() <= 1.0


def test_settings_have_limits():
    assert HairSettings(length=9.0).length == max(row.high for row in SETTINGS if row.name == "length")
    with pytest.raises(ControlError, match="finite"):
        HairSettings(grey=float("nan"))
    with pytest.raises(ControlError, match="no setting 'shine'"):
        HairSettings().changed(shine=1.0)
