"""The capture studio: people and shots come from seeds, strands follow the head, a job resumes and shares, Cycles renders."""

from __future__ import annotations

import functools
import importlib.util
import itertools
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from grmm_core.controls.names import ALIGNED_NAMES
from grmm_core.data.dataset import CaptureDataset
from grmm_core.data.layers import NORMAL, PART_LAYER, PARTS
from grmm_core.errors import ConfigError
from grmm_core.hair.roots import BEARD, BROWS, LASHES, SCALP
from grmm_core.head.lash_cards import lash_edges
from grmm_core.head.open_head import load_open_head, load_people_model
from grmm_studio import grooming
from grmm_studio.capture import job_order
from grmm_studio.grooming import make_groom, scalp_hairs
from grmm_studio.grooms import growth_of
from grmm_studio.settings import CaptureSettings, open_job
from grmm_studio.shots import expression_pool, held_out, make_shot, view_split
from grmm_studio.styles import HAIR_STYLES
from grmm_studio.subjects import draw_subject, skin_albedo

ROOT = Path(__file__).resolve().parents[2]


def test_a_person_depends_on_seed_and_number_only():
    people = load_people_model()
    a, b, other = (draw_subject(5, i, people) for i in (3, 3, 4))
    assert a.to_json() == b.to_json()
    np.testing.assert_array_equal(a.shape, b.shape)
    assert not np.allclose(a.shape, other.shape)
    json.dumps(a.to_json())


def test_people_are_varied():
    people = [draw_subject(1, i, load_people_model()) for i in range(24)]
    melanin = np.array([p.melanin for p in people])
    assert melanin.min() < 0.4
    assert melanin.max() > 1.2
    assert len({p.hair_style for p in people}) >= 7
    assert {p.hair_style for p in people} <= set(HAIR_STYLES)
    assert 8 <= sum(p.female for p in people) <= 16
    assert all(p.stubble == 0 and p.beard == 0 for p in people if p.female)
    age, weight = (np.array([p.macros[name] for p in people]) for name in ("age", "weight"))
    assert age.min() >= 18
    assert age.min() < 28
    assert age.max() > 62
    assert age.std() > 8
    assert weight.min() < 0.35
    assert weight.max() > 0.65
    lead = [max(("african", "asian", "caucasian"), key=p.macros.get) for p in people]
    assert sorted(map(lead.count, set(lead))) == [8, 8, 8]
    hair = np.array([p.hair_color for p in people])
    assert hair.mean(1).min() < 0.03  # black
    assert hair.mean(1).max() > 0.25  # fair or grey
    redness = hair[:, 0] / hair[:, 2]
    assert redness.min() < 1.2  # grey has none
    assert redness.max() > 4


def test_skin_darkens_with_melanin_and_reddens_with_blood():
    light, dark, bloody = skin_albedo(0.2, 0.5), skin_albedo(1.8, 0.5), skin_albedo(0.2, 1.0)
    assert (dark < light).all()
    assert bloody[1] / bloody[0] < light[1] / light[0]


def test_shots_are_deterministic_and_valid():
    for number in range(12):
        shot, again = make_shot(2, 3, number, 4, 64), make_shot(2, 3, number, 4, 64)
        np.testing.assert_array_equal(shot.aligned, again.aligned)
        np.testing.assert_array_equal(shot.cameras[0].world_to_camera, again.cameras[0].world_to_camera)
        assert shot.aligned.shape == (60,)
        assert 0 <= shot.aligned.min() <= shot.aligned.max() <= 1
        assert np.abs(shot.pose[1]).max() <= np.radians(17.1)
        assert len(shot.cameras) == len(shot.camera_names) == 4
    assert not make_shot(2, 3, 0, 1, 64).aligned.any()


def test_every_expression_is_captured():
    used = np.zeros(len(ALIGNED_NAMES))
    for subject in range(24):
        for number in range(12):
            used = np.maximum(used, make_shot(0, subject, number, 1, 64).aligned)
    assert used.min() > 0.3, [name for name, value in zip(ALIGNED_NAMES, used, strict=True) if value <= 0.3]


def test_expression_pool():
    assert expression_pool("all") == ALIGNED_NAMES
    shot = make_shot(0, 0, 1, 1, 64, expression_pool("jawOpen, laugh"))
    assert {name for name, weight in zip(ALIGNED_NAMES, shot.aligned, strict=True) if weight} <= {"jawOpen", "laugh"}
    with pytest.raises(ConfigError, match="grin"):
        expression_pool("jawOpen,grin")
    with pytest.raises(ConfigError, match="25 cameras"):
        make_shot(0, 0, 0, 25, 64)


