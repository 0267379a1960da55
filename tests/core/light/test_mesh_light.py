"""Light that is read from a mesh at each pixel: as the readable form has it, where the picture shows the mesh, and sharp."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.head import load_open_head
from grmm_core.light import mesh_light
from grmm_core.light.mesh_light import FAR, FRONT, NEAR, LitSurface, TexelGrid
from grmm_core.light.resting import casting_numbers
from grmm_core.model.layout import texel_layout

GRID, SIDE = 256, 96
LIGHT, SKIN = slice(2, 10), 1


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def lit(head, light):
    """A head with light [N, 7] by its texels' places on the template."""
    layout, (number, closed) = texel_layout(head.uv, head.uv_faces, GRID), casting_numbers(head)
    grid = TexelGrid.of(head.faces[number], head.uv, head.uv_faces[number], GRID, layout.texel, int(closed))
    places = np.einsum("nk,nkx->nx", layout.barycentric, head.v_template[head.faces[layout.face]])
    return LitSurface(grid, head.v_template, np.ascontiguousarray(light(places), np.float32))


def by_height(places):
    """Light that grows with the height, and is all seen."""
    rows = np.ones((len(places), 8))
    rows[:, 0] = 10.0 * places[:, 1]
    return rows


def seen(one, camera):
    return triangle_depth(one.vertices[one.grid.faces], camera)


def pictures(camera, generator):
    return generator.random((camera.height, camera.width, 12), dtype=np.float32) + 0.5


@pytest.mark.parametrize("orthographic", [False, True])
def test_compiled_light_is_the_readable_one(head, orthographic, monkeypatch):
    g = np.random.default_rng(3)
    one = lit(head, lambda places: g.random((len(places), 8)) + 0.1)
    camera = Camera.orbit(SIDE, SIDE + 10, 25.0, 10.0)
    if orthographic:
        camera = dataclasses.replace(camera, fx=300.0, fy=300.0, orthographic=True)
    depth = seen(one, camera) + g.normal(0.0, 0.004, (SIDE + 10, SIDE)).astype(np.float32)
    alpha, before = g.random(depth.shape, np.float32), pictures(camera, g)
    before[..., SKIN] = alpha * g.random(depth.shape, np.float32)
    fast, slow = before.copy(), before.copy()
    one.read_into(fast, LIGHT, depth, alpha, SKIN, camera)
    monkeypatch.setattr(mesh_light, "compiled_kernels", lambda: None)
    one.read_into(slow, LIGHT, depth, alpha, SKIN, camera)
    assert (np.abs(slow - before).max(-1) > 0.05).mean() > 0.1
    off = np.abs(fast - slow).max(-1) > 1e-3
    assert off.mean() < 2e-3  # pixels whose middle lies on an edge may see the other face
    np.testing.assert_array_equal(np.delete(fast, np.r_[LIGHT], 2), np.delete(before, np.r_[LIGHT], 2))


def test_light_stands_where_the_mesh_is_and_keeps_its_cover(head):
    one = lit(head, by_height)
    camera = Camera.orbit(SIDE, SIDE)
    depth = seen(one, camera)
    channels = np.zeros((SIDE, SIDE, 8), np.float32)
    channels[..., FRONT] = 0.5
    one.read_into(channels, slice(0, 8), depth, depth, None, camera)
    heights = (camera.cy - np.arange(SIDE)[:, None] - 0.5) / camera.fy * depth
    inside = np.abs(np.roll(depth, 1, 0) - np.roll(depth, -1, 0)) + np.abs(np.roll(depth, 1, 1) - np.roll(depth, -1, 1)) < 0.005
    off = np.abs(channels[..., 0] / 0.5 / 10.0 - heights)[inside & (depth < 5.0)]
    assert len(off) > 500
    assert np.median(off) < 3e-4
    assert np.percentile(off, 80) < 1e-3  # but at outlines
    np.testing.assert_allclose(channels[..., FRONT], 0.5, rtol=1e-5)


def test_what_stands_before_or_behind_the_mesh_keeps_its_light(head):
    one = lit(head, by_height)
    camera = Camera.orbit(SIDE, SIDE)
    depth = seen(one, camera)
    for away, changed in ((0.5 * NEAR, True), (FAR + 1e-3, False), (-FAR - 1e-3, False)):
        channels = np.full((SIDE, SIDE, 8), 0.25, np.float32)
        one.read_into(channels, slice(0, 8), depth + np.float32(away), depth, None, camera)
        assert (channels[..., 0] != 0.25).any() == changed
    channels = np.full((SIDE, SIDE, 9), 0.25, np.float32)
    channels[..., 8] = 0.0
    one.read_into(channels, slice(0, 8), depth, np.ones_like(depth), 8, camera)  # all strands
    assert (channels[..., :8] == 0.25).all()


def test_an_edge_of_light_is_as_sharp_as_texels(head):
    one = lit(head, lambda places: np.concatenate([places[:, :1] > 0.0, np.ones((len(places), 7))], 1))
    camera = Camera.orbit(256, 256, fov=8.0, target=(0.0, 0.09, 0.0))  # the forehead, 0.55 mm a pixel
    channels = np.ones((256, 256, 8), np.float32)
    one.read_into(channels, slice(0, 8), *2 * (seen(one, camera),), None, camera)
    row = channels[128, :, 0]
    between = ((row > 0.02) & (row < 0.98)).sum()
    assert row.min() < 0.01
    assert row.max() > 0.99
    assert 1 <= between <= 16  # three texels of less than 3 mm


def test_a_picture_does_not_depend_on_how_it_is_shared_out(head, monkeypatch):
    g = np.random.default_rng(4)
    one = lit(head, lambda places: g.random((len(places), 8)) + 0.3)
    camera = Camera.orbit(SIDE, SIDE)
    depth, before = seen(one, camera), pictures(camera, g)
    results = []
    for rows in (SIDE, 7):
        monkeypatch.setattr(mesh_light, "_ROWS", rows)
        results.append(before.copy())
        one.read_into(results[-1], LIGHT, depth, depth, None, camera)
    np.testing.assert_array_equal(*results)


def test_faces_at_the_camera_are_left_out(head):
    one = lit(head, by_height)
    camera = Camera.orbit(SIDE, SIDE, distance=0.05)
    channels = np.ones((SIDE, SIDE, 8), np.float32)
    one.read_into(channels, slice(0, 8), *2 * (seen(one, camera),), None, camera)
    assert np.isfinite(channels).all()
