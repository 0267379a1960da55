"""Grooms: strands stay where they were bound, turn with the head, thin out without jumps, and survive a file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from grmm_core.errors import ShapeError
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings
from grmm_core.hair.coloring import WornHair
from grmm_core.hair.compact import MAX_BYTES, compact_parts, restored_parts
from grmm_core.hair.groom import QUANTUM, TINTS, Groom, bind, join
from grmm_core.hair.packaged import library_groom
from grmm_core.hair.ready import ready
from grmm_core.hair.roots import BEARD, LASHES, SCALP
from grmm_core.hair.strands import blocks_of
from grmm_core.head.open_head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def turn(angle: float, other: float) -> np.ndarray:
    c, s, d, e = np.cos(angle), np.sin(angle), np.cos(other), np.sin(other)
    return np.array([[c, 0, s], [0, 1, 0], [-s, 0, c]]) @ np.array([[1, 0, 0], [0, d, -e], [0, e, d]])


@pytest.fixture(scope="module")
def strands(head) -> tuple[Groom, np.ndarray]:
    """Strands of 2 to 9 points on scalp and chin of the mean head, and their points in head space."""
    g = np.random.default_rng(3)
    faces = np.asarray(head.faces)
    scalp = np.zeros(len(head.v_template), bool)
    scalp[head.regions["scalp"]] = True
    above = np.flatnonzero(scalp[faces].all(1))
    triangles = g.choice(above, 60)
    weights = g.dirichlet((1, 1, 1), 60)
    counts = g.integers(2, 10, 60)
    offsets = np.concatenate([[0], np.cumsum(counts)])
    roots = (np.asarray(head.v_template, float)[faces[triangles]] * weights[..., None]).sum(1)
    steps = np.arange(offsets[-1]) - np.repeat(offsets[:-1], counts)
    points = np.repeat(roots, counts, 0) + steps[:, None] * 0.02 * np.repeat(g.normal(0, 0.6, (60, 3)), counts, 0)
    groups = g.choice([SCALP, BEARD, LASHES], 60)
    widths = np.tile([1e-4, 4e-5], (60, 1))
    groom = bind(head.v_template, head.faces, head.v_template, triangles, weights, points, offsets, widths, groups)
    return groom, points


def test_a_groom_is_where_it_was_bound(head, strands):
    groom, points = strands
    frames = groom.frames(head.v_template, head.faces)
    np.testing.assert_allclose(groom.posed(frames, head.v_template), points, atol=1e-6)


def test_a_groom_follows_a_rigid_motion_exactly(head, strands):
    groom, points = strands
    frames = groom.frames(head.v_template, head.faces)
    rotation = turn(0.7, -0.4)
    moved = np.asarray(head.v_template, float) @ rotation.T + [0.1, -0.2, 0.3]
    np.testing.assert_allclose(groom.posed(frames, moved), points @ rotation.T + [0.1, -0.2, 0.3], atol=2e-6)


def test_long_hair_does_not_swing_with_one_vertex(head, strands):
    """A dent of 2 mm at one vertex of the scalp turns a patch much less than it turns the triangle."""
    groom, _ = strands
    groom = groom.select(groom.groups == SCALP)
    dented = np.array(head.v_template, float)
    dented[np.asarray(head.faces)[groom.triangles[0], 0]] *= 1.02
    tilt = {}
    for name, group in (("patch", SCALP), ("triangle", LASHES)):
        frames = Groom(
            groom.triangles, groom.weights, groom.offsets, groom.points, groom.widths, np.full(len(groom), group, np.uint8)
        ).frames(head.v_template, head.faces)
        before, after = frames.at(head.v_template)[1][0], frames.at(dented)[1][0]
        tilt[name] = np.degrees(np.arccos(np.clip(before[2] @ after[2], -1, 1)))
    assert tilt["patch"] < 0.4 * tilt["triangle"]


def test_levels_are_nested_and_cover_as_much(strands):
    groom, _ = strands
    half, quarter = groom.level(0.5), groom.level(0.25)
    assert {p.tobytes() for p in quarter.points} <= {p.tobytes() for p in half.points}
    assert 0.4 < len(half) / len(groom) < 0.6
    np.testing.assert_allclose(half.widths.sum(), groom.widths.sum(), rtol=0.2)
    with pytest.raises(ShapeError, match="share of 0"):
        groom.level(0)


def test_resampling_keeps_roots_tips_and_shape(strands):
    groom, _ = strands
    even = groom.resampled(12)
    assert (even.counts == 12).all()
    np.testing.assert_allclose(even.points[even.offsets[:-1]], groom.points[groom.offsets[:-1]], atol=1e-6)
    np.testing.assert_allclose(even.points[even.offsets[1:] - 1], groom.points[groom.offsets[1:] - 1], atol=1e-6)
    steps = np.linalg.norm(np.diff(even.points.reshape(-1, 12, 3), axis=1), axis=2)
    assert (steps.std(1) < 0.01 * steps.mean(1) + 1e-6).all()  # straight strands here


def test_selecting_and_joining_are_inverse(strands):
    groom, _ = strands
    parts = [groom.select(np.arange(20)), groom.select(np.arange(len(groom)) >= 20)]
    again = join(parts)
    for name in ("triangles", "weights", "offsets", "points", "widths", "groups"):
        np.testing.assert_array_equal(getattr(again, name), getattr(groom, name))
    np.testing.assert_array_equal(groom.along[groom.offsets[:-1]], 0)
    np.testing.assert_array_equal(groom.along[groom.offsets[1:] - 1], 1)


def test_strands_keep_their_own_colors(strands, head):
    groom, _ = strands
    tints = np.random.default_rng(3).uniform(-0.5, 0.5, (len(groom), TINTS, 3)).astype(np.float32)
    streaked = replace(groom, tints=tints)
    some = np.flatnonzero(np.arange(len(groom)) % 3 == 1)
    np.testing.assert_array_equal(streaked.select(some).resampled(9).tints, tints[some])
    np.testing.assert_array_equal(join([groom, streaked]).tints, np.concatenate([0 * tints, tints]))
    packed = compact_parts(streaked)
    again = restored_parts(packed)
    assert sum(array.nbytes for array in packed.values()) <= MAX_BYTES
    np.testing.assert_allclose(again.tints, tints[np.argsort(groom.groups, kind="stable")], atol=0.5 / 127 + 1e-6)
    assert restored_parts(compact_parts(groom)).tints is None
    with pytest.raises(ShapeError, match="tints of size"):
        replace(groom, tints=tints[:, 1:])


def test_strands_that_are_ready_take_other_colors(strands, head):
    groom, _ = strands
    tints = np.random.default_rng(4).uniform(-0.5, 0.5, (len(groom), TINTS, 3)).astype(np.float32)
    streaked = replace(groom, tints=tints * (groom.groups == SCALP)[:, None, None])
    plain = ready(groom, head)
    for one in (streaked, replace(groom, tints=tints)):
        for block, before in zip(ready(one, head), plain, strict=True):
            assert block.points is before.points
            expected = one.tints[block.rows]
            np.testing.assert_array_equal(0.0 if block.tints is None else block.tints, expected)
    assert all(block.tints is None for block in ready(groom, head))


def test_own_colors_ride_on_what_settings_give(strands, head):
    """Whatever the pigments, the share of the strands and their length: the same is added, at the same place of the strand."""
    groom, _ = strands
    groom = groom.select(groom.groups == SCALP)
    tints = np.zeros((len(groom), TINTS, 3), np.float32)
    tints[:, TINTS // 2 :, 0] = 0.1  # red from the middle on
    vertices, camera = np.asarray(head.v_template, float), Camera.orbit(64, 64)
    for settings in (HairSettings(melanin=0.5), HairSettings(melanin=0.8, length=0.5)):
        plain, streaked = (
            WornHair(one, settings, vertices, camera, head).gaussians(settings) for one in (groom, replace(groom, tints=tints))
        )
        added = streaked.colors - plain.colors
        _, places = WornHair(groom, settings, vertices, camera, head).pieces(settings)
        wanted = np.interp(places, np.linspace(0, 1, TINTS), tints[0, :, 0])
        seen = plain.opacities > 0
        np.testing.assert_allclose(added[seen, 0], wanted[seen], atol=1e-5)
        np.testing.assert_allclose(added[seen, 1:], 0.0, atol=1e-6)
        assert added[seen, 0].max() == pytest.approx(0.1 if settings.length == 1.0 else 0.0, abs=0.05)


def test_packing_loses_half_a_quantum(strands):
    groom, _ = strands
    again = Groom.unpack(groom.pack())
    np.testing.assert_allclose(again.points, groom.points, atol=0.51 * QUANTUM)
    np.testing.assert_allclose(again.weights, groom.weights, atol=2e-5)
    np.testing.assert_array_equal(again.offsets, groom.offsets)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"points": np.full((4, 3), np.nan, np.float32)}, "not finite"),
        ({"points": np.full((4, 3), 90.0, np.float32)}, "longer than 2 m"),
        ({"offsets": np.array([0, 1, 4])}, "two points"),
        ({"widths": np.zeros((3, 2), np.float32)}, "widths of size"),
        ({"points": np.zeros((4, 2), np.float32)}, "cannot be used"),
    ],
)
def test_bad_strands_are_refused(change, message):
    good = {
        "triangles": np.zeros(2, np.int32), "weights": np.full((2, 3), 1 / 3, np.float32), "offsets": np.array([0, 2, 4]),
        "points": np.zeros((4, 3), np.float32), "widths": np.ones((2, 2), np.float32), "groups": np.zeros(2, np.uint8),
    }  # fmt: skip
    Groom(**good)
    with pytest.raises(ShapeError, match=message):
        Groom(**{**good, **change})


def test_a_groom_of_another_head_is_refused(head, strands):
    groom, _ = strands
    with pytest.raises(ShapeError, match="own head"):
        groom.frames(head.v_template, np.asarray(head.faces)[:50])
    arrays = groom.pack()
    arrays["steps"] = arrays["steps"][:-1]
    with pytest.raises(ShapeError, match="points"):
        Groom.unpack(arrays)


def test_hairs_of_straight_hair_end_beside_each_other_and_those_of_ropes_together():
    """Where the former met in points, a hem was a comb; braids and locs are told apart by gaps between them."""
    head = load_open_head()

    def left(name):
        (block,) = blocks_of(library_groom(name), head.v_template, head.faces)
        own = block.spread[len(block.points) :]  # the children
        root, tip = (np.linalg.norm(own[:, end, :2], axis=1).mean() for end in (0, 1))
        return tip / root

    assert 0.7 < left("bob") < 1.2
    assert left("locs") < 0.65


@pytest.mark.parametrize("name", ["buzz", "coily", "crop", "fade", "undercut"])
def test_thin_and_grey_hair_is_so_everywhere(head, name):
    """Beside each stored strand about as many are left, or grey, however many are stored: no tufts, and no white locks."""
    for block in blocks_of(library_groom(name), np.asarray(head.v_template, float), head.faces):
        there = block.level(1.0, HairSettings(density=0.3))[1] > 0.5
        left = np.bincount(block.owner[: len(there)], there, len(block.rows))
        assert left.min() >= 1
        for chosen in (there, *(block.chance[: len(there), 1:].T < 0.3)):
            assert np.bincount(block.owner[: len(there)], chosen, len(block.rows)).std() < 0.8
