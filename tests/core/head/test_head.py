"""The open head: its asset, skinning, expressions, lids, teeth, joints, landmarks. `test_head_uv` tests its texture layout."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from eyeballs import both, eye_visibility, random_people, sphere

from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ARKIT_NAMES, JOINT_NAMES
from grmm_core.errors import FileAccessError, FileFormatError, ShapeError
from grmm_core.files.tensorfile import read_tensors, write_tensors
from grmm_core.geometry.rotations import euler_to_matrix
from grmm_core.head import load_open_head, load_people_model, read_head
from grmm_core.head.open_head import ASSET
from grmm_core.head.skinning import joint_transforms, posed_vertices

SCULPT_TOLERANCE = 5e-6  # metres; 16-bit rounding of directions gives under 1e-6


@pytest.fixture(scope="module")
def head():
    return load_open_head()


@pytest.fixture(scope="module")
def raw():
    return read_tensors(ASSET)


def pose_head(head, weights, shape=(), pose=None):
    expression = np.zeros(head.expression_count, np.float32)
    for name, value in weights.items():
        expression[head.expression_index(name)] = value
    return head.vertices(np.asarray(shape, np.float32), expression, head.pose_of(expression, pose))


# ---- the asset ------------------------------------------------------------------------------------------------------------


def test_sizes_and_names(head):
    assert head.shape_count == 300
    assert head.expression_count == 100
    assert head.expression_names[:52] == ARKIT_NAMES
    assert len(set(head.expression_names)) == 100
    assert head.joint_names == JOINT_NAMES
    assert head.faces.dtype == np.int32
    assert head.shape_dirs.dtype == head.expression_dirs.dtype == head.v_template.dtype == np.float32
    assert ASSET.stat().st_size <= 12e6


def test_arrays_are_read_only(head):
    with pytest.raises(ValueError, match="read-only"):
        head.v_template[0] = 0
    with pytest.raises(ValueError, match="read-only"):
        head.regions["lips"][0] = 0
    with pytest.raises(TypeError):
        head.regions["lips"] = np.zeros(1)
    assert load_open_head() is head


def test_head_space(head):
    eyes = head.joints(np.zeros(0))[3:]
    assert abs(eyes[:, 0].sum()) < 1e-5
    assert eyes[0, 0] > 0.02
    assert (eyes[:, 2] > 0.05).all()
    template = head.v_template
    assert 0.12 < template[:, 1].max() < 0.17
    # ears on both sides of the origin, the left one at +x
    ears = template[head.regions["ears"]]
    assert abs(ears[:, 1].mean()) < 0.02
    assert abs(ears[:, 2].mean()) < 0.03
    # the mean person is symmetric
    mirrored = template * (-1, 1, 1)
    nearest = np.array([np.linalg.norm(template - point, axis=1).min() for point in mirrored[::25]])
    assert nearest.max() < 1e-3


def test_no_component_is_empty(head):
    for directions, pose in ((head.shape_dirs, 0.0), (head.expression_dirs, np.abs(head.expression_pose).sum((1, 2)))):
        assert (np.abs(directions).max((0, 1)) + pose > 1e-6).all()


def test_weights_and_regressor_are_affine(head):
    np.testing.assert_allclose(head.weights.sum(1), 1, atol=1e-5)
    assert head.weights.min() >= 0
    np.testing.assert_allclose(head.J_regressor.sum(1), 1, atol=1e-4)
    np.testing.assert_allclose(head.J_regressor @ head.v_template, head.joints(np.zeros(0)), atol=1e-6)


def test_triangles_look_outwards(head):
    corners = head.v_template[head.faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    for part in ("left_eyeball", "right_eyeball"):
        inside = np.isin(head.faces, head.regions[part]).all(1)
        outward = corners[inside].mean(1) - head.v_template[head.regions[part]].mean(0)
        assert ((normal[inside] * outward).sum(1) > 0).all()
    scalp = np.isin(head.faces, head.regions["scalp"]).all(1)
    assert ((normal[scalp] * (corners[scalp].mean(1) - (0, 0.03, 0))).sum(1) > 0).mean() > 0.99


def test_regions(head):
    wanted = {
        "upper_teeth", "lower_teeth", "tongue", "mouth_interior", "left_eyeball", "right_eyeball", "lips", "left_lids",
        "right_lids", "lids", "lashes", "scalp", "face", "neck", "ears", "brows",
    }  # fmt: skip
    assert wanted <= set(head.regions)
    cover = wanted - {"lips", "left_lids", "right_lids", "lids", "brows"}  # those are parts of the face
    together = np.concatenate([head.regions[name] for name in cover])
    assert len(together) == len(np.unique(together)) == head.vertex_count
    for name in wanted:
        assert (np.diff(head.regions[name]) > 0).all()
    assert (head.v_template[head.regions["left_lids"], 0] > 0).all()
    assert (head.v_template[head.regions["right_lids"], 0] < 0).all()


def test_corrupt_asset_is_refused(tmp_path, raw):
    tensors, metadata = raw
    target = tmp_path / "head.safetensors"

    def refuse(changed, meta, kind=FileFormatError):
        write_tensors(target, changed, meta)
        with pytest.raises(kind):
            read_head(target)

    refuse({k: v for k, v in tensors.items() if k != "weights"}, metadata)
    refuse(tensors, metadata | {"version": "99"})
    refuse(tensors, metadata | {"format": "other"})
    refuse(tensors, metadata | {"expression_names": "not json"})
    refuse(tensors | {"faces": tensors["faces"] + 9999}, metadata)
    refuse(tensors | {"v_template": tensors["v_template"][:-1]}, metadata)
    refuse(tensors | {"v_template": np.full_like(tensors["v_template"], np.nan)}, metadata)
    data = ASSET.read_bytes()
    target.write_bytes(data[: len(data) // 2])
    with pytest.raises(FileFormatError):
        read_head(target)
    with pytest.raises(FileAccessError):
        read_head(tmp_path / "missing.safetensors")


# ---- skinning -------------------------------------------------------------------------------------------------------------


def test_euler_convention_is_rz_ry_rx():
    angles = np.array([0.3, -0.5, 0.7])
    single = [euler_to_matrix(angles * axis) for axis in np.eye(3)]
    np.testing.assert_allclose(euler_to_matrix(angles), single[2] @ single[1] @ single[0], atol=1e-12)
    np.testing.assert_allclose(euler_to_matrix(np.array([0.1, 0, 0])) @ (0, 1, 0), (0, np.cos(0.1), np.sin(0.1)), atol=1e-12)


def test_joint_chain_turns_children(head):
    joints = head.joints(np.zeros(0))
    pose = np.zeros((5, 3), np.float32)
    pose[1] = (0.2, 0.4, -0.1)
    transforms = joint_transforms(euler_to_matrix(pose), joints, head.parents.tolist())
    neck = euler_to_matrix(pose[1])
    for child in (2, 3, 4):
        moved = transforms[child, :, :3] @ joints[child] + transforms[child, :, 3]
        np.testing.assert_allclose(moved, neck @ (joints[child] - joints[1]) + joints[1], atol=1e-6)


def test_root_moves_everything_rigidly(head):
    pose = np.zeros((5, 3), np.float32)
    pose[0] = (0.3, -0.2, 0.5)
    turned = head.vertices(np.zeros(0), np.zeros(0), pose)
    root = head.joints(np.zeros(0))[0]
    np.testing.assert_allclose(turned, (head.v_template - root) @ euler_to_matrix(pose[0]).T + root, atol=1e-5)


def test_numpy_and_torch_agree(head):
    from grmm_core.head.torch_head import TorchHead

    generator = np.random.default_rng(3)
    shape = generator.standard_normal((2, 300)).astype(np.float32)
    expression = generator.uniform(0, 0.5, (2, 100)).astype(np.float32)
    pose = generator.uniform(-0.3, 0.3, (2, 5, 3)).astype(np.float32)
    displacement = generator.normal(0, 1e-3, (2, head.vertex_count, 3)).astype(np.float32)
    twin = TorchHead(head)
    arguments = [torch.tensor(a) for a in (shape, expression, pose, displacement)]
    vertices, joints = twin(*arguments)
    for i in range(2):
        np.testing.assert_allclose(vertices[i], head.vertices(shape[i], expression[i], pose[i], displacement[i]), atol=2e-6)
        np.testing.assert_allclose(joints[i], head.joints(shape[i]), atol=2e-6)
    rotations = euler_to_matrix(arguments[2])
    np.testing.assert_allclose(twin(arguments[0], arguments[1], rotations, arguments[3])[0], vertices, atol=1e-6)
    np.testing.assert_allclose(twin.pose_of(arguments[1])[0], head.pose_of(expression[0]), atol=1e-5)
    assert not twin.state_dict()


def test_gradients_match_finite_differences(head):
    from grmm_core.head.torch_head import TorchHead

    twin = TorchHead(head, dtype=torch.float64)
    generator = torch.Generator().manual_seed(0)
    values = [
        (0.5 * torch.randn(size, generator=generator, dtype=torch.float64)).requires_grad_()
        for size in ((6,), (5,), (5, 3))
    ]  # fmt: skip
    probe = torch.randn((head.vertex_count, 3), generator=generator, dtype=torch.float64)

    def loss(shape, expression, pose):
        return (twin(shape, expression, pose)[0] * probe).sum()

    gradients = torch.autograd.grad(loss(*values), values)
    for which, gradient in enumerate(gradients):
        direction = torch.randn(values[which].shape, generator=generator, dtype=torch.float64)
        step = 1e-5
        ends = [loss(*[v + sign * step * direction if i == which else v for i, v in enumerate(values)]) for sign in (1, -1)]
        numeric = (ends[0] - ends[1]) / (2 * step)
        assert numeric.item() == pytest.approx((gradient * direction).sum().item(), rel=1e-5, abs=1e-7)


def test_persons_do_not_mix(head):
    one, two = random_people(2)
    expected = head.v_template + head.shape_dirs @ two
    first = head.shaped(one)
    np.testing.assert_allclose(head.shaped(two), expected, atol=1e-6)
    head.shaped(two)[:] = 0  # what is returned belongs to the caller
    head.joints(two)[:] = 0
    np.testing.assert_allclose(head.shaped(two), expected, atol=1e-6)
    np.testing.assert_allclose(head.joints(two), head.J_regressor @ expected, atol=1e-6)
    np.testing.assert_array_equal(head.shaped(one), first)


def test_posedirs_are_added_before_skinning(head):
    pose = np.zeros((5, 3), np.float32)
    pose[2] = (0.2, 0.1, 0)
    rotations = euler_to_matrix(pose)
    posedirs = np.random.default_rng(0).normal(0, 1e-3, (head.vertex_count, 3, 36)).astype(np.float32)
    extra = posedirs @ (rotations[1:] - np.eye(3, dtype=np.float32)).ravel()
    joints, parents = head.joints(np.zeros(0)), head.parents.tolist()
    np.testing.assert_allclose(
        posed_vertices(head.v_template, rotations, joints, head.weights, parents, posedirs),
        posed_vertices(head.v_template + extra, rotations, joints, head.weights, parents),
        atol=1e-6,
    )


def test_wrong_shapes_are_refused(head):
    with pytest.raises(ShapeError, match="shape"):
        head.shaped(np.zeros(301))
    with pytest.raises(ShapeError):
        head.shaped(np.zeros((1, 300)))
    with pytest.raises(ShapeError):
        head.vertices(np.zeros(0), np.zeros(0), np.zeros((4, 3)))
    with pytest.raises(ShapeError):
        head.vertices(np.zeros(0), np.zeros(0), np.zeros((5, 3)), np.zeros((3, 3)))
    with pytest.raises(ShapeError):
        head.expression_index("noSuchShape")
    with pytest.raises(ShapeError):
        head.landmark_positions(head.v_template, 12)


# ---- expressions ----------------------------------------------------------------------------------------------------------


def test_expression_at_one_is_the_sculpted_shape(head, raw):
    tensors, _ = raw
    checked = tensors["check_vertices"]
    for index, name in enumerate(head.expression_names):
        moved = pose_head(head, {name: 1.0})[checked] - head.v_template[checked]
        np.testing.assert_allclose(moved, tensors["check_sculpted"][index], atol=SCULPT_TOLERANCE, err_msg=name)


def test_front_teeth_overlap_and_the_bite_is_nearly_level(head):
    """Molars much higher than incisors are seen alone behind the lower lip of a hardly open mouth, as one lone tooth."""
    upper, lower = (head.v_template[head.regions[name]] for name in ("upper_teeth", "lower_teeth"))

    def edge(row, ahead, up):
        """Height of a row's biting edge in front of a depth, or behind it."""
        chosen = row[(row[:, 2] > 0.095) if ahead else (row[:, 2] < 0.062)]
        return up * (up * chosen[:, 1]).max()

    assert 0.001 < edge(lower, True, 1) - edge(upper, True, -1) < 0.004
    assert edge(lower, False, 1) - edge(lower, True, 1) < 0.005
    front = upper[upper[:, 2] > 0.095]
    assert lower[:, 2].max() < front[:, 2].max()  # behind the upper front teeth, where they overlap


