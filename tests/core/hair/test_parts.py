"""Brows, lashes and beards of the package: where they stand, how lashes go with lids, how files keep parts apart."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import FileAccessError
from grmm_core.hair import HairSettings, groom_names, join, library_groom
from grmm_core.hair.compact import MAX_BYTES, compact_parts, restored_parts
from grmm_core.hair.lashes import Lashes
from grmm_core.hair.roots import BEARD, BROWS, GROUPS, LASHES, SCALP
from grmm_core.hair.settings import DARKER, FACE_SHEEN, LASH_MELANIN, LASH_THICKNESS
from grmm_core.head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def posed(head, groom):
    template = np.asarray(head.v_template, float)
    return groom.posed(groom.frames(template, head.faces), template)


@pytest.mark.parametrize(
    ("group", "low", "high", "longest"),
    [(BROWS, 0.04, 0.065, 0.014), (LASHES, 0.015, 0.05, 0.016), (BEARD, -0.1, 0.04, 0.06)],
)
def test_parts_of_the_face_are_where_they_belong(head, group, low, high, longest):
    for name in groom_names(GROUPS[group]):
        groom = library_groom(name, part=GROUPS[group])
        points = posed(head, groom)
        roots, tips = points[groom.offsets[:-1]], points[groom.offsets[1:] - 1]
        assert (groom.groups == group).all()
        assert low < roots[:, 1].min() < roots[:, 1].max() < high
        assert np.linalg.norm(tips - roots, axis=1).max() < longest
        assert 0.4 < float((roots[:, 0] > 0).mean()) < 0.6  # as many on either side


def test_a_part_has_its_own_names(head):
    assert {"thin", "natural", "bushy"} <= set(groom_names("brows"))
    assert {"stubble", "short", "full", "moustache"} <= set(groom_names("beard"))
    assert "stubble" in groom_names()  # shorn hair of the scalp
    assert (library_groom("stubble").groups == SCALP).all()
    with pytest.raises(FileAccessError, match="groom of brows 'bob'; there are bushy"):
        library_groom("bob", part="brows")


def test_lashes_go_with_the_lids_and_end_on_the_seam(head):
    groom = library_groom("natural", part="lashes")
    template = np.asarray(head.v_template, float)
    lashes = Lashes.build(head, template, groom)
    open_ = lashes.points(template)
    np.testing.assert_allclose(open_.reshape(-1, 3), posed(head, groom), atol=1e-5)
    blink = sum(head.arkit_to_expression[ARKIT_NAMES.index(name)] for name in ("eyeBlinkLeft", "eyeBlinkRight"))
    shut = np.asarray(head.vertices(np.zeros(300), blink, np.zeros((5, 3))), float)
    moved = lashes.points(shut)
    upper = lashes.upper
    down = open_[upper, 0, 1] - moved[upper, 0, 1]
    assert np.median(down) > 0.003  # those in the corners of the eye hardly move
    assert np.abs(open_[~upper, 0, 1] - moved[~upper, 0, 1]).max() < 0.004
    for side, seam in lashes.seams.items():  # no lash of a shut lid has its root below the lower lid's edge
        roots = moved[upper & (lashes.sides == side), 0]
        line = shut[seam][np.argsort(shut[seam][:, 0])]
        assert (roots[:, 1] - np.interp(roots[:, 0], line[:, 0], line[:, 1])).min() > -0.001


def test_lashes_stand_as_a_fan_and_sink_with_their_lids(head):
    lashes = Lashes.build(head, np.asarray(head.v_template, float), library_groom("natural", part="lashes"))
    blink = sum(head.arkit_to_expression[ARKIT_NAMES.index(name)] for name in ("eyeBlinkLeft", "eyeBlinkRight"))
    rises = []
    for amount in (0.0, 0.5, 1.0):
        points = lashes.points(np.asarray(head.vertices(np.zeros(300), amount * blink, np.zeros((5, 3))), float))
        way = points[:, -1] - points[:, 0]
        rises.append(np.degrees(np.arctan2(way[:, 1], np.hypot(way[:, 0], way[:, 2]))))
        assert np.percentile(way[:, 2], 2) > 0.0  # all of them forwards
    upper, outer = lashes.upper, np.abs(points[:, 0, 0]) > 0.03
    assert np.median(rises[0][upper]) > 25 > np.median(rises[1][upper]) > 5 > -8 > np.median(rises[2][upper])
    assert np.percentile(rises[2][upper & outer], 90) < 5  # none stands up at the outer corner of a shut eye
    assert np.median(rises[0][~upper]) < -25


def test_drawn_lashes_stand_before_their_lids_and_towards_the_eye(head):
    template = np.asarray(head.v_template, float)
    lashes = Lashes.build(head, template, library_groom("natural", part="lashes"))
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # a quarter about the vertical: forward is now -x
    for pose in (np.eye(3), turn):
        shift = (lashes.drawn_points(template @ pose) - lashes.points(template @ pose)) @ pose.T
        np.testing.assert_allclose(shift, shift[:, :1].repeat(shift.shape[1], 1), atol=1e-9)  # no strand is bent
        up, forward = shift[:, 0, 1], shift[:, 0, 2]
        assert np.median(forward) > 0.0002
        assert np.median(up[lashes.upper]) < -0.0002 < 0.0 < np.median(up[~lashes.upper])
        assert np.linalg.norm(shift[:, 0], axis=1).max() < 0.001


def test_lashes_elsewhere_are_left_to_their_triangles(head):
    assert Lashes.build(head, np.asarray(head.v_template, float), library_groom("thin", part="brows")) is None


def test_a_file_keeps_parts_with_their_own_points():
    whole = join([library_groom("bob"), library_groom("natural", part="brows"), library_groom("natural", part="lashes")])
    arrays = compact_parts(whole)
    assert sum(array.nbytes for array in arrays.values()) <= MAX_BYTES
    again = restored_parts(arrays)
    for group in (SCALP, BROWS, LASHES):
        before, after = (groom.select(groom.groups == group) for groom in (whole, again))
        assert len(before) == len(after)
        np.testing.assert_array_equal(before.counts, after.counts)
        np.testing.assert_allclose(before.points, after.points, atol=2e-3)
    assert restored_parts({}) is None


def test_parts_take_the_pigments_of_the_hair():
    blond = HairSettings(melanin=0.1, grey=0.5, length=0.4)
    assert blond.for_part(SCALP) is blond
    assert blond.for_part(BROWS) == HairSettings(melanin=0.1 + DARKER, grey=0.5, sheen=FACE_SHEEN)
    assert blond.for_part(LASHES) == HairSettings(melanin=LASH_MELANIN, sheen=FACE_SHEEN, thickness=LASH_THICKNESS)
    assert HairSettings(melanin=1.0).for_part(LASHES).melanin == 1.0
