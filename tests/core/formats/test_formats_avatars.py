"""Avatars of other projects, splats on triangles, meshes with morph targets."""

from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from avatar_files import cap4d_bytes, flame_track, lam_archive
from mesh_files import grid, seamed_mesh
from splat_files import make_cloud

from grmm_core.errors import FileAccessError, FileFormatError, ShapeError
from grmm_core.formats import SplatCloud, read_avatar, write_mesh, write_splats
from grmm_core.formats.avatars.binding import bind_to_mesh, place_on_mesh, triangle_frames
from grmm_core.formats.avatars.cap4d import AnimatedAvatar, read_cap4d
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, read_gaussian_avatar, write_gaussian_avatar
from grmm_core.formats.avatars.lam import LamAvatar, read_lam
from grmm_core.formats.meshes.gltf_mesh import read_gltf_mesh
from grmm_core.formats.meshes.mesh import Mesh, split_seams, vertex_normals
from grmm_core.formats.splats.cloud import SH_C0
from grmm_core.geometry.rotations import axis_angle_to_matrix, quaternion_to_matrix


def covariances(cloud):
    axes = quaternion_to_matrix(cloud.quats) * cloud.scales[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


def test_triangle_frame_of_a_right_triangle():
    centre, rotation, size = triangle_frames(np.array([[0, 0, 0], [2, 0, 0], [0, 1, 0]], float), np.array([[0, 1, 2]]))
    assert centre[0] == pytest.approx([2 / 3, 1 / 3, 0])
    assert rotation[0, :, 1] == pytest.approx([0, 0, 1])
    assert rotation[0, :, 2] == pytest.approx([0, -1, 0])
    assert np.linalg.det(rotation[0]) == pytest.approx(1)
    assert size[0] == pytest.approx(1.5)


def test_bound_splats_follow_a_rigid_motion_and_come_back():
    vertices, faces = grid()
    cloud = make_cloud(200)
    binding = np.random.default_rng(1).integers(0, len(faces), 200)
    local = bind_to_mesh(cloud, vertices, faces, binding)
    back = place_on_mesh(local, vertices, faces)
    assert back.means == pytest.approx(cloud.means, abs=1e-6)
    assert covariances(back) == pytest.approx(covariances(cloud), rel=1e-3, abs=1e-9)
    turn = axis_angle_to_matrix(np.array([0.3, -0.9, 0.4]))
    moved = place_on_mesh(local, 2 * vertices @ turn.T + [1, 2, 3], faces)
    assert moved.means == pytest.approx(2 * cloud.means @ turn.T + [1, 2, 3], abs=1e-5)
    assert covariances(moved) == pytest.approx(4 * turn @ covariances(cloud) @ turn.T, rel=1e-3, abs=1e-8)


def test_binding_beyond_the_mesh_and_flat_triangles():
    vertices, faces = grid()
    cloud = replace(make_cloud(5), binding=np.full(5, len(faces), np.int32))
    with pytest.raises(ShapeError, match="choose the head they belong to"):
        place_on_mesh(cloud, vertices, faces)
    with pytest.raises(ShapeError, match="not bound"):
        place_on_mesh(make_cloud(5), vertices, faces)
    flat = np.array([[0, 0, 0]])
    with pytest.raises(ShapeError, match="without extent"):
        bind_to_mesh(make_cloud(1), vertices, flat, np.zeros(1))
    placed = place_on_mesh(replace(make_cloud(1), binding=np.zeros(1, np.int32)), vertices, flat)
    assert np.isfinite(placed.means).all()
    assert np.isfinite(placed.quats).all()


def test_gaussian_avatar_round_trip(tmp_path):
    cloud = replace(make_cloud(300, 3), binding=np.random.default_rng(3).integers(0, 10144, 300).astype(np.int32))
    write_gaussian_avatar(tmp_path, GaussianAvatar(cloud, flame_track()))
    avatar = read_gaussian_avatar(tmp_path)
    assert np.array_equal(avatar.cloud.binding, cloud.binding)
    assert avatar.cloud.means == pytest.approx(cloud.means)
    assert avatar.cloud.sh == pytest.approx(cloud.sh)
    assert avatar.track.jaw_rotation == pytest.approx(flame_track().jaw_rotation, abs=1e-6)
    (tmp_path / "flame_param.npz").unlink()
    assert read_gaussian_avatar(tmp_path / "point_cloud.ply").track is None


def test_gaussian_avatar_errors(tmp_path):
    write_splats(tmp_path / "point_cloud.ply", make_cloud(5))
    with pytest.raises(FileFormatError, match="ordinary splat file"):
        read_gaussian_avatar(tmp_path)
    write_splats(tmp_path / "point_cloud.ply", replace(make_cloud(5), binding=np.full(5, 10144, np.int32)))
    with pytest.raises(FileFormatError, match="more triangles than FLAME"):
        read_gaussian_avatar(tmp_path)
    with pytest.raises(ShapeError, match="bound to triangles"):
        write_gaussian_avatar(tmp_path, GaussianAvatar(make_cloud(5), None))
    bound = replace(make_cloud(5), binding=np.zeros(5, np.int32))
    with pytest.raises(FileAccessError, match="not a folder"):
        write_gaussian_avatar(tmp_path / "none", GaussianAvatar(bound, None))


@pytest.mark.parametrize("quantised", [True, False])
def test_cap4d_frames(tmp_path, quantised):
    data, meshes, faces = cap4d_bytes(quantised)
    (tmp_path / "a.ply").write_bytes(data)
    avatar = read_cap4d(tmp_path / "a.ply")
    assert avatar.frame_count == 3
    for i, mesh in enumerate(meshes):
        assert avatar.vertices(i) == pytest.approx(mesh, abs=4e-4 if quantised else 1e-6)
    assert avatar.splats(1).means == pytest.approx(place_on_mesh(avatar.cloud, avatar.vertices(1), faces).means)
    assert avatar.splats(1).binding is None


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (b"element base_vertex", b"element hase_vertex", "no element 'base_vertex'"),
        (b"index_2", b"ind_x_2", "no corners"),
        (b"meta_delta_max_00001", b"meta_delta_mix_00001", "frame 1 is incomplete"),
        (b"element delta_vertex_00002 64", b"element delta_vertex_00002 63", "frame 2 is incomplete"),
        (b"property float binding", b"property float bindung", "triangles that it does not have"),
    ],
)
def test_bad_cap4d_files(tmp_path, old, new, reason):
    data, _, _ = cap4d_bytes()
    assert old in data
    (tmp_path / "a.ply").write_bytes(data.replace(old, new))
    with pytest.raises(FileFormatError, match=reason):
        read_cap4d(tmp_path / "a.ply")