def test_jaw_carries_teeth_and_tongue(head):
    pose = head.pose_of(np.eye(100, dtype=np.float32)[head.expression_index("jawOpen")])
    assert np.degrees(pose[2, 0]) == pytest.approx(20, abs=8)
    opened = pose_head(head, {"jawOpen": 1})
    moved = opened - head.v_template
    assert np.abs(moved[head.regions["upper_teeth"]]).max() < 1e-6
    assert moved[head.regions["lower_teeth"], 1].max() < -0.003
    tip = head.regions["tongue"][np.argmax(head.v_template[head.regions["tongue"], 2])]
    assert moved[tip, 1] < -0.01
    # rigid teeth: distances between them stay
    teeth = head.regions["lower_teeth"]
    before, after = (np.linalg.norm(v[teeth] - v[teeth[0]], axis=1) for v in (head.v_template, opened))
    np.testing.assert_allclose(before, after, atol=1e-5)
    # the joint alone does most of it
    by_joint = head.vertices(np.zeros(0), np.zeros(0), pose) - head.v_template
    lower_lip = head.regions["lips"][head.v_template[head.regions["lips"], 1] < -0.035]
    left_over, whole = (np.linalg.norm(d[lower_lip], axis=1).mean() for d in (by_joint - moved, moved))
    assert left_over < 0.35 * whole


