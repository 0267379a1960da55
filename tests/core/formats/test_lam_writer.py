"""Avatars written for LAM's viewer: the steps of its loader, walked on the file alone, and back into our reader."""

from __future__ import annotations

import io
import json
import zipfile

import numpy as np
import plyfile
import pytest
from fuzzing import glb_document
from splat_files import make_cloud

from grmm_core.controls.frame import Controls
from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import ShapeError
from grmm_core.formats.avatars.lam import STANDING, LamAvatar, read_lam, vertex_triangles, write_lam
from grmm_core.formats.meshes.mesh import Mesh
from grmm_core.session.exporting import lam_avatar

_COMPONENTS = {5121: "<u1", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC3": 3, "VEC4": 4, "MAT4": 16}


class Glb:
    """A `.glb` as three.js opens it: only what the file says."""

    def __init__(self, data: bytes) -> None:
        self.document = glb_document(data)
        self._binary = data[28 + int.from_bytes(data[12:16], "little") :]

    def accessor(self, index: int) -> np.ndarray:
        entry = self.document["accessors"][index]
        width, dtype = _WIDTHS[entry["type"]], np.dtype(_COMPONENTS[entry["componentType"]])
        if "sparse" not in entry:
            return self._view(entry["bufferView"], dtype, entry["count"] * width).reshape(entry["count"], width)
        values, sparse = np.zeros((entry["count"], width), dtype), entry["sparse"]
        rows = self._view(sparse["indices"]["bufferView"], np.dtype("<u4"), sparse["count"])
        values[rows] = self._view(sparse["values"]["bufferView"], dtype, sparse["count"] * width).reshape(-1, width)
        return values

    def _view(self, index: int, dtype: np.dtype, count: int) -> np.ndarray:
        view = self.document["bufferViews"][index]
        assert view["byteLength"] == count * dtype.itemsize
        return np.frombuffer(self._binary, dtype, count, view["byteOffset"])

    def world(self, node: int) -> np.ndarray:
        """Matrix of a node whose file has translations alone, [4, 4]."""
        matrix = np.eye(4)
        while node is not None:
            matrix[:3, 3] += self.document["nodes"][node].get("translation", (0, 0, 0))
            node = next((i for i, other in enumerate(self.document["nodes"]) if node in other.get("children", ())), None)
        return matrix


class Viewer:
    """What the viewer has loaded; `centres` is what its vertex shader computes."""

    def __init__(self, path) -> None:
        with zipfile.ZipFile(path) as archive:
            folders = [info.filename for info in archive.infolist() if info.is_dir()]
            assert folders, "the viewer: file fold is not found"
            files = {name: archive.read(folders[-1] + name) for name in
                     ("skin.glb", "animation.glb", "vertex_order.json", "offset.ply")}  # fmt: skip
        skin, clips = Glb(files["skin.glb"]), Glb(files["animation.glb"])
        assert not skin.document.get("animations"), "the viewer would take these for the model"
        self.clips = clips.document["animations"]
        nodes = skin.document["nodes"]
        skinned = [node for node in nodes if "mesh" in node and "skin" in node]
        assert len(skinned) == 1
        entry = skin.document["meshes"][skinned[0]["mesh"]]
        primitive = entry["primitives"][0]
        assert primitive["mode"] == 4, "points are no skinned mesh there"
        self.vertices = skin.accessor(primitive["attributes"]["POSITION"])
        self.triangles = skin.accessor(primitive["indices"]).reshape(-1, 3)
        self.names = entry["extras"]["targetNames"]
        self.morphs = [skin.accessor(target["POSITION"]) for target in primitive["targets"]]
        assert len(self.names) == len(self.morphs) == len(entry["weights"])
        assert (len(self.morphs) + 1) * len(self.vertices) <= 4096 * 2048, "its texture is full"
        self.skin = skin.document["skins"][skinned[0]["skin"]]
        bones = [nodes[joint]["name"] for joint in self.skin["joints"]]
        assert "hip" in bones
        head = bones.index("head")
        attributes = primitive["attributes"]
        assert skin.accessor(attributes["JOINTS_0"]).shape == skin.accessor(attributes["WEIGHTS_0"]).shape
        assert (skin.accessor(attributes["JOINTS_0"])[:, 0] == head).all()
        inverse = skin.accessor(self.skin["inverseBindMatrices"])[head].reshape(4, 4).T
        self.bone = skin.world(self.skin["joints"][head]) @ inverse
        moved = {clips.document["nodes"][c["target"]["node"]]["name"] for clip in self.clips for c in clip["channels"]}
        assert moved <= {node.get("name") for node in nodes}
        rows = plyfile.PlyData.read(io.BytesIO(files["offset.ply"]))["vertex"]
        self.offsets = np.stack([rows[axis] for axis in "xyz"], 1)
        self.bytes = np.clip(np.floor(np.stack([rows[f"f_dc_{i}"] for i in range(3)], 1) * 255), 0, 255)
        self.rows = rows
        assert len(self.offsets) == len(self.vertices)
        assert sorted(json.loads(files["vertex_order.json"])) == list(range(len(self.vertices)))

    def centres(self, weights):
        moved = self.vertices + self.offsets
        for name, delta in zip(self.names, self.morphs, strict=True):
            moved = moved + weights.get(name, 0.0) * delta
        return moved @ self.bone[:3, :3].T + self.bone[:3, 3]


@pytest.fixture(scope="module")
def person(local):
    return local.open("default")


@pytest.fixture(scope="module")
def written(local, person, tmp_path_factory):
    """An avatar of the tiny model, with half a smile, and its file."""
    avatar = lam_avatar(local, person, Controls().set_named({"mouthSmileLeft": 0.5}), lod=1)
    path = tmp_path_factory.mktemp("lam") / "person.zip"
    write_lam(path, avatar)
    return avatar, path


def test_the_viewer_shows_the_avatar_and_its_expressions(local, person, written):
    avatar, path = written
    viewer = Viewer(path)
    assert len(viewer.clips) == 12  # two greetings, one of rest, six of speech, three of thought
    up = np.array([0.0, STANDING, 0.0])
    rest = local.gaussians(person.id, Controls().set_named({"mouthSmileLeft": 0.5}), lod=1)
    assert viewer.centres({}) == pytest.approx(rest.means + up, abs=1e-6)
    assert viewer.bytes / 255 == pytest.approx(np.clip(avatar.cloud.colors(), 0, 1), abs=1.01 / 255)  # it rounds down
    assert np.abs(viewer.bytes / 255 - rest.colors).mean() < 0.02  # the mean over views, against the view from the front
    assert np.exp(viewer.rows["scale_0"]) == pytest.approx(rest.scales[:, 0], rel=1e-4)
    for name in ("jawOpen", "tongueOut"):
        raised = local.gaussians(person.id, Controls().set_named({"mouthSmileLeft": 0.5, name: 1.0}), lod=1)
        assert np.linalg.norm(raised.means - rest.means, axis=1).max() > 1e-3
        assert viewer.centres({name: 1.0}) == pytest.approx(raised.means + up, abs=2e-5)
    assert viewer.names == list(ARKIT_NAMES)
    assert set(viewer.triangles.ravel()) == set(range(avatar.cloud.count))


def test_what_is_written_is_read_back_where_heads_are(written):
    avatar, path = written
    back = read_lam(path)
    assert back.cloud.means == pytest.approx(avatar.cloud.means, abs=1e-6)
    assert back.cloud.colors() == pytest.approx(np.clip(avatar.cloud.colors(), 0, 1), abs=1e-6)
    assert back.cloud.opacities == pytest.approx(avatar.cloud.opacities, abs=1e-5)
    assert np.abs((back.cloud.quats * avatar.cloud.quats).sum(1)) == pytest.approx(1, abs=1e-6)
    assert back.mesh.morphs["jawOpen"] == pytest.approx(avatar.mesh.morphs["jawOpen"], abs=1e-5)
    assert any("1.65 m above the ground" in warning for warning in back.cloud.warnings)


def _avatar(means=None, count=10, morphs=2):
    cloud = make_cloud(count)
    cloud.means = cloud.means if means is None else means
    shapes = {name: np.full((count, 3), 0.01) for name in ARKIT_NAMES[:morphs]}
    return LamAvatar(Mesh(cloud.means, vertex_triangles(count), morphs=shapes), cloud)


@pytest.mark.parametrize("height", [0.0, 1.65, 1.52])
def test_heads_at_another_height_are_brought_down(tmp_path, height):
    """LAM's own files have the head somewhere about 1.65 m; those about the origin stay where they are."""
    avatar = _avatar(make_cloud(10).means + np.array([0, height - STANDING, 0]))
    write_lam(tmp_path / "a.zip", avatar)
    found = read_lam(tmp_path / "a.zip").cloud
    exact = avatar.cloud.means + ([0, STANDING, 0] if height == 0 else [0, 0, 0])
    assert found.means == pytest.approx(exact, abs=1e-6)
    write_lam(tmp_path / "far.zip", _avatar(make_cloud(10).means + np.array([0, 30.0, 0])))
    far = read_lam(tmp_path / "far.zip").cloud.means
    assert (far.min(0) + far.max(0)) / 2 == pytest.approx(0, abs=1e-4)


def test_avatars_that_the_viewer_cannot_hold_are_refused(tmp_path):
    with pytest.raises(ShapeError, match="holds 158275 splats with 52 shapes; reduce the 158276 by a level"):
        write_lam(tmp_path / "a.zip", _avatar(count=158_276, morphs=52))
    with pytest.raises(ShapeError, match="a splat for each vertex"):
        write_lam(tmp_path / "a.zip", LamAvatar(_avatar(count=9).mesh, make_cloud(10)))
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("count", [1, 2, 3, 4, 11])
def test_every_vertex_is_in_a_triangle(count):
    triangles = vertex_triangles(count)
    assert set(triangles.ravel()) == set(range(count))


def test_colors_that_are_clipped_are_counted(tmp_path):
    avatar = _avatar()
    avatar.cloud.sh[:4, 0] = 9.0
    assert write_lam(tmp_path / "a.zip", avatar) == [
        "4 of 10 splats have colors beyond what the format holds; these were clipped."
    ]
