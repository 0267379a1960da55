"""Weights without hair: bare skin alone is painted, it stays closed, what is unseen is plain. Open head, no training."""

from __future__ import annotations

import pytest
import torch
from test_fitting_inpainting import SIZE, at, labels, track  # noqa: F401 - a fixture

from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.fitting.inpainting import fill_colors
from grmm_core.fitting.photo_targets import fit_view
from grmm_core.fitting.surface import INNER, SKIN, texel_surface
from grmm_core.head.open_head import load_open_head
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM


@pytest.fixture(scope="module")
def model():
    torch.manual_seed(0)
    return (
        GRMM(load_open_head(), PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True)).requires_grad_(False).eval()
    )


@pytest.fixture(scope="module")
def surface(model):
    return texel_surface(model)


def view_of(model, **changes):
    person = track(model.head_model, **changes)
    return fit_view(person, model.head_model, 0, SIZE, len(ALIGNED_NAMES), model.dtype, hairless=True)


def test_hair_cloth_and_background_are_no_targets_and_the_background_stays_empty(model):
    view, head = view_of(model), model.head_model
    image = view.image.numpy()
    painted = image[view.weight.numpy() > 0.5]
    assert len(painted) > 500
    assert float(abs(painted - [0.8, 0.6, 0.5]).max()) < 1e-5, "nothing but skin"
    assert at(view.weight, view, head, 1) == 1.0
    behind = view.mask.numpy() < 0.01
    assert float(view.empty.numpy()[behind].mean()) > 0.99
    assert float((view.empty * view.inside).sum()) == 0.0
    bearded = view_of(model, beard=True)
    assert at(bearded.weight, bearded, head, 18) == 1.0, "a beard is painted under its strands"


def test_a_scalp_is_skin(surface):
    assert set(surface.group.unique().tolist()) == {SKIN, INNER}


def test_skin_that_no_photo_shows_is_plain_and_what_is_seen_stays(model, surface):
    places = model.anchor(model.head.v_template).positions
    skin, front = surface.group == SKIN, places[:, 2] > 0.0
    start, changes = torch.full((model.gaussian_count, 3), 0.7), torch.zeros(model.gaussian_count, 3)
    shadow = skin & front & (places[:, 2] < 0.02)  # where the photo's hair begins
    changes[shadow] = -0.3
    filled = fill_colors(surface, start, changes, front.to(start), *torch.zeros(2, len(start)))
    kept = skin & front & (surface.beside == 0.0)
    assert int(kept.sum()) > 100
    torch.testing.assert_close(filled[kept], changes[kept], atol=0.03, rtol=0.0)
    assert float(filled[shadow & (surface.beside == 1.0)].max()) > -0.1, "shadows beside the face fade"
    assert float(filled[skin & (places[:, 2] < -0.05)].mean()) > -0.02


def test_lids_keep_their_crease_and_lose_what_is_black(model, surface):
    start = torch.full((model.gaussian_count, 3), 0.7)
    folded = (surface.group == SKIN) & (torch.arange(len(start)) % 7 == 0)
    for darker, least, most in ((0.12, -0.13, -0.1), (0.5, -0.1, 1e-6)):
        changes = torch.where(folded[:, None], -darker, 0.0).expand(-1, 3)
        filled = fill_colors(surface, start, changes, torch.ones(len(start)), folded.to(start), torch.zeros(len(start)))
        assert least < float(filled[folded].mean()) < most
