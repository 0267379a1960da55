"""The end of a fit: skin under strands and in a session's light, the shade of roots, the light of the mouth."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from lit_person import SIDE, light_from_a_side, lit_person
from photo_parts import parts_of

from grmm_core.avatar import save_avatar
from grmm_core.controls.frame import Controls
from grmm_core.controls.names import ALIGNED_NAMES, EXPRESSION_NAMES
from grmm_core.fitting import photo_targets
from grmm_core.fitting.hair_trim import STUBBLE, trimmed
from grmm_core.fitting.invert import photo_pictures, photo_views
from grmm_core.fitting.photo_light import MATT
from grmm_core.fitting.photo_targets import aligned_weights, bare_pixels
from grmm_core.fitting.result import LOCAL, photo_controls, photo_light
from grmm_core.fitting.root_shade import APPEARANCE, shaded_scalp
from grmm_core.fitting.settling import locally_lit, settled, worn_errors
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.hair import library_groom
from grmm_core.hair.roots import SCALP
from grmm_core.light.resting import MOUTH
from grmm_core.model.torch_loader import with_deltas
from grmm_core.session import Instance, RenderOptions, make_local_session

LARGE = 512


@pytest.fixture(scope="module")
def session():
    with make_local_session(engine="torch") as session:
        yield session


@pytest.fixture
def model(session):
    return session.engine.store.default().model


@pytest.fixture(autouse=True)
def all_skin(monkeypatch):
    """Parsed photos show nothing but skin."""
    monkeypatch.setattr(photo_targets, "parse", lambda track, head: parts_of(np.zeros(track.image.shape[:2])))


def colored(session, light, groom, side=SIDE):
    """`lit_person` with a map of colors that changes nothing."""
    avatar, track = lit_person(session, light, groom, side=side)
    model = session.engine.store.default().model
    plain = np.zeros((model.gaussian_count, 3 + model.config.features), np.float32)
    return dataclasses.replace(avatar, deltas={APPEARANCE: plain}), track


def worn(session, avatar, head, camera, light, path):
    save_avatar(avatar, path)
    placed = Instance(session.open(path).id, photo_controls(avatar, head), response=MATT, lighting=light.lighting)
    return session.render([placed], camera, RenderOptions(passes=("rgb", "hair"), background=(0.0, 0.0, 0.0)))


def test_skin_under_brows_looks_as_it_was_fitted(session, model, tmp_path):
    light, head = light_from_a_side(), model.head_model
    avatar, track = colored(session, light, library_groom("bushy", head.name, "brows"), LARGE)
    aims = photo_pictures(model, avatar, [track])
    ((view, aim),) = aims
    changed = settled(session, model, avatar, [track], aims)
    off = []
    for person in (avatar, changed):
        drawn = worn(session, person, head, view.camera, light, tmp_path / "worn.grmm")
        covered = (drawn["hair"][..., 0] > 0.1) & (drawn["hair"][..., 0] < 0.6) & (bare_pixels(view) > 0.5)
        assert covered.sum() > 20
        off.append(float((drawn["rgb"] - aim.image.numpy())[covered].mean()))
    assert off[0] < -0.03, "brows darken what is under them"
    assert abs(off[1]) < 0.8 * abs(off[0])
    assert np.abs(changed.deltas[APPEARANCE][:, 3:]).max() == 0.0


def test_a_session_draws_a_photos_person_as_the_fit_does(session, model, tmp_path):
    """In the photo's light, with a turned neck, an expression, and colors beyond what a screen shows."""
    light, head = light_from_a_side(), model.head_model
    avatar, track = colored(session, light, library_groom("bushy", head.name, "brows"), LARGE)
    beyond = avatar.deltas[APPEARANCE].copy()
    beyond[::7, :3], beyond[::11, :3] = 0.6, -0.5
    pose = np.zeros((5, 3))
    pose[1] = np.radians([5.0, 20.0, 3.0])
    smile = head.arkit_to_expression[EXPRESSION_NAMES.index("mouthSmileLeft")].astype(float)
    track = dataclasses.replace(track, pose=pose, expression=smile)
    aligned = aligned_weights(smile, head, len(ALIGNED_NAMES))
    tracking = {**avatar.tracking, "pose": pose[None], "expression": smile[None], "aligned": aligned[None]}
    avatar = dataclasses.replace(avatar, deltas={APPEARANCE: beyond}, tracking=tracking)
    person = with_deltas(model, avatar.deltas, tmp_path)
    ((view, aim),) = photo_pictures(person, avatar, [track])
    drawn = worn(session, avatar, head, view.camera, light, tmp_path / "person.grmm")
    bare = drawn["hair"][..., 0] == 0.0
    assert bare.mean() > 0.9
    assert np.sqrt(((drawn["rgb"] - aim.image.numpy())[bare] ** 2).mean()) < 0.002


