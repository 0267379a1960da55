"""The one list of file formats: complete, of one meaning, and what files are recognised by."""

from __future__ import annotations

import importlib
import os
import pkgutil
import threading
import zipfile
from pathlib import Path

import numpy as np
import pytest
from avatar_files import cap4d_bytes, flame_track, lam_archive
from performance_files import write_performances
from splat_files import make_cloud

import grmm_core.formats
from grmm_core.errors import FileAccessError, FileFormatError
from grmm_core.files.access import read_bytes
from grmm_core.files.archive import read_members
from grmm_core.files.npz import read_npz
from grmm_core.formats import format_to_read, format_to_write, formats, write_mesh, write_splats
from grmm_core.formats.avatars.gaussian_avatars import GaussianAvatar, write_gaussian_avatar
from grmm_core.formats.registry import MODULES
from grmm_core.video.request import SUFFIXES as VIDEOS
from grmm_core.voice.request import SUFFIXES as VOICES


def test_every_module_with_a_format_is_in_the_list():
    found = set()
    for each in pkgutil.walk_packages(grmm_core.formats.__path__, "grmm_core.formats."):
        if hasattr(importlib.import_module(each.name), "FORMAT"):
            found.add(each.name.removeprefix("grmm_core.formats."))
    assert found == set(MODULES)


def test_names_and_options_mean_one_thing():
    known = formats()
    assert len({one.name for one in known}) == len(known)
    assert all(one.description and not one.description.endswith(".") for one in known)
    assert all(one.reader or one.writer for one in known)
    options = {}
    for option in [option for one in known for option in (*one.reading, *one.writing)]:
        assert options.setdefault(option.identifier, option) == option
    for kind in {one.holds for one in known}:  # a suffix says which format of a kind is written
        written = [one.suffix for one in formats(kind, written=True)]
        assert len(set(written)) == len(written)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    folder = tmp_path_factory.mktemp("files")
    cloud = make_cloud(8)
    for suffix in (".ply", ".splat", ".spz", ".sog", ".glb"):
        write_splats(folder / f"splats{suffix}", cloud)
    write_mesh(folder / "mesh.glb", np.eye(3), np.array([[0, 1, 2]]))
    (folder / "cap.ply").write_bytes(cap4d_bytes()[0])
    lam_archive(folder / "lam.zip")
    bound = make_cloud(5)
    bound.binding = np.zeros(5, np.int32)
    (folder / "person").mkdir()
    write_gaussian_avatar(folder / "person", GaussianAvatar(bound, flame_track()))
    write_performances(folder)
    return folder


@pytest.mark.parametrize(
    ("file", "name"),
    [
        ("splats.ply", "ply"), ("splats.splat", "splat"), ("splats.spz", "spz"), ("splats.sog", "sog"),
        ("splats.glb", "gltf-splats"), ("mesh.glb", "gltf-mesh"), ("cap.ply", "cap4d"), ("lam.zip", "lam"),
        ("person", "gaussian-avatars"), ("person/point_cloud.ply", "gaussian-avatars"), ("speech.json", "arkit-json"),
        ("live_link.csv", "live-link"), ("talk.npz", "flame-npz"),
    ],
)  # fmt: skip
def test_files_are_recognised_and_described(folder, file, name):
    found = format_to_read(folder / file)
    assert found.name == name
    assert found.read(folder / file).summary()


def test_what_is_of_no_format_is_one_sentence(tmp_path):
    with pytest.raises(FileFormatError, match=r"not a splat file .* choose one of \.ply"):
        format_to_read(tmp_path / "a.xyz", "splats")
    with pytest.raises(FileFormatError, match=r"Meshes cannot be written as '.ply'; choose one of \.glb, \.obj\."):
        format_to_write(tmp_path / "a.ply", "mesh")
    with pytest.raises(FileAccessError, match="is a folder"):
        format_to_read(tmp_path)
    with pytest.raises(FileFormatError, match="only written"):
        formats("arrays")[0].read(tmp_path / "a.npz")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="named pipes")
def test_pipes_and_devices_are_refused_at_once(tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    for path in (tmp_path / "pipe.ply", "/dev/zero"):
        caught = []

        def attempt(path=path, caught=caught):
            try:
                read_bytes(path, 1000)
            except FileAccessError as error:
                caught.append(str(error))

        thread = threading.Thread(target=attempt, daemon=True)
        thread.start()
        thread.join(10)
        assert len(caught) == 1
        assert "device or a pipe" in caught[0]


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="files whose size is said to be zero")
def test_the_limit_holds_whatever_the_file_system_says():
    assert b"Name:" in read_bytes("/proc/self/status", 1 << 16)
    with pytest.raises(FileAccessError, match="more than the 100 bytes"):
        read_bytes("/proc/self/status", 100)


@pytest.mark.parametrize("method", [zipfile.ZIP_LZMA, zipfile.ZIP_BZIP2, zipfile.ZIP_DEFLATED])
def test_damaged_members_of_every_compression_are_one_sentence(tmp_path, method):
    """LZMA and bzip2 report damage by errors of their own."""
    path = tmp_path / "a.zip"
    with zipfile.ZipFile(path, "w", method) as archive:
        archive.writestr("expr.npy", np.random.default_rng(0).bytes(5000))
    good = path.read_bytes()
    for at in range(60, 4000, 97):
        path.write_bytes(good[:at] + bytes([good[at] ^ 0xFF]) + good[at + 1 :])
        for read in (lambda: read_members(path, "test archive", 1 << 20), lambda: read_npz(path)):
            with pytest.raises(FileFormatError, match="not a readable"):
                read()


@pytest.mark.parametrize(
    ("suffix", "kind"),
    [(suffix.upper(), "a video; .*grmm track") for suffix in VIDEOS] + [(suffix, "sound; .*grmm speak") for suffix in VOICES],
)
def test_a_recording_of_a_face_or_of_speech_is_refused_with_a_way_to_its_motion(tmp_path, suffix, kind):
    path = tmp_path / f"take{suffix}"
    path.write_bytes(b"RIFF\0\0\0\0WAVEfmt ")
    with pytest.raises(FileFormatError, match=kind):
        format_to_read(path, "performance")
