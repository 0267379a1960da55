"""Furrows: painted for a person, raised by an expression, drawn as the readable form has it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.geometry.camera import Camera
from grmm_core.geometry.zbuffer import EMPTY, triangle_depth
from grmm_core.head import load_open_head, load_people_model
from grmm_core.light.rough import rig_harmonics
from grmm_core.light.transfer import vertex_normals
from grmm_core.wrinkles import furrows
from grmm_core.wrinkles import relief as reliefs
from grmm_core.wrinkles.families import DRIVERS, FAMILIES, LINE_DEPTH, drive, line_depth
from grmm_core.wrinkles.furrows import Furrows, sizes_of
from grmm_core.wrinkles.relief import FINER, Relief, age_of, seed_of
from grmm_core.wrinkles.shade import LEVELS

GRID = 128
SMILE = np.array([name.startswith(("mouthSmile", "cheekSquint", "brow")) for name in ARKIT_NAMES], np.float32)


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def relief(head):
    return Relief.of(head, head.uv, GRID, 7, 0.8)


def furrowed(head, relief, vertices=None):
    vertices = np.asarray(head.v_template if vertices is None else vertices, np.float32)
    heights = relief.heights(SMILE)
    corners = head.uv[head.uv_faces[relief.faces]] * (GRID * FINER) - 0.5 - relief.corner[::-1]
    normals = vertex_normals(vertices, head.faces).astype(np.float32)
    faces = np.ascontiguousarray(head.faces[relief.faces], np.int32)
    size = int(relief.size[0]), int(relief.size[1])
    return Furrows(
        sizes_of(heights), size, faces, corners.astype(np.float32), vertices, normals, rig_harmonics().astype(np.float32)
    )


def test_every_family_has_drivers():
    assert {family.name for family in FAMILIES} == set(DRIVERS)
    assert len(FAMILIES) == len({(family.name, family.side) for family in FAMILIES}) == 22


def test_a_side_is_driven_by_its_own_shapes():
    assert drive({"browOuterUpLeft": 1.0}, "forehead_side", "Left") == 1.0
    assert drive({"browOuterUpLeft": 1.0}, "forehead_side", "Right") == 0.0


def test_relief_is_one_persons_own_and_deeper_with_age(head, relief):
    other, young = Relief.of(head, head.uv, GRID, 8, 0.8), Relief.of(head, head.uv, GRID, 7, 0.05)
    all_of_them = np.ones(len(ARKIT_NAMES), np.float32)
    mine, theirs, early = (each.heights(all_of_them) for each in (relief, other, young))
    assert mine is not None
    assert theirs is not None
    assert early is not None
    assert -2.0 * LINE_DEPTH < mine.min() < -0.6 * LINE_DEPTH
    assert mine.max() < LINE_DEPTH
    assert mine.shape != theirs.shape or np.abs(mine - theirs).max() > 0.3 * LINE_DEPTH
    assert early.min() > 0.6 * mine.min()
    assert line_depth(0.8) > 1.5 * line_depth(0.05)


def test_nothing_rises_in_a_neutral_face_nor_above_what_colors_hold(relief):
    assert relief.heights(0.0 * SMILE) is None
    assert relief.heights(SMILE, relief.driven(SMILE, 0.5 * SMILE)) is None


@pytest.mark.parametrize("share", [None, 0.4])
def test_the_compiled_form_raises_as_the_readable_one(relief, share, monkeypatch):
    frown = np.zeros_like(SMILE)
    frown[ARKIT_NAMES.index("browDownLeft")] = 0.7
    held = None if share is None else relief.driven(share * SMILE, frown)
    fast = relief.heights(SMILE + 0.9 * frown, held)
    monkeypatch.setattr(reliefs, "compiled_kernels", lambda: None)
    readable = relief.heights(SMILE + 0.9 * frown, held)
    assert np.abs(readable).max() > 0.1 * LINE_DEPTH
    np.testing.assert_allclose(fast, readable, atol=1e-8)


@pytest.mark.parametrize(("size", "fov", "flat"), [(192, 12.0, False), (96, 26.0, False), (160, 6.0, False), (128, 14.0, True)])
def test_the_compiled_form_draws_as_the_readable_one(head, relief, size, fov, flat, monkeypatch):
    shown = furrowed(head, relief)
    camera = Camera.orbit(size, size, 25, 5, fov=fov, target=(0.0, 0.02, 0.05))
    if flat:
        camera = dataclasses.replace(camera, orthographic=True)  # its pixels a metre fit a head 1 m away
    depth = triangle_depth(shown.vertices[head.faces], camera)
    alpha = (depth < EMPTY).astype(np.float32)
    skin = alpha * np.linspace(0.0, 1.0, size, dtype=np.float32)
    pictures = []
    for compiled in (True, False):
        if not compiled:
            monkeypatch.setattr(furrows, "compiled_kernels", lambda: None)
        picture = np.full((size, size, 3), 0.5, np.float32) * alpha[..., None]
        shown.draw(picture, np.where(alpha > 0, depth, 0.0).astype(np.float32), alpha, skin, camera)
        pictures.append(picture)
    fast, readable = pictures
    assert np.abs(fast - 0.5 * alpha[..., None]).max() > 0.01
    np.testing.assert_allclose(fast, readable, atol=1.5e-3)


def test_what_stands_before_the_skin_has_no_furrows(head, relief):
    shown, camera = furrowed(head, relief), Camera.orbit(128, 128, 0, fov=14)
    depth = triangle_depth(shown.vertices[head.faces], camera)
    picture = np.full((128, 128, 3), 0.5, np.float32)
    shown.draw(
        picture, np.where(depth < EMPTY, depth - 0.02, 0.0).astype(np.float32), np.ones_like(depth, np.float32), None, camera
    )
    assert (picture == 0.5).all()


def test_sizes_keep_the_mean(relief):
    heights = relief.heights(SMILE)
    levels, (rows, columns), first = sizes_of(heights), heights.shape, 0
    for number in range(LEVELS):
        count = (rows >> number) * (columns >> number)
        assert levels[first : first + count].mean() == pytest.approx(heights.mean(), rel=1e-4)
        first += count
    assert first == len(levels)


def test_age_is_read_from_a_shape():
    people = load_people_model()
    generator, told = np.random.default_rng(3), []
    for years in (20.0, 30.0, 45.0, 60.0, 75.0):
        macros = people.mean.copy()
        macros[people.names.index("age")] = years
        expected = (macros - people.mean) @ people.macro_to_shape
        shapes = expected + 0.3 * people.residual_std * generator.normal(size=(20, len(expected)))
        told.append(np.mean([age_of(shape, people) for shape in shapes]))
    assert told == sorted(told)
    assert told[0] < 0.25
    assert told[-1] > 0.75


def test_a_shape_always_has_its_own_seed():
    shape = np.arange(300, dtype=np.float32)
    assert seed_of(shape) == seed_of(shape.copy()) != seed_of(shape + 1e-3)