def test_lam_splats_ride_on_the_vertices(tmp_path):
    vertices, morphs, rows = lam_archive(tmp_path / "a.zip")
    avatar = read_lam(tmp_path / "a.zip")
    assert len(avatar.mesh.morphs) == 51
    offsets = np.stack([rows[axis] for axis in "xyz"], 1)
    assert avatar.cloud.means == pytest.approx(vertices + offsets, abs=1e-7)
    assert 0.5 + SH_C0 * avatar.cloud.sh[:, 0] == pytest.approx(np.stack([rows[f"f_dc_{i}"] for i in range(3)], 1), abs=1e-6)
    moved = avatar.splats({"jawOpen": 0.5, "unknown": 1.0})
    assert moved.means - avatar.cloud.means == pytest.approx(0.5 * morphs["jawOpen"], abs=1e-6)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda m: {k: v for k, v in m.items() if k != "skin.glb"}, "no 'skin.glb'"),
        (lambda m: m | {"offset.ply": m["offset.ply"].replace(b"element vertex 64", b"element vertex 63")}, "63 splats for 64"),
        (lambda m: m | {"offset.ply": b"ply"}, "no end"),
        (lambda m: m | {"skin.glb": m["skin.glb"][:500]}, "LAM|glTF mesh"),
    ],
)
def test_bad_lam_archives(tmp_path, change, reason):
    lam_archive(tmp_path / "a.zip", change)
    with pytest.raises(FileFormatError, match=reason):
        read_lam(tmp_path / "a.zip")


def test_archive_bombs_are_refused_by_their_stated_size(tmp_path):
    lam_archive(tmp_path / "a.zip")
    data = bytearray((tmp_path / "a.zip").read_bytes())
    at = data.rindex(b"PK\x01\x02")
    data[at + 24 : at + 28] = (3 << 30).to_bytes(4, "little")
    (tmp_path / "a.zip").write_bytes(data)
    with pytest.raises(FileFormatError, match="unpacked it would take"):
        read_lam(tmp_path / "a.zip")


def test_gltf_mesh_round_trip_with_seams_and_morph_targets(tmp_path):
    vertices, faces, uv, uv_faces, morphs = seamed_mesh()
    write_mesh(tmp_path / "a.glb", vertices, faces, uv, uv_faces, morphs)
    back = read_gltf_mesh(tmp_path / "a.glb")
    assert list(back.morphs) == ["jawOpen", "still"]
    assert back.vertices[back.faces] == pytest.approx(vertices[faces])
    assert back.uv[back.faces] == pytest.approx(uv[uv_faces], abs=1e-6)
    assert back.morphs["jawOpen"][back.faces] == pytest.approx(morphs["jawOpen"][faces])
    assert not back.morphs["still"].any()


