"""Shorn hair: drawn before the skin that it grows from, and straight in the package's grooms, where short curls stay curls."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.hair.drawing import MOST_RAISED, RAISED_SHORN, raised_by
from grmm_core.hair.packaged import library_groom
from grmm_core.hair.roots import BEARD, BROWS, GROUPS
from grmm_core.hair.strands import CROPPED, STUBBLE, blocks_of, lengths_of
from grmm_core.head import load_open_head

SHORT = 0.024  # metres


@pytest.fixture(scope="module")
def blocks():
    head = load_open_head()

    def of(name, part="scalp"):
        return blocks_of(library_groom(name, part=part), head.v_template, head.faces)

    return of


def test_shorn_hair_is_raised_and_longer_hair_less(blocks):
    """Gaussians of skin would else cover it in patches."""
    for name, part in (("buzz", "scalp"), ("long", "scalp"), ("fade", "scalp"), ("natural", "brows"), ("short", "beard")):
        for block in blocks(name, part):
            raised = raised_by(block, 0)
            if GROUPS[block.group] != "scalp":
                assert raised == 0.0
            elif block.length <= STUBBLE:
                assert raised == RAISED_SHORN
            elif block.length >= CROPPED:
                assert raised == 0.0
            else:
                assert 0.0 < raised < RAISED_SHORN
            assert raised_by(block, 1) >= 2 * raised
            assert (raised_by(block, 1) > 0.0) == (raised > 0.0 or block.group == BROWS)
            assert raised_by(block, 3) <= MOST_RAISED, "ears stand farther out than that"
            assert block.group != BEARD or raised_by(block, 3) == 0.0


def straight(blocks) -> np.ndarray:
    """The way from root to end over the length, of short strands [N]."""
    found = []
    for block in blocks:
        long = lengths_of(block.points)
        ways = np.linalg.norm(block.points[:, -1] - block.points[:, 0], axis=1)
        found.append((ways / long)[long < SHORT])
    return np.concatenate(found)


@pytest.mark.parametrize("name", ["afro", "coily"])
def test_short_curls_of_the_package_stay_curls(name, blocks):
    """Straightened they are black dots before and over the ears."""
    ways = straight(blocks(name))
    assert len(ways) > 20
    assert np.mean(ways > 0.93) < 0.05


def test_shorn_hair_of_the_package_is_straight(blocks):
    assert np.median(straight(blocks("buzz"))) > 0.9