@pytest.mark.parametrize(("name", "axis", "sign"), [("Up", 0, -1), ("Down", 0, 1), ("Out", 1, 1), ("In", 1, -1)])
def test_gaze_turns_the_eyes(head, name, axis, sign):
    pose = head.expression_pose[head.expression_index(f"eyeLook{name}Left")]
    assert 10 < sign * np.degrees(pose[3, axis]) < 40
    assert not pose[[0, 1, 2, 4]].any()
    other = head.expression_pose[head.expression_index(f"eyeLook{name}Right")]
    np.testing.assert_allclose(other[4], pose[3] * (1, -1, -1), atol=1e-6)
    directions = head.expression_dirs[head.regions["left_eyeball"], :, head.expression_index(f"eyeLook{name}Left")]
    assert np.abs(directions).max() < 1e-6


def test_controls_drive_the_head(head):
    controls = Controls().set_named({"jawOpen": 0.5, "eyeLookUpLeft": 1.0, "neck.y": 0.3})
    resolved = resolve(controls, head)
    neck = np.zeros((5, 3), np.float32)
    neck[1, 1] = 0.3
    expected = pose_head(head, {"jawOpen": 0.5, "eyeLookUpLeft": 1.0}, pose=neck)
    np.testing.assert_allclose(head.vertices(np.zeros(0), resolved.expression, resolved.pose), expected, atol=1e-6)


