"""What photos do not show or show wrongly: folded lids, hair over cheeks, clothes, hair at the back. Open head, no training."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch
from photo_parts import parts_of

from grmm_core.controls.names import ALIGNED_NAMES, ARKIT_NAMES
from grmm_core.fitting import photo_targets
from grmm_core.fitting.chin import below_chin
from grmm_core.fitting.inpainting import GRAIN, facing, fill_colors, uncut
from grmm_core.fitting.lids import LIGHTNESS, lid_exposure, lid_share, plain_lids
from grmm_core.fitting.objective import FIT_WEIGHTS, fit_loss
from grmm_core.fitting.photo_targets import fit_view, project
from grmm_core.fitting.surface import INNER, SCALP, SKIN, texel_surface
from grmm_core.fitting.types import LANDMARK_COUNT, PhotoTrack
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.triangles import vertex_normals
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.head.open_head import load_open_head
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM, Picture

SIZE = 160
SKIN_TONE, HAIR, CLOTH = np.array([0.8, 0.6, 0.5]), np.array([0.1, 0.07, 0.05]), np.array([0.1, 0.2, 0.7])


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return GRMM(load_open_head(), PRESETS["tiny"].replace(grid=128, decoder_grid=16)).requires_grad_(False).eval()


@pytest.fixture(scope="module")
def surface(model):
    return texel_surface(model)


def track(head, blink=0.0, beard=False):
    """A person in blue, hair on top and over the sides of the face, wider shoulders than the bust's."""
    expression = np.zeros(head.expression_count, np.float32)
    for name in ("eyeBlinkLeft", "eyeBlinkRight"):
        expression[ARKIT_NAMES.index(name)] = blink
    shape, pose = np.zeros(head.shape_count, np.float32), np.zeros((5, 3), np.float32)
    camera = Camera.orbit(SIZE, SIZE, distance=1.1, fov=23.0)
    vertices = head.vertices(shape, expression, head.pose_of(expression, pose))
    marks = project(head.landmark_positions(vertices, LANDMARK_COUNT), camera)
    mask = triangle_depth(vertices[head.faces], camera) < EMPTY
    rows, columns = np.mgrid[:SIZE, :SIZE] + 0.5
    chin, forehead, sides = marks[152], marks[10], marks[[234, 454], 0]
    half = 0.5 * abs(float(np.ptp(sides)))
    below = rows > chin[1] + 0.15 * (chin[1] - forehead[1])
    mask |= below & (np.abs(columns - chin[0]) < 2.2 * half)
    mask |= (rows > forehead[1]) & (rows < chin[1]) & (np.abs(columns - sides.mean()) < 1.3 * half)
    image = np.full((SIZE, SIZE, 3), 0.5)
    image[mask] = SKIN_TONE
    image[mask & (rows < forehead[1])] = HAIR
    image[mask & (np.abs(columns - sides.mean()) > 0.8 * half) & (rows < chin[1])] = HAIR
    image[mask & below] = CLOTH
    if beard:
        image[mask & (rows > marks[13, 1]) & (rows < chin[1])] = HAIR
    return PhotoTrack(
        source="drawn.png", image=image, mask=mask.astype(np.float32), valid=np.ones((SIZE, SIZE), np.float32), camera=camera,
        photo_camera=camera, shape=shape, expression=expression, pose=pose, landmarks=marks, landmarks_fitted=marks,
        arkit=expression[:52],
    )  # fmt: skip


def view_of(model, **changes):
    person, bare = track(model.head_model, **changes), model.config.hairless
    return fit_view(person, model.head_model, 0, SIZE, len(ALIGNED_NAMES), model.dtype, hairless=bare)


@pytest.fixture(autouse=True)
def labels(monkeypatch):
    """What the parser would say of such people, by their colors; it knows real ones only."""

    def parse(photo, head):
        rows = np.mgrid[:SIZE, :SIZE][0]
        dark, blue = ((np.abs(photo.image - color).max(-1) < 0.01).astype(float) for color in (HAIR, CLOTH))
        low = dark[int(photo.landmarks[14, 1]) + 2, int(photo.landmarks[14, 0])] * (rows > photo.landmarks[13, 1])
        return parts_of(1.0 - photo.mask, hair=dark * (1 - low), beard=dark * low, clothes=blue)

    monkeypatch.setattr(photo_targets, "parse", parse)


