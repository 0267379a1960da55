"""Tied hair: what a knot holds keeps its length, tails do not, and other hair has no knots."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.knots import tied
from grmm_core.hair.strands import blocks_of, lengths_of
from grmm_core.head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.mark.parametrize(("name", "least", "most"), [("ponytail", 0.7, 0.8), ("bun", 0.97, 1.0), ("long", 0.0, 0.0)])
def test_a_knot_holds_what_ends_beside_it(head, name, least, most):
    held = tied(library_groom(name), np.asarray(head.v_template, float), head.faces)
    assert least <= held.mean() <= most


def test_hair_on_one_spot_is_no_knot(head):
    groom = library_groom("buzz")
    spot = groom.triangles == np.bincount(groom.triangles).argmax()
    assert not tied(groom.select(spot), np.asarray(head.v_template, float), head.faces).any()


@pytest.mark.parametrize(("length", "least", "most"), [(0.5, 0.45, 0.55), (2.0, 1.5, 2.0)])
def test_only_the_tail_gets_longer_or_shorter(head, length, least, most):
    for block in blocks_of(library_groom("ponytail").level(0.1), np.asarray(head.v_template, float), head.faces):
        before, after = (lengths_of(block.styled(HairSettings(length=factor))) for factor in (1.0, length))
        np.testing.assert_allclose(after[block.tied], before[block.tied], rtol=1e-6)
        free = ~block.tied
        assert least < after[free].mean() / before[free].mean() < most
