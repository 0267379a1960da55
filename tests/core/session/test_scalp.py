"""Skin where an avatar wears other hair than its own: `grmm_core/session/scalp.py`."""

from types import SimpleNamespace

import numpy as np
import pytest

from grmm_core.avatar import Hair
from grmm_core.avatar.types import Provenance
from grmm_core.hair import HairSettings, join
from grmm_core.hair.brows import lowered, painted
from grmm_core.hair.packaged import library_groom
from grmm_core.hair.roots import GROUPS
from grmm_core.hair.strands import blocks_of
from grmm_core.pictures.color import srgb_to_linear
from grmm_core.session import HairUse, create_session
from grmm_core.session.photo_skin import plucked, untinted
from grmm_core.session.scalp import Covered, Skin, bare_skin, cap_color, covered, shade, shadow
from grmm_core.session.wardrobe import Wardrobe

SKIN = (0.8, 0.6, 0.5)


@pytest.fixture(scope="module")
def model():
    with create_session("local") as session:
        return session.engine.store.default().model


def _person(model, from_photos):
    config = SimpleNamespace(hairless=True, position_unit_mm=1.0)
    return SimpleNamespace(
        id=1,
        model=SimpleNamespace(head_model=model.head_model, layout=model.layout, config=config),
        avatar=SimpleNamespace(provenance=Provenance(from_photos=from_photos), hair=Hair(library_groom("bob"), HairSettings())),
    )


@pytest.mark.parametrize("hair", [(0.15, 0.12, 0.1), (0.75, 0.6, 0.3), (0.7, 0.7, 0.7)])
def test_a_photos_painted_hair_does_not_show_under_another_groom_and_stays_under_its_own(model, hair):
    head, layout = model.head_model, model.layout
    corners = np.asarray(head.faces)[layout.face]
    scalp = (head.marked("scalp").astype(float)[corners] * layout.barycentric).sum(1) > 0.99
    painted = np.where(scalp[:, None], hair, SKIN).astype(np.float32)
    evaluator = SimpleNamespace(
        cache=SimpleNamespace(get=lambda key, make: make()), appearance=lambda target, inputs, eye: (painted,)
    )
    target = _person(model, from_photos=True)
    other, own = (bare_skin(evaluator, target, SimpleNamespace(), own=mine) for mine in (False, True))
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    skin = other.color[~scalp & outer].mean(0)
    np.testing.assert_allclose(other.color[scalp & outer].mean(0), skin, rtol=0.1)
    np.testing.assert_allclose(own.color[scalp & outer].mean(0), srgb_to_linear(np.array(hair)), rtol=1e-3)
    np.testing.assert_array_equal(other.color[~scalp], own.color[~scalp])


@pytest.mark.parametrize("from_photos", [True, False])
def test_hair_that_a_photo_painted_is_taken_away_with_the_strands_and_a_shaven_scalp_is_left(model, from_photos):
    wardrobe, person = Wardrobe(None), _person(model, from_photos)
    assert wardrobe.worn(person, HairUse("none")).flat is from_photos
    assert wardrobe.worn(person, HairUse("own")).flat  # strands shade the skin


def test_a_shaven_scalps_tint_ends_nowhere_under_a_receded_groom(model):
    """Hair that somebody was trained without has tinted the scalp, in patches, up to the person's own hairline."""
    head, layout = model.head_model, model.layout
    faces = np.asarray(head.faces)
    corners = faces[layout.face]
    vertices = np.asarray(head.v_template, float)
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    scalp = (head.marked("scalp").astype(float)[corners] * layout.barycentric).sum(1)
    wider = np.isin(np.arange(len(vertices)), faces[head.marked("scalp")[faces].any(1)])
    front = (vertices[corners] * layout.barycentric[..., None]).sum(1)[:, 2] > 0.02
    beside = outer & front & (scalp < 0.01) & ((wider[corners] * layout.barycentric).sum(1) > 0.5)
    patches = np.random.default_rng(3).uniform(0.8, 0.95, len(scalp)) * ((scalp > 0) | beside)
    seen = np.where(patches[:, None] > 0, patches[:, None], 1.0) * np.array(SKIN)
    evaluator = SimpleNamespace(
        cache=SimpleNamespace(get=lambda key, make: make()), appearance=lambda target, inputs, eye: (seen.astype(np.float32),)
    )
    found = bare_skin(evaluator, _person(model, from_photos=False), SimpleNamespace())
    skin = srgb_to_linear(np.array(SKIN))
    np.testing.assert_allclose(found.color[outer & (scalp > 0.99)] / skin, 1.0, atol=0.02)
    assert beside.sum() > 100
    shown = srgb_to_linear(seen) * (1.0 - found.share[:, None]) + found.share[:, None] * found.color
    assert np.median(shown[beside] / skin) > 0.97 > np.median(srgb_to_linear(seen)[beside] / skin)


