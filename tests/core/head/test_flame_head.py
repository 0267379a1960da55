"""A FLAME file completed to a head model: conventions, teeth, texture islands, regions, landmarks, ARKit map."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from flame_files import flame_fields, write_flame_pickle
from flame_head_files import EYE, SCALE, SHIFT, SKIN, flame_head_fields
from uv_layout import cover_texels

from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import FileFormatError, GrmmError
from grmm_core.head import load_flame, load_open_head, read_head
from grmm_core.head.flame import describe_flame, read_landmark_embedding
from grmm_core.head.flame_regions import find_surface
from grmm_core.head.flame_teeth import build_teeth, teeth_faces

JAW = 2


@pytest.fixture(scope="module")
def fields():
    return flame_head_fields()


@pytest.fixture(scope="module")
def path(fields, tmp_path_factory):
    path = tmp_path_factory.mktemp("flame") / "flame2023.pkl"
    write_flame_pickle(path, fields)
    return path


@pytest.fixture(scope="module")
def flame(path):
    return load_flame(path)


def rodrigues(vector):
    angle = np.linalg.norm(vector)
    if angle == 0:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def textbook_lbs(fields, shape, expression, rotations):
    """FLAME's function by 4x4 matrices, vertex by vertex order of the original publication."""
    offsets = fields["shapedirs"] @ np.r_[shape, np.zeros(300 - len(shape)), expression]
    joints = fields["J_regressor"] @ (fields["v_template"] + fields["shapedirs"][:, :, : len(shape)] @ shape)
    feature = np.concatenate([(rotation - np.eye(3)).reshape(-1) for rotation in rotations[1:]])
    vertices = fields["v_template"] + offsets + fields["posedirs"] @ feature
    world = []
    for joint, parent in enumerate((-1, 0, 1, 1, 1)):
        local = np.eye(4)
        local[:3, :3] = rotations[joint]
        local[:3, 3] = joints[joint] - (joints[parent] if parent >= 0 else 0)
        world.append(local if parent < 0 else world[parent] @ local)
    posed = np.zeros_like(vertices)
    for joint in range(5):
        away = np.eye(4)
        away[:3, 3] = -joints[joint]
        matrix = world[joint] @ away
        posed += fields["weights"][:, joint : joint + 1] * (vertices @ matrix[:3, :3].T + matrix[:3, 3])
    return posed


def test_counts_names_and_untouched_arrays(flame, fields):
    assert flame.name == "flame2023"
    assert flame.v_template.shape == (5143, 3)
    assert flame.faces.shape == (10144, 3)
    assert flame.shape_dirs.shape == (5143, 3, 300)
    assert flame.expression_dirs.shape == (5143, 3, 100)
    assert flame.posedirs.shape == (5143, 3, 36)
    assert not flame.expression_pose.any()
    np.testing.assert_array_equal(flame.faces[:9976], fields["f"])
    np.testing.assert_allclose(flame.v_template[:5023], fields["v_template"], atol=1e-7)
    np.testing.assert_allclose(flame.J_regressor[:, :5023] @ fields["v_template"], flame.joint_template, atol=1e-5)
    assert not flame.J_regressor[:, 5023:].any()


def test_skinning_is_the_textbooks(flame, fields):
    rng = np.random.default_rng(3)
    shape, expression = rng.normal(size=20), rng.normal(size=100)
    vectors = rng.normal(0.0, 0.2, (5, 3))
    vectors[:, 1:] *= [[0], [1], [1], [1], [1]]  # two axes at once, so that the order of the angles counts
    euler = np.zeros((5, 3))
    rotations = [rodrigues(vector) for vector in vectors]
    for joint, r in enumerate(rotations):
        euler[joint] = np.arctan2(r[2, 1], r[2, 2]), np.arcsin(-r[2, 0]), np.arctan2(r[1, 0], r[0, 0])
    expected = textbook_lbs(fields, shape, expression, rotations)
    got = flame.vertices(shape, expression, euler)
    np.testing.assert_allclose(got[:5023], expected, atol=2e-6)
    without = textbook_lbs({**fields, "posedirs": 0 * fields["posedirs"]}, shape, expression, rotations)
    assert np.abs(without - expected).max() > 1e-4  # the correctives take part


