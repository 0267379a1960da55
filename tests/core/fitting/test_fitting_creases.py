"""Folds that belong to a photo's expression come and go with it; what lasts stays."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.fitting.creases import (
    PORES,
    STAYS,
    bringing,
    crease_colors,
    folds_brought,
    own_colors,
    soft_folds,
    strained,
)  # fmt: skip
from grmm_core.fitting.inpainting import gone_on
from grmm_core.fitting.surface import SKIN, texel_surface
from grmm_core.geometry.rotations import euler_to_matrix
from grmm_core.model.config import PRESETS
from grmm_core.model.decoders import ExpressionMaps
from grmm_core.model.grmm import GRMM
from grmm_core.model.parameters import EXPRESSION_MAPS

FOLD, FOREHEAD = 207, 10  # landmarks beside the mouth and at the hairline
TONE = torch.tensor([0.8, 0.6, 0.5])


def faces_of(head, **weights):
    """Vertices at rest and with ARKIT expressions."""
    expression = np.zeros(head.expression_count, np.float32)
    for name, value in weights.items():
        expression += value * head.arkit_to_expression[ARKIT_NAMES.index(name)]
    shape = np.zeros(head.shape_count, np.float32)
    rest = head.vertices(shape, np.zeros_like(expression), np.zeros((5, 3)))
    return rest, head.vertices(shape, expression, head.pose_of(expression, np.zeros((5, 3))))


def at_landmark(head, values, landmark):
    triangles, weights = head.landmarks478
    return float((values[head.faces[triangles[landmark]]] * weights[landmark]).sum())


def test_a_smile_strains_the_skin_beside_the_mouth_and_moving_the_head_none(head):
    rest, smiling = faces_of(head, mouthSmileLeft=0.8, mouthSmileRight=0.8)
    strain = strained(head, rest, smiling)
    assert at_landmark(head, strain, FOLD) > 0.15
    assert at_landmark(head, strain, FOREHEAD) < 0.01
    moved = rest @ euler_to_matrix(np.array([0.3, -0.5, 0.2])).T + 0.1
    assert strained(head, rest, moved).max() < 1e-3


@pytest.fixture(scope="module")
def model(head):
    torch.manual_seed(0)
    config = PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True)
    return GRMM(head, config).requires_grad_(False).eval()


def test_dark_lines_are_creases_where_skin_is_strained_and_marks_elsewhere(model):
    surface = texel_surface(model)
    colors = TONE.repeat(model.gaussian_count, 1)
    plain = torch.zeros(len(colors), dtype=torch.bool)
    dark = torch.zeros(len(colors), dtype=torch.bool)
    skin = torch.nonzero((surface.group == 0) & ~surface.lips)[:, 0]
    dark[skin[::97]] = True
    colors[dark] -= 0.3
    creases = crease_colors(surface, colors, torch.ones(len(colors)), plain)
    assert (creases[dark].mean(1) < -0.2 * (1.0 - STAYS)).all()
    assert (creases[dark].mean(1) > -0.3 * (1.0 - STAYS)).all()  # a part is seen at rest, too
    assert float(creases[~dark].abs().max()) < PORES
    assert not crease_colors(surface, colors, torch.zeros(len(colors)), plain).any()
    assert not crease_colors(surface, colors, torch.ones(len(colors)), ~plain).any()  # lips, lids and brows keep theirs


def test_dark_folds_go_where_skin_is_hardly_strained_and_moles_stay(model):
    surface = texel_surface(model)
    places = model.anchor(torch.as_tensor(np.array(model.head_model.v_template))).positions
    skin = (surface.group == SKIN) & ~surface.lips
    left = skin & (places[:, 0] > 0.0)
    fold = left & (places[:, 0] < 0.03) & (places[:, 1] - places[surface.lips, 1].max()).abs().lt(0.006)
    mole = torch.zeros_like(fold)
    mole[torch.nonzero(skin & ~left)[::97, 0]] = True
    colors = TONE.repeat(model.gaussian_count, 1)
    colors[fold | mole] -= 0.25
    plain, little = torch.zeros(len(colors), dtype=torch.bool), torch.full((len(colors),), 0.05)
    creases = crease_colors(surface, colors, little, plain)
    assert int(fold.sum()) > 8
    assert float(creases[fold].mean()) < -0.12 * (1.0 - STAYS)
    assert float(creases[mole].mean()) > -0.03 * (1.0 - STAYS)
    assert not crease_colors(surface, colors, 0.0 * little, plain).any()


def test_strong_folds_are_smoothed_where_skin_is_strained_and_hold_colors_that_screens_show(model):
    surface = texel_surface(model)
    places = model.anchor(torch.as_tensor(np.array(model.head_model.v_template))).positions
    skin = (surface.group == SKIN) & ~surface.lips & (places[:, 2] > 0.02)
    oblique = places[:, 1] + 0.7 * places[:, 0] - places[surface.lips, 1].max()
    line = skin & (places[:, 0] > 0.02) & (oblique.abs() < 0.002)
    pores = torch.zeros_like(line)
    pores[torch.nonzero(skin & (places[:, 0] < -0.01))[::9, 0]] = True
    colors = TONE.repeat(model.gaussian_count, 1)
    colors[line] -= torch.tensor([0.4, 0.7, 0.8])  # below black in blue, which cancels out between Gaussians that overlap
    colors[pores] -= 0.02
    none, strain = torch.zeros(len(colors), dtype=torch.bool), torch.ones(len(colors))
    soft, calm = soft_folds(surface, colors, strain, none), soft_folds(surface, colors, 0.0 * strain, none)
    assert int(line.sum()) > 8
    torch.testing.assert_close(calm, colors.clamp(0.0, 1.0))
    kept = (TONE - soft[line]).mean() / (TONE - calm[line]).mean()
    assert 0.3 < float(kept) < 0.85
    beside = skin & ~line & (oblique.abs() < 0.006) & (places[:, 0] > 0.02)
    assert float((calm - soft)[beside].mean()) > 0.005
    torch.testing.assert_close(soft[pores], colors[pores])
    torch.testing.assert_close(soft_folds(surface, colors, strain, ~none), colors)  # lips, lids and brows keep theirs


def test_what_made_up_for_the_priors_folds_does_not_come_out_at_rest(model):
    surface = texel_surface(model)
    generator = torch.Generator().manual_seed(4)
    maps = ExpressionMaps(6, 8, 5, model.gaussian_count).requires_grad_(False)
    maps.weights.weight.normal_(generator=generator)
    maps.maps.normal_(std=0.02, generator=generator)
    skin = (surface.group == SKIN) & ~surface.lips
    features, seen = ~skin, (model.anchor(torch.as_tensor(np.array(model.head_model.v_template))).positions[:, 0] > 0.0).float()
    z_id, rest, photo = torch.randn(3, 8, generator=generator)
    z_id, others = z_id[:6], 0.3 * torch.randn(12, 8, generator=generator)
    (brought,) = folds_brought(surface, maps, z_id, rest, [photo], features)
    painted = -brought * seen[:, None]  # the photo has no folds where it shows the skin
    prior = gone_on(surface, brought * seen[:, None], seen) * skin[:, None]
    before = maps(z_id, photo) + painted
    change = bringing(maps, z_id, rest, [photo], others).maps(-prior[None])
    painted = painted + prior - ((maps.weights(rest) * (1.0 + maps.gains(z_id))) @ change).view_as(prior)
    resting = maps(z_id, rest)
    maps.maps += change
    sure = skin & (surface.smooth(seen[:, None], 5.0)[:, 0] > 0.9)
    assert int(sure.sum()) > 500
    torch.testing.assert_close((maps(z_id, photo) + painted)[skin], before[skin], rtol=1e-3, atol=2e-3)
    assert float((maps(z_id, rest) + painted - resting)[sure].abs().max()) < 0.05 * float(brought[sure].abs().max())


def test_each_of_several_photos_has_its_own_folds(model):
    generator = torch.Generator().manual_seed(2)
    maps = ExpressionMaps(6, 8, 5, 40).requires_grad_(False)
    maps.weights.weight.normal_(generator=generator)
    z_id, rest, *shown = torch.randn(4, 8, generator=generator)
    z_id, others = z_id[:6], 0.3 * torch.randn(12, 8, generator=generator)
    folds = torch.randn(2, 40, 3, generator=generator)
    maps.maps += bringing(maps, z_id, rest, [rest + one for one in shown], others).maps(folds)
    for number, one in enumerate(shown):
        brought = maps(z_id, rest + one) - maps(z_id, rest)
        assert float((brought - folds[number]).norm()) < 0.25 * float(folds[number].norm())


def test_less_is_brought_of_an_expression_that_others_overdo():
    generator = torch.Generator().manual_seed(5)
    maps = ExpressionMaps(6, 8, 5, 40).requires_grad_(False)
    maps.weights.weight.normal_(generator=generator)
    rest, *shown = torch.randn(3, 8, generator=generator)
    z_id, others = torch.zeros(6), torch.stack([0.1 * shown[0], 2.5 * shown[1]])
    found = bringing(maps, z_id, rest, [rest + shown[0], rest + shown[1], rest], others)
    assert found.told.tolist() == [True, True, False]
    assert float(found.shares[0]) == float(found.shares[2]) == 1.0
    assert 0.35 < float(found.shares[1]) < 0.9
    reached = maps.weights(others) @ found.directions
    assert float((reached * found.shares[:2]).max()) < 1.001


def test_what_a_photo_shows_otherwise_is_a_fold_where_it_strains_the_skin(model):
    surface = texel_surface(model)
    skin = surface.group == SKIN
    difference = torch.zeros(len(skin), 3)
    line = torch.nonzero(skin).ravel()[::40]
    difference[line] = -0.2
    nothing, wide = torch.zeros(len(skin)), torch.full_like(difference, 0.1)
    none, one = torch.zeros(len(skin), dtype=torch.bool), torch.ones(())
    calm = own_colors(surface, difference, nothing, none, one)
    assert not calm.any()
    folded = own_colors(surface, difference, nothing + 1.0, none, one)
    assert (folded[line].mean(1) < -0.8 * 0.2).all()
    light = own_colors(surface, wide, nothing + 1.0, none, one)[skin]
    assert float(light.abs().mean()) < 0.05  # what is wide is light
    assert (own_colors(surface, wide, nothing, ~none, one) > 0.05).all()  # parts that move bring all
    doubted = own_colors(surface, difference, nothing + 1.0, none, 0.1 * one)  # what may be a shadow's edge
    torch.testing.assert_close(doubted, 0.1 * folded)


def test_creases_are_whole_in_the_photos_expression_and_gone_at_rest(model):
    generator = torch.Generator().manual_seed(1)
    maps = ExpressionMaps(6, 8, 5, 40).requires_grad_(False)
    maps.weights.weight.normal_(generator=generator)
    maps.gains.weight.normal_(std=0.1, generator=generator)
    maps.maps.normal_(std=0.05, generator=generator)
    z_id, rest, photo, *others = torch.randn(12, 8, generator=generator)
    z_id, others = z_id[:6], torch.stack(others)
    creases = torch.randn(40, 3, generator=generator)
    before = maps(z_id, photo), maps(z_id, rest)
    change = bringing(maps, z_id, rest, [photo], others).maps(creases[None])
    made_up = (maps.weights(rest) * (1.0 + maps.gains(z_id))) @ change
    maps.maps += change
    torch.testing.assert_close(maps(z_id, photo) - before[0] - made_up.view(40, 3), creases, rtol=1e-4, atol=1e-4)
    torch.testing.assert_close(maps(z_id, rest) - before[1] - made_up.view(40, 3), torch.zeros(40, 3), rtol=0, atol=1e-4)
    assert bringing(maps, z_id, rest, [rest], others) is None  # a photo of the face at rest shows no folds
    assert dict(model.named_parameters())[EXPRESSION_MAPS].ndim == 2
