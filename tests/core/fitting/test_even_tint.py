"""Which of a face's tints are the person's, on skin whose colors are known."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.fitting.even_tint import PEOPLE, even_tint
from grmm_core.fitting.surface import INNER, SKIN, texel_surface
from grmm_core.light.relight import to_display, to_linear
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM

WARM = torch.tensor([1.0, 0.0, -1.0])


@pytest.fixture(scope="module")
def skin(head):
    """A surface, where its texels lie from right to left in metres, and skin of the face that is no lip."""
    torch.manual_seed(0)
    model = GRMM(head, PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True)).requires_grad_(False).eval()
    surface = texel_surface(model)
    across = model.anchor(torch.as_tensor(np.array(head.v_template))).positions[:, 0]
    face = torch.as_tensor(head.marked("face")[head.faces[model.layout.face]].all(1))
    return surface, across, face & (surface.group == SKIN) & ~surface.lips & ~surface.brows & (surface.lip_rim == 0.0)


def tinted(strength):
    """Skin that is warmer by so much, [N, 3]."""
    return to_display(torch.tensor([0.4, 0.25, 0.2]) * torch.exp(strength[:, None] * WARM))


def warmth(colors):
    linear = to_linear(colors).log()
    return 0.5 * (linear[:, 0] - linear[:, 2])


def test_tints_stronger_than_peoples_go_and_lightness_stays(skin):
    surface, across, face = skin
    colors, plain = tinted(torch.where(across > 0.0, 0.2, -0.2)), tinted(0.0 * across)
    even = even_tint(surface, colors, plain, torch.ones(len(across)))
    before, after = (float(warmth(part)[face & (across.abs() > 0.03)].std()) for part in (colors, even))
    assert before == pytest.approx(0.2, rel=0.05)
    assert after < 0.4 * before
    torch.testing.assert_close(to_linear(even[face]).log().mean(1), to_linear(colors[face]).log().mean(1), atol=5e-3, rtol=0)


def test_peoples_own_tints_stay(skin):
    surface, across, face = skin
    colors, plain = tinted(torch.where(across > 0.0, PEOPLE, -PEOPLE)), tinted(0.0 * across)
    even = even_tint(surface, colors, plain, torch.ones(len(across)))
    torch.testing.assert_close(even[face], colors[face], atol=0.01, rtol=0)  # at its rims a little less
    # and what the mean person has is no tint of its own
    rosy = tinted(3.0 * PEOPLE * torch.cos(40.0 * across))
    torch.testing.assert_close(even_tint(surface, rosy, rosy, torch.ones(len(across)))[face], rosy[face], atol=1e-4, rtol=0)


def test_skin_that_no_photo_shows_goes_with_the_tint_of_what_one_shows(skin):
    surface, across, face = skin
    colors, plain = tinted(torch.where(across > 0.0, 0.15, 0.0)), tinted(0.0 * across)
    even = even_tint(surface, colors, plain, (across > 0.0).float())
    seen, unseen = (float(warmth(even)[face & side].mean()) for side in (across > 0.02, across < -0.02))
    assert seen == pytest.approx(float(warmth(colors)[face & (across > 0.02)].mean()), abs=0.01)
    assert 0.0 <= seen - unseen < 0.4 * 0.15
    torch.testing.assert_close(even_tint(surface, colors, plain, 0.0 * across), colors)  # of nothing nothing is told


def test_eyes_and_teeth_stay_and_lips_go_with_the_skin(skin):
    surface, across, _ = skin
    strength = torch.where(across > 0.0, 0.2, -0.2)
    lips = surface.lips & (across.abs() > 0.01)
    strength[lips] += 0.3
    colors, plain = tinted(strength), tinted(0.0 * across)
    even = even_tint(surface, colors, plain, torch.ones(len(across)))
    inner = surface.group == INNER
    torch.testing.assert_close(even[inner], colors[inner])
    left, right = (float(warmth(even)[lips & side].mean()) for side in (across > 0.0, across < 0.0))
    assert left - right < 0.25  # of 0.4
    assert 0.5 * (left + right) > 0.2
