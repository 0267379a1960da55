"""A groom the other way round."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from grmm_core.errors import ShapeError
from grmm_core.hair import library_groom
from grmm_core.hair.mirror import mirrored
from grmm_core.head import load_open_head


def posed(groom, head):
    return groom.posed(groom.frames(head.v_template, head.faces), np.asarray(head.v_template, np.float64))


def test_a_mirrored_groom_is_the_image_in_the_mirror_and_twice_the_same():
    head, groom = load_open_head(), library_groom("side_part")
    other = mirrored(groom, head)
    np.testing.assert_allclose(posed(other, head), posed(groom, head) * [-1.0, 1.0, 1.0], atol=1e-6)
    np.testing.assert_allclose(posed(mirrored(other, head), head), posed(groom, head), atol=1e-6)


def test_a_lopsided_mesh_is_refused():
    head = load_open_head()
    turned = np.asarray(head.v_template) @ np.array([[0.8, 0.6, 0], [-0.6, 0.8, 0], [0, 0, 1.0]])
    head = dataclasses.replace(head, v_template=turned)
    with pytest.raises(ShapeError, match="both sides"):
        mirrored(library_groom("side_part"), head)
