"""Which part of a photo's tint is its light's."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from grmm_core.fitting.inpainting import corners_of
from grmm_core.fitting.person_lights import found_lights
from grmm_core.fitting.types import PhotoTrack
from grmm_core.fitting.white_balance import FREE, SKIN_GREEN, cast
from grmm_core.geometry.camera import Camera
from grmm_core.head import load_open_head
from grmm_core.light.relight import to_display, to_linear
from grmm_core.model.config import PRESETS
from grmm_core.model.grmm import GRMM
from grmm_core.session import make_local_session

PALE, BROWN = np.array([0.55, 0.35, 0.29]), np.array([0.19, 0.085, 0.05])
SIZE = 128


def greenness(tone):
    red, green, blue = np.log(tone)
    return green - 0.5 * (red + blue) - SKIN_GREEN


@pytest.mark.parametrize("skin", [PALE, BROWN])
@pytest.mark.parametrize("tint", [0.3, -0.3])
def test_green_and_magenta_are_the_lights(skin, tint):
    seen = skin * np.exp([0.0, tint, 0.0])
    without = seen / cast(seen)
    assert abs(greenness(without)) <= FREE + 1e-6
    assert without @ [0.2126, 0.7152, 0.0722] == pytest.approx(seen @ [0.2126, 0.7152, 0.0722], rel=0.05)
    np.testing.assert_allclose(np.log(without[0] / without[2]), np.log(seen[0] / seen[2]), atol=1e-6)  # warm stays warm


def test_skin_in_plain_light_and_photos_without_colors_have_no_cast():
    for tone in (PALE, BROWN, PALE * [1.3, 1.0, 0.75], PALE * [0.85, 1.0, 1.3], np.full(3, 0.3), np.full(3, 1e-6)):
        np.testing.assert_allclose(cast(tone), 1.0, atol=1e-6)


def test_people_of_the_package_have_no_cast():
    with make_local_session(engine="torch") as session:
        model = session.engine.store.default().model
        face = torch.as_tensor(model.head_model.marked("face")[corners_of(model)].all(1))
        for seed in range(4):
            avatar = session.target(session.sample(seed).id).avatar
            z_id, shape = (torch.as_tensor(np.array(values)) for values in (avatar.z_id, avatar.shape))
            with torch.no_grad():
                colors = model.appearance(model.z_identity(z_id, shape), torch.tensor([0.0, 0.0, 1.0]))[0][face]
            tone = to_linear(colors.median(0).values.numpy().astype(np.float64))
            assert abs(greenness(tone)) < 0.05
            np.testing.assert_allclose(cast(tone), 1.0, atol=1e-6)


def photographed(head, color):
    """Found light and skin of a photo of which every pixel has a linear color."""
    model = GRMM(head, PRESETS["tiny"].replace(grid=64, decoder_grid=16, hairless=True))
    camera = Camera.orbit(SIZE, SIZE, distance=1.2, fov=20.0)
    picture = np.broadcast_to(np.asarray(to_display(color), np.float32), (SIZE, SIZE, 3))
    whole, marks = np.ones((SIZE, SIZE), np.float32), np.zeros((478, 2))
    track = PhotoTrack(
        "", picture, whole, whole, camera, camera, np.zeros(head.shape_count, np.float32),
        np.zeros(head.expression_count, np.float32), np.zeros((5, 3), np.float32), marks, marks, np.zeros(52),
    )  # fmt: skip
    lights, ratios, _ = found_lights(head, model.layout, [track], [(camera, picture, whole)])
    return lights[0], ratios[0]


def test_what_is_taken_out_of_the_skin_is_in_the_photos_light():
    head = load_open_head()
    seen = PALE * np.exp([0.0, 0.3, 0.0])
    (plain, _), (light, ratios) = (photographed(head, color) for color in (PALE, seen))
    assert abs(greenness(plain.tone)) < FREE
    assert abs(greenness(light.tone)) < FREE + 0.02
    shown = np.median(np.asarray(to_linear(to_display(light.tone * ratios[:, :3] / ratios[:, 3:]))), 0)
    assert greenness(shown) == pytest.approx(greenness(seen), abs=0.03)