def test_seams_double_only_the_vertices_on_them():
    vertices, faces = grid()
    uv = vertices[:, :2].copy()
    mesh, source = split_seams(Mesh(vertices, faces, uv, faces).validated())
    assert len(mesh.vertices) == len(vertices)
    assert sorted(source) == list(range(len(vertices)))


def test_normals_point_out_of_a_sphere():
    sphere = trimesh.creation.icosphere(2)
    normals = vertex_normals(np.asarray(sphere.vertices, np.float32), np.asarray(sphere.faces))
    assert (normals * sphere.vertices).sum(1) == pytest.approx(1, abs=0.02)


def test_obj_is_read_alike_by_another_program(tmp_path):
    vertices, faces, uv, uv_faces, _ = seamed_mesh()
    write_mesh(tmp_path / "a.obj", vertices, faces, uv, uv_faces)
    other = trimesh.load(tmp_path / "a.obj", process=False)
    assert np.asarray(other.triangles) == pytest.approx(vertices[faces], abs=1e-6)
    assert np.asarray(other.visual.uv)[other.faces] == pytest.approx(uv[uv_faces], abs=1e-6)


def test_gltf_mesh_is_read_alike_by_another_program(tmp_path):
    vertices, faces, uv, uv_faces, morphs = seamed_mesh()
    write_mesh(tmp_path / "a.glb", vertices, faces, uv, uv_faces, morphs)
    other = next(iter(trimesh.load(tmp_path / "a.glb", process=False).geometry.values()))
    assert np.asarray(other.triangles) == pytest.approx(vertices[faces], abs=1e-6)
    assert np.asarray(other.visual.uv)[other.faces] == pytest.approx(uv[uv_faces], abs=1e-5)


def test_bad_meshes_are_refused_before_anything_is_written(tmp_path):
    vertices, faces, uv, uv_faces, morphs = seamed_mesh()
    cases = [
        (vertices[:, :2], faces, None, None, {}),
        (vertices * np.nan, faces, None, None, {}),
        (vertices, faces + 10, None, None, {}),
        (vertices, faces, uv, None, {}),
        (vertices, faces, uv, uv_faces[:3], {}),
        (vertices, faces, None, None, {"a": morphs["jawOpen"][:5]}),
    ]
    for case in cases:
        for extension in (".obj", ".glb"):
            with pytest.raises(ShapeError):
                write_mesh(tmp_path / f"a{extension}", *case)
    with pytest.raises(FileFormatError, match=r"'\.fbx'"):
        write_mesh(tmp_path / "a.fbx", vertices, faces)
    assert list(tmp_path.iterdir()) == []


def test_obj_without_texture_coordinates(tmp_path):
    vertices, faces = grid()
    write_mesh(tmp_path / "a.obj", vertices, faces)
    lines = (tmp_path / "a.obj").read_text().splitlines()
    assert sum(line.startswith("v ") for line in lines) == len(vertices)
    first = next(line for line in lines if line.startswith("f "))
    assert [int(word) - 1 for word in first.split()[1:]] == list(faces[0])
    assert np.loadtxt(io.StringIO("\n".join(line[2:] for line in lines if line.startswith("v ")))) == pytest.approx(vertices)


def test_avatars_are_told_apart_by_what_is_in_them(tmp_path):
    (tmp_path / "cap.ply").write_bytes(cap4d_bytes()[0])
    lam_archive(tmp_path / "lam.zip")
    bound = replace(make_cloud(5), binding=np.zeros(5, np.int32))
    write_gaussian_avatar(tmp_path, GaussianAvatar(bound, flame_track()))
    write_splats(tmp_path / "plain.ply", make_cloud(5))
    write_splats(tmp_path / "plain.spz", make_cloud(5))
    expected = {
        "cap.ply": AnimatedAvatar, "lam.zip": LamAvatar, "point_cloud.ply": GaussianAvatar, ".": GaussianAvatar,
        "plain.ply": SplatCloud, "plain.spz": SplatCloud,
    }  # fmt: skip
    for name, kind in expected.items():
        assert type(read_avatar(tmp_path / name)) is kind
    with pytest.raises(FileAccessError, match="does not exist"):
        read_avatar(tmp_path / "none.ply")
