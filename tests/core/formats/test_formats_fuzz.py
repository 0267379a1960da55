"""Damaged files of every format: only one-sentence errors, bounded memory. The slow version reports its counts with `-s`."""

from __future__ import annotations

import json
import shutil
import sys
import time
import zipfile
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from avatar_files import cap4d_bytes, flame_track, lam_archive
from fuzzing import fuzz, glb_document, glb_with, memory_limit, mutate, odd_documents, read_or_refuse
from mesh_files import seamed_mesh
from splat_files import make_cloud, ply_bytes, splat_rows

from grmm_core.controls.names import ARKIT_NAMES
from grmm_core.errors import FileFormatError
from grmm_core.formats import read_performance, read_splats, write_mesh, write_performance, write_splats
from grmm_core.formats.avatars.cap4d import read_cap4d
from grmm_core.formats.avatars.gaussian_avatars import read_gaussian_avatar
from grmm_core.formats.avatars.lam import read_lam
from grmm_core.formats.meshes.gltf_mesh import read_gltf_mesh
from grmm_core.performance import Performance

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="limits memory through /proc and setrlimit"),
    pytest.mark.filterwarnings("error"),
]

DATA = Path(__file__).resolve().parents[2] / "data" / "formats"
QUICK, MANY = 30, 400  # damaged copies of each format


def make_ply(folder):
    write_splats(folder / "a.ply", make_cloud(40, 1))
    return folder / "a.ply", read_splats


def make_text_ply(folder):
    (folder / "a.ply").write_bytes(ply_bytes(splat_rows(10), "ascii"))
    return folder / "a.ply", read_splats


def make_splat(folder):
    write_splats(folder / "a.splat", make_cloud(40))
    return folder / "a.splat", read_splats


def make_spz(folder):
    write_splats(folder / "a.spz", make_cloud(40, 1))
    return folder / "a.spz", read_splats


def make_spz_4(folder):
    write_splats(folder / "a.spz", make_cloud(40, 1), version=4)
    return folder / "a.spz", read_splats


def make_sog(folder):
    write_splats(folder / "a.sog", make_cloud(40))
    return folder / "a.sog", read_splats


def make_gltf(folder):
    write_splats(folder / "a.glb", make_cloud(40))
    return folder / "a.glb", read_splats


def make_gltf_mesh(folder):
    write_mesh(folder / "a.glb", *seamed_mesh())
    return folder / "a.glb", read_gltf_mesh


def make_gaussian_avatar(folder):
    write_splats(folder / "point_cloud.ply", replace(make_cloud(40), binding=np.arange(40, dtype=np.int32)))
    return folder / "point_cloud.ply", read_gaussian_avatar


def make_cap4d(folder):
    (folder / "a.ply").write_bytes(cap4d_bytes()[0])
    return folder / "a.ply", read_cap4d


def make_lam(folder):
    lam_archive(folder / "a.zip")
    return folder / "a.zip", read_lam


def weights(extension):
    def make(folder):
        performance = Performance(np.arange(20) / 30, np.full((20, 52), 0.25), 30.0, found=ARKIT_NAMES)
        write_performance(folder / f"a{extension}", performance)
        return folder / f"a{extension}", read_performance

    return make


def make_flame(folder):
    write_performance(folder / "a.npz", flame_track())
    return folder / "a.npz", read_performance


def copied(name):
    def make(folder):
        shutil.copy(DATA / name, folder / name)
        return folder / name, read_splats

    return make


def make_table(prefix):
    def make(folder):
        rows = [",".join(["timeCode", *(f"{prefix}{name}" for name in ARKIT_NAMES)])]
        rows += [",".join(map(str, [i / 30, *[0.25] * 52])) for i in range(20)]
        (folder / "a.csv").write_text("\n".join(rows))
        return folder / "a.csv", read_performance

    return make


def make_face_cap(folder):
    rows = ["info,made by a test", ",".join(["bs", *ARKIT_NAMES])]
    rows += [",".join(map(str, ["k", 33 * i, *[0.5] * 10, *[0.25] * 52])) for i in range(20)]
    (folder / "a.txt").write_text("\n".join(rows))
    return folder / "a.txt", read_performance


def make_mediapipe(folder):
    categories = [{"categoryName": name, "score": 0.25} for name in ARKIT_NAMES]
    frames = [{"timestamp": 33 * i, "faceBlendshapes": [{"categories": categories}]} for i in range(4)]
    (folder / "a.json").write_text(json.dumps(frames))
    return folder / "a.json", read_performance