def test_job_order_interleaves_people_and_covers_everything():
    order = [(person, number) for person, numbers in job_order(3, 10) for number in numbers]
    assert len(order) == len(set(order)) == 30
    assert {person for person, _ in order[:12]} == {0, 1, 2}


def test_splits():
    assert [i for i in range(24) if held_out(i)] == [11, 23]
    assert view_split(11, 0, "face") == "person"
    assert view_split(0, 6, "face") == "expression"
    assert view_split(0, 1, "c05") == "camera"
    assert view_split(0, 1, "c06") == "train"


def test_a_job_with_other_settings_is_refused(tmp_path):
    open_job(tmp_path, CaptureSettings(seed=1))
    open_job(tmp_path, CaptureSettings(seed=1))
    with pytest.raises(ConfigError, match="seed 1, not 2"):
        open_job(tmp_path, CaptureSettings(seed=2))


def test_fine_mesh_passes_through_the_model(head, render_mesh):
    vertices = np.asarray(head.v_template, float)
    fine = render_mesh.refine(vertices)
    np.testing.assert_array_equal(fine[: len(vertices)], vertices)
    middle = 0.5 * (vertices[render_mesh.edges[:, 0]] + vertices[render_mesh.edges[:, 1]])
    assert np.linalg.norm(fine[len(vertices) :] - middle, axis=1).max() < 0.005
    assert render_mesh.corner_uv(head).shape == (len(render_mesh.faces) * 3, 2)


def test_lash_cards_have_root_and_tip(head):
    cards = lash_edges(head)
    assert len(cards) == 4
    assert sum(card.upper for card in cards) == 2
    for card in cards:
        assert len(card.root) == len(card.tip) == len(card.triangles) + 1
        assert not set(card.root) & set(card.tip)
        corners = np.asarray(head.faces)[card.triangles]
        assert all({a, b} < set(triangle) for a, b, triangle in zip(card.root, card.root[1:], corners, strict=False))


def test_a_groom_has_all_hair_and_is_the_same_again(head, render_mesh):
    subject = replace(draw_subject(1, 2, load_people_model()), beard=0.01, hair_style="crop")
    neutral = np.asarray(head.vertices(subject.shape, np.zeros(1), np.zeros((5, 3))), float)
    groom, again = (make_groom(head, render_mesh, neutral, subject, share=0.02) for _ in range(2))
    assert set(groom.groups) == {SCALP, BROWS, BEARD, LASHES}
    for name, values in groom.pack().items():
        np.testing.assert_array_equal(values, again.pack()[name])
    points = groom.posed(groom.frames(head.v_template, head.faces), neutral)
    skin = cKDTree(render_mesh.refine(neutral))
    assert skin.query(points[groom.offsets[:-1]])[0].max() < 0.012
    assert np.median(groom.widths[:, 0]) < 0.0002


@pytest.fixture(scope="module")
def grown(head, render_mesh):
    """Strand points [N, K, 3] of a style on one person, a few strands of it."""
    subject = draw_subject(1, 2, load_people_model())
    neutral = np.asarray(head.vertices(subject.shape, np.zeros(1), np.zeros((5, 3))), float)

    @functools.cache
    def grow(style, **changes):
        hairs = scalp_hairs(head, render_mesh, neutral, replace(subject, hair_style=style, **changes), share=0.02)
        return None if hairs is None else hairs.points

    grow.skin = cKDTree(render_mesh.refine(neutral))
    return grow


def lengths(points):
    return np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1)


def bends(points):
    """Mean angle between successive segments, degrees."""
    steps = np.diff(points, axis=1)
    steps /= np.linalg.norm(steps, axis=2, keepdims=True)
    return np.degrees(np.arccos(np.clip((steps[:, 1:] * steps[:, :-1]).sum(2), -1, 1))).mean()


@pytest.mark.parametrize("style", HAIR_STYLES)
def test_every_style_grows_from_the_scalp(grown, style):
    points = grown(style)
    if style == "bald":
        assert points is None
        return
    assert len(points) > 100
    assert np.isfinite(points).all()
    roots = points[:, 0]
    if style not in ("ponytail", "bun"):  # whose tail begins at the knot
        assert grown.skin.query(roots)[0].max() < 0.012
    assert roots[:, 1].min() > -0.06  # above the jaw
    assert (np.linalg.norm(points[:, -1] - [0, 0.045, 0], axis=1) > 0.06).mean() > 0.98  # outside the skull
    assert 0.0015 < np.median(lengths(points)) < 0.5


