"""Tensor files: round trip, an independent reader, damage, failed writes."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import safetensors.numpy

from grmm_core.errors import FileAccessError, FileFormatError, ShapeError
from grmm_core.files.tensorfile import read_metadata, read_tensors, write_tensors


def sample_tensors() -> dict[str, np.ndarray]:
    rng = np.random.default_rng(0)
    return {
        "a": rng.normal(size=(3, 4)).astype(np.float32),
        "b": rng.integers(-9, 9, (5,), np.int16),
        "scalar": np.float64(3.5),
        "empty": np.zeros((0, 3), np.float16),
        "flags": np.array([True, False]),
    }


def test_tensor_files_round_trip_and_open_in_the_independent_library(tmp_path):
    path = tmp_path / "файл.tensors"
    write_tensors(path, sample_tensors(), {"note": "näme"})
    tensors, metadata = read_tensors(path)
    other = safetensors.numpy.load_file(path)
    assert metadata == read_metadata(path) == {"note": "näme"}
    for name, array in sample_tensors().items():
        np.testing.assert_array_equal(tensors[name], array)
        np.testing.assert_array_equal(other[name], array)
        assert tensors[name].dtype == array.dtype


def test_every_damage_of_a_tensor_file_gives_a_typed_error(tmp_path):
    path = tmp_path / "x.tensors"
    write_tensors(path, sample_tensors(), {"note": "n"})
    whole = path.read_bytes()
    rng = np.random.default_rng(1)
    refused = 0
    for trial in range(600):
        data = bytearray(whole)
        if trial % 2:
            data = data[: rng.integers(0, len(data))]
        else:
            for position in rng.integers(0, min(len(data), 400), rng.integers(1, 4)):
                data[position] ^= 1 << int(rng.integers(8))
        path.write_bytes(data)
        try:
            read_tensors(path)
        except FileFormatError:
            refused += 1
    assert refused > 400


@pytest.mark.parametrize(
    "header",
    [
        {"a": {"dtype": "F32", "shape": [1 << 40], "data_offsets": [0, 1 << 42]}},
        {"a": {"dtype": "F32", "shape": [-1, -4], "data_offsets": [0, 16]}},
        {"a": {"dtype": "F32", "shape": [True, 4], "data_offsets": [0, 16]}},
        {"a": {"dtype": "O", "shape": [4], "data_offsets": [0, 16]}},
        {str(i): {"dtype": "F32", "shape": [4], "data_offsets": [0, 16]} for i in range(9)},
        {"__metadata__": {"a": 1}},
        [],
    ],
)
def test_headers_that_lie_are_refused(tmp_path, header):
    encoded = json.dumps(header).encode()
    path = tmp_path / "hostile"
    path.write_bytes(struct.pack("<Q", len(encoded)) + encoded + bytes(16))
    with pytest.raises(FileFormatError):
        read_tensors(path)


def test_a_failed_write_leaves_the_old_file(tmp_path):
    path = tmp_path / "x.tensors"
    write_tensors(path, {"a": np.zeros(3, np.float32)})
    before = path.read_bytes()
    with pytest.raises(ShapeError):
        write_tensors(path, {"a": np.array(["text"])})
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["x.tensors"]


def test_missing_files_and_folders_are_named(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        read_tensors(tmp_path / "none")
    with pytest.raises(FileAccessError, match="Cannot write"):
        write_tensors(tmp_path / "no folder" / "x", {})
