"""Avatars of the open head on a (stand-in for the) user's FLAME head."""

from __future__ import annotations

import numpy as np
import pytest
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from splat_files import make_cloud

from grmm_core.errors import FileFormatError, ShapeError
from grmm_core.formats.avatars.binding import place_on_mesh
from grmm_core.formats.avatars.flame_transfer import bind_to_flame, fit_flame, nearest_triangles
from grmm_core.head import load_flame, load_open_head
from grmm_core.head.flame_align import closest_on_surface


@pytest.fixture(scope="module")
def flame(tmp_path_factory):
    path = tmp_path_factory.mktemp("flame") / "flame2023.pkl"
    write_flame_pickle(path, flame_head_fields())
    return load_flame(path)


@pytest.fixture(scope="module")
def person():
    """Another face than the mean one."""
    head = load_open_head()
    shape = np.zeros(head.shape_count, np.float32)
    shape[:12] = np.random.default_rng(3).normal(0, 1.5, 12)
    return head.shaped(shape)


def test_flame_lies_on_the_person(flame, person):
    head = load_open_head()
    fit = fit_flame(person, flame)
    target = fit.scale * person + fit.shift
    skin = np.unique(np.concatenate([head.regions[name] for name in ("face", "scalp", "neck", "ears")]))
    before = np.linalg.norm(flame.v_template[:3931, None] - target[skin][None, ::7], axis=2).min(1)
    after = np.linalg.norm(fit.vertices[:3931, None] - target[skin][None, ::7], axis=2).min(1)
    assert after.mean() < before.mean()
    triangles, _, distance = closest_on_surface(fit.vertices[:3931:40].astype(float), target, head.faces)
    assert np.median(distance) < 0.002
    assert len(triangles) == len(distance)
    for side in ("left", "right"):
        centre = target[head.regions[f"{side}_eyeball"]].mean(0)
        own = flame.weights[:, 3 + (side == "right")] > 0.99
        assert fit.vertices[own].mean(0) == pytest.approx(centre, abs=1e-5)


def test_the_mean_person_hardly_moves_flame(flame):
    """The stand-in has the open head's shape, so what is left is the error of the correspondence."""
    fit = fit_flame(load_open_head().v_template, flame)
    assert np.median(np.linalg.norm(fit.offset, axis=1)) < 0.004


def test_splats_come_back_where_they_were(flame, person):
    cloud = make_cloud(300)
    cloud.means = person[np.random.default_rng(1).integers(0, len(person), 300)]
    fit = fit_flame(person, flame)
    placed = place_on_mesh(bind_to_flame(cloud, fit, flame), fit.vertices, flame.faces)
    assert placed.means == pytest.approx(fit.scale * cloud.means + fit.shift, abs=1e-6)
    assert placed.scales == pytest.approx(fit.scale * cloud.scales, rel=1e-4)


def test_nearest_triangles_are_nearest(flame):
    rng = np.random.default_rng(2)
    points = flame.v_template[rng.integers(0, len(flame.v_template), 150)] + rng.normal(0, 0.002, (150, 3))
    found = nearest_triangles(points, flame.v_template, np.asarray(flame.faces, np.int64))
    wanted, _, distance = closest_on_surface(points.astype(float), flame.v_template.astype(float), flame.faces)
    corners = flame.v_template[flame.faces[found]].astype(float)
    own = np.array([closest_on_surface(p[None], c, np.array([[0, 1, 2]]))[2][0] for p, c in zip(points, corners, strict=True)])
    assert (found == wanted).mean() > 0.7  # ties along edges may fall either way
    assert np.percentile(own - distance, 95) < 2e-4


def test_meshes_that_do_not_fit_are_named(flame):
    with pytest.raises(ShapeError, match="open head's is"):
        fit_flame(np.zeros((10, 3)), flame)
    with pytest.raises(FileFormatError, match="not a FLAME head"):
        fit_flame(load_open_head().v_template, _without_teeth(flame))


def _without_teeth(flame):
    import dataclasses

    faces = flame.faces[:9976]
    return dataclasses.replace(flame, faces=faces, uv_faces=flame.uv_faces[:9976], uv_islands=flame.uv_islands[:9976])
