"""Light at a glance: normals of Gaussians, and colors that go with the exact shading."""

from __future__ import annotations

import numpy as np

from grmm_core.light.lamps import STUDIO, Lighting, Sun, soft_box
from grmm_core.light.relight import to_linear
from grmm_core.light.rough import rough_normals, roughly_lit
from grmm_core.light.shading import Response
from grmm_core.light.surroundings import Surroundings, sphere


def ball(count: int = 500) -> tuple[np.ndarray, np.ndarray]:
    """Points of a ball of 10 cm, and its normals."""
    normals = sphere(count)[0].astype(np.float32)
    return 0.1 * normals, normals


def test_normals_are_the_thin_axis_of_skin_and_outwards_of_strands():
    means, _ = ball()
    quats = np.tile(np.array([1.0, 0.0, 0.0, 0.0], np.float32), (len(means), 1))
    flat = rough_normals(means, quats, np.tile(np.array([0.001, 0.001, 1e-5], np.float32), (len(means), 1)))
    out = means[:, 2] > 0.03
    assert (flat[out, 2] > 0.85).all()
    assert (flat[means[:, 2] < -0.03, 2] < -0.85).all()
    strands = rough_normals(means, quats, np.tile(np.array([0.001, 1e-4, 1e-4], np.float32), (len(means), 1)))
    np.testing.assert_allclose(strands, means / 0.1, atol=1e-5)


def test_the_rig_changes_nothing_and_a_sun_lights_its_side():
    means, normals = ball()
    colors = np.full_like(means, 0.5)
    np.testing.assert_allclose(roughly_lit(colors, means, normals, STUDIO, Response()), colors, atol=1e-4)
    lit = roughly_lit(colors, means, normals, Lighting((Sun(direction=(1.0, 0.0, 0.0), strength=3.0),)), Response())
    assert lit[normals[:, 0] > 0.5].min() > 0.25
    assert lit[normals[:, 0] < -0.5].max() == 0.0


def test_lights_add_up_and_intensity_is_a_factor():
    means, normals = ball()
    colors = np.full_like(means, 0.4)
    one, other = Lighting((soft_box(60, 20, 1.5, 0.5, 20.0),)), Lighting((), Surroundings.even((0.2, 0.1, 0.1)))
    both = Lighting(one.lamps, other.surroundings)
    found = [to_linear(roughly_lit(colors, means, normals, each, Response())) for each in (one, other, both)]
    np.testing.assert_allclose(found[0] + found[1], found[2], atol=1e-4)
    half = to_linear(roughly_lit(colors, means, normals, both, Response(intensity=0.5)))
    np.testing.assert_allclose(2.0 * half, found[2], atol=1e-4)
    assert roughly_lit(colors[:0], means[:0], normals[:0], both, Response()).shape == (0, 3)