@pytest.mark.parametrize("from_photos", [True, False])
def test_the_dark_rim_and_inner_side_of_a_bust_are_no_hair(model, from_photos):
    head, layout = model.head_model, model.layout
    corners = np.asarray(head.faces)[layout.face]
    points = (np.asarray(head.v_template, float)[corners] * layout.barycentric[..., None]).sum(1)
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    bust = outer & (points[:, 1] < -0.11)
    rim = bust & (points[:, 1] < np.quantile(points[bust, 1], 0.02))
    back = bust & (points[:, 2] < -0.06)
    front_view = np.where((rim | back)[:, None], 0.02, SKIN).astype(np.float32)  # the back is seen from within
    behind = np.where(rim[:, None], 0.02, SKIN).astype(np.float32)
    evaluator = SimpleNamespace(
        cache=SimpleNamespace(get=lambda key, make: make()),
        appearance=lambda target, inputs, eye: (front_view if eye[2] > 0 else behind,),
    )
    found = bare_skin(evaluator, _person(model, from_photos), SimpleNamespace())
    assert min(rim.sum(), back.sum()) > 20
    assert found.share[rim | back].max() < 0.01
    scalp = (head.marked("scalp").astype(float)[corners] * layout.barycentric).sum(1) > 0.99
    assert found.share[scalp & outer].min() > 0.99


def test_a_bun_behind_the_head_lies_over_no_forehead(model):
    head, layout = model.head_model, model.layout
    mean = np.asarray(head.v_template, float)
    x, y, z = (mean[np.asarray(head.faces)[layout.face]] * layout.barycentric[..., None]).sum(1).T
    forehead = (np.asarray(head.uv_islands)[layout.face] == 0) & (z > 0.085) & (y > 0.09) & (y < 0.107) & (np.abs(x) < 0.03)
    assert forehead.sum() > 100
    bun, tail = (
        covered(_person(model, from_photos=False), blocks_of(library_groom(name), mean, head.faces)).under[forehead]
        for name in ("bun", "ponytail")
    )
    np.testing.assert_allclose(bun.mean(), tail.mean(), atol=0.05)  # both are combed back alike


def test_skin_under_a_beard_and_a_fringe_is_dark_and_other_skin_is_not(model):
    head, layout = model.head_model, model.layout
    target = _person(model, from_photos=False)
    mean = np.asarray(head.v_template, float)
    places = (mean[np.asarray(head.faces)[layout.face]] * layout.barycentric[..., None]).sum(1)
    x, y, z = places.T
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    jaw = outer & (y > -0.07) & (y < -0.055) & (z > 0.08) & (np.abs(x) < 0.03)
    brow = outer & (y > 0.08) & (y < 0.09) & (z > 0.08) & (np.abs(x) < 0.03)
    nose = outer & (z > 0.105) & (y > 0.005) & (y < 0.04)
    assert min(part.sum() for part in (jaw, brow, nose)) > 20

    def left(name, part, **values):
        there = covered(target, blocks_of(library_groom(name, part=part), mean, head.faces))
        return shade(there, [HairSettings(**values)] * len(GROUPS))[:, 0]

    beard, fringe = left("full", "beard"), left("fringe", "scalp")
    assert beard[jaw].mean() < 0.7
    assert fringe[brow].mean() < 0.9
    assert min(beard.min(), fringe.min()) > 0.4
    for dark, others in ((beard, (brow, nose, ~outer)), (fringe, (jaw, nose, ~outer))):
        assert min(dark[other].min() for other in others) > 0.9999  # but for a last hair of a moustache below a nose
    assert left("coily", "scalp")[brow | nose].min() > 0.99  # curls stand out before it
    np.testing.assert_allclose(1.0 - left("full", "beard", density=0.25), 0.25 * (1.0 - beard), atol=1e-6)
    assert (shade(covered(target, ()), [HairSettings()] * len(GROUPS)) == 1.0).all()


def test_what_shows_between_shorn_hair_is_not_rust_and_deep_inside_hair_is_dark():
    """Brown hair's color without the glints that its strands have is far redder than they are."""
    ones = np.ones(3, np.float32)
    light = np.array([0.9, 0.5, 0.05])
    skin = Skin(ones, srgb_to_linear(np.tile(SKIN, (3, 1))), ones)
    red, green, blue = cap_color(skin, Covered(ones, ones, light, (), ones), HairSettings(melanin=0.62), False).T
    assert red[0] < 2.2 * blue[0]
    assert (np.diff(green) < 0.0).all()
    assert green[2] < 0.06


def test_hair_that_hangs_beside_a_neck_throws_a_shadow_on_it(model):
    head, layout = model.head_model, model.layout
    target = _person(model, from_photos=False)
    mean = np.asarray(head.v_template, float)
    x, y, z = (mean[np.asarray(head.faces)[layout.face]] * layout.barycentric[..., None]).sum(1).T
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    neck = outer & (y > -0.12) & (y < -0.08) & (np.abs(x) > 0.03) & (z > -0.03) & (z < 0.03)
    nose = outer & (z > 0.105) & (y > 0.005) & (y < 0.04)
    assert min(neck.sum(), nose.sum()) > 20

    def left(*names, **values):
        blocks = [block for name in names for block in blocks_of(library_groom(name), mean, head.faces)]
        return shadow(covered(target, blocks), HairSettings(**values))[:, 0]

    long, short = left("long"), left("crop")
    assert long[neck].mean() < 0.8 < 0.95 < short[neck].mean()
    assert long[nose].mean() > 0.95
    assert long[~outer].min() == 1.0
    assert long.min() > 0.3  # skin and hair around give some light back
    assert left("long", density=0.3)[neck].mean() > long[neck].mean() + 0.1
    assert (left() == 1.0).all()


