"""Figures of how clean a person looks: nothing beside the head, no hole, no speck, no seam, and each of these found."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.evaluation.cleanliness import Shot, cleanliness, seam, seen_vertices
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.head import load_open_head
from grmm_core.model.portrait import portrait_camera


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def shot(head, yaw=0.0, **changes):
    vertices, camera = np.asarray(head.v_template, np.float64), portrait_camera(160, yaw)
    alpha = (triangle_depth(vertices[head.faces], camera) < EMPTY).astype(np.float32)
    planes = {"rgb": np.full((160, 160, 3), 0.6, np.float32), "alpha": alpha, "hair": np.zeros_like(alpha), **changes}
    return Shot(vertices, camera, **planes)


def test_a_plain_head_is_clean(head):
    assert cleanliness(shot(head), head) == {"outside": 0.0, "holes": 0.0, "specks": 0.0}


def test_wisps_holes_and_specks_are_found(head):
    plain = shot(head)
    wisp, hole, spotted = plain.alpha.copy(), plain.alpha.copy(), plain.rgb.copy()
    wisp[5:15, 5:15] = 1.0
    hole[70:76, 78:84] = 0.0
    spotted[44:54:5, 72:90:5] = 0.2
    assert cleanliness(shot(head, alpha=wisp), head)["outside"] > 0.005
    assert cleanliness(shot(head, alpha=wisp, hair=wisp * (1 - plain.alpha)), head)["outside"] == 0.0, "strands may stand off"
    assert cleanliness(shot(head, alpha=hole), head)["holes"] > 0.001
    assert cleanliness(shot(head, rgb=spotted), head)["specks"] > 0.0


def test_a_seam_is_a_jump_where_the_photo_ends(head):
    noise = 0.02 * np.random.default_rng(2).standard_normal((160, 160, 3))
    shots = {step: [] for step in (0.0, 0.2)}
    front = shot(head)
    seen = seen_vertices(front.vertices, front.camera, front.alpha, head)
    assert 0.2 < seen.mean() < 0.8
    for yaw in (-60.0, 60.0):
        plain = shot(head, yaw)
        pixels = plain.camera.project(plain.vertices)[1].astype(int).clip(0, 159)
        dark = np.zeros((160, 160, 1))
        dark[pixels[~seen, 1], pixels[~seen, 0]] = 1.0
        for step, kept in shots.items():
            kept.append(shot(head, yaw, rgb=plain.rgb + noise - step * dark))
    smooth, stepped = (seam(kept, seen, head) for kept in shots.values())
    assert 0.5 < smooth < 1.5
    assert stepped > 2.0
