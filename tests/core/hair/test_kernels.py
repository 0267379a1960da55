"""Compiled loops of hair against the readable steps that they stand for."""

import numpy as np
import pytest

from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.hair.drawing import Hiding
from grmm_core.hair.packaged import library_groom
from grmm_core.hair.pigment import albedos
from grmm_core.hair.settings import HairSettings
from grmm_core.hair.strands import blocks_of
from grmm_core.head.open_head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def _skin(head):
    return np.asarray(head.faces)[np.asarray(head.uv_islands) == 0]


def _readable(vertices, faces, camera, cell):
    columns, rows = int(np.ceil(camera.width / cell)), int(np.ceil(camera.height / cell))
    coarse = Camera(
        camera.world_to_camera, camera.fx / cell, camera.fy / cell, camera.cx / cell, camera.cy / cell, columns, rows,
        orthographic=camera.orthographic,
    )  # fmt: skip
    depth = np.pad(triangle_depth(vertices[faces], coarse), 1, constant_values=EMPTY)
    for axis in (0, 1):
        depth = np.maximum(np.maximum(np.roll(depth, 1, axis), np.roll(depth, -1, axis)), depth)
    depth = depth[1:-1, 1:-1]
    scale = np.cbrt(np.linalg.det(camera.world_to_camera[:3, :3]))
    return np.where(depth < EMPTY, depth / scale, EMPTY)


@pytest.mark.parametrize("yaw", [0.0, 35.0, 180.0])
@pytest.mark.parametrize("distance", [1.1, 0.12])  # the nearer one stands in the head
def test_what_a_head_hides_is_the_readable_depth_of_its_triangles(head, yaw, distance):
    vertices = np.asarray(head.v_template, np.float32)
    camera = Camera.orbit(512, 384, yaw, 10.0, distance=distance)
    found = Hiding.of(vertices, _skin(head), camera)
    wanted = _readable(vertices, _skin(head), camera, found.cell)
    assert found.depth.shape == wanted.shape
    assert (wanted < EMPTY).sum() > 300
    off = np.abs(found.depth - wanted) > 1e-5 * wanted
    assert off.sum() <= 2, "cells that an edge meets in the very middle"


def test_roots_stand_where_the_readable_frames_are(head):
    vertices = np.asarray(head.v_template, float) + 0.002 * np.random.default_rng(1).normal(size=np.shape(head.v_template))
    for block in blocks_of(library_groom("bob").level(0.1), head.v_template, head.faces):
        for count in (None, 7):
            wanted, found = block.frames.at(vertices, count), block.frames.standing(vertices, count)
            for one, other in zip(wanted, found, strict=True):
                assert other.dtype == np.float32
                np.testing.assert_allclose(other, one, atol=2e-6)


def test_strands_that_are_kept_are_those_of_the_last_settings(head):
    (block, *_) = blocks_of(library_groom("bob").level(0.1), head.v_template, head.faces)
    for share, settings, detail in ((0.5, HairSettings(), 1.0), (0.5, HairSettings(grey=0.7), 1.0), (0.9, HairSettings(), 0.2)):
        radii, there, color = block.drawn(share, settings, detail)
        again = block.drawn(share, settings, detail)
        assert again[0] is radii
        wanted = block.level(share, settings, detail)
        np.testing.assert_array_equal(radii, wanted[0])
        np.testing.assert_array_equal(there, wanted[1])
        count = len(there)
        plain = albedos(settings, block.lock[block.owner[:count]], block.chance[:count, 1:], block.hairs, share)
        np.testing.assert_array_equal(color, plain)
