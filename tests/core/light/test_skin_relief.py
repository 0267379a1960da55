"""Pores and furrows in highlights: as the readable form has them, bright as the mesh's in the mean, and still from afar."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import triangle_depth
from grmm_core.head import load_open_head
from grmm_core.light import mesh_light, shading
from grmm_core.light.lamps import Sun, soft_box
from grmm_core.light.materials import SKIN, Materials
from grmm_core.light.mesh_light import SHINE, LitSurface, TexelGrid
from grmm_core.light.resting import casting_numbers
from grmm_core.light.shading import Response, shade, transport
from grmm_core.light.shadows import Receivers
from grmm_core.light.skin_relief import LEVELS, SIDE, SOFTENED, VALUES, gleam, lying, softened, texel_ways, tile
from grmm_core.model.layout import texel_layout

GRID, TEXEL = 256, 0.0015  # metres
UP = np.array([[[TEXEL, 0.0, 0.0], [0.0, TEXEL, 0.0]]])
EYE = np.array([0.1, 0.05, 1.0])
LAMPS = (Sun(direction=(math.sin(1.0), 0.0, math.cos(1.0)), strength=3.0), soft_box(-40.0, 20.0, 1.0, 0.3, 20.0))


def everywhere(count=20000):
    return np.random.default_rng(0).random((count, 2)) * GRID


def shine(relief, step=0.02, detail=1.0, places=None, ways=UP):
    places = everywhere() if places is None else places
    tilts, lies = (np.tile(np.asarray(part, float), (len(places), 1)) for part in relief)
    return gleam(tilts, lies, np.repeat(ways, len(places), 0), places, np.full(len(places), step), GRID, detail)[0]


def rows(change=(0.0, 0.0, 0.0), fall=0.0, strength=1.0):
    return [*change, fall], [TEXEL, TEXEL, strength, 0.0]


def ball_of_skin(count=4000):
    g = np.random.default_rng(1)
    normals = g.normal(size=(count, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    looks = Materials(*(np.full(count, value, np.float32) for value in vars(SKIN).values()))
    return Receivers.around(normals * 0.1, normals), looks, g.random((2, count)).astype(np.float32)


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def skin(head):
    """The template in all light from a sun, with what its highlights do."""
    layout, (number, closed) = texel_layout(head.uv, head.uv_faces, GRID), casting_numbers(head)
    grid = TexelGrid.of(head.faces[number], head.uv, head.uv_faces[number], GRID, layout.texel, int(closed))
    relief = lying(head, head.v_template, layout.uv, GRID, layout.face)
    g = np.random.default_rng(2)
    tilts = np.concatenate([g.normal(size=(len(relief), 3)) * 5.0, g.random((len(relief), 1)) * 20.0], 1).astype(np.float32)
    light = np.ones((len(relief), 8), np.float32)
    light[:, SHINE] = 0.2
    return LitSurface(grid, head.v_template, light, tilts, relief)


def seen(surface, camera, monkeypatch=None):
    depth = triangle_depth(surface.vertices[surface.grid.faces], camera)
    channels = np.ones((camera.height, camera.width, 8), np.float32)
    if monkeypatch is not None:
        monkeypatch.setattr(mesh_light, "compiled_kernels", lambda: None)
    surface.read_into(channels, slice(0, 8), depth, np.ones_like(depth), None, camera)
    return channels, depth < 5.0


def test_the_tile_is_always_the_same_and_leans_nowhere():
    values, spread = tile()
    tile.cache_clear()
    np.testing.assert_array_equal(tile().values, values)
    assert len(values) == sum((SIDE >> k) ** 2 for k in range(LEVELS))
    np.testing.assert_allclose(values[: SIDE * SIDE].mean(0), 0.0, atol=1e-6)
    assert (np.diff(spread) < 0.0).all()  # the coarser, the smoother
    assert 0.05 < math.sqrt(spread[0]) < 0.2
    assert spread[-1] == 0.0


@pytest.mark.parametrize("step", [0.02, 0.3, 1.3])
@pytest.mark.parametrize("change", [(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (3.0, -8.0, 1.0)])
def test_highlights_are_as_bright_as_without_relief_in_the_mean(change, step):
    found = shine(rows(change, 30.0), step)
    assert found.mean() == pytest.approx(1.0, abs=0.06)
    assert found.std() > 0.01


def test_from_afar_relief_is_gone_and_on_the_way_it_only_fades():
    deviations = [shine(rows((4.0, 2.0, 0.0), 20.0), step).std() for step in (0.02, 0.08, 0.2, 0.5, 1.2, 3.0, 8.0)]
    assert (np.diff(deviations) <= 1e-9).all()
    assert deviations[-1] == 0.0


def test_nothing_jumps_from_one_size_to_the_next_or_on_the_grid():
    places = everywhere(500)
    steps = np.linspace(0.05, 0.8, 400)
    near = np.stack([shine(rows((4.0, 2.0, 0.0), 20.0), step, places=places) for step in steps])
    assert np.abs(np.diff(near, axis=0)).max() < 0.1
    line = np.stack([np.linspace(20.0, 60.0, 20000), np.full(20000, 33.3)], 1)
    assert np.abs(np.diff(shine(rows((4.0, 2.0, 0.0), 20.0), places=line))).max() < 0.1


def test_where_skin_is_pressed_together_it_is_rougher_and_where_stretched_smoother():
    change = (0.0, 3.0, 0.0)
    pressed, usual, stretched = (shine(rows(change), ways=UP * [[[1.0], [along]]]).std() for along in (0.8, 1.0, 1.2))
    assert pressed > 1.4 * usual
    assert stretched < 0.8 * usual


def test_strength_and_detail_at_nothing_change_nothing():
    for found in (shine(rows((4.0, 0.0, 0.0), 20.0, 0.0)), shine(rows((4.0, 0.0, 0.0), 20.0), detail=0.0)):
        np.testing.assert_array_equal(found, 1.0)


def test_a_tilt_changes_highlights_as_light_says():
    receivers, looks, seen_part = ball_of_skin()
    eye, nothing, still = EYE, np.zeros((len(looks.smooth), 9)), Response()
    parts = transport(LAMPS[:1], receivers, [seen_part[0]], looks, nothing, eye, still)
    colors = np.ones((1, 3))
    tilts = parts.tilts(colors, parts.light(colors, np.zeros((9, 3)))[1])
    half = np.asarray(LAMPS[0].direction) + EYE / np.linalg.norm(EYE)
    half /= np.linalg.norm(half)
    near = receivers.normals @ half
    chosen = (near > math.cos(0.5)) & (near < math.cos(0.1))
    aside = np.cross(receivers.normals, [0.0, 1.0, 0.0])
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    turned = receivers.normals + 1e-3 * aside
    turned /= np.linalg.norm(turned, axis=1, keepdims=True)
    other = transport(LAMPS[:1], replace(receivers, normals=turned), [seen_part[0]], looks, nothing, eye, still)
    measured = np.log(other.highlights[0][chosen] / parts.highlights[0][chosen]) / 1e-3
    told = (tilts[:, :3] * aside).sum(1)[chosen]
    assert len(told) > 100
    assert np.corrcoef(measured, told)[0, 1] > 0.95  # the cosine and what hides itself are left out
    assert np.abs(measured).mean() == pytest.approx(np.abs(told).mean(), rel=0.25)
    assert (tilts[:, 3] >= 0.0).all()


def test_the_compiled_tilts_are_the_readable_ones(monkeypatch):
    receivers, looks, seen_part = ball_of_skin()
    around = np.random.default_rng(3).random((9, 3)) * 0.1
    transfers = np.random.default_rng(4).random((len(looks.smooth), 9)).astype(np.float32) * 0.1
    found = []
    for compiled in (True, False):
        if not compiled:
            monkeypatch.setattr(shading, "compiled_kernels", lambda: None)
        tilts = np.empty((len(looks.smooth), VALUES + 3), np.float32)
        light = shade(LAMPS, receivers, seen_part, looks, transfers, EYE, around, tilts=tilts)
        found.append(tilts)
    there = light.front[:, 0] > 0.5
    np.testing.assert_allclose(found[0][there], found[1][there], rtol=2e-3, atol=2e-3)
    assert np.isfinite(found[0]).all()


@pytest.mark.parametrize("fov", [4.0, 25.0])
def test_the_compiled_relief_is_the_readable_one(skin, fov, monkeypatch):
    camera = Camera.orbit(128, 120, 20.0, 5.0, fov=fov, target=(0.02, 0.05, 0.08))
    fast, _ = seen(skin, camera)
    slow, there = seen(skin, camera, monkeypatch)
    smooth, _ = seen(skin._replace(tilts=None), camera, monkeypatch)
    assert (np.abs(slow - smooth).max(-1) > 0.004)[there].mean() > (0.3 if fov < 10.0 else 0.02)
    assert (np.abs(fast - slow).max(-1) > 2e-3).mean() < 3e-3  # pixels whose middle lies on an edge may see the other face
    np.testing.assert_array_equal(np.delete(slow, np.r_[SHINE], 2), np.delete(smooth, np.r_[SHINE], 2))


def test_irradiance_changes_with_tilts_as_leanings_say():
    receivers, looks, seen_part = ball_of_skin()
    aside = np.cross(receivers.normals, np.random.default_rng(5).normal(size=receivers.normals.shape))
    aside /= np.linalg.norm(aside, axis=1, keepdims=True)
    tilted = replace(receivers, normals=receivers.normals + 1e-4 * aside)
    still = Response(scattering=0.0)
    colors, none = np.ones((2, 3)), np.zeros((9, 3))
    rows_ = np.zeros((len(aside), 9))
    here, there = (transport(LAMPS, r, list(seen_part), looks, rows_, EYE, still) for r in (receivers, tilted))
    before, after = (parts.light(colors, none)[0] for parts in (here, there))
    told = (here.leanings(colors, before) * aside).sum(1)
    lit = before.mean(1) > 0.05
    np.testing.assert_allclose(((after - before) / before)[lit, 0] / 1e-4, told[lit], rtol=0.05, atol=0.02)


@pytest.mark.parametrize("fov", [4.0, 25.0])
def test_compiled_relief_in_irradiance_is_the_readable_one(skin, fov, monkeypatch):
    leaning = np.random.default_rng(6).normal(size=(len(skin.light), 3)).astype(np.float32)
    both = skin._replace(tilts=np.concatenate([skin.tilts, leaning], 1), softened=np.array(SOFTENED, np.float32))
    camera = Camera.orbit(128, 120, 20.0, 5.0, fov=fov, target=(0.02, 0.05, 0.08))
    fast, _ = seen(both, camera)
    slow, there = seen(both, camera, monkeypatch)
    assert (np.abs(fast - slow).max(-1) > 2e-3).mean() < 3e-3
    spread = [slow[..., channel][there].std() for channel in range(3)]
    assert spread[0] < spread[1] < spread[2]  # red light has wandered farthest
    np.testing.assert_allclose(slow[..., SHINE], seen(skin, camera, monkeypatch)[0][..., SHINE], atol=1e-5)


def test_irradiance_has_relief_in_close_ups_only():
    assert len(softened(512 / 0.35)) == 0  # a head in a picture of 512 pixels
    np.testing.assert_allclose(softened(768 / 0.15), SOFTENED)
    assert 0.0 < softened(2500.0)[2] < softened(3500.0)[2] < SOFTENED[2]


def test_relief_lies_on_the_skin_and_moves_with_it(skin, head):
    turn = np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])
    there = np.eye(4)
    there[:3, :3], there[:3, 3] = turn, (0.1, 0.2, 0.3)
    camera = Camera.orbit(96, 96, 20.0, 5.0, fov=6.0, target=(0.02, 0.05, 0.08))
    moved = skin.tilts.copy()
    moved[:, :3] = moved[:, :3] @ turn.T
    other = skin._replace(vertices=skin.vertices @ turn.T + there[:3, 3], tilts=moved)
    usual, carried = seen(skin, camera)[0], seen(other, camera.transformed(np.linalg.inv(there)))[0]
    assert (np.abs(usual - carried).max(-1) > 2e-3).mean() < 5e-3


def test_eyes_and_teeth_are_smooth_and_the_face_is_not(head):
    layout = texel_layout(head.uv, head.uv_faces, GRID)
    strength = lying(head, head.v_template, layout.uv, GRID, layout.face)[:, 2]
    corners = head.faces[layout.face]

    def of(name):
        return strength[np.isin(corners, head.regions[name]).all(1)]

    assert max(of(name).max() for name in ("left_eyeball", "upper_teeth", "tongue", "lashes")) == 0.0
    assert np.median(of("face")) > 0.9


def test_a_texels_ways_are_its_sides():
    places = np.array([[[0.0, 0.0], [2.0, 0.0], [0.0, 3.0]]])
    corners = np.array([[[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 0.0, 3.0]]])
    np.testing.assert_allclose(texel_ways(corners, places)[0], [[2.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


def test_highlights_that_took_something_off_stay(skin):
    dark = skin.light.copy()
    dark[:, SHINE] = -0.1
    camera = Camera.orbit(64, 64, fov=8.0, target=(0.0, 0.05, 0.08))
    fine, smooth = (seen(skin._replace(light=dark, tilts=tilts), camera)[0] for tilts in (skin.tilts, None))
    np.testing.assert_array_equal(fine, smooth)
