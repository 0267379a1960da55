"""Shade of narrow folds is light; marks on plain skin, and what the prior has as well, are the person's."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.fitting import fold_light
from grmm_core.fitting.fold_light import LEAST, FoldShade
from grmm_core.fitting.surface import SKIN, texel_surface
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM

TONE = torch.tensor([0.8, 0.6, 0.5])


class Skin:
    """A model's skin in one tone, furrowed on its left side, with moles on its right."""

    def __init__(self, model):
        self.surface = texel_surface(model)
        self.plain = (self.surface.group == SKIN) & ~self.surface.lips
        places = model.anchor(torch.as_tensor(np.array(model.head_model.v_template))).positions
        left = self.plain & (places[:, 0] > 0.02)
        self.furrows = left & ((places[:, 1] / 0.012).floor() % 2 == 0)  # several texels wide
        self.moles = torch.zeros_like(left)
        self.moles[torch.nonzero(self.plain & (places[:, 0] < -0.02))[::211, 0]] = True
        self.even = TONE.repeat(model.gaussian_count, 1)
        self.colors = self.even.clone()
        self.colors[self.furrows] = TONE * torch.tensor([0.6, 0.5, 0.45])  # shade is red
        self.colors[self.moles] = TONE * 0.5
        middle = places[torch.nonzero(self.plain)[places[self.plain][:, 2].argmax()]]
        self.hollow = torch.exp(-(((places - middle) / 0.012) ** 2).sum(1)) * self.plain
        self.within = left & (places[:, 0] > 0.035)

    def shown(self, colors, **given):
        """What even light shows."""
        expected = {"prior": self.even, "plain": self.plain} | given
        return FoldShade.of(self.surface, colors, **expected).without(colors)


@pytest.fixture(scope="module")
def skin(head):
    torch.manual_seed(0)
    config = PRESETS["tiny"].replace(grid=128, decoder_grid=16, hairless=True)
    return Skin(GRMM(head, config).requires_grad_(False).eval())


def contrast(colors, dark, where):
    """How much darker texels are than those around, in logarithms."""
    light = colors.clamp(min=1e-3).log().mean(1)
    return float(light[where & ~dark].mean() - light[where & dark].mean())


def test_furrows_are_seen_softly_and_moles_stay(skin):
    shown = skin.shown(skin.colors)
    before, after = (contrast(colors, skin.furrows, skin.within) for colors in (skin.colors, shown))
    assert LEAST * before < after < 0.8 * before
    kept = (shown - skin.even)[skin.moles] / (skin.colors - skin.even)[skin.moles]
    assert float(kept.mean()) > 0.9
    furrows = skin.furrows & skin.within
    tint = [float((colors[:, 0] / colors[:, 1])[furrows].mean()) for colors in (skin.even, shown, skin.colors)]
    assert tint[1] - tint[0] < 0.8 * (tint[2] - tint[0]), "red goes with the shade"


def test_shade_that_people_have_anyway_stays(skin, monkeypatch):
    """As that of nostrils, which the prior has, too."""
    monkeypatch.setattr(fold_light, "LEAST", 0.3)  # so that what goes is much
    dark = skin.even * (1.0 - 0.7 * skin.hollow[:, None])
    known, new = ((skin.shown(dark, **given) - dark)[skin.hollow > 0.5].mean() for given in ({"prior": dark}, {}))
    assert abs(float(known)) < 0.15 * float(new)
    assert float(new) > 0.02
    torch.testing.assert_close(skin.shown(skin.even), skin.even, atol=1e-3, rtol=0.0)


def test_other_parts_than_plain_skin_stay(skin):
    nothing = torch.zeros_like(skin.plain)
    torch.testing.assert_close(skin.shown(skin.colors, plain=nothing), skin.colors)
    half = skin.plain & ~skin.within
    shown = skin.shown(skin.colors, plain=half)
    torch.testing.assert_close(shown[skin.within], skin.colors[skin.within])
