"""Light that reaches strands, and what they do with it."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.light import hair_shading, shadows
from grmm_core.light.hair_shading import GRID, HairCloud, LightGrid, Reaching, strand_light, strand_transport
from grmm_core.light.lamps import Point, Spot, Sun, soft_box
from grmm_core.light.shading import Response
from grmm_core.light.shadows import Casters, Receivers, maps_of

PANE = np.array([[[-0.05, -0.05, 0.05], [0.05, -0.05, 0.05], [0.05, 0.05, 0.05]]])
NOTHING = Casters(np.zeros((0, 3)), np.zeros((0, 3), int))


def test_compiled_light_at_strands_is_the_readable_one(monkeypatch):
    random = np.random.default_rng(0)
    points, quats = random.uniform(-0.15, 0.15, (200, 3)), random.normal(size=(200, 4))
    quats /= np.linalg.norm(quats, axis=1, keepdims=True)
    lamps = (
        soft_box(45, 35, 1.5, 0.5, 42), Sun((1.0, 0.5, 0.2), 2.0, direction=(0.6, 0.8, 0.0)),
        Point((0.2, 0.4, 1.0), 20.0, position=(0.3, 0.1, 0.5), radius=0.02),
        Spot(strength=30.0, position=(-0.5, 0.2, 0.6), direction=(0.6, -0.2, -0.75), cone=0.6),
    )  # fmt: skip
    grid = LightGrid.around(np.full(3, -0.1), np.full(3, 0.1))  # some points lie beside it
    turn = np.linalg.qr(random.normal(size=(3, 3)))[0]
    harmonics, centre, eye = random.random((9, 3)), np.array([0.0, 0.02, 0.0]), np.array([0.1, 0.0, 1.0])
    for some in (lamps, ()):
        parts = random.random((*grid.size, len(some))).astype(np.float32)
        reaching = Reaching(parts, grid.coordinates(turn, np.array([0.01, 0.0, 0.02])))
        arguments = some, points, quats, reaching, centre, eye, harmonics, Response(1.3, 0.8)
        fast = strand_light(*arguments)
        with monkeypatch.context() as patch:
            patch.setattr(hair_shading, "compiled_kernels", lambda: None)
            np.testing.assert_allclose(fast.values, strand_light(*arguments).values, rtol=2e-3, atol=2e-4)


@pytest.mark.parametrize("lamp", [Sun(direction=(0.1, 0.0, 0.99)), soft_box(20.0, 10.0, 1.0, 0.5, 10.0)], ids=["sun", "box"])
def test_hair_behind_a_pane_is_lit_just_behind_it_and_dark_further_off_alike_without_numba(monkeypatch, lamp):
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (300, 3))
    points[:3] = [[0.02, -0.02, 0.06], [0.02, -0.02, 0.045], [0.02, -0.02, 0.0]]
    maps = maps_of(lamp, Receivers.around(points, points), NOTHING.and_triangles(PANE))
    reaching = maps.reaching(points)
    assert reaching[0] == reaching[1] == 1.0
    assert reaching[2] < 0.01
    monkeypatch.setattr(shadows, "compiled_kernels", lambda: None)
    np.testing.assert_allclose(reaching, maps.reaching(points), atol=2e-3)


def test_light_is_asked_for_at_just_the_places_between_which_hair_lies_alike_without_numba(monkeypatch):
    random, grid = np.random.default_rng(1), LightGrid.around(np.full(3, -0.1), np.full(3, 0.1))
    points = random.uniform(-0.13, 0.05, (80, 3)).astype(np.float32)  # some lie beside it
    coordinates = grid.coordinates(np.linalg.qr(random.normal(size=(3, 3)))[0], np.array([0.01, 0.0, 0.02]))
    asked = grid.around_points(points, coordinates)
    parts = random.random((*grid.size, 2)).astype(np.float32)
    elsewhere = np.ones(parts[..., 0].size, bool)
    elsewhere[asked] = False
    before = Reaching(parts.copy(), coordinates).at(points)
    parts.reshape(-1, 2)[elsewhere] = np.nan
    np.testing.assert_array_equal(Reaching(parts, coordinates).at(points), before)
    assert len(asked) < 0.5 * elsewhere.size
    monkeypatch.setattr(hair_shading, "compiled_kernels", lambda: None)
    np.testing.assert_array_equal(grid.around_points(points, coordinates), asked)


def test_the_light_between_places_changes_evenly_and_places_stay_where_they_are():
    small, large = (LightGrid.around(np.full(3, -half), np.full(3, half)) for half in (0.05, 0.08))
    assert {tuple(place) for place in small.points.round(6)} <= {tuple(place) for place in large.points.round(6)}
    wave = Reaching(small.points[:, :1].reshape(*small.size, 1), small.coordinates(np.eye(3), np.zeros(3)))
    x = np.linspace(-0.05, 0.05, 7)
    np.testing.assert_allclose(wave.at(np.stack([x, 0 * x, 0 * x], -1))[0], x, atol=1e-6)
    assert wave.at(np.array([[1.0, 0.0, 0.0]]))[0, 0] == pytest.approx(0.06, abs=GRID * 0.01)


def test_hair_dims_what_lies_in_it_and_more_what_lies_behind_it():
    pieces = np.random.default_rng(0).uniform(-0.05, 0.05, (4000, 3)) * [1.0, 1.0, 0.3]
    cloud = HairCloud.of(pieces, np.random.default_rng(1).normal(0.0, 1.2e-6, pieces.shape))
    places = np.array([[0.0, 0.0, 0.04], [0.0, 0.0, 0.0], [0.0, 0.0, -0.04]])  # before it, within, behind
    through = cloud.through(Sun(direction=(0.0, 0.0, 1.0)), places)
    assert through[0] == 1.0
    assert 0.0 < through[2] < through[1] < 1.0


def test_hair_keeps_less_off_of_light_that_comes_along_it():
    pieces = np.random.default_rng(0).uniform(-0.05, 0.05, (8000, 3))
    cloud = HairCloud.of(pieces, np.tile([0.0, -2e-6, 0.0], (len(pieces), 1)))  # it hangs
    middle = np.zeros((1, 3))
    along, aside, between = (
        -np.log(cloud.through(Sun(direction=way), middle)[0]) for way in ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0), (0.0, 0.6, 0.8))
    )
    assert along < 0.02 * aside
    assert between == pytest.approx(0.8 * aside, rel=0.15)  # the sine of the angle between them


def test_no_lamp_shines_through_hair_that_it_does_not_reach():
    g = np.random.default_rng(1)
    points, tangents = g.normal(0.0, 0.1, (200, 3)), g.normal(0.0, 1.0, (200, 3))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    lamps, eye = (Sun(direction=(0.0, 0.0, -1.0)),), np.array([0.0, 0.0, 1.0])  # behind, as the eye sees it
    dark, lit = (
        strand_transport(lamps, points, tangents, [np.full(200, part)], np.zeros(3), eye).diffuse for part in (0.0, 1.0)
    )
    assert dark.max() == 0.0
    assert (lit > 0.0).mean() > 0.5


def test_strands_show_the_side_that_is_lit_to_who_looks_from_the_lamp():
    """Where half of the light comes through, more of it is on what is seen from the lamp's side than from the other."""
    points, centre = np.array([[0.0, 0.1, 0.0]]), np.zeros(3)
    sun, tangents = Sun(direction=(0.0, 0.6, 0.8)), np.array([[1.0, 0.0, 0.0]])

    def of(part, eye):
        return float(strand_transport((sun,), points, tangents, [np.array([part])], centre, np.array(eye)).diffuse[0, 0, 0])

    ahead, behind = (0.0, 0.7, 0.8), (0.0, -0.5, -0.8)
    assert of(0.5, ahead) / of(1.0, ahead) > 0.7 > 0.35 > of(0.5, behind) / of(1.0, behind)
    assert of(0.0, ahead) == of(0.0, behind) == 0.0


def test_locks_keep_more_light_off_themselves_than_off_skin():
    random = np.random.default_rng(5)
    cloud = HairCloud.of(random.uniform(-0.05, 0.05, (4000, 3)), random.normal(0.0, 1.2e-6, (4000, 3)))
    sun, inside = Sun(direction=(0.0, 0.0, 1.0)), random.uniform(-0.04, 0.04, (50, 3))
    skin, hair = cloud.through(sun, inside), cloud.through_to_hair(sun, inside)
    assert (hair <= skin).all()
    assert hair.mean() < 0.95 * skin.mean()
    np.testing.assert_array_equal(cloud.through_to_hair(sun, np.full((1, 3), 0.3)), 1.0)
