"""Texels where eyes look."""

from __future__ import annotations

import numpy as np
import pytest

from grmm_core.errors import ShapeError
from grmm_core.head import load_open_head
from grmm_core.model import focus
from grmm_core.model.focus import SIZES_MM, focused_uv
from grmm_core.model.layout import texel_layout


@pytest.fixture(scope="module")
def focused():
    head = load_open_head()
    return head, focused_uv(head)


def signed_areas(uv, uv_faces):
    a, b, c = (uv[uv_faces[:, k]].astype(float) for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def test_no_face_folds_and_no_two_overlap(focused):
    head, uv = focused
    before, after = signed_areas(head.uv, head.uv_faces), signed_areas(uv, head.uv_faces)
    assert (np.sign(before) == np.sign(after)).all()
    # overlapping faces would need more texels than the square has cells under them
    layout = texel_layout(uv, head.uv_faces, 512)
    assert np.abs(after).sum() / 2 == pytest.approx(len(layout) / 512**2, rel=0.01)
    assert uv.min() >= 0
    assert uv.max() <= 1


def test_texels_have_the_wanted_sizes_relative_to_one_another(focused):
    head, uv = focused
    corners = head.v_template[head.faces].astype(float)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    counts = np.bincount(texel_layout(uv, head.uv_faces, 256).face, minlength=len(area))
    side = {}
    for name in ("lips", "lids", "brows", "face", "neck", "scalp", "upper_teeth", "tongue"):
        inside = np.isin(head.faces, head.regions[name]).all(1)
        side[name] = 1e3 * np.sqrt(area[inside].sum() / counts[inside].sum())
    ratios = np.array([side[name] / SIZES_MM[name] for name in side])
    assert ratios.max() / ratios.min() < 1.2
    assert counts[np.isin(head.faces, head.regions["lips"]).all(1)].sum() > 3 * 493  # what the head's own map gives them


def test_a_map_that_would_fold_is_refused(monkeypatch):
    monkeypatch.setattr(focus, "_BLURS", (0.1,) * 4)  # sharper than the faces are large
    with pytest.raises(ShapeError, match="fold"):
        focused_uv(load_open_head())
