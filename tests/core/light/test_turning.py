"""What the turn of a neck makes of the studio's light."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.controls.names import JOINT_NAMES
from grmm_core.geometry.triangles import vertex_normals
from grmm_core.head import load_open_head
from grmm_core.light.lamps import STUDIO, arriving
from grmm_core.light.resting import Texels
from grmm_core.light.surroundings import sphere
from grmm_core.light.turning import rig_irradiance, turned_light, turned_shade

ROOT, NECK = JOINT_NAMES.index("root"), JOINT_NAMES.index("neck")


def posed(**turns):
    """Head, texels of its faces' middles, vertices and pose for turns in degrees of joints."""
    head = load_open_head()
    pose = np.zeros((5, 3), np.float32)
    for name, angles in turns.items():
        pose[JOINT_NAMES.index(name)] = np.radians(angles)
    count = len(head.faces)
    texels = Texels.of(head, np.arange(count), np.full((count, 3), 1.0 / 3.0, np.float32))
    return head, texels, head.vertices(np.zeros(1), np.zeros(1), pose), pose


def test_it_is_the_rig_on_turned_normals_over_the_rig_on_those_before():
    """On the skull, which turns with the neck as a whole, it can be had from the two meshes."""
    head, texels, vertices, pose = posed(neck=(12.0, -25.0, 6.0))
    light = turned_light(head, texels, vertices, pose)
    straight = head.vertices(np.zeros(1), np.zeros(1), np.zeros((5, 3)))
    after, before = (rig_irradiance(vertex_normals(mesh, head.faces)) for mesh in (vertices, straight))
    skull = (head.weights[:, NECK:].sum(1) > 0.999) & head.marked("scalp", "face") & ~head.marked("mouth_interior")
    whole = skull[texels.corners].all(1)
    expected = (after / before)[texels.corners].mean(1)
    assert whole.sum() > 2000
    np.testing.assert_allclose(light[whole, 0], expected[whole], atol=0.02)
    assert light.min() < 0.85
    assert light.max() > 1.1


def test_the_rig_is_its_lamps_and_its_surroundings():
    """It is the sum of cosines, and a little more where lamps graze skin with pores."""
    normals = sphere(200)[0]
    plain = np.full(200, np.pi * 0.42)
    for lamp in STUDIO.lamps:
        towards, strength = arriving(lamp, np.zeros((1, 3)))
        plain += np.maximum(normals @ towards[0], 0.0) * strength[0]
    more = rig_irradiance(normals) / plain
    assert (more > 1.0).all()
    assert more.max() < 1.15
    assert more.mean() < 1.05


def test_what_does_not_turn_the_neck_changes_nothing():
    assert turned_light(*posed(jaw=(15.0, 0.0, 0.0), left_eye=(0.0, 20.0, 0.0))) is None
    assert turned_light(*posed(root=(0.0, 60.0, 0.0))) is None


def test_the_rig_goes_with_the_shoulders():
    """A head turned by root and neck has the light of one turned by its neck alone."""
    alone = turned_light(*posed(neck=(5.0, 20.0, 0.0)))
    both = turned_light(*posed(root=(10.0, 50.0, -8.0), neck=(5.0, 20.0, 0.0)))
    np.testing.assert_allclose(both, alone, atol=2e-3)


def test_shoulders_and_the_inside_of_the_mouth_stay():
    head, texels, vertices, pose = posed(neck=(0.0, 30.0, 0.0))
    light = turned_light(head, texels, vertices, pose)[:, 0]
    still = (head.weights[:, ROOT] > 0.999)[texels.corners].all(1)
    inside = head.marked("upper_teeth", "lower_teeth", "tongue")[texels.corners].all(1)
    assert still.any()
    np.testing.assert_allclose(light[still], 1.0, atol=1e-3)
    np.testing.assert_array_equal(light[inside], 1.0)


def test_display_colors_follow_the_same_light():
    head, texels, vertices, pose = posed(neck=(10.0, 20.0, 0.0))
    np.testing.assert_allclose(
        turned_shade(head, texels, vertices, pose), turned_light(head, texels, vertices, pose) ** (1 / 2.2), rtol=1e-5
    )


@pytest.mark.parametrize("angle", [0.01, 1.0, 179.0, 400.0])
def test_any_angle_gives_light(angle):
    light = turned_light(*posed(neck=(0.0, angle, 0.0)))
    assert np.isfinite(light).all()
    assert (light > 0.2).all()
    assert (light < 5.0).all()
