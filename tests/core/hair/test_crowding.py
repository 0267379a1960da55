"""Strands on top are lighter than those below them."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.hair import HairSettings, library_groom
from grmm_core.hair.crowding import crowding
from grmm_core.hair.drawing import strand_gaussians
from grmm_core.hair.grid_kernels import fill
from grmm_core.hair.strands import blocks_of, means_between
from grmm_core.head import load_open_head

WIDTH = 0.0001


def layers(*heights: float, apart: float = 0.0002) -> np.ndarray:
    """Straight strands side by side over 4 cm, a layer of them at each height, [N, 9, 3] metres; light comes from above."""
    along, across = np.linspace(0.0, 0.04, 9), np.arange(0.0, 0.04, apart)
    x, y, z = np.meshgrid(across, np.array(heights), along, indexing="ij")
    return np.stack([x, y, z], -1).transpose(1, 0, 2, 3).reshape(-1, 9, 3)


def shares(points: np.ndarray) -> np.ndarray:
    """`crowding` of each layer's middle, where nothing ends."""
    way = np.broadcast_to([0.0, 1.0, 0.0], points.shape)
    found = crowding(points, np.full(len(points), WIDTH), way)
    each = found.reshape(-1, 200, 8)[:, 60:140, 2:6]
    return each.mean((1, 2))


def test_layers_on_top_are_lighter_and_deep_ones_are_alike():
    top_last = shares(layers(*np.arange(5) * 0.0012))
    assert (np.diff(top_last)[2:] > 0.1).all()  # three layers are looked ahead
    assert np.abs(np.diff(top_last)[:2]).max() < 0.02
    assert top_last[-1] > 1.2
    assert top_last[0] < 0.9


def test_a_single_layer_is_as_light_as_its_surroundings_tell():
    assert shares(layers(0.0)) == pytest.approx(1.0, abs=0.15)


def test_hair_pressed_flat_is_not_dark_on_top():
    """Its cells are dense, so that all in them was dark; one twentieth as dense hangs beside it."""
    pressed = layers(*np.arange(20) * 0.0002)
    loose = layers(*np.arange(5) * 0.002) + np.array([0.1, 0.0, 0.0])
    way = np.broadcast_to([0.0, 1.0, 0.0], (len(pressed) + len(loose), 9, 3))
    found = crowding(np.concatenate([pressed, loose]), np.full(len(way), WIDTH), way)
    on_top = found[: len(pressed)].reshape(20, 200, 8)[-1, 60:140, 2:6]
    assert on_top.mean() > 1.0


def test_hair_of_any_length_has_room():
    spread = layers(0.0, 0.001) * np.array([50.0, 4000.0, 50.0])  # 2 m wide and long, 4 m high
    found = crowding(spread, np.full(len(spread), WIDTH), np.broadcast_to([0.0, 1.0, 0.0], spread.shape))
    assert np.isfinite(found).all()


def test_what_is_filled_in_is_the_area_of_the_strands():
    points = np.random.default_rng(3).uniform(0.01, 0.09, (50, 6, 3)).astype(np.float32)
    widths = np.linspace(0.0001, 0.0003, 50, dtype=np.float32)
    grid = np.zeros((20, 20, 20), np.float32)
    fill(points, widths, np.zeros(3, np.float32), np.float32(0.005), grid)
    assert grid.sum() == pytest.approx((np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1) * widths).sum(), rel=1e-4)


def test_the_shades_of_a_groom_are_drawn_and_weaker_where_it_is_thin():
    head = load_open_head()
    template = np.asarray(head.v_template, float)
    (block,) = blocks_of(library_groom("bob").level(0.2), template, head.faces)
    origin, axes = block.frames.at(template)
    points = (np.matmul(block.points, axes) + origin[:, None]).astype(np.float32)
    crowded = block.crowded(points, axes)
    assert crowded.shape == (len(block), block.segments)
    assert np.isfinite(crowded).all()
    assert crowded.min() > 0.0

    def made(settings: HairSettings, given: np.ndarray | None) -> np.ndarray:
        return strand_gaussians(block, points, axes, settings, 1.0, whole=True, crowded=given)

    usual, thin = HairSettings(), HairSettings(density=0.5)
    even, shaded = made(usual, None), made(usual, crowded)
    assert np.array_equal(shaded.share.reshape(crowded.shape), crowded)
    assert (even.share == 1.0).all()
    darker, lighter = crowded.ravel() < 0.7, crowded.ravel() > 1.3
    assert (shaded.colors < even.colors)[darker].all()
    assert (shaded.colors > even.colors)[lighter].all()
    assert made(thin, crowded).share.std() < 0.7 * crowded.std()


def test_fewer_segments_have_the_mean_of_those_they_stand_for():
    found = means_between(np.arange(10.0, dtype=np.float32)[None].repeat(2, 0), np.array([0, 2, 4, 6, 8, 10]))
    np.testing.assert_allclose(found, [[0.5, 2.5, 4.5, 6.5, 8.5]] * 2)