def test_without_strands_nothing_is_settled(session, model):
    avatar, track = colored(session, light_from_a_side(), library_groom("bob"))
    bald = dataclasses.replace(avatar, hair=None)
    assert settled(session, model, bald, [track], []) is bald


def test_what_photos_show_otherwise_becomes_their_light(session, model, tmp_path):
    light, head = light_from_a_side(), model.head_model
    avatar, track = colored(session, light, library_groom("bushy", head.name, "brows"))
    assert locally_lit(session, model, avatar, [track]) is avatar, "whose light on the skin was never looked for"
    ((view, aim),) = photo_pictures(model, avatar, [track])
    rows = np.linspace(0.4, 1.0, SIDE)[:, None, None]  # darker towards the top, as under a hat
    track = dataclasses.replace(track, image=aim.image.numpy() * rows, mask=aim.alpha.numpy())
    avatar = dataclasses.replace(avatar, tracking={**avatar.tracking, LOCAL: np.ones((1, head.vertex_count, 3), np.float32)})
    lit = locally_lit(session, model, avatar, [track])
    bare, off = bare_pixels(view) * aim.alpha.numpy() > 0.99, []
    for person in (avatar, lit):
        drawn = worn(session, person, head, view.camera, photo_light(person), tmp_path / "person.grmm")
        off.append(np.sqrt(((drawn["rgb"] - track.image)[bare & (drawn["hair"][..., 0] < 0.01)] ** 2).mean()))
    assert off[0] > 0.08
    assert off[1] < 0.35 * off[0]
    np.testing.assert_array_equal(lit.deltas[APPEARANCE], avatar.deltas[APPEARANCE])


def test_a_color_error_is_of_the_head_with_its_strands(session, model, tmp_path):
    light, head = light_from_a_side(), model.head_model
    avatar, track = colored(session, light, library_groom("bushy", head.name, "brows"), LARGE)
    drawn = worn(session, avatar, head, track.camera, light, tmp_path / "person.grmm")["rgb"]
    track = dataclasses.replace(track, image=np.clip(drawn, 0.0, 1.0))
    with_brows, bare = (
        worn_errors(session, model, one, [track])[0] for one in (avatar, dataclasses.replace(avatar, hair=None))
    )
    assert with_brows < 0.004
    assert bare > 1.5 * with_brows


def test_skin_that_a_photo_shows_bare_takes_no_shade_of_roots(session, model):
    head = model.head_model
    vertices = head.vertices(np.zeros(1), np.zeros(1), np.zeros((5, 3)))
    avatar, track = colored(session, light_from_a_side(), library_groom("bob", head.name))
    cover = triangle_depth(vertices[head.faces], track.camera) < 5.0
    track = dataclasses.replace(track, mask=cover.astype(np.float32))
    everywhere, behind = (shaded_scalp(model, avatar, views) for views in ([], photo_views(model, [track], SIDE)))
    corners = np.asarray(head.faces)[model.layout.face]
    places = (np.asarray(head.v_template)[corners] * model.layout.barycentric[..., None]).sum(1)
    shaded, left = (np.abs(one.deltas[APPEARANCE][:, :3]).max(1) > 0.05 for one in (everywhere, behind))
    forehead = shaded & (places[:, 2] > 0.06)
    assert forehead.sum() > 20
    assert left[forehead].mean() < 0.3
    assert left[shaded & (places[:, 2] < -0.02)].mean() > 0.95, "the back of the head is not seen"


