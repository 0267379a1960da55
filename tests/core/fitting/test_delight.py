"""Light taken out of skin colors, and gradients of relit colors against finite differences."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch

from grmm_core.fitting.delight import SUNS, delit, skin_parts
from grmm_core.head import load_open_head
from grmm_core.light.relight import relit, to_display, to_linear
from grmm_core.light.shading import Transport, reached


@pytest.fixture(scope="module")
def face():
    """Some points of the face, and what light does there."""
    head = load_open_head()
    inside = np.zeros(head.vertex_count, bool)
    inside[head.regions["face"]] = True
    faces = np.flatnonzero(inside[head.faces].all(1))[::3]
    return skin_parts(head, head.v_template.astype(float), faces, np.full((len(faces), 3), 1.0 / 3.0))


def test_skin_lit_from_a_side_becomes_even_and_its_own_light_makes_it_as_before(face):
    random = np.random.default_rng(0)
    count = len(face.rig)
    marks = np.where(random.random(count) < 0.05, 0.6, 1.0)[:, None]  # freckles stay
    skin = np.array([0.5, 0.3, 0.22]) * marks
    lamps = np.zeros((len(SUNS), 3), np.float32)
    lamps[np.argmax([sun.direction[0] for sun in SUNS])] = [4.0, 3.0, 2.0]
    harmonics = np.zeros((9, 3), np.float32)
    harmonics[0] = 0.5
    irradiance, _ = face.parts.light(lamps, harmonics)
    colors = to_display(skin * irradiance / reached(face.rig))
    found = delit(colors, np.ones(count), face)
    open_to_light = (face.rig > 0.3 * face.rig.max()).all(1)
    plain, freckled = (open_to_light & (marks[:, 0] == value) for value in (1.0, 0.6))
    lit, flat = to_linear(colors)[plain], to_linear(found.flat)[plain]
    uneven, left = lit.std(0) / lit.mean(0), flat.std(0) / flat.mean(0)
    assert uneven.min() > 0.4
    assert (left < 0.4 * uneven).all()
    freckles = to_linear(found.flat)[freckled]
    np.testing.assert_allclose(freckles.mean(0) / flat.mean(0), 0.6, atol=0.08)
    again = to_display(to_linear(found.flat) * found.relative)
    assert math.sqrt(((again - colors) ** 2).mean()) < 0.005
    assert all(min(sun.color) >= 0.0 for sun in found.light.lamps)


def test_even_colors_stay_as_they_are(face):
    colors = np.full((len(face.rig), 3), 0.6)
    found = delit(colors, np.ones(len(colors)), face)
    assert np.abs(found.flat - colors).mean() < 0.02


def test_relit_colors_have_the_gradients_of_finite_differences(face):
    random = np.random.default_rng(0)
    rows = random.choice(np.flatnonzero((face.rig > 0.3 * face.rig.max()).all(1)), 12, replace=False)
    chosen = (a[:, rows] if len(a) == len(SUNS) else a[rows] for a in vars(face.parts).values())
    some = Transport(*(torch.from_numpy(np.float64(array)) for array in chosen))
    rig, alpha = torch.from_numpy(np.float64(face.rig[rows])), torch.ones(3, 4, dtype=torch.float64)

    def lit(flat, lamps, around):
        irradiance, highlights = some.light(lamps, around)
        return relit(flat, alpha, (irradiance / rig).reshape(3, 4, 3), highlights.reshape(3, 4, 3))

    given = [random.uniform(0.2, 0.7, (3, 4, 3)), random.uniform(0.1, 1.0, (len(SUNS), 3)), random.uniform(0.05, 0.3, (9, 3))]
    assert torch.autograd.gradcheck(lit, [torch.from_numpy(array).requires_grad_() for array in given], eps=1e-6, atol=1e-5)
