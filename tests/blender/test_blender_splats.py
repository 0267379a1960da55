"""Splat files and other projects' avatars in Blender: imported, drawn by the engine, driven by the avatars' controls."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from avatar_files import cap4d_bytes, flame_track, lam_archive
from blender_process import RunBlender, find_python
from flame_files import write_flame_pickle
from flame_head_files import flame_head_fields
from performance_files import write_performances
from PIL import Image
from splat_files import make_cloud
from tolerances import CHANNEL_STEP

from grmm_core.formats import write_splats
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, write_gaussian_avatar

pytestmark = pytest.mark.blender

PATIENCE = 600.0  # seconds; many imports in one Blender, also on a busy machine
CLOSE = (2e-6, 1e-5, 1e-3)  # metres, 1 - |cos|, share of a scale


@pytest.fixture(scope="module", params=["4.5", "5.2"])
def imported(request: pytest.FixtureRequest, run_blender: RunBlender, tmp_path_factory: pytest.TempPathFactory) -> dict:
    find_python(request.param)
    from tiny_model import write_tiny_weights

    folder = tmp_path_factory.mktemp("splats")
    weights = write_tiny_weights(folder / "tiny.safetensors")
    cloud = replace(make_cloud(3000, 2), scales=np.full((3000, 3), 0.006, np.float32) * [1, 1, 0.4])
    for extension in (".ply", ".splat", ".spz", ".glb", ".sog"):
        write_splats(folder / f"cloud{extension}", cloud)
    lam_archive(folder / "lam.zip")
    (folder / "cap4d.ply").write_bytes(cap4d_bytes()[0])
    write_performances(folder)  # speech.json
    (folder / "person").mkdir()
    write_flame_pickle(folder / "flame2023.pkl", flame_head_fields())
    bound = replace(make_cloud(2000), binding=np.random.default_rng(3).integers(0, 10144, 2000).astype(np.int32))
    write_gaussian_avatar(folder / "person", GaussianAvatar(bound, flame_track()))
    (folder / "truncated.spz").write_bytes((folder / "cloud.spz").read_bytes()[:900])
    (folder / "text.ply").write_text(json.dumps({"not": "splats"}))
    (folder / "unknown.xyz").write_text("1 2 3")
    environment = {"GRMM_WORKER_PYTHON": sys.executable, "OMP_NUM_THREADS": "1"}
    done = run_blender("splats_import.py", weights, folder, python=request.param, environment=environment, timeout=PATIENCE)
    return done.result | {"folder": folder}


def test_formats_are_drawn_as_their_files_say(imported):
    assert len(imported["formats"]) == 4
    for name, found in imported["formats"].items():
        assert found["count"] == 3000, name
        assert (np.array(found["gap"]) < CLOSE).all(), (name, found)
        assert found["picture"] <= CHANNEL_STEP, name
        assert found["covered"] > 0.05, name
        assert found["terms"] == (1 if name == "cloud.splat" else 9)


def test_clouds_live_in_blend_files(imported):
    kept = imported["kept"]
    assert kept["same"] == 0.0
    assert kept["names"] == ["cloud", "cloud.001"]
    assert kept["versions"] == 2
    assert kept["shown"] == [2, 1]
    assert "lost the attribute 'rotation'" in kept["damaged"]


def test_clouds_and_heads_occlude_one_another(imported):
    masks = imported["beside"]["masks"]
    assert masks["front"][0] < 0.95 * masks["behind"][0]
    assert max(masks[where][1] for where in masks) <= CHANNEL_STEP
    assert imported["beside"]["names"]


def test_lam_is_driven_by_arkit_controls(imported):
    lam = imported["lam"]
    assert lam["controls"] == 51
    assert (np.array(lam["moved"]) < CLOSE).all()
    assert lam["can"]
    assert (np.array(lam["performed"]) < CLOSE).all()
    assert lam["occludes"] == 0


def test_cap4d_plays_its_frames(imported):
    assert imported["cap4d"]["frames"] == 3
    assert (np.array(imported["cap4d"]["gaps"]) < CLOSE).all()


def test_gaussian_avatars_ride_on_the_users_flame(imported):
    flame = imported["flame"]
    assert "choose your own FLAME file" in flame["message"]
    assert (np.array(flame["gaps"]) < (2e-5, 1e-3, 1e-2)).all()
    assert flame["opened"] > 0.005
    assert flame["drawn"] == [flame["cloud"]]


def test_sog_is_decoded_by_blender(imported):
    assert imported["sog"] == {"count": 3000, "images": 0}
    found = np.load(imported["folder"] / "pictures.npz")
    with zipfile.ZipFile(imported["folder"] / "cloud.sog") as archive:
        names = [name for name in archive.namelist() if name.endswith(".webp")]
        assert sorted(found.files) == sorted(names)
        for name in names:
            with Image.open(io.BytesIO(archive.read(name))) as picture:
                wanted = np.asarray(picture.convert("RGBA"))
            assert np.array_equal(found[name], wanted), name


def test_what_cannot_be_read_is_one_sentence(imported):
    said = imported["errors"]["messages"]
    assert "does not exist" in said["gone.ply"]
    assert "not a readable SPZ file" in said["truncated.spz"]
    assert "not a readable" in said["text.ply"]
    assert "not a splat file" in said["unknown.xyz"]
    assert "choose a file" in said[""]
    assert all(sentence.count(". ") == 0 for sentence in said.values())
    assert imported["errors"]["left"] == 0