def at(plane, view, head, landmark):
    """Value of a picture where a landmark is."""
    vertices = head.vertices(view.shape.numpy(), view.expression.numpy(), view.pose.numpy())
    x, y = project(head.landmark_positions(vertices, LANDMARK_COUNT)[landmark][None], view.camera)[0].astype(int)
    return float(plane[y, x])


def test_clothes_are_fitted_on_the_bust_but_not_measured(model):
    view, head = view_of(model), model.head_model
    image = view.image.numpy()
    blue = (image[..., 2] > 0.6) & (image[..., 0] < 0.2)
    inside = view.inside.numpy() > 0.5
    assert (blue & inside).sum() > 200, "the bust is a target"
    assert float((view.measured.numpy() * blue).sum()) == 0.0
    assert at(view.measured, view, head, 1) == 1.0
    beside = blue & ~inside
    assert view.empty.numpy()[beside].mean() > 0.5, "clothes beside the bust"
    assert float((view.empty * view.inside).sum()) == 0.0


def test_the_rim_of_the_outline_does_not_tell_the_hairs_color(model):
    view, head = view_of(model), model.head_model
    assert at(view.inner, view, head, 1) == 1.0
    gone = (view.inside > 0.5) & (view.inner == 0.0)
    assert 0.01 < float(gone.sum()) / float(view.inside.sum()) < 0.25
    beside = torch.nn.functional.max_pool2d((view.inside < 0.5).float()[None, None], 3, 1, 1)[0, 0] > 0.5
    assert float(view.inner[beside].sum()) == 0.0


def test_an_avatar_may_not_cover_clothes_beside_its_bust(model):
    view = view_of(model)
    losses = []
    for alpha in (view.inside, (view.inside + view.empty).clamp(0, 1)):
        picture = view.image * alpha[..., None]
        drawn = Picture(picture, picture, alpha, alpha)
        losses.append(float(fit_loss(drawn, view, torch.zeros(3), FIT_WEIGHTS, None)))
    assert losses[1] > losses[0] + 0.5 * FIT_WEIGHTS.alpha * float(view.empty.mean())


def test_brighter_than_a_burnt_out_photo_is_no_error_and_darker_is_one(model):
    view = view_of(model)
    burnt = torch.zeros_like(view.image, dtype=torch.bool)
    burnt[::2, :, 0] = view.inside[::2] == 1.0
    view = dataclasses.replace(view, image=torch.where(burnt, 1.0, view.image))
    losses = []
    for off in (0.0, 0.3, -0.3):
        picture = (view.image + off * burnt) * view.inside[..., None]
        drawn = Picture(picture, picture, view.inside, view.inside)
        losses.append(float(fit_loss(drawn, view, torch.zeros(3), FIT_WEIGHTS, None)))
        np.testing.assert_allclose(view.excess(picture)[burnt], max(off, 0.0), atol=1e-6)
    assert losses[1] == pytest.approx(losses[0], abs=1e-6)
    assert losses[2] > losses[0] + 1e-3


def test_skin_that_light_from_behind_has_burnt_out_tells_no_color(model, monkeypatch):
    head, person = model.head_model, track(model.head_model)
    x, y = person.landmarks[1].astype(int)
    seen = photo_targets.parse(person, head)
    monkeypatch.setattr(photo_targets, "parse", lambda *_: seen)
    dark = 0.5 * person.image
    burnt = dark.copy()
    burnt[y - 2 : y + 3, x - 2 : x + 3] = 1.0
    views = [
        fit_view(dataclasses.replace(person, image=image), head, 0, SIZE, len(ALIGNED_NAMES), model.dtype, hairless=True)
        for image in (dark, burnt)
    ]
    assert [at(view.weight, view, head, 1) for view in views] == [1.0, 0.0]
    assert 0.7 < float(views[1].weight.sum() / views[0].weight.sum()) < 1.0