def test_torch_twin_agrees(flame):
    from grmm_core.head.torch_head import TorchHead

    rng = np.random.default_rng(4)
    shape, expression, pose = rng.normal(size=10), rng.normal(size=100), rng.normal(0, 0.2, (5, 3))
    twin = TorchHead(flame)
    got, _ = twin(*(torch.tensor(a, dtype=torch.float32)[None] for a in (shape, expression, pose)))
    np.testing.assert_allclose(got[0].numpy(), flame.vertices(shape, expression, pose), atol=2e-6)


def test_teeth_layout(flame):
    faces = teeth_faces()
    assert faces.shape == (168, 3)
    assert sorted(np.unique(faces)) == list(range(120))
    rows = faces // 15
    # front, back and biting edge of the upper, then of the lower teeth, 28 triangles each
    for strip, pair in enumerate([(0, 2), (4, 5), (2, 5), (1, 3), (6, 7), (3, 7)]):
        assert set(np.unique(rows[28 * strip : 28 * strip + 28])) == set(pair)
    vertices = flame.v_template[5023:].reshape(8, 15, 3)
    assert (np.diff(vertices[..., 0], axis=1) < 0).all()  # from the subject's left to the right
    assert (vertices[0, :, 1] > vertices[2, :, 1]).all()  # upper roots above the edge
    assert (vertices[1, :, 1] < vertices[3, :, 1]).all()
    corners = flame.v_template[5023:][faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (np.linalg.norm(normals, axis=1) > 0).all()
    assert (normals[:28, 2] > 0).mean() > 0.9  # fronts look forwards, backs backwards
    assert (normals[28:56, 2] < 0).mean() > 0.9
    assert (normals[56:84, 1] < 0).all()
    assert (normals[84:112, 2] > 0).mean() > 0.9
    assert (normals[140:, 1] > 0).all()


def test_teeth_stand_behind_the_lips_inside_the_head(flame):
    teeth, lips = flame.v_template[5023:], flame.v_template[flame.regions["lips"]]
    assert teeth[:, 2].max() < lips[:, 2].max()
    assert np.ptp(teeth[:, 0]) == pytest.approx(np.ptp(lips[:, 0]), rel=0.4)
    assert abs(teeth[:, 1].mean() - lips[:, 1].mean()) < 0.01
    assert teeth[:, 2].min() > flame.v_template[:5023, 2].mean() - 0.02


def test_lower_teeth_follow_the_jaw_upper_ones_the_neck(flame):
    upper, lower = flame.regions["upper_teeth"], flame.regions["lower_teeth"]
    assert len(upper) == len(lower) == 60
    pose = np.zeros((5, 3))
    pose[JAW, 0] = 0.3
    moved = flame.vertices(np.zeros(0), np.zeros(0), pose) - flame.v_template
    assert np.abs(moved[upper]).max() < 1e-7
    assert moved[lower, 1].max() < -0.005
    pose = np.zeros((5, 3))
    pose[1, 1] = 0.3
    turned = flame.vertices(np.zeros(0), np.zeros(0), pose)
    for part in (upper, lower):
        before, after = flame.v_template[part], turned[part]
        np.testing.assert_allclose(
            np.linalg.norm(before[:, None] - before, axis=2), np.linalg.norm(after[:, None] - after, axis=2), atol=1e-6
        )
        assert np.abs(after - before).max() > 0.005
    assert not flame.expression_dirs[5023:].any()
    assert not flame.posedirs[5023:].any()


def test_identity_moves_teeth_with_the_mouth_as_a_body():
    angle = np.linspace(0, 2 * np.pi, 30, endpoint=False)
    mouth = np.stack([0.025 * np.cos(angle), 0.002 * np.sin(angle), 0.09 - 8 * (0.025 * np.cos(angle)) ** 2], 1)
    shift, turn, growth = np.array([0.001, -0.002, 0.003]), np.array([0.02, -0.03, 0.01]), 0.05
    arms = mouth - mouth.mean(0)
    moves = shift + np.cross(turn, arms) + growth * arms
    teeth = build_teeth(mouth, moves[:, :, None])
    arms = teeth.vertices - mouth.mean(0)
    expected = shift + np.cross(turn, arms) + growth * arms
    np.testing.assert_allclose(teeth.shape_dirs[:, :, 0], expected, atol=2e-4)


def test_texture_islands_do_not_overlap_and_keep_a_gutter(flame):
    assert flame.uv.min() >= 0
    assert flame.uv.max() <= 1
    plane = flame.uv[flame.uv_faces].astype(np.float64)
    area = np.linalg.det(np.stack([plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]], -1)) / 2
    assert (area > 0).all()
    count, owner = cover_texels(plane, 1024)
    assert count.max() == 1
    assert (count > 0).mean() > 0.6
    island = np.where(owner >= 0, flame.uv_islands[owner], -1)
    for axis in (0, 1):
        for shift in range(1, 8):
            a, b = np.moveaxis(island, axis, 0)[shift:], np.moveaxis(island, axis, 0)[:-shift]
            assert not ((a >= 0) & (b >= 0) & (a != b)).any()


