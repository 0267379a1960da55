"""The rig's light in colors that an expression changes."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.frame import Controls, resolve
from grmm_core.head import load_open_head
from grmm_core.light import expressed
from grmm_core.light.expressed import brightness, rig_in_colors, shut_eyes
from grmm_core.light.materials import materials_of
from grmm_core.light.resting import MOUTH, RestLight, Texels
from grmm_core.model.layout import texel_layout


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def texels(head):
    layout = texel_layout(head.uv, head.uv_faces, 128)
    return Texels.of(head, layout.face, layout.barycentric)


def test_the_rig_follows_colors_where_they_change_and_nowhere_else(head, texels):
    rig, count = np.full((len(texels.corners), 3), 2.0, np.float32), len(head.v_template)
    colors, at = np.full_like(rig, 0.5), texels.at(head.v_template)
    lids = (np.abs(at[:, 1] - head.v_template[head.marked("lids")][:, 1].mean()) < 0.02) & (at[:, 2] > 0.0)
    tint = np.float32(0.1) * np.repeat(lids[:, None], 3, 1)  # 1.44 times as bright
    rest, posed = (brightness(texels, colors, added, count) for added in (0.0 * tint, tint))
    nowhere = np.zeros(count, np.float32), np.full(count, 2.0, np.float32)
    found = rig_in_colors(rig, head, texels, rest, posed, *nowhere)
    mouth = head.marked(*MOUTH)[texels.corners]
    inside = lids & ~mouth.any(1)
    assert np.median(found[inside] / rig[inside]) == pytest.approx(1.44, rel=1e-3)
    touched = np.zeros(count, bool)
    touched[texels.corners[lids]] = True
    far = ~touched[texels.corners].any(1)
    assert far.mean() > 0.5
    np.testing.assert_allclose(found[far], rig[far], rtol=1e-5)
    np.testing.assert_allclose(rig_in_colors(rig, head, texels, rest, 0.1 * rest, *nowhere)[mouth.all(1)], 2.0, rtol=1e-5)


def test_lids_that_shut_hold_the_rig_of_shut_lids_and_nothing_else_does(head, texels):
    materials, grey = materials_of(head, *texels[:2]), np.full((len(texels.corners), 3), 0.6)
    rest = RestLight.of(head, texels, materials, head.v_template.astype(float), grey)
    lids, left = head.marked("lids"), head.v_template[:, 0] > 0.0

    def shut(*names, value=1.0):
        still, posed = (resolve(Controls().set_named(dict.fromkeys(here, value)), head) for here in ((), names))
        moved = [head.vertices(np.zeros(1), each.expression, each.pose) for each in (still, posed)]
        return shut_eyes(rest, rest.vertices + moved[1] - moved[0])

    wink, brows = shut("eyeBlinkLeft"), shut("browDownLeft", "browDownRight")
    half = shut("eyeBlinkLeft", "eyeBlinkRight", value=0.5)
    assert np.median(wink[lids & left]) > 0.95
    assert wink[lids & ~left].max() < 0.1
    assert brows[lids].max() < 0.25
    assert np.median(half[lids]) == pytest.approx(0.5, abs=0.05)
    assert not half[head.marked("neck", "lips", "ears")].any()
    rig, level = np.ones_like(grey, np.float32), np.ones(len(lids), np.float32)
    more, less = (rig_in_colors(rig, head, texels, level, level, wink, level * times) for times in (1.5, 0.5))
    near = ((wink > 0.95) & ~head.marked(*MOUTH))[texels.corners].all(1)
    assert near.sum() > 100
    np.testing.assert_allclose(more[near], 1.5, rtol=0.03)
    np.testing.assert_allclose(less, 1.0, rtol=1e-6)  # what loses light keeps the colors that it has
    assert np.quantile(rest.turned_out[lids & (wink > 0.95)], 0.9) > 1.1


def test_compiled_brightness_is_the_readable_one(head, texels, monkeypatch):
    random, count = np.random.default_rng(0), len(head.v_template)
    colors, tint = random.random((len(texels.corners), 3)), 0.3 * random.standard_normal((len(texels.corners), 3))
    fast = brightness(texels, colors, tint, count)
    monkeypatch.setattr(expressed, "compiled_kernels", lambda: None)
    np.testing.assert_allclose(fast, brightness(texels, colors, tint, count), rtol=1e-4, atol=1e-5)