def test_tongue_out_leaves_the_mouth(head):
    lips = head.regions["lips"]
    lower = lips[head.v_template[lips, 1] < -0.033]
    for shape in (np.zeros(300), *random_people(4)):
        for weights in ({"tongueOut": 1}, {"tongueOut": 1, "jawOpen": 0.5}):
            vertices = pose_head(head, weights, shape)
            # an open jaw carries the tongue back with it, so the lower lip is the measure
            assert vertices[head.regions["tongue"], 2].max() > vertices[lower, 2].max() + 0.005
    inside = head.v_template[head.regions["tongue"], 2].max()
    assert inside < head.v_template[head.regions["lips"], 2].max() - 0.005


def test_teeth_are_inside(head):
    for shape in (np.zeros(300), *random_people()):
        vertices = head.shaped(shape)
        front = vertices[head.regions["lips"], 2].max()
        upper, lower = vertices[head.regions["upper_teeth"]], vertices[head.regions["lower_teeth"]]
        for teeth in (upper, lower):
            assert teeth[:, 2].max() < front - 0.003
            cheeks = vertices[head.regions["face"]]
            beside = cheeks[(np.abs(cheeks[:, 1] - teeth[:, 1].mean()) < 0.01) & (cheeks[:, 2] > teeth[:, 2].min())]
            assert np.abs(teeth[:, 0]).max() < np.abs(beside[:, 0]).max()
        assert upper[:, 1].mean() > lower[:, 1].mean() + 0.008


