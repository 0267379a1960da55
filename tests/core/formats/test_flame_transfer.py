"""Avatars of the open head on a (stand-in for the) user's FLAME head."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import plyfile
import pytest
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from splat_files import make_cloud

from grmm_core.controls.frame import Controls, resolve
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import FileFormatError, ShapeError
from grmm_core.formats import SplatCloud
from grmm_core.formats.avatars.binding import place_on_mesh, triangle_frames
from grmm_core.formats.avatars.flame_transfer import PROBES, bind_to_flame, fit_flame, nearest_triangles
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, write_gaussian_avatar
from grmm_core.geometry.rotations import axis_angle_to_matrix
from grmm_core.geometry.triangles import closest_on_surface
from grmm_core.head import load_flame, load_open_head
from grmm_core.head.skinning import posed_vertices
from grmm_core.performance import Performance, to_expression


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
    found = nearest_triangles(points[None], flame.v_template[None], np.asarray(flame.faces, np.int64))
    wanted, _, distance = closest_on_surface(points.astype(float), flame.v_template.astype(float), flame.faces)
    corners = flame.v_template[flame.faces[found]].astype(float)
    own = np.array([closest_on_surface(p[None], c, np.array([[0, 1, 2]]))[2][0] for p, c in zip(points, corners, strict=True)])
    assert (found == wanted).mean() > 0.7  # ties along edges may fall either way
    assert np.percentile(own - distance, 95) < 2e-4


class Person:
    """A person of the open head whose Gaussians lie on the mesh, on the parts that touch at rest."""

    PARTS = ("lips", "lids", "left_eyeball", "right_eyeball", "upper_teeth", "lower_teeth", "tongue", "face")
    COUNT = 150

    def __init__(self):
        rng = np.random.default_rng(3)
        self.head = load_open_head()
        self.shape = np.zeros(self.head.shape_count, np.float32)
        self.shape[:12] = rng.normal(0, 1.0, 12)
        inside = {name: np.flatnonzero(np.isin(self.head.faces, self.head.regions[name]).all(1)) for name in self.PARTS}
        self.corners = self.head.faces[np.concatenate([rng.choice(inside[name], self.COUNT) for name in self.PARTS])]
        self.shares = rng.dirichlet((1, 1, 1), len(self.corners))
        self.parts = np.repeat(self.PARTS, self.COUNT)
        self.jaw = np.einsum("nk,nk->n", self.shares, self.head.weights[self.corners, 2])

    def pose(self, weights):
        """Gaussians and mesh for ARKit weights."""
        found = resolve(Controls().set_named(weights), self.head)
        mesh = self.head.vertices(self.shape, found.expression, found.pose)
        return np.einsum("nk,nkx->nx", self.shares, mesh[self.corners]), mesh

    def cloud(self):
        count = len(self.corners)
        quats = np.tile([1.0, 0, 0, 0], (count, 1))
        return SplatCloud.from_rgb(
            self.pose({})[0], quats, np.full((count, 3), 1e-3), np.full(count, 0.5), np.full((count, 3), 0.5)
        )


def play(folder, flame):
    """Splats of the folder's first frame, in the steps of GaussianAvatars' loader and viewer, [N, 3]."""
    vertex = plyfile.PlyData.read(folder / "point_cloud.ply").elements[0]
    rest = [prop.name for prop in vertex.properties if prop.name.startswith("f_rest_")]
    assert len(rest) == 3 * (3 + 1) ** 2 - 3, "that loader asserts degree 3"
    with np.load(folder / "flame_param.npz") as file:
        track = {name: file[name] for name in file.files}
    frames = len(track["expr"])
    for name, width in (("rotation", 3), ("neck_pose", 3), ("jaw_pose", 3), ("eyes_pose", 6), ("translation", 3)):
        assert track[name].shape == (frames, width)
        assert track[name].dtype == np.float32
    assert track["dynamic_offset"][[0]].shape == (1, len(flame.v_template), 3)
    shaped = flame.shaped(track["shape"][: flame.shape_count], track["expr"][0]) + track["static_offset"][0]
    poses = np.concatenate([track[name][0] for name in ("rotation", "neck_pose", "jaw_pose", "eyes_pose")]).reshape(5, 3)
    joints = (flame.J_regressor @ shaped).astype(np.float32)  # with the offsets, as that project's skinning has it
    mesh = posed_vertices(
        shaped, axis_angle_to_matrix(poses), joints, flame.weights, flame.parents.tolist(), flame.posedirs
    ) + track["translation"][0]  # fmt: skip
    binding = np.asarray(vertex["binding_0"]).astype(np.int32)
    centre, rotation, size = triangle_frames(mesh, flame.faces)
    local = np.stack([vertex[axis] for axis in "xyz"], 1)
    return np.einsum("nij,nj->ni", rotation[binding], local) * size[binding, None] + centre[binding]


@pytest.mark.parametrize("kind", ["jaw", "lids", "gaze"])
def test_exported_folders_move_in_the_loader_of_gaussian_avatars(flame, tmp_path, kind):
    """The parts that touch at rest go their own ways: both lips, both rows of teeth, tongue, lids and eyeballs."""
    weights = {
        "jaw": {"jawOpen": 0.8}, "lids": {"eyeBlinkLeft": 1.0, "eyeBlinkRight": 1.0},
        "gaze": {"eyeLookOutLeft": 0.7, "eyeLookInRight": 0.7},
    }[kind]  # fmt: skip
    person = Person()
    fit = fit_flame(person.pose({})[1], flame)
    bound = bind_to_flame(person.cloud(), fit, flame, [person.pose(probe) for probe in PROBES])
    recorded = np.zeros((1, 52), np.float32)
    for name, weight in weights.items():
        recorded[0, ARKIT_NAMES.index(name)] = weight
    track = to_expression(Performance([0.0], recorded, 25.0, recorded_shapes=ARKIT_NAMES), flame)
    write_gaussian_avatar(tmp_path, GaussianAvatar(bound, replace(track, static_offset=fit.offset)))
    resting = fit.scale * person.pose({})[0] + fit.shift
    wanted = fit.scale * (person.pose(weights)[0] - person.pose({})[0])
    gap = np.linalg.norm(play(tmp_path, flame) - resting - wanted, axis=1)
    lips, teeth = person.parts == "lips", np.char.endswith(person.parts, "teeth")
    if kind == "jaw":
        down = np.linalg.norm(wanted, axis=1)
        lower = lips & (person.jaw > 0.6)
        assert down[lower].mean() > 0.018
        assert np.percentile(gap[lower], 90) < 0.4 * down[lower].mean()
        assert gap[lips & (person.jaw < 0.3)].mean() < 0.003
        assert gap[person.parts == "upper_teeth"].max() < 0.002
        assert gap[teeth & (person.parts != "upper_teeth")].mean() < 0.005
        assert gap[person.parts == "tongue"].mean() < 0.005
    else:
        eyeballs, lids = np.char.endswith(person.parts, "eyeball"), person.parts == "lids"
        assert np.percentile(gap[eyeballs], 95) < 0.001
        assert gap[lids].mean() < (0.003 if kind == "lids" else 0.001)
        assert gap[lips | teeth].mean() < 0.001


def test_the_probes_matter(flame):
    """Without them, splats of one lip are bound to the other, and splats of lids to eyeballs."""
    person = Person()
    fit = fit_flame(person.pose({})[1], flame)
    probes = [person.pose(probe) for probe in PROBES]
    opened = fit.posed(probes[0][1], flame)
    wanted = fit.scale * probes[0][0] + fit.shift
    lips = person.parts == "lips"
    errors = []
    for given in ((), probes):
        placed = place_on_mesh(bind_to_flame(person.cloud(), fit, flame, given), opened, flame.faces)
        errors.append(np.percentile(np.linalg.norm(placed.means - wanted, axis=1)[lips], 95))
    assert errors[1] < 0.5 * errors[0]


def test_meshes_that_do_not_fit_are_named(flame):
    with pytest.raises(ShapeError, match="open head's is"):
        fit_flame(np.zeros((10, 3)), flame)
    with pytest.raises(FileFormatError, match="not a FLAME head"):
        fit_flame(load_open_head().v_template, _without_teeth(flame))


def _without_teeth(flame):
    import dataclasses

    faces = flame.faces[:9976]
    return dataclasses.replace(flame, faces=faces, uv_faces=flame.uv_faces[:9976], uv_islands=flame.uv_islands[:9976])
