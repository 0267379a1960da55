"""Documents with values of another type, and small files that claim much: only one-sentence errors, bounded memory.

Damage at random: `tests/core/test_fuzz.py`.
"""

from __future__ import annotations

import json
import sys
import zipfile
from collections import Counter

import numpy as np
import pytest
from fuzzing import glb_document, glb_with, memory_limit, odd_documents, read_or_refuse
from good_files import KINDS
from splat_files import make_cloud

from grmm_core.errors import FileFormatError
from grmm_core.formats import read_splats, write_mesh, write_splats
from grmm_core.formats.meshes.gltf_mesh import read_gltf_mesh

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="limits memory through /proc and setrlimit"),
    pytest.mark.filterwarnings("error"),
]


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
    good_file = KINDS[name](tmp_path)
    path, read = good_file.path, good_file.read
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
