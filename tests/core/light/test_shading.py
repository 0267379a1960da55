"""What arrives at a ball and at a head, and what a picture becomes."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from grmm_core.head import load_open_head
from grmm_core.light import bounce, shading
from grmm_core.light import shadow_kernels as kernels
from grmm_core.light.bounce import Exchange, albedo_of
from grmm_core.light.hair_shading import CELL, HairCloud
from grmm_core.light.lamps import Lighting, Point, Spot, Sun, soft_box
from grmm_core.light.materials import MATERIALS, RELIEF, SKIN, Materials, materials_of
from grmm_core.light.relight import over_cover, relit, relit_pixels, to_display, to_linear
from grmm_core.light.shading import (
    LEAST_FRONT,
    MAX_RATIO,
    Arrived,
    Learned,
    Response,
    Transport,
    colors_of,
    ratio,
    relative,
    shade,
    transport,
    weight,
)
from grmm_core.light.shadows import RESOLUTION, Casters, Receivers, _map_at, compared, drawn, visible
from grmm_core.light.surroundings import Surroundings
from grmm_core.light.transfer import openness, transfer, turn_between, vertex_normals
from grmm_core.model.layout import texel_layout
from grmm_core.pictures.color import linear_to_srgb, srgb_to_linear


def ball(rows=24, columns=48, radius=0.1):
    polar, around = np.meshgrid(
        np.linspace(0, math.pi, rows), np.linspace(0, 2 * math.pi, columns, endpoint=False), indexing="ij"
    )
    points = radius * np.stack([np.sin(polar) * np.cos(around), np.cos(polar), np.sin(polar) * np.sin(around)], -1)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1], np.roll(index, -1, 1)[:-1], np.roll(index, -1, 1)[1:], index[1:]
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    points = points.reshape(-1, 3)
    return points, points / radius, faces


def plain(count):
    return Materials(*(np.full(count, value, np.float32) for value in vars(SKIN).values()))


def test_a_ball_hides_nothing_from_itself_and_sees_all_surroundings():
    points, normals, faces = ball()
    rows = transfer(points, normals, faces, directions=200)
    assert openness(rows).min() > 0.9
    sky = Surroundings.of_directions(
        normals, np.maximum(normals[:, [1, 1, 1]], 0.0) + 0.2, np.full(len(points), 4 * math.pi / len(points))
    )
    np.testing.assert_allclose(rows @ sky.coefficients, sky.irradiance(normals), rtol=0.15, atol=0.1)


def test_what_lies_behind_an_occluder_is_dark_and_a_wide_lamp_has_a_soft_edge():
    x = np.linspace(-0.1, 0.1, 401)
    receivers = Receivers.around(np.stack([x, 0 * x, 0 * x], -1), np.tile([0.0, 0.0, 1.0], (401, 1)))
    wall = np.array([[[0.0, -1.0, 0.3], [0.0, 1.0, 0.3], [-2.0, 0.0, 0.3]]])  # covers x < 0
    sun = visible(Sun(direction=(0.0, 0.0, 1.0)), receivers, walls(wall))
    assert sun[x < -0.004].max() == 0.0
    assert sun[x > 0.004].min() == 1.0
    wide = visible(soft_box(0.0, 0.0, 1.5, 0.6, 10.0), receivers, walls(wall))
    assert 0.2 < wide[200] < 0.8
    assert np.ptp(x[(wide > 0.05) & (wide < 0.95)]) > 5 * np.ptp(x[(sun > 0.05) & (sun < 0.95)])
    assert (np.diff(wide) > -1e-6).all()


def walls(triangles):
    return Casters(np.zeros((0, 3)), np.zeros((0, 3), int)).and_triangles(np.asarray(triangles, float))


@pytest.mark.parametrize("lamp", [Sun(direction=(0.6, 0.8, 0.0)), Point(position=(0.5, 0.1, 0.3))], ids=["sun", "point"])
def test_compiled_shadow_maps_are_the_readable_ones(lamp):
    points, normals, faces = ball(48, 96)
    receivers = Receivers.around(points, normals)
    floor = [[[-2.0, -0.1, -2.0], [2.0, -0.1, -2.0], [0.0, -0.1, 2.0]], [[0.3, 0.1, 0.0], [0.7, 0.1, 0.4], [0.5, 0.12, 0.3]]]
    casters = Casters(points, faces).and_triangles(np.array(floor))
    place = np.array(lamp.direction if isinstance(lamp, Sun) else lamp.position)
    seen_from = _map_at(lamp, place, receivers)
    readable = drawn(casters, seen_from)
    depth, crossing = np.full((RESOLUTION, RESOLUTION), 1e30, np.float32), np.empty(len(casters.faces), np.int32)
    meshes = casters.vertices.astype(np.float32), casters.faces.astype(np.int32)
    place = seen_from.turn.astype(np.float32), seen_from.shift.astype(np.float32)
    cut = kernels.draw_map(*meshes, 0, *place, seen_from.focal, seen_from.flat, 1e-3, depth, 1e30, crossing)
    if cut:
        np.minimum(depth, drawn(casters._replace(faces=casters.faces[crossing[:cut]]), seen_from), out=depth)
    assert (np.abs(np.minimum(depth, 99.0) - np.minimum(readable, 99.0)) < 1e-3).mean() > 0.998  # but for edges
    seen = visible(lamp, receivers, casters)
    assert (np.abs(seen - compared(depth, receivers, seen_from)) < 2e-3).mean() > 0.999  # but for ties
    assert 0.2 < seen.mean() < 0.8


def test_compiled_light_is_the_readable_one():
    points, normals, _ = ball()
    random = np.random.default_rng(0)
    receivers, rows = Receivers.around(points, normals), random.random((len(points), 9)).astype(np.float32)
    lamps = (
        soft_box(45, 35, 1.5, 0.5, 42), Sun((1.0, 0.5, 0.2), 2.0, direction=(0.6, 0.8, 0.0), angle=0.05),
        Point((0.2, 0.4, 1.0), 20.0, position=(0.3, 0.1, 0.5), radius=0.02),
        Spot(strength=30.0, position=(-0.5, 0.2, 0.6), direction=(0.6, -0.2, -0.75), cone=0.6),
    )  # fmt: skip
    seen = random.random((4, len(points))).astype(np.float32)
    seen[:, ::3], seen[:, 1::3] = 0.0, 1.0
    materials = Materials(*(random.uniform(0.1, 0.9, len(points)).astype(np.float32) for _ in range(6)))
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    harmonics, eye, response = random.random((9, 3)).astype(np.float32), np.array([0.1, 0.0, 1.0]), Response(1.3, 0.8, 2.0)
    for some in (lamps, ()):
        fast = shade(some, receivers, seen[: len(some)], materials, rows, eye, harmonics, response, turn)
        parts = transport(some, receivers, list(seen[: len(some)]), materials, rows, eye, response, turn)
        irradiance, highlights = parts.light(colors_of(some), harmonics)
        near = fast.front[:, 0] > shading.LEAST_FRONT
        np.testing.assert_allclose(fast.irradiance, irradiance, rtol=1e-4, atol=1e-4)
        np.testing.assert_allclose(fast.highlights[near], highlights[near], rtol=5e-3, atol=1e-4)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(shading, "compiled_kernels", lambda: None)
            plain = shade(some, receivers, seen[: len(some)], materials, rows, eye, harmonics, response, turn)
        np.testing.assert_allclose(fast.values, plain.values, rtol=5e-3, atol=2e-4)
        if some:  # the first, fourth, ... see no lamp: all is kept off that would arrive
            assert np.median(fast.share[1::3]) - np.median(fast.share[::3]) > 0.0
            assert np.median(fast.share[::3]) < 1e-3
        assert (fast.front.min(), fast.front.max()) == (np.float32(shading.LEAST_FRONT), 1.0)


def test_compiled_learned_light_is_the_readable_one(monkeypatch):
    arrived = Arrived(np.random.default_rng(0).random((50, 8)).astype(np.float32) ** 4)
    fast = Learned.of(arrived)
    monkeypatch.setattr(shading, "compiled_kernels", lambda: None)
    for found, wanted in zip(fast, Learned.of(arrived), strict=True):
        np.testing.assert_allclose(found, wanted, rtol=1e-6)
    assert (fast.rig > arrived.irradiance).any()  # colors say little about what the rig hardly reaches


def test_compiled_relative_light_is_the_readable_one(monkeypatch):
    random = np.random.default_rng(0)
    corners, weights = random.integers(0, 20, (50, 3)).astype(np.int32), random.dirichlet(np.ones(3), 50)
    learned = Learned(random.uniform(0.1, 1.0, (50, 3)), random.random((50, 3)))
    values, bounced = random.random((50, 8)).astype(np.float32), random.random((20, 3))
    values[:10, 6] = LEAST_FRONT
    inside = np.array([0.3, 0.2, 0.1])
    arguments = bounced, corners, weights, learned, 0.7
    fast, within = (relative(Arrived(values.copy()), *arguments, given) for given in (None, inside))
    monkeypatch.setattr(shading, "compiled_kernels", lambda: None)
    np.testing.assert_allclose(fast, relative(Arrived(values), *arguments), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(within, relative(Arrived(values), *arguments, inside), rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(within[10:], fast[10:])
    counts = weight(np.full((10, 1), LEAST_FRONT), learned.rig[:10])
    np.testing.assert_allclose(within[:10, :3], counts * inside / learned.rig[:10], rtol=1e-5)


def test_a_pixel_that_bright_and_dark_skin_share_is_lit_by_what_both_get_over_what_both_had():
    """As at the outline of a jaw before a neck: the mean of their ratios would be 3, and a bright line there."""
    rig = np.float32(math.pi) * np.array([[1.0, 1.0, 1.0], [0.1, 0.1, 0.1]], np.float32)
    arrived = np.zeros((2, 8), np.float32)
    arrived[:, :3], arrived[:, 6] = 0.5 * math.pi, 1.0
    nothing = np.zeros((0, 3), np.int32)
    light = relative(Arrived(arrived), nothing, nothing, nothing, Learned(rig, np.zeros_like(rig)), 1.0)
    each, together = light[:, :3] / light[:, 6:7], light[:, :3].mean(0) / light[:, 6].mean()
    np.testing.assert_allclose(each, [[0.5] * 3, [5.0] * 3], rtol=1e-5)
    np.testing.assert_allclose(together, 0.5 / 0.55, rtol=1e-5)


def test_a_lit_wall_lights_the_one_that_stands_on_it():
    side = np.linspace(0.0, 0.1, 21)
    u, v = (grid.ravel() for grid in np.meshgrid(side, side - 0.05, indexing="ij"))
    cells = 21 * np.arange(20)[:, None, None] + np.arange(20)[:, None]
    faces = np.concatenate([cells + np.array(corner) for corner in ([0, 21, 22], [0, 22, 1])]).reshape(-1, 3)
    floor, wall = np.stack([u, 0 * u, v], -1), np.stack([0 * u, u, v], -1)
    points, faces = np.concatenate([floor, wall]), np.concatenate([faces[:, ::-1], faces + len(floor)])
    normals = np.repeat([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]], len(floor), 0)
    exchange = Exchange.of(points, normals, faces, transfer(points, normals, faces))
    straight = np.zeros((len(points), 3))
    straight[: len(floor)] = [2.0, 1.0, 0.0]
    bounced = exchange.bounced(straight, np.array([0.5, 0.5, 0.5]))[len(floor) :]
    inner, low, high = np.abs(v) < 0.02, (u > 0.005) & (u < 0.03), u > 0.07
    assert 0.2 < bounced[inner & low, 0].mean() < 0.5  # a wide floor would give 2 * 0.5 / 2
    assert bounced[inner & high, 0].mean() < 0.5 * bounced[inner & low, 0].mean()
    np.testing.assert_allclose(bounced[:, 1], 0.5 * bounced[:, 0], rtol=1e-5)
    assert not bounced[:, 2].any()
    ball_points, ball_normals, ball_faces = ball()
    alone = Exchange.of(ball_points, ball_normals, ball_faces, transfer(ball_points, ball_normals, ball_faces, 200))
    assert alone.bounced(np.ones_like(ball_points), np.ones(3)).max() < 0.1


def test_the_compiled_search_for_givers_finds_those_of_the_plain_one(monkeypatch):
    head = load_open_head()
    vertices = np.asarray(head.v_template, np.float64)
    normals = vertex_normals(vertices, head.faces)
    given = vertices, normals, head.faces, transfer(vertices, normals, head.faces, 50)
    fast = Exchange.of(*given)
    monkeypatch.setattr(bounce, "compiled_kernels", lambda: None)
    plain = Exchange.of(*given)
    np.testing.assert_allclose(np.sort(fast.shares, 1), np.sort(plain.shares, 1), atol=1e-7)
    light = np.random.default_rng(0).random((len(vertices), 3))
    np.testing.assert_allclose(fast.bounced(light, np.ones(3)), plain.bounced(light, np.ones(3)), atol=1e-5)


def test_albedo_is_what_the_rig_shows():
    rig = np.full((10, 3), math.pi) * [1.0, 2.0, 1.0]
    colors = linear_to_srgb(np.tile([0.5, 0.5, 1.5], (10, 1)))
    assert albedo_of(colors, rig) == pytest.approx([0.5, 0.25, 0.9], abs=1e-3)


@pytest.mark.parametrize("lamp", [Sun(direction=(0.48, 0.6, 0.64)), Point(position=(0.1, 0.3, 0.2))], ids=["sun", "point"])
def test_hair_dims_what_lies_behind_it(lamp):
    random = np.random.default_rng(0)
    cloud = HairCloud.of(random.uniform(-0.05, 0.05, (4000, 3)), random.normal(0.0, 1.5e-6, (4000, 3)))
    points = np.concatenate([random.uniform(-0.12, 0.12, (300, 3)), [[-0.5, -0.5, -0.5]]])
    seen = cloud.through(lamp, points)
    np.testing.assert_allclose(seen, cloud.through_plain(lamp, points), atol=1e-4)
    assert seen[-1] == 1.0
    assert 0.1 < seen.min() < 0.8
    # as much as cylinders in locks, which lie every way, keep off on a way through the middle
    every_way = np.zeros((30, 30, 30, 6), np.float32)
    every_way[..., :3] = 1.0 / 3.0
    thick = HairCloud(np.full((30, 30, 30), 10.0, np.float32), every_way, np.full(3, -15 * CELL))
    assert thick.through(Sun(direction=(0.0, 1.0, 0.0)), np.zeros((1, 3))) == pytest.approx(
        math.exp(-10.0 * 14.5 * CELL), rel=0.05
    )


@pytest.mark.parametrize("strength", [0.5, 4.0])  # within what the polynomials reach, and beyond it
def test_compiled_pixels_are_the_readable_ones(strength):
    random = np.random.default_rng(0)
    alpha = random.random((9, 7)).astype(np.float32)
    alpha[0] = 0.0
    rgb, channels = random.random((9, 7, 3)) * alpha[..., None], random.random((9, 7, 9)) * strength * alpha[..., None]
    channels[..., 5:8] -= 0.25 * strength * alpha[..., None]
    channels[..., 8] = alpha * random.uniform(0.5, 1.0, alpha.shape)
    rgb, channels = rgb.astype(np.float32), channels.astype(np.float32)
    light = over_cover(channels[..., 2:], alpha)
    np.testing.assert_allclose(
        relit_pixels(rgb, alpha, channels, 2), relit(rgb, alpha, light[..., :3], light[..., 3:6]), atol=1e-5
    )


def test_a_wide_lamp_shines_as_many_small_ones_in_its_place():
    points, normals, _ = ball(radius=0.1)
    receivers, eye = Receivers.around(points, normals), np.array([0.0, 0.0, 1.0])
    skin = Materials(*(np.full(len(points), value, np.float32) for value in vars(SKIN).values()))
    wide = soft_box(40.0, 20.0, 1.5, 0.5, 40.0)
    spread = (np.arange(8) + 0.5) / 4.0 - 1.0
    places = [np.add(wide.position, a * np.array(wide.across) + b * np.array(wide.up)) for a in spread for b in spread]
    small = tuple(
        replace(wide, position=at, strength=40.0 / 64, across=np.divide(wide.across, 8), up=np.divide(wide.up, 8))
        for at in places
    )  # fmt: skip
    shine = []
    for lamps in ((wide,), small):
        seen = np.ones((len(lamps), len(points)), np.float32)
        rows = np.zeros((len(points), 9), np.float32)
        shine.append(shade(lamps, receivers, seen, skin, rows, eye, np.zeros((9, 3))).highlights[:, 0])
    assert shine[0].max() == pytest.approx(shine[1].max(), rel=0.05)
    front = points[:, 2] > 0.0
    assert shine[0][front].sum() == pytest.approx(shine[1][front].sum(), rel=0.05)


def test_what_a_lamp_makes_of_the_far_side_does_not_shine_through():
    points, normals, faces = ball()
    receivers, eye = Receivers.around(points, normals), np.array([0.0, 0.0, 1.0])
    behind, skin = Sun(strength=5.0, direction=(0.0, 0.0, -1.0)), [np.full(len(points), 0.5, np.float32) for _ in range(6)]
    seen, rows = visible(behind, receivers, Casters(points, faces))[None], np.zeros((len(points), 9), np.float32)
    arrived = shade((behind,), receivers, seen, Materials(*skin), rows, eye, np.full((9, 3), 0.1))
    rig, nothing = np.ones((len(points), 3), np.float32), np.zeros((len(points), 3), np.float32)
    corners = np.zeros((len(points), 3), np.int32)
    light = relative(arrived, nothing, corners, nothing, Learned(rig, nothing), 1.0)
    near, far = points[:, 2].argmax(), points[:, 2].argmin()
    pixel = 0.9 * light[near] + 0.1 * light[far]  # nine tenths of what is in front, and what is left of what is behind
    assert pixel[:3].max() / pixel[6] < 0.02


def test_the_nose_throws_a_shadow_on_the_cheek_away_from_the_lamp():
    head = load_open_head()
    vertices = head.v_template.astype(float)
    receivers = Receivers.around(vertices, vertex_normals(vertices, head.faces))
    sun = Sun(direction=(math.sin(1.2), 0.1, math.cos(1.2)))
    seen = visible(sun, receivers, Casters(vertices, head.faces))
    beside = np.abs(vertices - [-0.022, -0.005, 0.095]).max(1) < 0.010  # at the right side of the nose
    mirrored = (np.abs(vertices - [0.022, -0.005, 0.095]).max(1) < 0.010) & (receivers.normals @ sun.direction > 0.3)
    assert seen[beside].mean() < 0.4
    assert seen[mirrored].mean() > 0.85  # all but the nostril


def test_light_of_a_sun_is_lamberts_on_matt_skin_and_wanders_further_in_red():
    points, normals, _ = ball()
    receivers, sun = Receivers.around(points, normals), Sun(direction=(0.0, 0.0, 1.0), strength=2.0)
    none = np.zeros((len(points), 9))
    seen = [np.ones(len(points))]
    even_skin = replace(plain(len(points)), rough=np.zeros(len(points), np.float32))  # without pores and wrinkles
    dull = transport((sun,), receivers, seen, even_skin, none, np.array([0, 0, 2.0]), Response(scattering=0.0))
    np.testing.assert_allclose(dull.diffuse[0], np.maximum(normals[:, 2:], 0.0) * [[2.0] * 3], atol=1e-5)
    wide = transport((sun,), receivers, seen, even_skin, none, np.array([0, 0, 2.0])).diffuse[0]
    assert wide[normals[:, 2] < -0.02].max() == 0.0  # a millimetre is little on a ball like a head
    nose = replace(even_skin, curvature=np.full(len(points), 100.0, np.float32))
    skin = transport((sun,), receivers, seen, nose, none, np.array([0, 0, 2.0])).diffuse[0]
    beyond = (normals[:, 2] < -0.01) & (normals[:, 2] > -0.1)
    assert (skin[beyond, 0] > 2 * skin[beyond, 1]).all()
    # the same light all in all: the mean over the ball of max(0, (c + w) / (1 + w)^2) is 1/4 for every w
    even = np.sqrt(np.maximum(1.0 - normals[:, 1] ** 2, 0.0))[:, None]  # the grid's points crowd at the poles
    assert (skin * even).sum(0) == pytest.approx(np.full(3, (dull.diffuse[0] * even)[:, 0].sum()), rel=0.03)


def test_pores_soften_the_terminator_of_skin_alone():
    points, normals, _ = ball()
    receivers, sun = Receivers.around(points, normals), Sun(direction=(0.0, 0.0, 1.0))
    given = (sun,), receivers, [np.ones(len(points))]
    eye, still = np.array([0, 0, 2.0]), Response(scattering=0.0)
    none, count = np.zeros((len(points), 9)), len(points)
    skin = transport(*given, plain(count), none, eye, still).diffuse[0, :, 0]
    ivory = Materials(*(np.full(count, value, np.float32) for value in vars(MATERIALS["left_eyeball"]).values()))
    smooth = transport(*given, ivory, none, eye, still).diffuse[0, :, 0]
    cosine = np.maximum(normals[:, 2], 0.0)
    beside = np.abs(normals[:, 2]) < 1e-9
    assert skin[beside] == pytest.approx(RELIEF * SKIN.rough**2, rel=1e-4)
    assert (skin - cosine)[normals[:, 2] > 0.5].max() < 2e-3
    assert skin[normals[:, 2] < -0.2].max() < 4e-3
    assert np.abs(smooth - cosine).max() < 0.3 * np.abs(skin - cosine).max()
    order = np.argsort(normals[:, 2])
    assert (np.diff(skin[order]) >= -1e-7).all()


def test_highlights_stand_where_a_mirror_would_throw_the_lamp():
    points, normals, _ = ball(96, 192)
    receivers = Receivers.around(points, normals)
    lamp, eye = Sun(direction=(math.sin(1.0), 0.0, math.cos(1.0))), np.array([0.0, 0.0, 50.0])
    rows = np.zeros((len(points), 9))
    shine = transport((lamp,), receivers, [np.ones(len(points))], plain(len(points)), rows, eye).highlights[0]
    half = np.array([math.sin(0.5), 0.0, math.cos(0.5)])
    assert normals[shine.argmax()] @ half > math.cos(0.15)
    wet = Materials(*(np.full(len(points), v, np.float32) for v in (0.1, 0.2, 1.0, 0.04, 1.0, 0.0)))
    sharp = transport((lamp,), receivers, [np.ones(len(points))], wet, rows, eye).highlights[0]
    assert sharp.max() > 5 * shine.max()
    assert (sharp > 0.1 * sharp.max()).sum() < 0.3 * (shine > 0.1 * shine.max()).sum()


def test_light_is_linear_in_its_colors_and_has_gradients():
    points, normals, faces = ball()
    rows = transfer(points, normals, faces, directions=60)
    lamps = (Sun(direction=(0.0, 0.0, 1.0)), soft_box(60.0, 20.0, 1.0, 0.3, 20.0))
    parts = transport(
        lamps, Receivers.around(points, normals), [np.ones(len(points))] * 2, plain(len(points)), rows, np.array([0, 0, 1.0])
    )
    colors, sky = (
        np.array([[1.0, 0.5, 0.2], [0.1, 0.2, 0.9]], np.float32),
        np.random.default_rng(0).random((9, 3)).astype(np.float32),
    )
    irradiance, shine = parts.light(colors, sky)
    twin = Transport(*(torch.from_numpy(part) for part in vars(parts).values()))
    color, around = torch.from_numpy(colors).requires_grad_(), torch.from_numpy(sky).requires_grad_()
    irradiance_2, shine_2 = twin.light(color, around)
    np.testing.assert_allclose(irradiance_2.detach(), irradiance, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(shine_2.detach(), shine, rtol=1e-4, atol=1e-6)
    irradiance_2.sum().backward()
    np.testing.assert_allclose(color.grad, parts.diffuse.sum(1), rtol=1e-3)
    np.testing.assert_allclose(around.grad, np.repeat(parts.ambient.sum(0)[:, None], 3, 1), rtol=1e-3, atol=1e-2)


def test_ratios_stay_finite_where_the_rig_is_dark():
    found = ratio(np.array([[1.0, 1.0, 1.0], [2.0, 2.0, 2.0]]), np.array([[0.0, 0.0, 0.0], [2.0, 2.0, 2.0]]))
    assert found.max() <= MAX_RATIO
    assert found[1] == pytest.approx(np.ones(3), rel=2e-3)


def test_a_picture_in_the_light_it_was_learned_in_is_the_same():
    random = np.random.default_rng(0)
    alpha = random.random((6, 7)).astype(np.float32)
    alpha[0, 0] = 0.0
    rgb = random.random((6, 7, 3)).astype(np.float32) * alpha[..., None]
    same = relit(rgb, alpha, np.repeat(alpha[..., None], 3, -1), np.zeros_like(rgb))
    np.testing.assert_allclose(same, rgb, atol=2e-6)
    brighter = relit(
        torch.from_numpy(rgb), torch.from_numpy(alpha), torch.from_numpy(alpha[..., None] * 2.0), torch.zeros(6, 7, 3)
    )
    covered = alpha > 0.1
    expected = linear_to_srgb(2 * srgb_to_linear(rgb[covered] / alpha[covered][:, None])) * alpha[covered][:, None]
    np.testing.assert_allclose(brighter.numpy()[covered], expected, atol=1e-5)
    values = np.linspace(0, 3, 100, dtype=np.float32)
    np.testing.assert_allclose(to_linear(to_display(values)), values, rtol=1e-4, atol=1e-6)


def test_eyes_are_wet_and_the_nose_is_oily():
    head = load_open_head()
    layout = texel_layout(head.uv, head.uv_faces, 128)
    looks = materials_of(head, layout.face, layout.barycentric)
    place = np.einsum("nk,nkx->nx", layout.barycentric, head.v_template[head.faces[layout.face]])
    eye = np.isin(head.faces[layout.face], head.regions["left_eyeball"]).all(1)
    nose = np.linalg.norm(place - [0.0, 0.010, 0.115], axis=1) < 0.01
    cheek = np.linalg.norm(np.abs(place) - [0.055, 0.02, 0.06], axis=1) < 0.02
    assert looks.smooth[eye].max() < 0.1
    assert looks.shine[nose].mean() > 1.3 * looks.shine[cheek].mean()


def test_the_turn_of_a_head_is_found():
    rest = np.random.default_rng(0).normal(size=(50, 3))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    np.testing.assert_allclose(turn_between(rest, rest @ turn.T + 0.3), turn, atol=1e-9)


def test_what_a_hollow_takes_is_a_share_of_what_lights_its_opening():
    points, normals, faces = ball()
    exchange = Exchange.of(points, normals, faces, np.zeros((len(points), 9)))
    inside, around = points[:, 2] < -0.08, points[:, 2] > 0.08
    exchange.light(inside, around, 0.4)
    lit = np.where(around, 3.0, 0.0)[:, None] * np.ones(3)
    found = exchange.bounced(lit, np.full(3, 0.5))
    assert 0.3 < found[inside].mean() <= 0.4 * 3.0 * 0.5 + 1e-5
    assert np.ptp(found[inside]) < 1e-5
    exchange.light(inside, np.zeros(len(points), bool), 0.4)
    assert exchange.bounced(lit, np.full(3, 0.5))[inside].max() == 0.0


def test_softness_widens_a_lamp():
    x = np.linspace(-0.1, 0.1, 201)
    receivers = Receivers.around(np.stack([x, 0 * x, 0 * x], -1), np.tile([0.0, 0.0, 1.0], (201, 1)))
    wall = np.array([[[0.0, -1.0, 0.3], [0.0, 1.0, 0.3], [-2.0, 0.0, 0.3]]])
    box = soft_box(0.0, 0.0, 1.5, 0.3, 10.0)
    narrow, wide = (visible(box, receivers, walls(wall), softness) for softness in (0.3, 3.0))
    assert np.ptp(x[(wide > 0.1) & (wide < 0.9)]) > 2 * np.ptp(x[(narrow > 0.1) & (narrow < 0.9)])
    assert visible(box, receivers, walls(wall[:0])).min() == 1.0
    assert Lighting().shaded((0.0, 0.0, 0.0)) == ()


def test_a_suns_glint_in_an_eye_is_wide_enough_to_wander_from_one_gaussian_to_the_next():
    angles = np.array([0.0, 0.04])  # half a millimetre on an eye
    normals = np.stack([np.sin(angles), np.zeros(2), np.cos(angles)], -1)
    receivers, sun = Receivers.around(0.012 * normals, normals), Sun(direction=(0.0, 0.0, 1.0))
    eye = Materials(*(np.full(2, value, np.float32) for value in vars(MATERIALS["left_eyeball"]).values()))
    arguments = (sun,), receivers, np.ones((1, 2), np.float32), eye, np.zeros((2, 9), np.float32), np.array([0.0, 0.0, 1.0])
    middle, beside = shade(*arguments, np.zeros((9, 3))).highlights[:, 0]
    assert 0.05 * middle < beside < middle
