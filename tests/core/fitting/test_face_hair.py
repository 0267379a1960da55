"""Brows and beards that a photo shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from photo_parts import parts_of

from grmm_core.fitting.face_hair import BRIDGE, OUTLINES, brow_cover, face_hair
from grmm_core.fitting.hair_stage import LIGHTER, person_hair
from grmm_core.fitting.hair_view import hair_view
from grmm_core.fitting.photo_targets import project
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.coloring import WornHair
from grmm_core.hair.roots import BEARD, BROWS, LASHES
from grmm_core.hair.strands import lengthened
from grmm_core.head import load_open_head
from grmm_core.photo.parser import MESH_PARTS, part_map

SKIN = np.array([0.75, 0.56, 0.47])


def face(drawn=(), yaw=10.0, melanin=0.95):
    """A tracked bald head with groups of strands drawn on it, and what its pixels show."""
    head = load_open_head()
    vertices, camera = np.asarray(head.v_template, np.float64), Camera.orbit(288, 288, yaw, 0.0)
    covered = (triangle_depth(vertices[head.faces], camera) < EMPTY).astype(np.float32)
    image, beard = covered[..., None] * SKIN + (1 - covered[..., None]) * 0.5, np.zeros_like(covered)
    for group, groom in drawn:
        settings = HairSettings(melanin=melanin)
        rgb, alpha = WornHair(groom, settings, vertices, camera, head).drawn(settings)
        image = rgb + (1 - alpha[..., None]) * image
        beard = alpha if group == BEARD else beard
    marks = project(head.landmark_positions(vertices, LANDMARK_COUNT), camera)
    fitted = marks.copy()
    for group, groom in drawn:  # a detector finds brows where they are drawn, not where the mesh has their landmarks
        points = camera.project(groom.posed(groom.frames(vertices, head.faces), vertices))[1]
        for outline in OUTLINES if group == BROWS else ():
            own = np.sign(points[:, 0] - marks[BRIDGE, 0]) == np.sign(marks[outline[0], 0] - marks[BRIDGE, 0])
            marks[list(outline), 1] += points[own, 1].mean() - marks[list(outline), 1].mean()
    shown = np.maximum(covered, beard)
    zeros = {"shape": np.zeros(head.shape_count), "expression": np.zeros(head.expression_count), "pose": np.zeros((5, 3))}
    track = PhotoTrack(
        source="", image=image, mask=shown, valid=np.ones_like(covered), camera=camera, photo_camera=camera, landmarks=marks,
        landmarks_fitted=fitted, arkit=np.zeros(52), **zeros,
    )  # fmt: skip
    return track, parts_of(1.0 - shown, beard=beard), head


def test_shaded_skin_beside_a_hat_does_not_tell_the_hairs_color():
    track, _, head = face([])
    shape = track.mask.shape
    hat, hair, ear = (np.zeros(shape, np.float32) for _ in range(3))
    hat[:100], hair[100:120, :150], ear[100:120, 150:200] = 1.0, 1.0, 1.0
    image = np.broadcast_to(SKIN, (*shape, 3)).copy()
    image[hair > 0] = 0.4  # grey
    image[ear > 0] = SKIN * [0.7, 0.5, 0.45]  # taken for hair
    shown, parts = replace(track, image=image), parts_of(np.zeros(shape), hat=hat, hair=hair + ear)
    view = hair_view(shown, parts, head)
    assert (view.counts[hair > 0] == 1.0).all()
    assert not view.counts[ear > 0].any()
    bare = hair_view(shown, parts_of(np.zeros(shape), hair=hair + ear), head)
    assert (bare.counts == 1.0).all(), "without a hat hair may have any color"
    red = hair_view(shown, parts_of(np.zeros(shape), hat=hat, hair=ear), head)
    assert (red.counts[ear > 0] == 1.0).all(), "hair may be as red as skin"


def test_hair_that_hardly_shows_is_about_as_dark_as_the_brows():
    """Below a hat a little skin is taken for hair."""
    track, parts, head = face([(BROWS, library_groom("bushy", part="brows"))])
    scalp = part_map(head, hair_view(track, parts, head).vertices, track.camera)[0] == tuple(MESH_PARTS).index("scalp")
    hat = np.float32(scalp)
    strip = np.float32(scalp & (np.cumsum(scalp[::-1], 0)[::-1] < 4))
    hidden = parts_of(1.0 - np.maximum(track.mask, hat), hat=hat - strip, hair=strip)
    found = person_hair([track], [hidden], head)
    assert found.parts["brows"].melanin > 0.6
    assert found.settings.melanin == pytest.approx(found.parts["brows"].melanin - LIGHTER)
    bald = person_hair([track], [parts_of(1.0 - track.mask, hair=strip)], head)
    assert bald.settings == HairSettings(), "the little hair without a hat may be white above dark brows"


def test_the_shade_beside_hair_is_no_brow():
    track, parts, head = face([(BROWS, library_groom("bushy", part="brows"))])
    view = hair_view(track, parts, head)
    cover = brow_cover(track, parts, view, head)
    rows = np.nonzero(cover > 0.5)[0]
    fringe = np.zeros_like(cover)
    fringe[: rows.min() + 1] = 1.0  # down to the brows
    under = brow_cover(track, replace(parts, hair=fringe), view, head)
    assert cover.sum() > 100
    assert not under[: rows.min() + 2].any()
    assert under[rows.max()].sum() == pytest.approx(cover[rows.max()].sum())


def test_a_brow_in_the_shade_of_hair_is_as_the_other_one():
    track, parts, head = face([(BROWS, library_groom("bushy", part="brows"))])
    cover = brow_cover(track, parts, hair_view(track, parts, head), head)
    rows, columns = np.nonzero(cover > 0.5)
    lock = np.zeros_like(cover)
    lock[rows.min() - 4 : rows.max() + 5, : round(float(columns.mean()))] = 1.0  # of hair, over the brow on the left

    def sides(hair):
        shown = replace(parts, hair=hair)
        grooms, _ = face_hair(track, shown, hair_view(track, shown, head), head, HairSettings())
        (brows,) = (groom for groom in grooms if (groom.groups == BROWS).all())
        roots = brows.frames(np.asarray(head.v_template, np.float64), head.faces).at(np.asarray(head.v_template, np.float64))[0]
        return np.array([(roots[:, 0] < 0).sum(), (roots[:, 0] > 0).sum()])

    np.testing.assert_allclose(sides(lock), sides(np.zeros_like(cover)), rtol=0.15)


@pytest.mark.parametrize("name", ["thin", "bushy"])
def test_brows_stand_where_the_photo_has_them(name):
    track, parts, head = face([(BROWS, library_groom(name, part="brows"))])
    hair = person_hair([track], [parts], head)
    groups = hair.groom.groups
    assert set(groups.tolist()) == {BROWS, LASHES}, "bald, and no beard"
    share = (groups == BROWS).sum() / len(library_groom("bushy", part="brows"))
    assert 0.05 < share < 0.75 if name == "thin" else share > 0.5
    assert name == "thin" or hair.parts["brows"].melanin > 0.6  # of 0.95; blond ones would be below 0.3


def test_faint_brows_are_followed_and_darker_than_the_skin_between_their_hairs():
    """Thin brows darken skin by a fifth: their hairs are darker than that, and not black."""
    track, parts, head = face([(BROWS, library_groom("thin", part="brows"))])
    bare = face([])[0].image
    faint = replace(track, image=bare + 0.35 * (track.image - bare))
    view = hair_view(faint, parts, head)
    grooms, own = face_hair(faint, parts, view, head, HairSettings(melanin=0.4))
    (brows,) = (groom for groom in grooms if (groom.groups == BROWS).all())
    cover = brow_cover(faint, parts, view, head)
    rgb, alpha = WornHair(brows, own["brows"], view.vertices, view.camera, head).drawn(own["brows"])
    assert (alpha * (cover > 0.2)).sum() > 0.5 * alpha.sum(), "strands stand beside the brows"
    skin, seen, tone = SKIN.mean(), faint.image[cover > 0.5].mean(), rgb.sum() / (3.0 * alpha.sum())
    assert 0.5 * skin < tone < seen + 0.02


def test_brows_go_as_low_as_the_photo_has_them():
    track, parts, head = face([(BROWS, library_groom("bushy", part="brows"))])
    low = track.landmarks.copy()
    height = float(np.ptp(track.landmarks_fitted[:, 1]))
    for outline in OUTLINES:
        low[list(outline), 1] += 0.03 * height
    rows = np.arange(288) - int(0.03 * height)  # the picture around the brows moves down with them
    lower = replace(track, image=track.image[np.clip(rows, 0, 287)], landmarks=low)
    vertices = np.asarray(head.v_template, np.float64)
    middles = []
    for seen in (track, lower):
        hair = person_hair([seen], [parts], head)
        brows = hair.groom.select(hair.groom.groups == BROWS)
        points = brows.posed(brows.frames(vertices, head.faces), vertices)
        middles.append(track.camera.project(points)[1][:, 1].mean())
    assert middles[1] - middles[0] == pytest.approx(0.03 * height, rel=0.35)


def test_brows_behind_frames_of_glasses_are_as_what_is_seen_of_them():
    """Dark frames, which the parser knows: an upright bar through each brow, one below both, and then one over all of them."""
    track, parts, head = face([(BROWS, library_groom("bushy", part="brows"))])
    rows, _ = np.nonzero(brow_cover(track, parts, hair_view(track, parts, head), head) > 0.5)
    every, bars = np.zeros(track.mask.shape, bool), np.zeros(track.mask.shape, bool)
    every[rows.min() - 4 : rows.max() + 4] = True
    for outline in OUTLINES:
        middle = round(float(track.landmarks[list(outline), 0].mean()))
        bars[rows.min() - 4 : rows.max() + 4, middle - 5 : middle + 5] = True
    bars[rows.max() + 2 : rows.max() + 7] = True

    def brows(frames):
        image = np.where(frames[..., None], 0.05, track.image).astype(np.float32)
        glasses = parts_of(1.0 - track.mask, glasses=frames * track.mask)
        return int((person_hair([replace(track, image=image)], [glasses], head).groom.groups == BROWS).sum())

    bare = brows(np.zeros_like(bars))
    assert (bars & every).sum() > 100
    assert 0.8 * bare < brows(bars) < 1.1 * bare
    assert brows(every) == len(library_groom("natural", part="brows")), "nothing is known of them"


def test_a_beard_keeps_the_strands_that_the_photo_shows():
    track, parts, head = face([(BEARD, library_groom("goatee", part="beard"))])
    hair = person_hair([track], [parts], head)
    beard = hair.groom.select(hair.groom.groups == BEARD)
    assert len(beard) > 50
    vertices = np.asarray(head.v_template, np.float64)
    points = beard.posed(beard.frames(vertices, head.faces), vertices)
    assert float(np.abs(points[:, 0]).max()) < 0.05, "none on the cheeks"


def test_a_long_beard_hangs_as_low_as_in_the_photo_in_its_color():
    head, full = load_open_head(), library_groom("full", part="beard").resampled(12)
    roots = full.frames(np.asarray(head.v_template, float), head.faces).at(np.asarray(head.v_template, float))[0]
    points = full.points.reshape(len(full), 12, 3)
    long = np.where((roots[:, 1] < -0.05)[:, None, None], lengthened(points, 2.5), points)
    track, parts, _ = face([(BEARD, replace(full, points=long.reshape(-1, 3)))], melanin=0.4)
    hair = person_hair([track], [parts], head)
    beard = hair.groom.select(hair.groom.groups == BEARD)

    def lowest(groom):
        frames = groom.frames(np.asarray(head.v_template, float), head.faces)
        return np.quantile(groom.posed(frames, np.asarray(head.v_template, float))[:, 1], 0.03)

    short, drawn, found = map(lowest, (full, replace(full, points=long.reshape(-1, 3)), beard))
    assert short - drawn > 0.015
    assert 0.4 < (short - found) / (short - drawn) < 1.2  # few tips are no beard to a pixel
    assert hair.parts["beard"].melanin == pytest.approx(0.4, abs=0.1)
    assert not hair.parts["beard"].dye