FORMATS = {
    "ply": make_ply,
    "compressed ply": copied("playcanvas.compressed.ply"),
    "ksplat": copied("level_2.ksplat"),
    "audio2face csv": make_table("blendShapes."),
    "face cap": make_face_cap,
    "mediapipe json": make_mediapipe,
    "text ply": make_text_ply,
    "splat": make_splat,
    "spz": make_spz,
    "spz 4": make_spz_4,
    "sog": make_sog,
    "gltf splats": make_gltf,
    "gltf mesh": make_gltf_mesh,
    "gaussian avatar": make_gaussian_avatar,
    "cap4d": make_cap4d,
    "lam": make_lam,
    "arkit json": weights(".json"),
    "live link csv": weights(".csv"),
    "flame npz": make_flame,
}


@pytest.mark.parametrize("name", FORMATS)
def test_damaged_files_give_one_sentence(tmp_path, name):
    path, read = FORMATS[name](tmp_path)
    outcomes = fuzz(read, path, QUICK, seed=1)
    assert outcomes.total() == QUICK
    assert outcomes["refused"] > 0, "the mutations do nothing"


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_damaged_files_give_one_sentence(tmp_path, name):
    path, read = FORMATS[name](tmp_path)
    start = time.perf_counter()
    outcomes = fuzz(read, path, MANY, seed=2)
    sys.stdout.write(f"\n{name}: {outcomes['refused']} refused, {outcomes['read']} read, {time.perf_counter() - start:.1f} s")
    assert outcomes.total() == MANY


def sog_with(path, document):
    with zipfile.ZipFile(path) as archive:
        pictures = {name: archive.read(name) for name in archive.namelist() if name != "meta.json"}
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("meta.json", json.dumps(document))
        for name, content in pictures.items():
            archive.writestr(name, content)


@pytest.mark.parametrize("name", ["gltf splats", "gltf mesh", "sog", "arkit json", "mediapipe json"])
def test_values_of_another_type_give_one_sentence(tmp_path, name):
    """Every value of the file's JSON in turn, exchanged for one of each type that JSON has."""
    path, read = FORMATS[name](tmp_path)
    good = path.read_bytes()
    if name.startswith("gltf"):
        document = glb_document(good)
    elif name == "sog":
        document = json.loads(zipfile.ZipFile(path).read("meta.json"))
    else:
        document = json.loads(good)
        if isinstance(document, dict):
            document["frames"] = document["frames"][:4]
    outcomes = Counter()
    for changed in odd_documents(document):
        if name.startswith("gltf"):
            path.write_bytes(glb_with(good, changed))
        elif name == "sog":
            sog_with(path, changed)
        else:
            path.write_text(json.dumps(changed))
        outcomes[read_or_refuse(read, path)] += 1
    assert outcomes["refused"] > 50, outcomes


def test_gltf_files_that_use_one_array_thousands_of_times_are_refused(tmp_path):
    """A small file can name one buffer again and again: as morph targets, primitives, or meshes of many nodes."""
    mesh_path = tmp_path / "m.glb"
    vertices = np.ones((60_000, 3), np.float32)
    write_mesh(mesh_path, vertices, np.array([[0, 1, 2]]), morphs={"a": vertices})
    document = glb_document(mesh_path.read_bytes())
    primitive = document["meshes"][0]["primitives"][0]
    primitive["targets"] = primitive["targets"] * 4000
    mesh_path.write_bytes(glb_with(mesh_path.read_bytes(), document))
    splat_path = tmp_path / "s.glb"
    write_splats(splat_path, make_cloud(60_000))
    good = splat_path.read_bytes()
    with memory_limit(1 << 30):
        with pytest.raises(FileFormatError, match="morph targets"):
            read_gltf_mesh(mesh_path)
        for change in ("primitives", "nodes"):
            document = glb_document(good)
            if change == "primitives":
                document["meshes"][0]["primitives"] *= 5000
            else:
                document["nodes"] = document["nodes"] * 5000
            splat_path.write_bytes(glb_with(good, document))
            with pytest.raises(FileFormatError, match="splats"):
                read_splats(splat_path)


def test_mutations_are_the_same_every_time():
    import random

    data = bytes(range(256)) * 4
    assert [mutate(data, random.Random(3)) for _ in range(3)] == [mutate(data, random.Random(3)) for _ in range(3)]
    assert mutate(data, random.Random(3)) != mutate(data, random.Random(4))
