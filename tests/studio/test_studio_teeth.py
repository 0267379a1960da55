"""The studio's teeth and its captures of open mouths."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.errors import ConfigError
from grmm_core.head.open_head import load_people_model
from grmm_studio.settings import CaptureSettings, check_settings, planned_shot
from grmm_studio.shots import around, make_mouth_shot
from grmm_studio.subjects import draw_subject
from grmm_studio.teeth import CROWNS, TEXELS, UPPER, TeethAtlas, paint_teeth


@pytest.fixture(scope="module")
def atlas(head):
    return TeethAtlas.build(head)


@pytest.fixture(scope="module")
def painted(atlas):
    people = load_people_model()
    return [paint_teeth(draw_subject(31, number, people), atlas) for number in (8, 12)]


def test_texels_know_their_place_on_the_arch(head, atlas):
    assert atlas.nearest.shape == (atlas.height, TEXELS)
    assert atlas.share < 0.2
    upper, outer = atlas.row == 0, ~atlas.inner
    for row in (upper, ~upper):
        assert abs(atlas.along[row].min() + atlas.along[row].max()) < 0.004  # metres; as far to the left as to the right
        assert atlas.along[row].max() > 0.06
    # the outer side of an incisor, from edge to gum, is in front of its inner side
    front = upper & (np.abs(atlas.along) < 0.004) & (atlas.off > 0.003) & (atlas.off < 0.009)
    assert atlas.rest[front & outer, 2].min() > atlas.rest[front & atlas.inner, 2].max()
    assert atlas.off.min() >= 0


def test_crowns_end_in_gums_and_people_differ(atlas, painted):
    for textures in painted:
        assert np.isfinite(textures.albedo).all()
        assert textures.albedo.min() >= 0
        assert textures.albedo.max() < 1
        gum = np.zeros(len(atlas.row))
        gum[atlas.nearest.ravel()] = textures.detail[..., 1].ravel()
        front = (atlas.row == 0) & ~atlas.inner & (np.abs(atlas.along) < 0.007)
        height = CROWNS[UPPER][0]
        assert gum[front & (atlas.off < 0.6 * height)].mean() < 0.05
        assert gum[front & (atlas.off > 1.2 * height)].min() > 0.95
        enamel = textures.albedo[textures.detail[..., 1] < 0.1]
        flesh = textures.albedo[textures.detail[..., 1] > 0.9]
        assert np.median(enamel[:, 1]) > 2 * np.median(flesh[:, 1])
    assert np.abs(painted[0].albedo - painted[1].albedo).mean() > 0.01


def test_teeth_are_apart(atlas, painted):
    """Along the middle of the crowns darker lines stand between teeth, about one a tooth's width."""
    for textures in painted:
        color = np.zeros(len(atlas.row))
        color[atlas.nearest.ravel()] = textures.albedo[..., 1].ravel()
        belt = (atlas.row == 0) & ~atlas.inner & (np.abs(atlas.off - 0.005) < 0.0004) & (np.abs(atlas.along) < 0.022)
        order = np.argsort(atlas.along[belt])
        along, shade = atlas.along[belt][order], color[belt][order]
        bins = np.arange(-0.022, 0.022, 0.0004)
        darkest = np.array([shade[(along >= b) & (along < b + 0.0004)].min(initial=1.0) for b in bins])
        lines = darkest < 0.75 * np.median(darkest)
        count = (lines[1:] & ~lines[:-1]).sum()
        assert 5 <= count <= 8  # six front teeth and parts of premolars


def test_mouth_shots_are_open_repeatable_and_from_near():
    opened = []
    for number in range(12):
        shot, again = make_mouth_shot(2, 3, number, 3, 64), make_mouth_shot(2, 3, number, 3, 64)
        np.testing.assert_array_equal(shot.aligned, again.aligned)
        np.testing.assert_array_equal(shot.cameras[2].world_to_camera, again.cameras[2].world_to_camera)
        weights = dict(zip(ALIGNED_NAMES, shot.aligned.tolist(), strict=True))
        assert 0 <= shot.aligned.min() <= shot.aligned.max() <= 1
        if number % 6 < 4:
            assert not any(weights[name] for name in ("mouthClose", "mouthPucker", "mouthStretchLeft", "laugh"))
            opened.append(weights["jawOpen"])
        else:
            assert weights["jawOpen"] <= 0.3
        camera = shot.cameras[0]
        assert camera.width / camera.fx * 1.1 < 0.1  # metres seen across at the mouth
    assert np.mean(np.array(opened) > 0.3) > 0.6


def test_cameras_are_moved_to_the_mouth():
    camera = make_mouth_shot(2, 3, 1, 1, 64).cameras[0]
    place = np.array([0.01, -0.05, 0.09])
    moved = around(camera, place)
    before, after = camera.project(np.zeros((1, 3))), moved.project(place[None])
    np.testing.assert_allclose(after[0], before[0], atol=1e-6)
    np.testing.assert_allclose(moved.position - camera.position, place, atol=1e-9)


def test_framing_is_a_setting_of_a_capture():
    mouth = planned_shot(CaptureSettings(framing="mouth", views=2, size=64), 0, 1)
    assert mouth.camera_names == ("mouth", "mouth")
    assert planned_shot(CaptureSettings(views=2, size=64), 0, 1).camera_names != mouth.camera_names
    with pytest.raises(ConfigError, match="--framing nose is not possible"):
        check_settings(CaptureSettings(framing="nose"))
