"""Coily hair is told from straight hair by its grain, and by nothing where there is none to see."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.fitting.hair_grain import coiliness, coils, waves, waviness
from grmm_core.geometry.camera import Camera
from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.coloring import WornHair
from grmm_core.hair.roots import SCALP
from grmm_core.head import load_open_head

SKIN = np.array([0.75, 0.56, 0.47])


def drawn(name, size=448):
    """A picture of a package's groom on the mean head, its cover, and where plain skin is."""
    head = load_open_head()
    vertices, camera = np.asarray(head.v_template, np.float64), Camera.orbit(size, size, 30.0, 6.0)
    settings = HairSettings(melanin=0.8)
    rgb, alpha = WornHair(library_groom(name), settings, vertices, camera, head).drawn(settings)
    return rgb + (1 - alpha[..., None]) * SKIN, alpha, alpha < 0.05


@pytest.mark.parametrize(("name", "coily"), [("coily", True), ("afro", True), ("bob", False), ("side_part", False)])
def test_grain_of_drawn_hair(name, coily):
    image, cover, skin = drawn(name)
    found = coiliness(image, cover, skin)
    assert found is not None
    assert (found > 0.7) if coily else (found == 0.0)


def test_noise_and_small_faces_tell_nothing():
    image, cover, skin = drawn("coily")
    assert coiliness(*(part[::4, ::4] for part in (image, cover, skin))) is None, "too few pixels"
    flat = np.where(cover[..., None] > 0.5, np.full(3, 0.2), SKIN)
    noisy = flat + np.random.default_rng(0).normal(0.0, 0.03, flat.shape)
    assert coiliness(noisy, cover, skin) is None, "the grain of the picture, which the skin has as well"


def test_waves_of_drawn_hair():
    metre = 448 / 0.45

    def of(name, share=1):
        image, cover, _ = drawn(name)
        return waviness(image[::share, ::share], cover[::share, ::share], metre / share)

    straight, wavy, ringlets = (of(name) for name in ("long", "wavy_long", "ringlets"))
    assert straight < 0.3 < wavy < ringlets
    assert of("long", 8) is None, "too few pixels"


def even(groom):
    return groom.resampled(24).points.reshape(len(groom), 24, 3)


def test_coils_of_strands():
    def of(name):
        groom = library_groom(name)
        rows = np.flatnonzero(groom.groups == SCALP)[::20]
        return coils(even(groom.select(rows)))

    assert of("coily") == of("afro") == 1.0
    assert 0.7 < of("fade") <= 1.0
    assert of("bob") == of("side_part") == of("long") == 0.0
    assert of("stubble") < 0.5, "too short to show any"


def test_waves_are_what_turns_to_and_fro():
    def of(name):
        groom = library_groom(name)
        rows = np.flatnonzero(groom.groups == SCALP)[::20]
        return waves(even(groom.select(rows)))

    assert of("stubble") < 0.05
    assert of("slick_back") < of("long") < 0.5, "a bend from root to tip is no wave"
    assert 1.8 < of("wavy_long") < of("ringlets")