def test_a_neck_in_the_shade_of_the_chin_tells_its_color_and_cloth_that_was_taken_for_neck_does_not(model, monkeypatch):
    head, person = model.head_model, track(model.head_model)
    low = (np.abs(person.image - CLOTH).max(-1) < 0.01).astype(float)
    monkeypatch.setattr(photo_targets, "parse", lambda photo, _: parts_of(1.0 - photo.mask, neck=low))
    shade, deep = np.multiply(SKIN_TONE, (0.6, 0.5, 0.45)), np.multiply(SKIN_TONE, (0.3, 0.2, 0.18))
    cloths = [(0.95, 0.95, 0.95), (0.1, 0.1, 0.12), (0.35, 0.35, 0.36), tuple(CLOTH), (0.8, 0.1, 0.1)]
    counts = []
    for tone in (shade, deep, *cloths):
        shown = dataclasses.replace(person, image=np.where(low[..., None] > 0.0, tone, person.image))
        view = fit_view(shown, head, 0, SIZE, len(ALIGNED_NAMES), model.dtype, hairless=True)
        counts.append(int(((view.measured > 0.5).numpy() & (np.abs(view.image.numpy() - tone).max(-1) < 0.02)).sum()))
    assert counts[0] > 20
    assert counts[1:] == [counts[0], 0, 0, 0, 0, 0]


def test_hair_over_the_cheeks_is_told_from_skin_brows_and_beard(model):
    head = model.head_model
    view, bearded = view_of(model), view_of(model, beard=True)
    dark = (view.image.numpy().max(-1) < 0.2) & (view.mask.numpy() > 0.5)
    assert at(view.hair, view, head, 1) == 0.0, "the nose"
    assert at(view.hair, view, head, 227) == 1.0, "before the ear"
    assert float(view.hair.numpy()[~dark & (view.measured.numpy() > 0.5)].mean()) < 0.05
    chin_row = int(project(head.landmark_positions(head.v_template, LANDMARK_COUNT)[[17]], bearded.camera)[0, 1])
    assert float(bearded.hair[chin_row].sum()) == 0.0, "beside a bearded chin dark pixels are the beard's"
    assert float(view.hair[chin_row].sum()) > 0.0


def test_hats_are_left_out_of_the_skin_and_said(model, monkeypatch):
    head, plain = model.head_model, photo_targets.parse
    person = track(head)
    rows = np.mgrid[:SIZE, :SIZE][0]
    hat = ((rows < person.landmarks[10, 1]) & (person.mask > 0.5)).astype(float)

    def parse(photo, head):
        found = plain(photo, head)
        return parts_of(found.background * (1 - hat), hair=found.hair * (1 - hat), clothes=found.clothes * (1 - hat), hat=hat)

    assert photo_targets.left_out([person], head) == []
    monkeypatch.setattr(photo_targets, "parse", parse)
    assert photo_targets.left_out([person], head) == ["The hat or scarf in drawn.png is left out of the skin."]
    view = view_of(model)
    top = int(project(head.landmark_positions(head.v_template, LANDMARK_COUNT)[[10]], view.camera)[0, 1])
    assert float(view.inside[: top - 2].sum()) == 0.0
    assert at(view.measured, view, head, 1) == 1.0


def test_only_open_eyes_fold_lids_away(model):
    opened, closed = (lid_exposure(model, view_of(model, blink=blink)) for blink in (0.0, 1.0))
    assert float(opened.max()) > 0.9
    assert 10 < int((opened > 0.5).sum()) < 0.05 * model.gaussian_count
    assert float(closed.max()) == 0.0
    places = model.anchor(model.head.v_template).positions
    eyes = places[opened > 0.5]
    assert float(eyes[:, 1].max() - eyes[:, 1].min()) < 0.04, "around the eyes only, metres"


def test_shade_in_folded_lids_is_not_taken_for_their_color(model, surface):
    folded = lid_exposure(model, view_of(model))
    start = torch.full((model.gaussian_count, 3), 0.6)
    skin = surface.group == SKIN
    lids, mole = (folded > 0.9) & skin, ((folded == 0.0) & skin).nonzero()[-1]
    changes = torch.zeros_like(start)
    changes[lids] = changes[mole] = -0.4
    known = torch.ones(model.gaussian_count)
    filled = fill_colors(surface, start, start, changes, known, folded, torch.zeros_like(folded))
    assert float(filled[lids].mean()) > -0.1, "the tone of the skin around"
    torch.testing.assert_close(filled[mole], changes[mole])
    untouched = fill_colors(surface, start, start, changes, known, torch.zeros_like(folded), torch.zeros_like(folded))
    assert float(untouched[lids].mean()) < -0.35