def test_at_the_hairline_skin_is_no_brighter_than_in_the_shadow_beside_it():
    ones = np.ones(3, np.float32)
    skin = Skin(ones, np.full((3, 3), 0.5, np.float32), ones)
    there = Covered(np.array([0.0, 0.3, 1.0], np.float32), 0.0 * ones, np.array([1.0, 1.0, 0.2], np.float32), (), 0.6 * ones)
    plain, shaded = (srgb_to_linear(cap_color(skin, there, HairSettings(), rig))[:, 1] for rig in (False, True))
    assert plain[0] == plain[1] == pytest.approx(0.5, abs=1e-3)
    np.testing.assert_allclose(shaded[:2], 0.3, atol=1e-3)
    assert shaded[2] == plain[2] < 0.3  # under dense hair it is darker than that already


def test_brows_that_a_photo_painted_go_with_its_strands_and_others_stand_at_their_height(model):
    head, layout = model.head_model, model.layout
    vertices, faces = np.asarray(head.v_template, float), np.asarray(head.faces)
    natural = library_groom("natural", head.name, "brows")
    own = lowered(natural, head, np.full(len(natural), 0.003))
    person = _person(model, from_photos=True)
    person.avatar.hair = Hair(join([library_groom("bob"), own]), HairSettings())
    wardrobe = Wardrobe(None)
    assert wardrobe.worn(person, HairUse("own")).gone is None
    thin = wardrobe.worn(person, HairUse("own", brows="thin"))
    assert len(thin.gone) == len(own)
    worn = [layer.groom for layer in thin.layers if layer.key[:2] == ("brows", "thin")]
    roots = [groom.frames(vertices, faces).at(vertices)[0][:, 1].mean() for groom in worn]
    usual = library_groom("thin", head.name, "brows").frames(vertices, faces).at(vertices)[0][:, 1].mean()
    np.testing.assert_allclose(usual - np.array(roots), [0.003], atol=0.001)

    points = (vertices[faces[layout.face]] * layout.barycentric[..., None]).sum(1)
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    under = own.frames(vertices, faces).at(vertices)[0]
    apart = np.sqrt(((points[:, None] - under[::4]) ** 2).sum(2).min(1))
    brow, beside = outer & (apart < 0.0025), outer & (apart > 0.012)
    painted = np.where(brow[:, None], (0.2, 0.15, 0.12), SKIN).astype(np.float32)
    evaluator = SimpleNamespace(appearance=lambda target, inputs, eye: (painted,))
    bared = painted * plucked(evaluator, person, SimpleNamespace(), own)
    assert min(brow.sum(), beside.sum()) > 50
    np.testing.assert_allclose(bared[brow], np.broadcast_to(SKIN, bared[brow].shape), atol=0.02)
    np.testing.assert_array_equal(bared[beside], painted[beside])


def test_where_the_weights_have_a_tint_of_brows_skin_is_plain(model):
    head, layout = model.head_model, model.layout
    vertices, faces = np.asarray(head.v_template, float), np.asarray(head.faces)
    person = _person(model, from_photos=False)
    assert Wardrobe(None).worn(person, HairUse("own", brows="none")).tinted
    roots = painted(head)
    usual = library_groom("bushy", head.name, "brows").frames(vertices, faces).at(vertices)[0]
    assert roots[:, 1].mean() - usual[:, 1].mean() == pytest.approx(0.006, abs=0.001)

    points = (vertices[faces[layout.face]] * layout.barycentric[..., None]).sum(1)
    outer = np.asarray(head.uv_islands)[layout.face] == 0
    apart = np.sqrt(((points[:, None] - roots) ** 2).sum(2).min(1))
    brow, beside = outer & (apart < 0.0025), outer & (apart > 0.006)
    mole = np.flatnonzero(brow)[::40]
    tinted = np.where(brow[:, None], 0.93 * np.asarray(SKIN), SKIN).astype(np.float32)
    tinted[mole] = 0.4 * np.asarray(SKIN)
    evaluator = SimpleNamespace(appearance=lambda target, inputs, eye: (tinted,))
    bared = tinted * untinted(evaluator, person, SimpleNamespace())
    np.testing.assert_array_equal(bared[mole], tinted[mole])
    np.testing.assert_array_equal(bared[beside], tinted[beside])
    brow[mole] = False
    np.testing.assert_allclose(bared[brow], np.broadcast_to(SKIN, bared[brow].shape), atol=0.01)
