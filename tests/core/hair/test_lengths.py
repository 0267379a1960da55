"""Strands cut or grown on: what is left is the strand, what is added is like its end."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.hair.packaged import library_groom
from grmm_core.hair.strands import blocks_of, lengthened, lengths_of
from grmm_core.head.open_head import load_open_head

RADIUS, RISE = 0.004, 0.06  # metres, of a coil of six turns
ALONG = np.linspace(0.0, 1.0, 181)


def coil(along: np.ndarray) -> np.ndarray:
    angle = 12.0 * np.pi * along
    return np.stack([RADIUS * np.cos(angle), RADIUS * np.sin(angle), RISE * along], -1)


def turns(strand: np.ndarray) -> np.ndarray:
    """Angles between segments of a strand [K, 3], radians."""
    ways = np.diff(strand, axis=0)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    return np.arccos(np.clip((ways[1:] * ways[:-1]).sum(1), -1.0, 1.0))


@pytest.mark.parametrize("length", [1.1, 1.3, 1.6, 2.4])
def test_coils_go_on_as_coils(length):
    strand = coil(ALONG)
    grown = lengthened(strand[None], length)
    assert lengths_of(grown)[0] == pytest.approx(length * lengths_of(strand[None])[0], rel=0.02)
    assert grown[0, -1, 2] == pytest.approx(length * RISE, rel=0.02)
    assert np.hypot(*grown[0, :, :2].T).max() < 3.1 * RADIUS
    assert turns(grown[0]).max() < 1.5 * length * turns(strand).max(), "a kink"


@pytest.mark.parametrize("name", ["crop", "pixie", "bob"])
def test_the_grown_part_of_straight_hair_hardly_leaves_its_way(name):
    head = load_open_head()
    for block in blocks_of(library_groom(name), np.asarray(head.v_template, float), head.faces):
        grown = lengthened(block.points, 1.25)
        way = grown[:, -1] - block.points[:, -1]
        beyond = grown[:, np.linspace(0.0, 1.25, grown.shape[1]) > 1.0] - block.points[:, -1:]
        beside = np.linalg.norm(np.cross(beyond, way[:, None]), axis=2) / np.linalg.norm(way, axis=1)[:, None].clip(1e-9)
        assert np.median(beside.max(1) / np.linalg.norm(way, axis=1).clip(1e-9)) < 0.1


def test_straight_strands_go_on_straight():
    strand = ALONG[:, None] * np.array([0.1, -0.2, 0.05])
    np.testing.assert_allclose(lengthened(strand[None], 1.5)[0], 1.5 * strand, atol=1e-12)


def test_what_is_cut_keeps_its_course():
    strand = coil(ALONG)
    np.testing.assert_allclose(lengthened(strand[None], 0.5)[0, ::2], strand[: len(strand) // 2 + 1], atol=1e-12)
