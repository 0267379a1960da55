"""Lamps against Cycles, which gives a white plane one metre away these radiances (64 samples, Blender 4.5)."""

from __future__ import annotations

import math

import numpy as np
import pytest

from grmm_core.errors import ConfigError
from grmm_core.light.lamps import (
    MAX_LAMPS,
    MAX_SINGLE,
    STUDIO,
    Area,
    Lamp,
    Lighting,
    Point,
    Spot,
    Sun,
    arriving,
    half_angle,
    soft_box,
)
from grmm_core.light.surroundings import Surroundings, sphere
from grmm_studio.lights import RIG

DOWN = (0.0, 0.0, -1.0)
ORIGIN = np.zeros((1, 3))


def radiance(lamp):
    towards, irradiance = arriving(lamp, ORIGIN)
    return float(irradiance[0] * max(towards[0, 2], 0.0) / math.pi)


def slanted(angle, **more):
    return Spot(strength=10.0, position=(math.tan(angle), 0.0, 1.0), direction=DOWN, cone=1.0, **more)


@pytest.mark.parametrize(
    ("lamp", "cycles", "tolerance"),
    [
        (Sun(strength=2.0, direction=(0.0, 0.0, 1.0)), 0.63662, 1e-4),
        (Point(strength=10.0), 0.253297, 1e-4),
        (Point(strength=10.0, radius=0.2), 0.24355, 1e-3),
        (Spot(strength=10.0, direction=DOWN, cone=1.0, blend=0.0), 0.253297, 1e-4),
        (slanted(0.4, blend=0.5), 0.157653, 1e-3),
        (slanted(0.2, blend=0.5), 0.23845, 1e-3),
        (Area(strength=10.0, across=(0.005, 0, 0), up=(0, 0.005, 0)), 1.013144, 1e-3),
        (Area(strength=10.0, across=(0.5, 0, 0), up=(0, 0.5, 0)), 0.76244, 1e-2),
        (Area(strength=10.0, across=(0.005, 0, 0), up=(0, 0.005, 0), ellipse=True), 1.013152, 1e-3),
        (Area(strength=10.0, across=(0.005, 0, 0), up=(0, -0.005, 0)), 0.0, 0.0),  # its back
    ],
)
def test_watts_and_angles_mean_what_they_mean_to_cycles(lamp, cycles, tolerance):
    assert radiance(lamp) == pytest.approx(cycles, rel=tolerance, abs=1e-9)


def test_the_rig_is_the_studios():
    assert STUDIO.surroundings.irradiance(np.array([[0.0, 1.0, 0.0]]))[0] == pytest.approx(np.full(3, math.pi * RIG.strength))
    for own, other in zip(STUDIO.lamps, RIG.lamps, strict=True):
        made = soft_box(other.yaw, other.pitch, other.distance, other.side, other.power, other.color)
        assert own == made
        np.testing.assert_allclose(np.asarray(own.position) / other.distance, -own.direction, atol=1e-9)


@pytest.mark.parametrize("scale", [1.0, 2.5])
def test_other_axes_and_another_scale_change_nothing_that_is_seen(scale):
    lamps = (
        Sun((1.0, 0.5, 0.2), 2.0, direction=(0.6, 0.8, 0.0)), Point(strength=20.0, position=(0.3, 1.0, 0.4), radius=0.1),
        Spot(strength=30.0, position=(0.0, 1.0, 1.0), direction=(0.0, -0.707107, -0.707107), cone=1.2),
        soft_box(40.0, 20.0, 1.5, 0.5, 12.0),
    )  # fmt: skip
    points = np.random.default_rng(0).normal(0, 0.1, (20, 3))
    turn = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    turn *= np.sign(np.linalg.det(turn))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = turn * scale, [1.0, -2.0, 0.5]
    moved = Lighting(lamps).in_space(matrix)
    for one, two in zip(lamps, moved.lamps, strict=True):
        towards, irradiance = arriving(one, points)
        towards_2, irradiance_2 = arriving(two, points @ matrix[:3, :3].T + matrix[:3, 3])
        np.testing.assert_allclose(towards_2, towards @ turn.T, atol=1e-9)
        np.testing.assert_allclose(irradiance_2, irradiance, rtol=1e-9)
        middle = 1.0
        assert half_angle(two, middle * scale) == pytest.approx(half_angle(one, middle))


def test_of_many_lamps_the_strongest_are_kept():
    lamps = tuple(Point(strength=float(i), position=(0.0, 0.0, 2.0)) for i in range(100))
    kept = Lighting(lamps).shaded((0.0, 0.0, 0.0), 99, 4)
    assert [lamp.strength for lamp in kept[:4]] == [99.0, 98.0, 97.0, 96.0]
    assert len(Lighting(lamps).shaded((0.0, 0.0, 0.0), 100)) == 99  # the weakest gives nothing
    assert Lighting((Point(strength=0.0),), Surroundings.even((0.0, 0.0, 0.0))).shaded((0.0, 0.0, 0.0)) == ()


def lit(lamps, normals):
    total = np.zeros((len(normals), 3))
    for lamp in lamps:
        towards, strength = arriving(lamp, 0.1 * normals)
        total += (np.maximum((normals * towards).sum(1), 0.0) * strength)[:, None] * lamp.color
    return total


def ceiling():
    rng = np.random.default_rng(4)
    return np.stack([rng.uniform(-4.0, 4.0, 1000), np.full(1000, 2.0), rng.uniform(-4.0, 4.0, 1000)], -1)


def strip():
    return np.stack([np.full(300, 1.5), np.linspace(-1.5, 1.5, 300), np.full(300, 0.4)], -1)


@pytest.mark.parametrize("places", [ceiling(), strip()], ids=["ceiling", "strip"])
def test_very_many_weak_lamps_light_as_their_sum(places):
    lamps = tuple(Point(color=(1.0, 0.8, 0.5), strength=2.0, position=tuple(place)) for place in places)
    normals, _ = sphere(200)
    every, kept = lit(lamps, normals), Lighting(lamps).shaded((0.0, 0.0, 0.0))
    assert len(kept) <= MAX_LAMPS
    assert np.abs(lit(kept, normals) - every).mean() < 0.08 * every.mean()
    assert lit(kept[:MAX_SINGLE], normals).mean() < 0.3 * every.mean()


def test_weak_lamps_that_wander_are_put_together_without_jumps():
    normals, _ = sphere(200)

    def light(step):
        turn, rows = math.radians(3.0 * step), ceiling()[:80]
        rotation = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
        lamps = tuple(Point(strength=2.0, position=tuple(rotation @ row)) for row in rows)
        return lit(Lighting(lamps).shaded(ORIGIN[0]), normals)

    frames = np.array([light(step) for step in range(20)])
    first, second = np.abs(np.diff(frames, axis=0)), np.abs(np.diff(frames, 2, axis=0))
    assert second.mean() < 0.5 * first.mean()


def test_a_lamp_inside_the_head_is_finite():
    _, irradiance = arriving(Point(strength=1000.0, position=(0.0, 0.0, 0.0)), ORIGIN)
    assert np.isfinite(irradiance).all()


@pytest.mark.parametrize("values", [{"strength": math.nan}, {"strength": -1.0}, {"color": (0.0, math.inf, 0.0)}])
def test_numbers_that_are_no_light_are_one_sentence(values):
    with pytest.raises(ConfigError, match="correct it in the scene"):
        Lamp(**values)
