"""Light at a glance: normals of Gaussians, and colors that go with the exact shading."""

from __future__ import annotations

import numpy as np

from grmm_core.light.lamps import STUDIO, Lighting, Sun, soft_box
from grmm_core.light.rough import evened, rough_normals, roughly_lit
from grmm_core.light.surroundings import Surroundings, sphere


def ball(count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    """Points of a ball of 10 cm, and its normals."""
    normals = sphere(count)[0].astype(np.float32)
    return 0.1 * normals, normals


def test_normals_are_the_thin_axis_of_skin_and_outwards_of_strands():
    means, _ = ball()
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(means), 1))
    flat = rough_normals(means, quats, np.tile(np.array([0.001, 0.001, 1e-5], np.float32), (len(means), 1)))
    assert (flat[means[:, 2] > 0.0, 2] > 0.9).all()
    turned = np.tile(np.array([0.5**0.5, 0.0, 0.5**0.5, 0.0], np.float32), (len(means), 1))  # by 90 degrees about y
    sideways = rough_normals(means, turned, np.tile(np.array([0.001, 0.001, 1e-5], np.float32), (len(means), 1)))
    assert (sideways[means[:, 0] > 0.0, 0] > 0.9).all()
    strands = rough_normals(means, quats, np.tile(np.array([0.001, 1e-4, 1e-4], np.float32), (len(means), 1)))
    np.testing.assert_allclose(strands, means / 0.1, atol=1e-5)


def test_the_lean_of_single_gaussians_of_skin_is_evened_out():
    means, normals = ball(50_000)
    noise = np.random.default_rng(0).normal(0.0, 0.4, normals.shape)
    leaning = (normals + noise).astype(np.float32)
    leaning /= np.linalg.norm(leaning, axis=1, keepdims=True)
    skin = np.tile(np.array([0.001, 0.001, 1e-5], np.float32), (len(means), 1))
    found = evened(means, skin, leaning)
    before, after = (np.degrees(np.arccos(np.clip((part * normals).sum(1), -1.0, 1.0))) for part in (leaning, found))
    assert np.median(before) > 20.0
    assert np.median(after) < 6.0
    strands = np.tile(np.array([0.001, 1e-4, 1e-4], np.float32), (len(means), 1))
    assert evened(means, strands, leaning) is leaning
    assert evened(means[:0], skin[:0], leaning[:0]).shape == (0, 3)


def test_the_rig_changes_nothing_and_a_sun_lights_its_side():
    _, normals = ball()
    colors = np.full_like(normals, 0.5)
    np.testing.assert_allclose(roughly_lit(colors, normals, STUDIO), colors, atol=1e-4)
    lit = roughly_lit(colors, normals, Lighting((Sun(direction=(1.0, 0.0, 0.0), strength=3.0),)))
    front, back = (lit[side * normals[:, 0] > 0.5] for side in (1.0, -1.0))
    assert front.min() > 0.25
    assert back.mean() < 0.2 * front.mean()
    assert roughly_lit(colors[:0], normals[:0], STUDIO).shape == (0, 3)


def test_lights_add_up_and_intensity_is_a_factor():
    _, normals = ball()
    colors = np.ones_like(normals)
    one, other = Lighting((soft_box(60, 20, 1.5, 0.5, 20.0),)), Lighting((), Surroundings.even((0.4, 0.3, 0.3)))
    both = Lighting(one.lamps, other.surroundings)
    found = [roughly_lit(colors, normals, each) ** 2.2 for each in (one, other, both)]
    lit = normals @ one.lamps[0].direction < -0.2
    np.testing.assert_allclose((found[0] + found[1])[lit], found[2][lit], rtol=1e-3)
    np.testing.assert_allclose(2.0 * roughly_lit(colors, normals, both, 0.5) ** 2.2, found[2], rtol=1e-3)
