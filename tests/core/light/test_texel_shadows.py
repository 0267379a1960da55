"""Shadows on texels: the same with fewer looks, smooth where texels are long, and points on what flat faces stand for."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.head import load_open_head
from grmm_core.light import resting, shading, texel_shadows
from grmm_core.light.lamps import Sun, soft_box
from grmm_core.light.materials import curvature
from grmm_core.light.resting import Texels, casters_of
from grmm_core.light.shading import facing
from grmm_core.light.shadows import Receivers, maps_of
from grmm_core.light.texel_shadows import TexelShadows
from grmm_core.light.transfer import vertex_normals
from grmm_core.model.layout import texel_layout

GRID = 256
NOON = Sun(direction=(0.2, 0.9, 0.4))


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def texels(head):
    layout = texel_layout(head.uv, head.uv_faces, GRID)
    return Texels.of(head, layout.face, layout.barycentric)


@pytest.fixture(scope="module")
def lying(head, texels):
    layout = texel_layout(head.uv, head.uv_faces, GRID)
    uv = layout.uv[head.uv_faces[layout.face]] * GRID
    return TexelShadows.of(GRID, layout.texel, texels.corners, uv, head.v_template, texels.at(head.v_template))


@pytest.fixture(scope="module")
def receivers(head, texels):
    return texels.receivers(head.v_template, vertex_normals(head.v_template, head.faces))


def look(lying, lamp, head, receivers):
    known = np.full(len(receivers.points), -1.0, np.float32)
    every = np.arange(len(known), dtype=np.int32)
    maps = maps_of(lamp, receivers, casters_of(head, head.v_template))
    lying.seen(maps, receivers, lying.split(every), known, head.v_template)
    return known, maps.seen(receivers)


def test_a_wide_lamp_is_looked_at_less_often_and_seen_the_same(head, lying, receivers):
    alone, others = lying.split(np.arange(len(receivers.points), dtype=np.int32))
    assert len(others) > 0.35 * len(receivers.points)
    assert len(alone) + len(others) == len(receivers.points)
    assert (lying.between[others] >= 0).all()
    assert not np.isin(lying.between[others], others).any()
    few, all_ = look(lying, soft_box(45, 35, 1.5, 0.5, 42), head, receivers)
    short = np.ones(len(few), bool)
    short[lying.long] = False
    assert np.abs(few - all_)[short].mean() < 2e-3
    assert (np.abs(few - all_)[short] > 0.1).mean() < 1e-3
    assert 0.1 < all_.mean() < 0.9


def test_compiled_and_readable_forms_agree(head, texels, lying, receivers, monkeypatch):
    lamp = soft_box(45, 35, 1.5, 0.5, 42)
    fast, _ = look(lying, lamp, head, receivers)
    normals = vertex_normals(head.v_template, head.faces)
    rows = np.arange(0, len(fast), 3, dtype=np.int32)
    through = np.random.default_rng(0).random(len(head.v_template)).astype(np.float32)
    dimmed, eye = fast.copy(), np.array([0.3, 0.1, 1.0])
    texels.dim(dimmed, rows, through)
    towards = facing(receivers, eye, -0.1)
    for module in (resting, shading, texel_shadows):
        monkeypatch.setattr(module, "compiled_kernels", lambda: None)
    slow, _ = look(lying, lamp, head, receivers)
    assert (np.abs(slow - fast) < 1e-3).mean() > 0.999  # but where what is around differs by as much as it may
    readable = texels.receivers(head.v_template, normals)
    np.testing.assert_allclose(readable.points, receivers.points, atol=2e-7)
    np.testing.assert_allclose(readable.normals, receivers.normals, atol=2e-6)
    again = fast.copy()
    texels.dim(again, rows, through)
    np.testing.assert_allclose(again, dimmed, atol=1e-6)
    assert (again[1::3] == fast[1::3]).all()
    assert (facing(receivers, eye, -0.1) == towards).mean() > 0.9999


def test_the_edge_of_a_shadow_is_even_on_the_long_texels_of_a_neck(head, lying, receivers):
    few, point_by_point = look(lying, NOON, head, receivers)
    beside = lying.beside
    whole = (beside != lying.long[:, None]).all(1)

    def roughness(seen):
        own, ends = seen[lying.long[whole]], seen[beside[whole]]
        return np.abs(ends.mean(1) - own).sum()

    assert roughness(few) < 0.8 * roughness(point_by_point)
    assert few[lying.long].mean() == pytest.approx(point_by_point[lying.long].mean(), abs=0.01)


@pytest.mark.parametrize("compiled", [True, False])
def test_long_texels_are_looked_at_where_the_skin_is_hollow_and_not_below_it(compiled, monkeypatch):
    if not compiled:
        monkeypatch.setattr(texel_shadows, "compiled_kernels", lambda: None)
    angles, radius = np.array([-0.15, 0.0, 0.15]), 0.06  # texels of 9 mm on a hollow neck
    points = radius * np.stack([np.zeros(3), np.sin(angles), 1.0 - np.cos(angles)], -1)
    plane = np.array([[0.0, 0.0, 0.0], [0.0, 0.009, 0.0], [0.009, 0.0, 0.0]])
    one, ends = np.array([1], np.int32), np.array([[0, 2]], np.int32)
    along = np.array([[-1.0, 1.0, 0.0]], np.float32)
    lying = TexelShadows(np.full((3, 4), -1, np.int32), one, along, ends, np.array([[0, 1, 2]], np.int32))
    normals = np.array([[0.0, 0.1, 1.0], [0.0, 0.0, 1.0], [0.0, -0.1, 1.0]])
    on_neck = Receivers.around(points.astype(np.float32), normals.astype(np.float32))
    there = lying._places(np.array([0], np.int32), on_neck, plane)
    places = there.points
    assert there.normals == pytest.approx(np.tile([0.0, 0.0, 1.0], (len(places), 1)))
    away = radius - np.linalg.norm(places - [0.0, 0.0, radius], axis=1)
    assert np.abs(away).max() < 5e-5
    assert np.ptp(places[:, 1]) == pytest.approx(1.8 * 0.009, rel=0.02)
    alone = lying._replace(beside=np.array([[1, 2]], np.int32))._places(np.array([0], np.int32), on_neck, plane)
    assert np.abs(alone.points[:, 2]).max() == 0.0  # beside the edge of the grid: in the plane of its face


def test_points_of_flat_faces_lie_nearer_to_the_round_form_and_never_below_the_faces(head, texels, receivers):
    polar, around = np.meshgrid(np.linspace(0.2, 2.9, 10), np.linspace(0, 6.0, 12), indexing="ij")
    points = 0.1 * np.stack([np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], -1).reshape(-1, 3)
    first = (12 * np.arange(9)[:, None] + np.arange(11)).ravel()
    corners = np.stack([first, first + 1, first + 13], -1).astype(np.int32)
    even = np.full((len(corners), 3), 1 / 3, np.float32)
    ball = Texels(np.arange(len(corners)), even, corners)
    off = [np.abs(np.linalg.norm(at, axis=1) - 0.1) for at in (ball.at(points), ball.receivers(points, points / 0.1).points)]
    assert (off[1] < 0.2 * off[0]).all()
    lifted = ((receivers.points - texels.at(head.v_template)) * receivers.normals).sum(1)
    assert lifted.min() > -1e-4
    assert lifted.max() < 3e-3


def test_curvature_is_that_of_a_ball():
    t = (1.0 + 5.0**0.5) / 2.0
    corners = np.array([[-1, t, 0], [1, t, 0], [-1, -t, 0], [1, -t, 0], [0, -1, t], [0, 1, t], [0, -1, -t], [0, 1, -t]])
    points = np.concatenate([corners, [[t, 0, -1], [t, 0, 1], [-t, 0, -1], [-t, 0, 1]]])
    points = 0.05 * points / np.linalg.norm(points[0])
    apart = np.linalg.norm(points[:, None] - points, axis=2)
    side = np.sort(apart[0])[1] * 1.01
    faces = [
        (a, b, c) if np.dot(np.cross(points[b] - points[a], points[c] - points[a]), points[a]) > 0 else (a, c, b)
        for a in range(12) for b in range(a) for c in range(b)
        if max(apart[a, b], apart[b, c], apart[a, c]) < side
    ]  # fmt: skip
    assert len(faces) == 20
    np.testing.assert_allclose(curvature(points, np.array(faces)), 1 / 0.05, rtol=1e-6)
