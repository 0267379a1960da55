"""The groom that a photo shows: found among the package's, both ways round, with its color."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.fitting.hair_stage import directions, fit_hair
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.coloring import HairView, WornHair
from grmm_core.hair.mirror import mirrored
from grmm_core.head import load_open_head

SKIN = np.array([0.75, 0.56, 0.47])


def photo(groom, settings, yaw):
    """What a photo of the mean head with a groom shows, and its hair's true cover."""
    head = load_open_head()
    vertices, camera = np.asarray(head.v_template, np.float64), Camera.orbit(288, 288, yaw, 6.0)
    rgb, alpha = WornHair(groom, settings, vertices, camera, head).drawn(settings)
    image = rgb + (1 - alpha[..., None]) * SKIN
    return HairView(camera, vertices, image, alpha, np.ones_like(alpha))


@pytest.mark.parametrize(
    ("name", "flipped", "settings"),
    [("bob", False, HairSettings(melanin=0.3)), ("side_part", True, HairSettings(melanin=0.9, grey=0.5))],
)
def test_a_packaged_groom_is_found_again_with_its_color(name, flipped, settings):
    head = load_open_head()
    groom = mirrored(library_groom(name), head) if flipped else library_groom(name)
    hair = fit_hair([photo(groom, settings, yaw) for yaw in (-20.0, 35.0)], head)
    assert len(hair.groom) == len(groom)
    np.testing.assert_allclose(hair.groom.points, groom.points, atol=1e-6)
    assert abs(hair.settings.length - 1.0) < 0.3
    shown, again = (photo(groom, made, -20.0) for made in (settings, hair.settings))
    full = (shown.hair > 0.95) & (again.hair > 0.95)
    np.testing.assert_allclose(again.image[full].mean(0), shown.image[full].mean(0), atol=0.05)


def test_a_head_without_hair_is_bald():
    head = load_open_head()
    view = photo(library_groom("bob"), HairSettings(), 0.0)
    nothing = HairView(view.camera, view.vertices, view.image, np.zeros_like(view.hair), view.counts)
    assert fit_hair([nothing], head) is None


def test_directions_are_those_of_stripes():
    y, x = np.mgrid[0:40, 0:40] * 1.0
    for degrees in (0.0, 30.0, 90.0, 150.0):
        angle = np.radians(degrees)
        stripes = 0.5 + 0.4 * np.sin(0.8 * (x * np.sin(angle) - y * np.cos(angle)))
        seen = directions(np.repeat(stripes[..., None], 3, 2), np.ones((40, 40)))
        inner = (slice(8, -8),) * 2
        assert np.mean(seen.cosine[inner] * np.cos(2 * angle) + seen.sine[inner] * np.sin(2 * angle)) > 0.9
