"""Which of several photos is believed where, on skin whose colors are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.fitting.agreement import APART, agreement
from grmm_core.fitting.surface import SKIN, texel_surface
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM


@pytest.fixture(scope="module")
def skin(head):
    """A surface, its left half, and what lies amid each half."""
    torch.manual_seed(0)
    config = PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True)
    model = GRMM(head, config).requires_grad_(False).eval()
    surface = texel_surface(model)
    across = model.anchor(torch.as_tensor(np.array(head.v_template))).positions[:, 0]
    face = (surface.group == SKIN) & ~surface.lips & torch.as_tensor(head.marked("face")[head.faces[model.layout.face]].all(1))
    return surface, across > 0.0, face & (across > 0.04), face & (across < -0.04)


def test_a_shadow_that_one_photo_shows_alone_is_believed_less_there(skin):
    surface, left, amid_left, amid_right = skin
    shadowed, lit = torch.zeros(2, len(left), 3)
    shadowed[left] = -5.0 * APART
    believed = agreement(surface, torch.stack([shadowed, lit]), torch.ones(2, len(left)))
    assert float(believed[0, amid_left].max()) < 0.1
    assert float(believed[0, amid_right].mean()) > 0.98
    torch.testing.assert_close(believed[1], torch.ones(len(left)))


def test_what_all_photos_show_is_the_persons(skin):
    surface, left, *_ = skin
    mark = torch.zeros(len(left), 3)
    mark[left] = 10.0 * APART
    believed = agreement(surface, torch.stack([mark, mark]), torch.ones(2, len(left)))
    torch.testing.assert_close(believed, torch.ones_like(believed))


def test_a_photo_that_does_not_see_a_place_contradicts_none(skin):
    surface, left, amid_left, amid_right = skin
    mark, unseen = torch.full((len(left), 3), 10.0 * APART), torch.zeros(len(left), 3)
    seen = torch.stack([torch.ones(len(left)), torch.where(left, 0.0, 1.0)])
    believed = agreement(surface, torch.stack([mark, unseen]), seen)
    assert float(believed[0, amid_left].min()) == 1.0
    assert float(believed[0, amid_right].max()) < 0.1
    torch.testing.assert_close(agreement(surface, torch.stack([mark, unseen]), 0.0 * seen), torch.ones_like(believed))
