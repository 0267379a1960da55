"""Exporters in Blender: what they write is read back, by our readers and by others."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import plyfile
import pytest
import trimesh
from avatar_files import flame_track
from blender_process import RunBlender, find_python
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from performance_files import write_performances
from splat_files import make_cloud

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.formats import read_performance, read_splats, write_splats
from grmm_core.formats.avatars.binding import place_on_mesh
from grmm_core.formats.avatars.flame_transfer import fit_flame
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, read_gaussian_avatar, write_gaussian_avatar
from grmm_core.formats.avatars.lam import read_lam
from grmm_core.formats.meshes.gltf_mesh import read_gltf_mesh
from grmm_core.head import load_flame, load_open_head

pytestmark = pytest.mark.blender

PATIENCE = 600.0  # seconds; many exports in one Blender, also on a busy machine


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def exported(
    request: pytest.FixtureRequest, run_blender: RunBlender, tmp_path_factory: pytest.TempPathFactory
) -> tuple[dict, Path]:
    find_python(request.param)
    from tiny_model import write_tiny_weights

    folder = tmp_path_factory.mktemp("export")
    weights = write_tiny_weights(folder / "tiny.safetensors")
    write_performances(folder)  # speech.json
    write_splats(folder / "cloud.ply", make_cloud(500, 2))
    (folder / "person").mkdir()
    write_flame_pickle(folder / "flame2023.pkl", flame_head_fields())
    bound = replace(make_cloud(800), binding=np.random.default_rng(3).integers(0, 10144, 800).astype(np.int32))
    write_gaussian_avatar(folder / "person", GaussianAvatar(bound, flame_track()))
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    done = run_blender("export_scene.py", weights, folder, python=request.param, environment=environment, timeout=PATIENCE)
    return done.result, folder


def test_splats_of_a_frame(exported):
    said, folder = exported
    wanted = np.load(folder / "gaussians.npz")
    tolerance = {".ply": 1e-6, ".spz": 1e-5, ".glb": 1e-6}
    for extension, allowed in tolerance.items():
        found = read_splats(folder / f"frame{extension}")
        assert np.abs(found.means - wanted["means"]).max() < allowed, extension
        assert found.degree == 1
        assert np.abs(found.opacities - wanted["opacities"].clip(0, 1)).max() < 3e-3
    assert read_splats(folder / "frame.splat").count == len(wanted["means"])
    assert np.abs(read_splats(folder / "frame.ply").colors().mean(0) - wanted["colors"].mean(0)).max() < 0.1
    assert said["files"]["frame"] == 14


def test_rest_and_sequence(exported):
    said, folder = exported
    posed, rest = read_splats(folder / "frame.ply"), read_splats(folder / "rest.ply")
    assert posed.count / 5 < rest.count < posed.count / 2  # blocks at the rims of texture islands are not full
    assert rest.degree == 0
    assert rest.means.mean(0)[0] == pytest.approx(0.0, abs=0.01)
    files = sorted(path.name for path in folder.glob("walk_*"))
    assert files == ["walk_012.ply", "walk_013.ply", "walk_014.ply"]
    first, last = (read_splats(folder / files[k]) for k in (0, 2))
    assert first.count == last.count
    assert np.abs(first.means - last.means).max() > 0.005
    assert "is not a folder" in said["files"]["missing_folder"]
    assert "choose a file name" in said["files"]["no_name"]
    assert "no frame from 20 to 10" in said["files"]["no_frames"]


def test_lam_avatars(exported):
    """The neutral face, brought down again by our reader, with the ARKit shapes; clouds have no shapes."""
    said, folder = exported
    avatar, rest = read_lam(folder / "person.zip"), read_splats(folder / "rest.ply")
    assert avatar.cloud.means == pytest.approx(rest.means, abs=1e-5)
    assert list(avatar.mesh.morphs) == list(ARKIT_NAMES)
    assert np.abs(avatar.mesh.morphs["jawOpen"]).max() > 0.01
    assert "select a GRMM avatar" in said["clouds"]["lam"]


def test_splats_in_other_readers(exported):
    _, folder = exported
    rows = plyfile.PlyData.read(str(folder / "frame.ply"))["vertex"]
    wanted = np.load(folder / "gaussians.npz")
    assert rows["x"] == pytest.approx(wanted["means"][:, 0], abs=1e-6)
    assert rows["y"] == pytest.approx(-wanted["means"][:, 1], abs=1e-6)  # y down in these files
    assert np.exp(rows["scale_0"]) == pytest.approx(wanted["scales"][:, 0], rel=1e-4)


def test_meshes(exported):
    _, folder = exported
    head = load_open_head()
    mesh = read_gltf_mesh(folder / "head.glb")
    assert list(mesh.morphs) == list(ARKIT_NAMES)
    assert np.abs(mesh.morphs["jawOpen"]).max() > 0.01
    assert len(mesh.faces) == len(head.faces)
    other = trimesh.load(folder / "head.obj", process=False, maintain_order=True)
    posed = np.load(folder / "posed.npy")
    assert len(other.faces) == len(head.faces)
    assert other.bounds == pytest.approx(np.stack([posed.min(0), posed.max(0)]), abs=1e-4)


def test_caches_through_blenders_exporters(exported):
    caches = exported[0]["caches"]
    assert caches["range"] == [11, 15, 15]
    assert caches["active"]
    assert 0 <= caches["cache.abc"] < 1e-5
    assert 0 <= caches["cache.usdc"] < 1e-5


def test_performances_come_back(exported):
    said, folder = exported
    recorded = read_performance(folder / "speech.json")
    again = read_performance(folder / "again.json")
    assert again.fps == 30
    assert again.frame_count == recorded.frame_count
    assert again.weights == pytest.approx(recorded.weights.clip(0, 1), abs=1e-5)
    csv = read_performance(folder / "again.csv")
    assert csv.frame_count == 31
    assert csv.weights == pytest.approx(recorded.weights[:31].clip(0, 1), abs=1e-5)
    assert np.abs(csv.head_rotation).max() > 0.2  # the neck's own animation
    flame = read_performance(folder / "again.npz")
    assert flame.head_model == "flame"
    assert flame.frame_count == 11
    assert np.abs(flame.expression).max() > 0.1
    assert "choose it in the export options" in said["performances"]["needs"]
    assert said["performances"]["detail"]


def test_gaussian_avatars_of_ours(exported):
    """FLAME with the written offsets carries the splats to where the avatar's are, in FLAME's coordinates."""
    said, folder = exported
    made = read_gaussian_avatar(folder / "ours")
    head = load_flame(folder / "flame2023.pkl")
    assert made.track.frame_count == 5
    placed = place_on_mesh(made.cloud, head.v_template + made.track.static_offset, head.faces)
    resting = np.load(folder / "resting.npz")["means"]
    fit = fit_flame(load_open_head().v_template, head)
    assert placed.means == pytest.approx(resting * fit.scale + fit.shift, abs=1e-5)
    assert np.linalg.norm(made.cloud.means, axis=1).mean() < 5  # near their triangles, in sizes of a triangle
    assert "choose it in the export options" in said["gaussian"]["needs"]


def test_gaussian_avatars_of_others(exported):
    said, folder = exported
    made, original = read_gaussian_avatar(folder / "theirs"), read_gaussian_avatar(folder / "person")
    assert np.array_equal(made.cloud.binding, original.cloud.binding)
    assert made.track.expression == pytest.approx(original.track.expression, abs=1e-4)
    assert made.track.jaw_rotation == pytest.approx(original.track.jaw_rotation, abs=1e-4)
    assert made.track.shape == pytest.approx(original.track.shape, abs=1e-5)
    assert said["gaussian"]["again"] < 1e-4
    assert read_splats(folder / "posed_person.ply").count == 800
    assert len(read_gltf_mesh(folder / "person.glb").morphs) == 52


def test_clouds_are_written_as_they_were_read(exported):
    said, folder = exported
    before, after = read_splats(folder / "cloud.ply"), read_splats(folder / "cloud_again.ply")
    assert after.means == pytest.approx(before.means, abs=1e-6)
    assert np.abs((after.quats * before.quats).sum(1)) == pytest.approx(1, abs=1e-5)
    assert after.sh == pytest.approx(before.sh, abs=1e-6)
    assert said["clouds"]["polls"] == [False] * 5
