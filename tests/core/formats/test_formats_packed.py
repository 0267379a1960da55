"""Packed splat files of other programs, as these programs wrote them (tests/data/SOURCES.md), and damage to them."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from splat_files import make_cloud

from grmm_core.errors import FileFormatError
from grmm_core.formats import format_to_read, read_splats

DATA = Path(__file__).resolve().parents[2] / "data" / "formats"
WRITTEN = make_cloud(300, 2, seed=5)  # what both programs were given as a .ply

# Largest errors: metres, 1 - |cos| of half the angle, logarithm of scale, opacity, color, harmonics.
TOLERANCES = {
    "level_0.ksplat": (0.0, 1e-6, 1e-6, 4e-3, 4e-3, 1e-6),
    "level_1.ksplat": (2e-6, 1e-6, 1e-3, 4e-3, 4e-3, 3e-4),
    "level_2.ksplat": (2e-6, 1e-6, 1e-3, 4e-3, 4e-3, 3e-3),
    "playcanvas.compressed.ply": (6e-4, 3e-6, 4e-3, 3e-3, 3e-3, 0.016),
}


@pytest.mark.parametrize("name", TOLERANCES)
def test_files_of_the_programs_themselves(name):
    assert format_to_read(DATA / name, "splats").name == ("ksplat" if name.endswith("ksplat") else "compressed-ply")
    found = read_splats(DATA / name)
    expected = WRITTEN.select(np.argmin(((found.means[:, None] - WRITTEN.means[None]) ** 2).sum(-1), 1))
    assert found.count == len(np.unique(expected.means, axis=0)) == 300
    assert found.degree == 2
    errors = (
        np.abs(found.means - expected.means).max(),
        (1 - np.abs((found.quats * expected.quats).sum(1))).max(),
        np.abs(np.log(found.scales / expected.scales)).max(),
        np.abs(found.opacities - expected.opacities).max(),
        np.abs(found.colors() - expected.colors()).max(),
        np.abs(found.sh[:, 1:] - expected.sh[:, 1:]).max(),
    )
    assert all(error <= tolerance for error, tolerance in zip(errors, TOLERANCES[name], strict=True)), errors
    assert found.warnings == []
    turned = read_splats(DATA / name, axes="y_up")
    assert turned.means == pytest.approx(found.means * [1, -1, -1])


def packed(tmp_path, data):
    path = tmp_path / "a.compressed.ply"
    path.write_bytes(data)
    return path


def test_a_compressed_ply_without_bounds_of_colors(tmp_path):
    """Older ones have none: their colors go from 0 to 1."""
    data = (DATA / "playcanvas.compressed.ply").read_bytes()
    text, _, body = data.partition(b"end_header\n")
    bounds = [f"property float {end}_{name}\n".encode() for end in ("min", "max") for name in "rgb"]
    for line in bounds:
        text = text.replace(line, b"")
    chunks = np.frombuffer(body[: 2 * 72], "<f4").reshape(2, 18)[:, :12]
    old = read_splats(packed(tmp_path, text + b"end_header\n" + chunks.tobytes() + body[2 * 72 :]))
    new = read_splats(DATA / "playcanvas.compressed.ply")
    assert old.means == pytest.approx(new.means)
    low, high = np.frombuffer(body[: 2 * 72], "<f4").reshape(2, 2, 9)[0, 1, 3:6], np.frombuffer(body[:72], "<f4")[15:18]
    assert low.shape == high.shape == (3,)
    first = np.frombuffer(body[:72], "<f4")
    assert old.colors()[:256] * (first[15:18] - first[12:15]) + first[12:15] == pytest.approx(new.colors()[:256], abs=1e-5)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda data: data.replace(b"element chunk 2", b"element chunk 1"), "1 chunks for 300|malformed|claims|line"),
        (lambda data: data.replace(b"packed_scale", b"packed_smell"), "no packed columns"),
        (lambda data: data.replace(b"min_scale_x", b"min_smell_x"), "no bounds of scale_x"),
        (lambda data: data.replace(b"f_rest_3\n", b"f_rest_99\n", 1), "fit no degree"),
        (lambda data: data[:-10], "claims 300 rows"),
    ],
)
def test_bad_compressed_ply_files(tmp_path, change, reason):
    with pytest.raises(FileFormatError, match=reason):
        read_splats(packed(tmp_path, change((DATA / "playcanvas.compressed.ply").read_bytes())))


def put(data, offset, form, value):
    changed = bytearray(data)
    struct.pack_into(form, changed, offset, value)
    return bytes(changed)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda data: b"", "truncated"),
        (lambda data: put(data, 1, "<B", 0), "version is 0.0"),
        (lambda data: put(data, 0, "<B", 1), "version is 1.1"),
        (lambda data: put(data, 20, "<H", 3), "level 3"),
        (lambda data: put(data, 4, "<I", 4_000_000), "4000000 sections"),
        (lambda data: put(data, 4, "<I", 30), "truncated"),
        (lambda data: put(data, 16, "<I", 0), "0 splats"),
        (lambda data: put(data, 16, "<I", 299), "do not have the 299 splats"),
        (lambda data: put(data, 4096 + 4, "<I", 4_000_000_000), "longer than the file"),
        (lambda data: put(data, 4096 + 12, "<I", 4_000_000_000), "longer than the file|contradicts"),
        (lambda data: put(data, 4096 + 20, "<H", 2), "longer than the file"),
        (lambda data: put(data, 4096 + 32, "<I", 0), "fewer splats"),
        (lambda data: put(data, 4096 + 40, "<H", 7), "contradicts itself"),
        (lambda data: put(data, 4096 + 16, "<f", float("nan")), "contradicts itself"),
        (lambda data: data[:-1], "longer than the file"),
    ],
)
def test_bad_ksplat_files(tmp_path, change, reason):
    path = tmp_path / "a.ksplat"
    path.write_bytes(change((DATA / "level_2.ksplat").read_bytes()))
    with pytest.raises(FileFormatError, match=reason):
        read_splats(path)
