"""The open head's texture layout: no overlaps, gutters, texel sizes, islands."""

from __future__ import annotations

import json

import numpy as np
import pytest
from uv_layout import cover_texels

from grmm_core.files.tensorfile import read_metadata
from grmm_core.head import load_open_head
from grmm_core.head.open_head import ASSET


@pytest.fixture(scope="module")
def head():
    return load_open_head()


def test_texture_layout_has_no_overlaps_and_a_gutter(head):
    assert head.uv.min() >= 0
    assert head.uv.max() <= 1
    count, owner = cover_texels(head.uv[head.uv_faces].astype(np.float64), 1024)
    assert count.max() == 1
    assert (count > 0).mean() > 0.65
    island = np.where(owner >= 0, head.uv_islands[owner], -1)
    # two texels at 256 are eight at 1024: islands keep that distance (and their border to the square's edge)
    for shift in range(1, 8):
        for axis in (0, 1):
            a, b = np.roll(island, shift, axis), island
            cut = (slice(shift, None), slice(None)) if axis == 0 else (slice(None), slice(shift, None))
            a, b = a[cut], b[cut]
            assert not ((a >= 0) & (b >= 0) & (a != b)).any()


def test_face_has_finer_texels_than_the_back(head):
    corners, plane = head.v_template[head.faces], head.uv[head.uv_faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    edges = np.stack([plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]], -1)
    mapped = 0.5 * np.linalg.det(edges)
    assert (mapped > 0).all()
    centre = corners.mean(1)
    skin = head.uv_islands == 0
    face = skin & (centre[:, 2] > 0.03) & (centre[:, 1] > -0.06) & (centre[:, 1] < 0.115) & (np.abs(centre[:, 0]) < 0.065)
    back = skin & (centre[:, 2] < -0.02) & (centre[:, 1] > -0.05)
    texel = {name: 1000 / 256 * np.sqrt(area[m].sum() / mapped[m].sum()) for name, m in (("face", face), ("back", back))}
    assert texel["face"] <= 1.5
    assert texel["back"] > 1.5 * texel["face"]


def test_islands_keep_parts_apart(head):
    names = json.loads(read_metadata(ASSET)["island_names"])
    assert names[0] == "head"
    for part in ("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "lashes"):
        triangles = np.isin(head.faces, head.regions[part]).all(1)
        assert {names[i].removesuffix("_back") for i in head.uv_islands[triangles]} == {part}


def test_irises_have_texels_enough(head):
    centre = head.v_template[head.faces].mean(1)
    plane = head.uv[head.uv_faces]
    mapped = 0.5 * np.linalg.det(np.stack([plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]], -1))
    for side, joint in (("left", 3), ("right", 4)):
        eye = head.joints(np.zeros(0))[joint]
        iris = np.isin(head.faces, head.regions[f"{side}_eyeball"]).all(1) & (centre[:, 2] > eye[2])
        iris &= np.hypot(centre[:, 0] - eye[0], centre[:, 1] - eye[1]) < 0.006
        assert mapped[iris].sum() * 256**2 > 250