def test_islands_belong_to_one_part_and_the_face_is_finest(flame):
    part = np.zeros(5143, int)
    for number, name in enumerate(("left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth"), 1):
        part[flame.regions[name]] = number
    for number in np.unique(flame.uv_islands):
        assert len(np.unique(part[flame.faces[flame.uv_islands == number]])) == 1
    inner = np.isin(flame.faces, flame.regions["mouth_interior"]).all(1)
    assert inner.sum() > 30
    assert 0 not in flame.uv_islands[inner]
    corners, plane = flame.v_template[flame.faces].astype(float), flame.uv[flame.uv_faces].astype(float)
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    mapped = 0.5 * np.linalg.det(np.stack([plane[:, 1] - plane[:, 0], plane[:, 2] - plane[:, 0]], -1))
    size = np.sqrt(area / mapped) / 256  # metres per texel

    def of(name):
        return np.median(size[np.isin(flame.faces, flame.regions[name]).all(1)])

    assert of("face") < 0.002
    assert of("face") < of("scalp")
    assert np.percentile(size[flame.uv_islands == 0], 99) < 0.005


def test_regions(flame):
    cover = ["scalp", "face", "neck", "ears", "mouth_interior", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth"]
    together = np.concatenate([flame.regions[name] for name in cover])
    assert len(together) == len(np.unique(together)) == 5143
    assert len(flame.regions["left_eyeball"]) == len(flame.regions["right_eyeball"]) == EYE
    left, right = (flame.v_template[flame.regions[f"{side}_eyeball"], 0].mean() for side in ("left", "right"))
    assert left > right
    height = {name: flame.v_template[flame.regions[name], 1].mean() for name in ("scalp", "lids", "lips", "neck")}
    assert height["scalp"] > height["lids"] > height["lips"] > height["neck"]
    assert flame.regions["face"].max() < SKIN


def test_landmarks_lie_where_the_open_heads_do(flame):
    head = load_open_head()
    expected = head.landmark_positions(head.v_template) * SCALE + SHIFT
    gap = np.linalg.norm(flame.landmark_positions(flame.v_template) - expected, axis=1)
    assert np.median(gap[17:]) < 0.004
    assert gap.max() < 0.02
    assert flame.landmarks478 is None


@pytest.mark.parametrize(
    ("name", "limit"),
    [
        ("jawOpen", 0.15),
        ("mouthSmileLeft", 0.15),
        ("eyeBlinkRight", 0.15),
        ("browInnerUp", 0.2),
        ("mouthPucker", 0.2),
        ("cheekPuff", 0.2),
        ("mouthLeft", 0.2),
    ],
)
def test_arkit_shapes_do_what_they_do_on_the_open_head(flame, name, limit):
    """The stand-in's expression space is the open head's, rotated at random: what each shape should move is known."""
    head = load_open_head()
    index = ARKIT_NAMES.index(name)
    rotation = np.linalg.qr(np.random.default_rng(7).normal(size=(100, 100)))[0]
    wanted = flame.vertices(np.zeros(0), rotation[index], head.expression_pose[index]) - flame.v_template
    controls = Controls().set_named({name: 1.0})
    inputs = resolve(controls, flame)
    got = flame.vertices(np.zeros(0), inputs.expression, inputs.pose) - flame.v_template
    assert np.linalg.norm(got[:SKIN] - wanted[:SKIN]) < limit * np.linalg.norm(wanted[:SKIN])


def test_arkit_turns_jaw_and_eyes_linearly(flame):
    half = resolve(Controls().set_named({"jawOpen": 0.5}), flame).pose
    assert 0.1 < half[JAW, 0] < 0.3
    assert not half[JAW, 1:].any()
    whole = resolve(Controls().set_named({"jawOpen": 1.0, "jaw.x": 0.1}), flame).pose
    assert whole[JAW, 0] == pytest.approx(2 * half[JAW, 0] + 0.1, abs=1e-6)
    left = resolve(Controls().set_named({"eyeLookOutLeft": 1.0}), flame).pose
    assert left[3, 1] > 0.2
    assert not left[4].any()


def test_open_head_resolves_as_before():
    head = load_open_head()
    assert head.arkit_pose.shape == (52, 5, 3)
    assert not head.arkit_pose.any()


def test_read_head_masks_and_cache(flame, path, tmp_path):
    import pickle

    assert read_head(path) is flame
    masks = tmp_path / "FLAME_masks.pkl"
    masks.write_bytes(pickle.dumps({"scalp": np.arange(500, 700), "lips": np.arange(100, 140)}, 2))
    with_masks = load_flame(path, masks=masks)
    assert set(with_masks.regions["scalp"]) <= set(range(500, 700))
    np.testing.assert_array_equal(with_masks.uv, flame.uv)  # deterministic


def test_landmark_embedding(tmp_path):
    path = tmp_path / "embedding.npz"
    good = {"lmk_face_idx": np.arange(68), "lmk_b_coords": np.full((68, 3), 1 / 3)}
    np.savez(path, **good)
    triangles, coordinates = read_landmark_embedding(path)
    assert triangles.tolist() == list(range(68))
    np.testing.assert_allclose(coordinates.sum(1), 1, atol=1e-6)
    for change in ({"lmk_face_idx": np.arange(51)}, {"lmk_face_idx": np.full(68, 9976)}, {"lmk_b_coords": np.ones((68, 3))}):
        np.savez(path, **{**good, **change})
        with pytest.raises(FileFormatError):
            read_landmark_embedding(path)


def test_info(path):
    facts = describe_flame(path)
    assert facts["kind"] == "flame-head"
    assert facts["name"] == "flame2023"
    assert "5143" in facts["with teeth"]


def test_meshes_that_are_no_head_say_why(fields, tmp_path):
    path = tmp_path / "flame.npz"
    np.savez(path, **flame_fields())  # right shapes, triangles at random
    with pytest.raises(FileFormatError, match=r"flame\.npz"):
        load_flame(path)
    vertices, faces = fields["v_template"], fields["f"].astype(np.int32)
    with pytest.raises(FileFormatError, match="metres"):
        find_surface(vertices * 1000, faces, "x")
    with pytest.raises(FileFormatError, match="twice"):
        find_surface(vertices, np.r_[faces[:-1], [[1, 1, 2]]], "x")
    joined = faces.copy()
    joined[-1] = 0, SKIN, SKIN + EYE
    with pytest.raises(FileFormatError, match="eyeballs"):
        find_surface(vertices, joined, "x")
    rim = find_surface(vertices, faces, "x").mouth_loop
    fan = np.stack([np.full(len(rim) - 2, rim[0]), rim[2:], rim[1:-1]], 1)
    with pytest.raises(FileFormatError, match="mouth"):
        find_surface(vertices, np.r_[faces, fan], "x")


def test_damaged_files_give_typed_errors_only(path, tmp_path):
    whole = path.read_bytes()
    rng = np.random.default_rng(0)
    target = tmp_path / "flame2023.pkl"
    for trial in range(6):
        data = bytearray(whole[: rng.integers(1, len(whole))] if trial % 2 else whole)
        for position in rng.integers(0, min(len(data), 4000), 5):
            data[position] = rng.integers(256)
        target.write_bytes(data)
        with pytest.raises(GrmmError):
            load_flame(target)