def test_hair_under_a_hat_keeps_its_roots(session, model):
    avatar, track = colored(session, light_from_a_side(), library_groom("bob", model.head_model.name))
    hat, nothing = np.zeros((SIDE, SIDE)), np.zeros((SIDE, SIDE))
    hat[: SIDE // 3] = 1.0
    assert trimmed(model, avatar, [track], [parts_of(nothing, hat=hat)]) is avatar
    assert trimmed(model, avatar, [track], [parts_of(nothing)]) is not avatar, "where there is no hat bare skin has none"


def test_hair_that_hangs_out_from_behind_a_head_ends_where_the_photo_has_none(session, model, tmp_path):
    light, head = light_from_a_side(), model.head_model
    avatar, track = colored(session, light, library_groom("bob", head.name))
    track = dataclasses.replace(track, image=np.full((SIDE, SIDE, 3), 0.3))
    shown = worn(session, avatar, head, track.camera, light, tmp_path / "person.grmm")["hair"][..., 0]
    beside = np.flatnonzero(shown.sum(1) > 1.0)
    end = round(0.6 * beside[0] + 0.4 * beside[-1])  # of the photo's hair: ears and neck are free in it
    shorter = shown * (np.arange(SIDE) < end)[:, None]
    cut = trimmed(model, avatar, [track], [parts_of(1.0 - shorter, hair=shorter)])
    left = worn(session, cut, head, track.camera, light, tmp_path / "cut.grmm")["hair"][..., 0]
    assert left[end + 4 :].sum() < 0.6 * shown[end + 4 :].sum()  # places lie two centimetres apart; before, 0.98
    assert left[:end].sum() > 0.9 * shown[:end].sum()
    scalp, kept = (one.hair.groom.select(one.hair.groom.groups == SCALP) for one in (avatar, cut))
    assert len(kept) > 0.97 * len(scalp), "no bald spots where it was too long"
    assert 0.9 * STUBBLE < kept.lengths.min() < 0.5 * scalp.lengths.min()


def test_behind_a_bald_forehead_no_stubble_stands(session, model, tmp_path):
    light, head = light_from_a_side(), model.head_model
    avatar, track = colored(session, light, library_groom("quiff", head.name))
    shown = worn(session, avatar, head, track.camera, light, tmp_path / "person.grmm")["hair"][..., 0]
    rows = np.flatnonzero(shown.sum(1) > 1.0)
    sides = shown * (np.arange(SIDE) > rows[0] + 0.45 * np.ptp(rows))[:, None]  # what is above is skin
    template = np.asarray(head.v_template, float)
    tops = []
    for hair in (shown, sides):
        groom = trimmed(model, avatar, [track], [parts_of(1.0 - hair, hair=hair)]).hair.groom
        scalp = groom.select(groom.groups == SCALP)
        roots = scalp.frames(template, head.faces).at(template)[0]
        tops.append(int(((roots[:, 1] > 0.1) & (roots[:, 2] > 0.0)).sum()))
    full, bald = tops
    assert full > 500
    assert bald < 0.2 * full


def test_the_mouth_of_a_photos_light_is_the_lips_and_the_rest_is_as_before(session, model):
    head, light = model.head_model, light_from_a_side()
    controls = Controls().set_named({"jawOpen": 0.8})
    number = session.sample(0).id
    camera = Camera.orbit(SIDE, SIDE, 0.0, 0.0, distance=0.5)
    options = RenderOptions(passes=("rgb",))
    even, scene = (
        session.render([Instance(number, controls, response=response, lighting=light.lighting)], camera, options)["rgb"]
        for response in (MATT, dataclasses.replace(MATT, even_mouth=False))
    )
    vertices = np.asarray(session.deform(number, controls).vertices, np.float64)
    inner = head.marked(*MOUTH)[head.faces].all(1)
    depth, outer = (triangle_depth(vertices[head.faces[part]], camera) for part in (inner, ~inner))
    mouth = depth < outer
    differs = np.abs(even - scene).max(2) > 0.03
    assert differs[mouth].mean() > 0.3
    rows, columns = np.nonzero(mouth)
    far = np.ones_like(mouth)
    far[rows.min() - 4 : rows.max() + 5, columns.min() - 4 : columns.max() + 5] = False
    assert differs[far].mean() < 0.002, "elsewhere next to nothing changes"
