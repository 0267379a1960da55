from __future__ import annotations

import math

import numpy as np
import pytest

from grmm_core.errors import ConfigError
from grmm_core.light.surroundings import Surroundings, picture_directions, sphere


def normals(count=40):
    return sphere(count)[0]


def truth(picture, at):
    """Irradiance by summing over every pixel."""
    directions, solid = picture_directions(*picture.shape[:2])
    cosine = np.maximum(np.einsum("hwk,nk->nhw", directions, at), 0.0)
    return np.einsum("nhw,hw,hwc->nc", cosine, solid, picture)


def with_spots(around, at):
    total = around.irradiance(at)
    for spot in around.spots:
        total = total + np.maximum(at @ spot.direction, 0.0)[:, None] * spot.irradiance
    return total


def test_even_light_is_pi_times_its_radiance():
    found = Surroundings.even((0.5, 1.0, 2.0)).irradiance(normals())
    np.testing.assert_allclose(found, [[0.5 * math.pi, math.pi, 2 * math.pi]] * 40, rtol=1e-5)


def test_a_soft_sky_is_held_by_nine_numbers():
    directions, _ = picture_directions(64, 128)
    sky = np.exp(directions[..., 1:2] * [1.5, 0.7, 0.2])
    found = Surroundings.of_picture(sky)
    assert found.spots == ()
    np.testing.assert_allclose(
        with_spots(found, normals()), truth(sky, normals()), rtol=0.05, atol=0.03 * truth(sky, normals()).max()
    )


@pytest.mark.parametrize(
    ("around", "radius", "radiance", "share"),
    [(0.3, 2.5, (900.0, 700.0, 400.0), 0.03), (0.1, 14.0, (60.0, 45.0, 25.0), 0.05)],
    ids=["sun", "window"],
)
def test_the_sun_of_a_picture_and_a_window_become_lamps(around, radius, radiance, share):
    directions, _ = picture_directions(96, 192)
    towards = np.array([0.48, 0.64, 0.6])
    picture = np.full((96, 192, 3), around)
    picture[directions @ towards > math.cos(math.radians(radius))] = radiance
    found = Surroundings.of_picture(picture)
    (spot,) = found.spots
    assert spot.direction @ towards > math.cos(math.radians(1.0))
    assert math.degrees(spot.angle) == pytest.approx(2 * radius, rel=0.2 if radius < 5 else 0.1)
    exact = truth(picture, normals())
    np.testing.assert_allclose(with_spots(found, normals()), exact, atol=share * exact.max())


def test_light_turns_with_the_world():
    directions, _ = picture_directions(64, 128)
    sky = Surroundings.of_picture(np.maximum(directions[..., [1, 1, 0]], 0.0) + 0.1)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    np.testing.assert_allclose(sky.turned(turn).irradiance(normals() @ turn.T), sky.irradiance(normals()), atol=0.02)


def test_the_middle_of_a_picture_is_ahead_and_its_left_half_at_the_persons_left():
    directions, _ = picture_directions(8, 16)
    assert directions[4, 8] @ [0, 0, 1] > 0.9
    assert directions[4, 4] @ [1, 0, 0] > 0.9
    assert directions[0, 0] @ [0, 1, 0] > 0.9


@pytest.mark.parametrize(
    ("picture", "word"),
    [(np.zeros((4, 8)), "three colors"), (np.full((4, 8, 3), np.nan), "not finite"), (np.ones((1, 1, 3)), "rows")],
)
def test_pictures_that_are_no_surroundings_are_one_sentence(picture, word):
    with pytest.raises(ConfigError, match=word):
        Surroundings.of_picture(picture)