def test_styles_differ_in_length(grown):
    order = ("stubble", "buzz", "crop", "side_part", "slick_back", "bob", "long")
    median = [np.median(lengths(grown(style))) for style in order]
    assert all(longer > 1.2 * shorter for shorter, longer in itertools.pairwise(median)), dict(zip(order, median, strict=True))
    assert np.median(lengths(grown("long", hair_length=1.25))) > 1.2 * np.median(lengths(grown("long", hair_length=0.75)))


@pytest.mark.parametrize("style", ["crop", "bob", "long", "wavy_long", "ringlets", "afro", "curly", "coily", "receding"])
def test_the_radius_of_curls_acts(grown, monkeypatch, style):
    curled = bends(grown(style, hair_curl=1.0))
    monkeypatch.setattr(grooming, "growth_of", lambda subject: replace(growth_of(subject), curl_radius=0.0))
    straight = bends(grown.__wrapped__(style, hair_curl=1.0))  # past the cache
    assert straight < 12
    assert curled > straight + 3


def test_braids_and_locs_are_ropes(grown):
    """Halfway down, a strand of a rope has many more close neighbours than a strand of loose hair."""
    crowd = {}
    for style in ("long", "locs", "braids"):
        middle = grown(style)[:, grown(style).shape[1] // 2]
        crowd[style] = np.median(cKDTree(middle).query(middle, k=4)[0][:, 3])
    assert max(crowd["locs"], crowd["braids"]) < 0.6 * crowd["long"], crowd


def test_shorn_sides_are_shorter_below(grown, head):
    points = grown("fade")
    side = np.abs(points[:, 0, 0]) > 0.055
    low = lengths(points)[side & (points[:, 0, 1] < 0.03)]
    high = lengths(points)[side & (points[:, 0, 1] > 0.075)]
    assert np.median(low) < 0.4 * np.median(high)


@pytest.mark.slow
@pytest.mark.skipif(importlib.util.find_spec("bpy") is None, reason="needs bpy")
def test_capture_with_cycles(tmp_path):
    """Two tiny people: the picture agrees with mask, depth and parameters; a second run has nothing to do."""
    command = [sys.executable, "-m", "grmm_core", "capture", str(tmp_path), "--subjects", "2", "--shots", "1", "--cameras", "1",
               "--size", "64", "--samples", "1", "--seed", "2", "--bare", "--layers", "--lights", "key", "--json"]  # fmt: skip
    # Without PYTHONUNBUFFERED Blender's own lines wait in the C library, and must not come after the result.
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONUNBUFFERED"}
    for made in (2, 0):
        result = subprocess.run(command, capture_output=True, text=True, timeout=500, cwd=ROOT, check=True, env=environment)
        assert json.loads(result.stdout)["shots"] == made
    data = CaptureDataset(tmp_path)
    head = load_open_head()
    for shot, view in data.views():
        picture = data.picture(shot, view)
        assert 0.1 < picture.mask.mean() < 0.95
        vertices = head.vertices(data.shape(shot.subject), shot.expression, shot.pose)
        nose = vertices[np.argmax(vertices[:, 2])]
        x, y, z = view.camera.world_to_camera[:3, :3] @ nose + view.camera.world_to_camera[:3, 3]
        column, row = int(view.camera.fx * x / z + view.camera.cx), int(view.camera.fy * y / z + view.camera.cy)
        if 0 <= row < 64 and 0 <= column < 64 and picture.depth[row, column] > 0:
            assert picture.depth[row, column] <= z + 0.02
        parts, bare = data.layer(shot, view, PART_LAYER), data.layer(shot, view.bare, PART_LAYER)
        np.testing.assert_allclose(parts.sum(0), picture.mask, atol=0.12)
        hair = PARTS.index("hair")
        assert parts[hair].mean() > 0.02
        assert bare[hair].max() == 0
        front = (np.linalg.norm(data.layer(shot, view, NORMAL), axis=-1) - 1)[picture.mask > 0.99]
        assert np.abs(front).max() < 0.03
        assert data.groom(shot.subject) is not None
        assert np.abs(data.layer(shot, view, "light_key") - picture.rgb)[picture.mask > 0.99].mean() > 0.05
