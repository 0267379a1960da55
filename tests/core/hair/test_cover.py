"""Skin under strands: `grmm_core/hair/cover.py`."""

import numpy as np
import pytest

from grmm_core.geometry.triangles import vertex_normals
from grmm_core.hair import library_groom
from grmm_core.hair.cover import beneath
from grmm_core.hair.strands import blocks_of
from grmm_core.head import load_open_head


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def test_a_parting_is_bare_and_a_few_millimetres_wide(head):
    template, faces = np.asarray(head.v_template, float), np.asarray(head.faces)
    blocks = blocks_of(library_groom("bob"), template, faces)
    g = np.random.default_rng(3)
    corners = faces[np.isin(faces, head.regions["scalp"]).all(1)]
    corners = np.repeat(corners, 40, 0)
    weights = g.dirichlet((1.0, 1.0, 1.0), len(corners))
    points = (template[corners] * weights[..., None]).sum(1)
    assert (vertex_normals(template, faces)[corners[:, 0], 1] > 0.5).sum() > 1000  # the crown is among them
    found = beneath(head, points, corners, weights, blocks)
    front = (points[:, 2] > 0.0) & (points[:, 2] < 0.06) & (points[:, 1] > 0.12)
    apart = np.abs(points[:, 0] - 0.0175)  # of the parting of the style on the mean head
    on, beside = (found[front & some].mean() for some in (apart < 0.001, (apart > 0.008) & (apart < 0.012)))
    assert beside > 0.9
    assert on < 0.75 * beside
    chin = (template[faces].mean(1)[:, 1] < -0.05) & (template[faces].mean(1)[:, 2] > 0.09)
    below = faces[chin]
    thirds = np.full(below.shape, 1.0 / 3.0)
    assert beneath(head, np.concatenate([points, template[below].mean(1)]), np.concatenate([corners, below]),
                   np.concatenate([weights, thirds]), blocks)[len(points):].max() < 0.01  # fmt: skip


def test_skin_under_curls_that_stand_off_is_covered_by_what_is_farther_out(head):
    template, faces = np.asarray(head.v_template, float), np.asarray(head.faces)
    corners = faces[np.isin(faces, head.regions["scalp"]).all(1)]
    points = template[corners].mean(1)
    back = (points[:, 2] < -0.05) & (points[:, 1] > 0.0)
    found = beneath(head, points, corners, np.full(corners.shape, 1.0 / 3.0), blocks_of(library_groom("afro"), template, faces))
    assert found[back].min() > 0.9


def test_skin_under_shorn_hair_is_covered_evenly(head):
    """Roots lie unevenly by a tenth or two; where skin lay under hair from some cover on, these were patches of bare skin."""
    template, faces = np.asarray(head.v_template, float), np.asarray(head.faces)
    corners = faces[np.isin(faces, head.regions["scalp"]).all(1)]
    points = template[corners].mean(1)
    crown = points[:, 1] > 0.08
    thirds = np.full(corners.shape, 1.0 / 3.0)
    found = beneath(head, points, corners, thirds, blocks_of(library_groom("buzz"), template, faces))[crown]
    assert np.percentile(found, 5) > 0.8
    assert np.ptp(np.percentile(found, (5, 95))) < 0.15
    stubble = beneath(head, points, corners, thirds, blocks_of(library_groom("stubble"), template, faces))[crown]
    assert stubble.mean() < found.mean() - 0.1  # through which more skin shows
