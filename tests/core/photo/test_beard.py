"""Beards on chins: by the parser's share, and by what is dark there."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.photo.beard import Place, beard_on_chin

ROWS, COLUMNS = np.mgrid[:64, :64] / 64.0
DOWN, ACROSS = (ROWS - 0.5) * 0.16, (COLUMNS - 0.5) * 0.16  # metres from the middle of the lips
SKIN = np.hypot(DOWN, ACROSS * 1.2) < 0.075
PLACE = Place(ACROSS, DOWN - 0.006, -0.006 - DOWN, SKIN, np.zeros_like(SKIN))
JAW = DOWN > 0.0


def face(light_of_jaw, of_right=1.0):
    """Light of a face whose jaw and whose right half are darker or lighter, [64, 64]."""
    return 0.5 * np.where(JAW, light_of_jaw, 1.0) * np.where(ACROSS > 0.0, of_right, 1.0)


@pytest.mark.parametrize(
    ("share", "light", "is_one"),
    [
        (0.8, face(1.4), True),  # white hair, of which the parser is sure
        (0.5, face(0.9), False),  # colored light from below
        (0.1, face(0.2), True),  # dark hair, of which it is not
        (0.1, face(0.7), False),  # the shade of a chin
        (0.01, face(0.2), False),  # a hand, perhaps, of which it says that it is none
        (0.1, face(1.0, of_right=0.1), False),  # a face that is lit from one side
        (0.1, face(0.2, of_right=0.1), True),
    ],
)
def test_a_beard_is_what_the_parser_is_sure_of_or_what_is_much_darker_than_the_cheek_above_it(share, light, is_one):
    assert (beard_on_chin(np.full((64, 64), share), PLACE, light) is not None) == is_one


def test_dark_skin_of_a_bearded_chin_is_beard_and_lit_skin_beside_it_is_not():
    goatee = JAW & (np.abs(ACROSS) < 0.03)
    light = np.where(goatee, 0.05, np.where(JAW & (np.abs(ACROSS) > 0.045), 0.5, 0.2))
    light[~JAW] = 0.5
    found = beard_on_chin(np.full((64, 64), 0.3), PLACE, light)
    inside = found.around & SKIN
    assert found.dark[inside & goatee].min() == 1.0
    assert found.dark[inside & (light == 0.5)].max() == 0.0
    assert not found.around[~JAW].any()


def test_a_chin_that_is_not_seen_has_none():
    hidden = Place(ACROSS, DOWN - 0.006, -0.006 - DOWN, SKIN & ~JAW, np.zeros_like(SKIN))
    assert beard_on_chin(np.ones((64, 64)), hidden, face(0.1)) is None