# ---- eyes -----------------------------------------------------------------------------------------------------------------


def test_eyeballs_stay_spheres_around_their_joints(head):
    for shape in (np.zeros(300), *random_people()):
        vertices, joints = head.shaped(shape), head.joints(shape)
        for side, joint in (("left", 3), ("right", 4)):
            part = vertices[head.regions[f"{side}_eyeball"]]
            centre, radius = sphere(part)
            assert 0.009 < radius < 0.02
            np.testing.assert_allclose(np.linalg.norm(part - centre, axis=1), radius, rtol=0.03)
            assert np.linalg.norm(centre - joints[joint]) < 3e-4


def test_lids_cover_the_eyeballs(head):
    for shape in (np.zeros(300), *random_people(4)):
        opened, closed = pose_head(head, {}, shape), pose_head(head, both("eyeBlink"), shape)
        for side in ("left", "right"):
            visible = eye_visibility(head, opened, side)
            assert 0.02 < visible < 0.5
            assert eye_visibility(head, closed, side) <= 0.1 * visible
    closed = pose_head(head, both("eyeBlink"))
    assert eye_visibility(head, closed, "left") == eye_visibility(head, closed, "right") == 0


# ---- landmarks and people -------------------------------------------------------------------------------------------------


def test_landmarks68_are_in_place(head):
    points = head.landmark_positions(head.v_template)
    assert points.shape == (68, 3)
    np.testing.assert_allclose(head.landmarks68[1].sum(1), 1, atol=1e-5)
    assert (np.diff(points[:17, 0]) > -1e-3).all()  # the jaw runs from the subject's right to the left
    assert points[8, 1] == points[:17, 1].min()
    assert points[30, 2] > points[[27, 33, 36, 45, 48, 54], 2].max()  # the tip of the nose is in front
    eyes = head.joints(np.zeros(0))[3:]
    np.testing.assert_allclose(points[42:48].mean(0)[:2], eyes[0, :2], atol=0.006)
    np.testing.assert_allclose(points[36:42].mean(0)[:2], eyes[1, :2], atol=0.006)
    mirror = points[[16, 26, 45, 42, 54, 35]] * (-1, 1, 1)
    np.testing.assert_allclose(mirror, points[[0, 17, 36, 39, 48, 31]], atol=0.004)
    opened = head.landmark_positions(pose_head(head, {"jawOpen": 0.5}))
    assert opened[62, 1] - opened[66, 1] > 0.008 > abs(points[62, 1] - points[66, 1])


def test_landmarks478_are_in_place(head):
    points = head.landmark_positions(head.v_template, 478)
    assert points.shape == (478, 3)
    np.testing.assert_allclose(head.landmarks478[1].sum(1), 1, atol=1e-5)
    coarse = head.landmark_positions(head.v_template)
    # MediaPipe's numbers of points that the 68 have too: nose tip, eye corners, mouth corners, chin
    pairs = {1: 30, 33: 36, 133: 39, 362: 42, 263: 45, 61: 48, 291: 54, 152: 8}
    for fine, other in pairs.items():
        limit = 0.012 if other == 8 else 0.006
        assert np.linalg.norm(points[fine, :2] - coarse[other, :2]) < limit, (fine, other)
    eyes = head.joints(np.zeros(0))[3:]
    np.testing.assert_allclose(points[[473, 468], :2], eyes[:, :2], atol=0.002)  # pupils
    opened = head.landmark_positions(pose_head(head, {"jawOpen": 0.5}), 478)
    assert opened[13, 1] - opened[14, 1] > 0.008 > abs(points[13, 1] - points[14, 1])


def test_people_model(head):
    people = load_people_model()
    assert people.macro_to_shape.shape == (len(people.names), head.shape_count)
    female = people.names.index("female")
    women, men = (head.shaped((value - people.mean[female]) * people.macro_to_shape[female]) for value in (1.0, 0.0))
    jaw = head.regions["face"]
    assert np.ptp(men[jaw, 0]) > np.ptp(women[jaw, 0])