def test_lids_of_a_photo_take_the_tone_of_plain_skin(bare, bare_surface):
    """Grey with shade and lashes in the photo, they would be grey patches whenever the avatar blinks."""
    model, surface = bare, bare_surface
    share = lid_share(model, view_of(model, blink=1.0))
    torch.testing.assert_close(share, lid_share(model, view_of(model)))  # whatever the photo's own expression
    prior = torch.tensor([0.7, 0.5, 0.4]).expand(model.gaussian_count, 3)
    person = 0.8 * prior
    lids, elsewhere = share > 0.95, share == 0.0
    assert int(lids.sum()) > 10
    seen = person.clone()
    seen[lids] = 0.3
    mole = (elsewhere & (surface.group == SKIN)).nonzero()[-1]
    seen[mole] = 0.2
    plain = plain_lids(surface, seen, prior, share, torch.ones_like(share))
    darkest = LIGHTNESS[0] * person[0]
    torch.testing.assert_close(plain[lids], darkest.expand(int(lids.sum()), 3), atol=0.02, rtol=0.0)
    torch.testing.assert_close(plain[elsewhere], seen[elsewhere])
    torch.testing.assert_close(plain_lids(surface, seen, prior, share, torch.zeros_like(share)), seen)


def test_hair_at_the_back_takes_no_tint_that_the_seen_hair_lacks(model, surface):
    scalp = surface.group == SCALP
    z = model.anchor(model.head.v_template).positions[:, 2]
    front = scalp & (z > 0.0)
    start = torch.full((model.gaussian_count, 3), 0.3)
    start[scalp & ~front] = torch.tensor([0.2, 0.6, 0.2])  # green
    seen = front.to(start)
    filled = start + fill_colors(surface, start, start, torch.zeros_like(start), seen, *torch.zeros(2, len(seen)))
    back = filled[scalp & (z < -0.03)]
    assert float((back - back.mean(1, keepdim=True)).abs().max()) < 0.02
    torch.testing.assert_close(filled[front], start[front], atol=0.02, rtol=0.0)


