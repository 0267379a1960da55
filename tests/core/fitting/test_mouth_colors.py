"""Mouths at rest: lips and teeth in the photo's tone, without its gloss, its teeth on lips, its lips on skin."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.fitting.inpainting import fill_colors
from grmm_core.fitting.mouth_colors import DETAIL, LIPS_DETAIL, TEETH_LIGHT
from grmm_core.fitting.objective import decode, draw
from grmm_core.fitting.recoloring import PhotoLight
from grmm_core.fitting.surface import INNER, SKIN, texel_surface
from grmm_core.geometry.camera import Camera
from grmm_core.light.resting import mouth_rows

PALE, RED, WHITE, DARK = (
    torch.tensor(color) for color in ([0.7, 0.55, 0.45], [0.7, 0.4, 0.35], [0.8, 0.78, 0.7], [0.3, 0.1, 0.1])
)
LIPSTICK = torch.tensor([0.8, 0.2, 0.25])


@pytest.fixture(scope="module")
def surface(bare):
    return texel_surface(bare)


@pytest.fixture(scope="module")
def prior(surface):
    """Skin, red lips that end a little inside the mesh's, white teeth, a dark mouth."""
    colors = PALE.repeat(len(surface.group), 1)
    colors[surface.lips & (surface.smooth(surface.lips[:, None].float(), 1.0)[:, 0] > 0.6)] = RED
    colors[surface.teeth] = WHITE
    colors[surface.inside] = DARK
    return colors


@pytest.fixture(scope="module")
def redness(surface, prior):
    """How far texels are amid red lips, 1, or away from them, 0: in between a border is soft."""
    return surface.smooth((surface.lips & (prior == RED).all(1))[:, None].float(), 1.0)[:, 0]


def filled(surface, prior, shown, seen=None):
    """Colors at rest of a person whom a photo shows so."""
    nothing = torch.zeros(len(prior))
    seen = torch.ones(len(prior)) if seen is None else seen
    return prior + fill_colors(surface, prior, prior, shown - prior, seen, nothing, nothing)


def test_lips_have_their_color_and_neither_gloss_nor_teeth(surface, prior, redness):
    shown, red = prior.clone(), (prior == RED).all(1)
    shown[red] = LIPSTICK
    shown[red & (torch.arange(len(prior)) % 3 == 0)] = WHITE
    red = redness > 0.98
    patches = red & (shown == WHITE).all(1)
    found = filled(surface, prior, shown)
    assert int(red.sum()) > 100
    assert float((found[red] - LIPSTICK).abs().max()) <= LIPS_DETAIL + 0.01
    assert float((found[patches].mean(0) - LIPSTICK)[1]) > 0.01, "a little of what else is shown stays"


def test_skin_around_lips_has_nothing_of_them(surface, prior, redness):
    shown = prior.clone()
    shown[surface.lips | (surface.lip_rim == 1.0)] = LIPSTICK  # tracked a little beside
    found, rim = filled(surface, prior, shown), (surface.lip_rim == 1.0) & (redness < 0.1)
    assert int((rim & (surface.group == SKIN)).sum()) > 20
    assert float((found[rim] - PALE).abs().max()) < 0.03
    edge = surface.lips & (prior == PALE).all(1)  # of the mesh's lips, and skin to see: as red as a soft border is there
    assert int(edge.sum()) > 3
    most = 0.03 + redness[edge] * float((LIPSTICK - PALE).abs().max())
    assert bool(((found[edge] - PALE).abs().amax(1) < most).all())


@pytest.mark.parametrize("factor", [[0.9, 0.88, 0.85], [0.5, 0.5, 0.6], [1.6, 1.5, 1.8]])
def test_teeth_have_a_tone_that_teeth_have(surface, prior, factor):
    shown = prior.clone()
    shown[surface.teeth] = prior[surface.teeth] * torch.tensor(factor)
    shown[surface.teeth & (torch.arange(len(prior)) % 4 == 0)] = DARK  # lips before them
    found = filled(surface, prior, shown)[surface.teeth]
    light = torch.tensor(factor).mean().clamp(*TEETH_LIGHT)
    assert float((found.median(0).values.mean() / WHITE.mean() - light).abs()) < 2.0 * DETAIL
    assert float((found - found.median(0).values).abs().max()) <= 2.0 * DETAIL + 1e-5
    blue = found[:, 2] / found[:, 0]
    assert float(blue.median()) < 1.12 * float(WHITE[2] / WHITE[0]), "never blue"


def test_a_mouth_that_shows_teeth_stays_dark_behind_them(surface, prior):
    shown = prior.clone()
    shown[surface.group == INNER] = WHITE
    found = filled(surface, prior, shown)[surface.inside]
    assert float((found - DARK).abs().max()) <= DETAIL + 1e-5


def test_where_no_photo_tells_a_mouth_it_is_the_priors(surface, prior, redness):
    mouth = surface.lips | surface.teeth | surface.inside
    found = filled(surface, prior, prior, (~mouth).float())
    mouth &= ~surface.lips | (redness > 0.98) | (redness < 0.02)
    torch.testing.assert_close(found[mouth], prior[mouth], atol=0.015, rtol=0.0)


def test_lips_have_no_hard_border(surface, prior, redness):
    found = filled(surface, prior, prior)
    border = (redness > 0.3) & (redness < 0.7) & surface.skin
    assert int(border.sum()) > 50
    redder = (PALE - found[border])[:, 1] / float((PALE - RED)[1])
    hard = (PALE - prior[border])[:, 1] / float((PALE - RED)[1])
    assert float(hard.min()) == 0.0
    assert float(((redder > 0.15) & (redder < 0.85)).float().mean()) > 0.9


def test_a_fit_can_make_lips_as_light_as_a_photo_shows_them(bare, surface):
    head, camera = bare.head_model, Camera.orbit(96, 96, distance=0.9, fov=12.0)
    counts = bare.config.z_id, head.shape_count, head.expression_count, (5, 3), len(ALIGNED_NAMES)
    inputs = bare.performed(*(torch.zeros(count) for count in counts))
    found, mesh = decode(bare, inputs, camera), bare.mesh(inputs).vertices
    assert float(bare.tone(mesh)[surface.lips].median()) < 0.95
    light = draw(bare, camera, mesh, found.recolored(torch.full_like(found.colors, 2.0)), refined=False)
    covered = light.alpha > 0.99
    assert float(light.raw[covered].min()) > 0.97, "not held before they are made darker"
    assert float(light.raw.max()) <= 1.0 + 1e-5


def test_local_light_on_lips_is_that_in_the_mouth_of_a_photo_whose_light_is_known(bare, surface):
    """As a session has it, or teeth that a fit made for other light would glow or be grey."""
    count, rows = len(surface.lips), mouth_rows(bare.head_model, bare.lit_texels.corners)
    even, factor = np.ones((2, count, 4), np.float32), np.ones((2, count, 3), np.float32)
    factor[:, surface.lips.numpy()] = 1.4
    light = PhotoLight.of(bare, even, np.ones(2)).times(factor, np.ones((2, count)), rows, [True, False])
    known, rig = light.ratios()
    teeth = surface.teeth.numpy()
    np.testing.assert_allclose(known[teeth], 1.25 * 1.4, rtol=1e-5)
    np.testing.assert_allclose(rig[teeth], 1.0)
    np.testing.assert_allclose(known[~teeth & ~surface.inside.numpy()], factor[0, ~teeth & ~surface.inside.numpy()])