def test_seen_hair_keeps_its_extremes_out(model, surface):
    """A few seen texels far brighter than all other hair would flash from the side."""
    count = model.gaussian_count
    scalp = torch.nonzero(surface.group == SCALP)[:, 0]
    colors = 0.3 + 0.1 * torch.rand(count, 3, generator=torch.Generator().manual_seed(4))
    few = scalp[:: max(1, len(scalp) // 5)][:5]
    colors[few] = torch.tensor([1.4, 1.3, 0.9])
    everything, nothing = torch.ones(count), torch.zeros(count)
    changed = fill_colors(surface, colors, colors, torch.zeros_like(colors), everything, nothing, nothing)
    assert (colors + changed)[few].max() < 0.5
    others = torch.tensor([index for index in scalp.tolist() if index not in few.tolist()])
    assert changed[others].abs().mean() < 0.005
    assert changed[surface.group != SCALP].abs().max() < 1e-5


def test_unseen_skin_behind_hair_goes_on_as_hair(model, surface):
    places = model.anchor(model.head.v_template).positions
    skin, scalp = surface.group == SKIN, surface.group == SCALP
    left = places[:, 0] > 0.0
    # a dark strip over the left cheek; the left side behind it unseen, all of the right side seen and light
    strip = skin & left & (places[:, 2] > 0.02) & (places[:, 2] < 0.045)
    behind = skin & left & (places[:, 2] <= 0.02) & (places[:, 2] > -0.03) & (places[:, 1] > -0.05)
    start, changes = torch.full((model.gaussian_count, 3), 0.7), torch.zeros(model.gaussian_count, 3)
    changes[strip] = changes[scalp] = -0.6
    seen = (~(left & (places[:, 2] <= 0.02) & skin)).to(start)
    none = torch.zeros_like(seen)
    light, dark = (start + fill_colors(surface, start, start, changes, seen, none, hairy) for hairy in (none, strip.to(seen)))
    assert int(behind.sum()) > 50
    assert float(dark[behind].mean()) < float(light[behind].mean()) - 0.1
    torch.testing.assert_close(dark[skin & ~left], light[skin & ~left], atol=0.02, rtol=0.0)


def test_grazing_skin_counts_less_than_skin_that_faces_the_camera(model, surface):
    view = view_of(model)
    frontal = facing(model, view, model.vertices(view.shape, view.expression, view.pose), surface)
    places = model.anchor(model.head.v_template).positions
    skin = surface.group == SKIN
    nose = skin & (places[:, 2] > places[skin, 2].max() - 0.01)
    assert float(frontal[nose].mean()) > 0.8
    assert float(frontal[skin & (places[:, 2] < -0.05)].max()) == 0.0
    assert float(frontal[surface.group == SCALP].min()) == 1.0


def test_what_the_pictures_edge_cuts_through_is_not_known(model):
    view = view_of(model)
    half = dataclasses.replace(view, camera=view.camera.crop(0, 0, view.camera.width, view.camera.height // 2))
    vertices = torch.as_tensor(model.head_model.vertices(np.zeros(1), np.zeros(1), np.zeros((5, 3))), dtype=model.dtype)
    _, pixels = half.camera.project(model.anchor(vertices).positions.double().numpy())
    inside = uncut(model, half, vertices).numpy()
    assert not inside[pixels[:, 1] > half.camera.height].any()
    middle = (np.abs(pixels - [half.camera.width / 2, half.camera.height / 2]) < 20).all(1)
    assert middle.any()
    assert (inside[middle] == 1.0).all()


# --- weights without hair: bare skin alone is painted, it stays closed, what is unseen is the prior's ---


@pytest.fixture(scope="module")
def bare():
    torch.manual_seed(0)
    return (
        GRMM(load_open_head(), PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True)).requires_grad_(False).eval()
    )


@pytest.fixture(scope="module")
def bare_surface(bare):
    return texel_surface(bare)


def test_hair_cloth_and_background_are_no_targets_and_the_background_stays_empty(bare):
    view, head = view_of(bare), bare.head_model
    image = view.image.numpy()
    painted = image[view.weight.numpy() > 0.5]
    assert len(painted) > 500
    assert float(abs(painted - [0.8, 0.6, 0.5]).max()) < 1e-5, "nothing but skin"
    assert at(view.weight, view, head, 1) == 1.0
    behind = view.mask.numpy() < 0.01
    assert float(view.empty.numpy()[behind].mean()) > 0.99
    assert float((view.empty * view.inside).sum()) == 0.0
    bearded = view_of(bare, beard=True)
    assert at(bearded.weight, bearded, head, 18) == 1.0, "a beard is painted under its strands"


def test_a_scalp_is_skin(bare_surface):
    assert set(bare_surface.group.unique().tolist()) == {SKIN, INNER}


def test_a_rim_of_light_is_none_of_the_persons_colors(bare, bare_surface):
    start = torch.tensor([0.5, 0.35, 0.25]).repeat(bare.gaussian_count, 1)
    seen, none = torch.ones(len(start)), torch.zeros(len(start))
    skin = (bare_surface.group == SKIN) & ~bare_surface.lips & (bare_surface.lip_rim == 0.0)
    middle, beside = (torch.nonzero(skin & (bare_surface.beside == far)).ravel()[::50] for far in (0.0, 1.0))
    change = torch.zeros_like(start)
    change[middle] = change[beside] = 0.5
    filled = fill_colors(bare_surface, start, start, change, seen, none, none)
    assert float(filled[beside].mean()) < 0.25
    torch.testing.assert_close(filled[middle], change[middle], atol=0.03, rtol=0.0)  # a glint on the nose


def test_light_from_behind_on_the_jaw_leaves_plain_skin(bare, bare_surface):
    places = bare.anchor(bare.head.v_template).positions
    start, none = torch.tensor([0.5, 0.35, 0.25]).repeat(bare.gaussian_count, 1), torch.zeros(bare.gaussian_count)
    skin = (bare_surface.group == SKIN) & ~bare_surface.lips & (bare_surface.below == 0.0)
    under = places[bare_surface.lips, 1].min() - 0.011
    rim = skin & (places[:, 1] < under) & (places[:, 0] > 0.042)
    assert int(rim.sum()) > 10
    change = torch.zeros_like(start)
    change[rim] = torch.tensor([0.2, 0.3, 0.4])  # whitish
    filled = fill_colors(bare_surface, start, start, change, torch.ones_like(none), none, none)
    assert float(filled[rim].abs().max()) < 0.1
    assert float(filled[rim].abs().mean()) < 0.03


def test_a_neck_has_the_tone_that_a_photo_shows_of_it(bare, bare_surface):
    """A collar leaves a strip: what it covers is as dark and as red, and nothing of that is on the face."""
    places = bare.anchor(bare.head.v_template).positions
    skin, neck = bare_surface.group == SKIN, bare_surface.below == 1.0
    start = torch.tensor([0.7, 0.5, 0.4]).repeat(bare.gaussian_count, 1)
    strip = neck & skin & (places[:, 2] > places[neck & skin, 2].median())
    change = torch.zeros_like(start)
    change[strip] = start[strip] * torch.tensor([-0.12, -0.16, -0.17])
    seen, none = (~neck | strip).to(start), torch.zeros(len(start))
    filled = start + fill_colors(bare_surface, start, start, change, seen, none, none)
    covered = neck & skin & ~strip
    tone = filled[covered].mean(0) / start[0]
    torch.testing.assert_close(tone, torch.tensor([0.88, 0.84, 0.83]), atol=0.02, rtol=0.0)
    face = skin & (bare_surface.below == 0.0) & (bare_surface.beside == 0.0)
    torch.testing.assert_close(filled[face], start[face], atol=0.01, rtol=0.0)


def test_necklaces_and_blotches_stay_off_the_neck(bare, bare_surface):
    """They would stand on it in every other view and light; how dark the neck is stays."""
    skin, neck = bare_surface.group == SKIN, bare_surface.below == 1.0
    start, change = torch.full((bare.gaussian_count, 3), 0.5), torch.zeros(bare.gaussian_count, 3)
    change[neck] = -0.2 * torch.rand(int(neck.sum()), 3, generator=torch.Generator().manual_seed(5))
    necklace = torch.nonzero(neck & skin).ravel()[::40]
    change[necklace] = 0.4
    everything, nothing = torch.ones(bare.gaussian_count), torch.zeros(bare.gaussian_count)
    filled = fill_colors(bare_surface, start, start, change, everything, nothing, nothing)
    own = filled[neck & skin]
    assert float((own - own.mean(1, keepdim=True)).std()) < 0.01
    assert float(filled[necklace].max()) < 0.0
    assert float(own.mean()) < -0.05
    face = skin & (bare_surface.beside == 0.0)
    assert float(filled[face].abs().mean()) < 0.005


def test_neck_and_underside_of_the_jaw_are_below_the_chin(bare):
    head = bare.head_model
    below = below_chin(head)
    assert (below[head.regions["neck"]] == 1.0).all()
    assert (below[head.marked("lips", "brows", "ears", "scalp") & ~head.marked("neck")] == 0.0).all()
    x, y, _ = np.asarray(head.v_template).T
    jaw = (vertex_normals(np.asarray(head.v_template, float), head.faces)[:, 1] < -0.8) & head.marked("face") & (below > 0.0)
    assert (np.abs(x[jaw]) > 0.02).any()
    assert y[jaw].max() > y[head.regions["neck"]].min()


def test_skin_that_no_photo_shows_is_plain_and_what_is_seen_stays(bare, bare_surface):
    places = bare.anchor(bare.head.v_template).positions
    skin, front = bare_surface.group == SKIN, places[:, 2] > 0.0
    start, changes = torch.full((bare.gaussian_count, 3), 0.7), torch.zeros(bare.gaussian_count, 3)
    shadow = skin & front & (places[:, 2] < 0.02)  # where the photo's hair begins
    changes[shadow] = -0.3
    filled = fill_colors(bare_surface, start, start, changes, front.to(start), *torch.zeros(2, len(start)))
    kept = skin & front & (bare_surface.beside == 0.0)
    assert int(kept.sum()) > 100
    torch.testing.assert_close(filled[kept], changes[kept], atol=0.03, rtol=0.0)
    assert float(filled[shadow & (bare_surface.beside == 1.0)].max()) > -0.1, "shadows beside the face fade"
    assert float(filled[skin & (places[:, 2] < -0.05)].mean()) > -0.02


def test_a_brow_that_hair_hides_has_the_color_of_the_other_one(bare, bare_surface):
    brows, left = bare_surface.brows, bare.anchor(bare.head.v_template).positions[:, 0] > 0.0
    start, dark = torch.full((len(brows), 3), 0.6), torch.tensor([-0.3, -0.25, -0.2])
    changes = torch.where((brows & ~left)[:, None], dark, torch.zeros(3))
    seen, unknown = (~(brows & left)).to(start), torch.zeros(2, len(start))
    filled = fill_colors(bare_surface, start, start, changes, seen, *unknown)
    assert int((brows & left).sum()) > 20
    torch.testing.assert_close(filled[brows & left].mean(0), dark, atol=0.04, rtol=0.0)
    neither = fill_colors(bare_surface, start, start, torch.zeros_like(changes), (~brows).to(start), *unknown)
    torch.testing.assert_close(neither[brows], torch.zeros_like(neither[brows]), atol=0.05, rtol=0.0)  # none is made up


def test_what_no_photo_shows_is_the_priors_with_the_skins_change(bare, bare_surface):
    places = bare.anchor(bare.head.v_template).positions
    skin, front = bare_surface.group == SKIN, places[:, 2] > 0.0
    prior = 0.5 + 0.1 * torch.sin(300.0 * places[:, 1:2]).expand(-1, 3)  # the stubble of a scalp, the shade of an ear
    start = bare_surface.smooth(prior, 5.0)
    seen = (front & ~bare_surface.lips).to(start)
    filled = start + fill_colors(bare_surface, prior, start, prior - start + 0.15, seen, *torch.zeros(2, len(start)))
    back = skin & (places[:, 2] < -0.02)
    torch.testing.assert_close(filled[back], prior[back] + 0.15, atol=0.05, rtol=0.0)  # a little is pulled back
    torch.testing.assert_close(filled[bare_surface.lips], prior[bare_surface.lips])  # lips are no skin
    behind = (bare_surface.group == INNER) & (places[:, 2] < -0.01)  # no further than a little beside what was seen
    torch.testing.assert_close(filled[behind], prior[behind], atol=0.02, rtol=0.0)


@pytest.mark.parametrize("strength", [0.0, 0.01, 0.02])
def test_skin_that_no_photo_shows_is_as_rough_as_what_is_seen(bare, bare_surface, strength):
    places = bare.anchor(bare.head.v_template).positions
    skin, front = (bare_surface.group == SKIN) & ~bare_surface.lips, places[:, 2] > 0.0
    start = torch.full((bare.gaussian_count, 3), 0.6)
    spots = strength * torch.randn(len(start), 1, generator=torch.Generator().manual_seed(1)).expand(-1, 3)
    filled = fill_colors(bare_surface, start, start, spots, front.to(start), *torch.zeros(2, len(start)))
    hidden = skin & (places[:, 2] < -0.02) & (bare_surface.below == 0.0)
    rough = float((filled - bare_surface.smooth(filled, 4.0))[hidden].std())
    shown = float((spots - bare_surface.smooth(spots, 4.0))[skin & front].std())
    assert abs(rough - GRAIN[0] * shown) < 0.15 * shown + 1e-4
    low = skin & (places[:, 2] < -0.02) & (bare_surface.below == 1.0)
    assert float((filled - bare_surface.smooth(filled, 4.0))[low].std()) < 0.4 * shown + 1e-4, "the neck is smoother"
    kept = skin & front & (bare_surface.beside == 0.0) & (bare_surface.lip_rim == 0.0)
    torch.testing.assert_close(filled[kept], spots[kept], atol=0.01 + strength, rtol=0.0)


def test_folded_lids_are_the_priors_however_dark_the_photo_shows_them(bare, bare_surface):
    start = torch.full((bare.gaussian_count, 3), 0.7)
    folded = (bare_surface.group == SKIN) & ~bare_surface.lips & (torch.arange(len(start)) % 7 == 0)
    for darker in (0.12, 0.5):
        changes = torch.where(folded[:, None], -darker, 0.0).expand(-1, 3)
        everything, nothing = torch.ones(len(start)), torch.zeros(len(start))
        filled = fill_colors(bare_surface, start, start, changes, everything, folded.to(start), nothing)
        assert abs(float(filled[folded].mean())) < 0.02
