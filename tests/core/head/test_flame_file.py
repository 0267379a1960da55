"""Reading FLAME model files: every structure that is distributed, and files that mean harm."""

from __future__ import annotations

import os
import pickle
import subprocess
import zipfile

import numpy as np
import pytest
from flame_files import flame_fields, write_flame_pickle

from grmm_core.errors import FileAccessError, FileFormatError, GrmmError
from grmm_core.head import flame_file
from grmm_core.head.flame_file import read_flame_file, read_flame_masks
from grmm_core.head.restricted_pickle import load_restricted


@pytest.fixture(scope="module")
def fields():
    return flame_fields()


@pytest.mark.parametrize(("python", "protocol"), [(2, 0), (2, 1), (2, 2), (3, 0), (3, 1), (3, 2), (3, 3), (3, 4), (3, 5)])
def test_pickles_of_every_age_read_as_what_was_written(tmp_path, fields, python, protocol):
    if protocol < 2:  # numbers as text: arrays with few digits keep it quick
        fields = {**fields, "shapedirs": np.round(fields["shapedirs"], 3), "posedirs": np.zeros((5023, 3, 36))}
    path = tmp_path / "generic_model.pkl"
    write_flame_pickle(path, fields, protocol, python)
    flame = read_flame_file(path)
    np.testing.assert_allclose(flame.v_template, fields["v_template"])
    np.testing.assert_allclose(flame.shape_dirs, fields["shapedirs"][:, :, :300])
    np.testing.assert_allclose(flame.expression_dirs, fields["shapedirs"][:, :, 300:])
    np.testing.assert_allclose(flame.posedirs, fields["posedirs"])
    np.testing.assert_allclose(flame.joint_regressor, fields["J_regressor"])
    assert flame.faces.dtype == np.int32


def test_npz_reads_the_same(tmp_path, fields):
    path = tmp_path / "flame.npz"
    np.savez(path, **fields)
    np.testing.assert_allclose(read_flame_file(path).weights, fields["weights"])


def test_masks(tmp_path):
    path = tmp_path / "FLAME_masks.pkl"
    path.write_bytes(pickle.dumps({"face": np.array([5, 3, 3, 9]), "neck": np.array([1])}, 2))
    masks = read_flame_masks(path)
    assert masks["face"].tolist() == [3, 5, 9]
    path.write_bytes(pickle.dumps({"face": np.array([5023])}, 2))
    with pytest.raises(FileFormatError, match="face"):
        read_flame_masks(path)


class Hostile:
    def __init__(self, function, *arguments):
        self.call = (function, arguments)

    def __reduce__(self):
        return self.call


@pytest.mark.parametrize("protocol", range(6))
@pytest.mark.parametrize("function", [os.system, eval, subprocess.check_output, getattr])
def test_code_in_a_pickle_is_refused_named_and_does_not_run(tmp_path, function, protocol):
    marker = tmp_path / "ran"
    argument = f"open({str(marker)!r}, 'w')" if function is eval else f"touch {marker}"
    path = tmp_path / "model.pkl"
    path.write_bytes(pickle.dumps({"v_template": Hostile(function, argument)}, protocol))
    with pytest.raises(FileFormatError, match=function.__name__):
        read_flame_file(path)
    assert not marker.exists()


def text(value):
    return b"X" + len(value).to_bytes(4, "little") + value.encode()


NUMBERS = b"cnumpy\ndtype\n" + text("f8") + b"\x85R"
BYTES = b"c_codecs\nencode\n" + text("abcdefgh") + b"\x85R"
EMPTY = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85" + text("b") + b"\x87R"


@pytest.mark.parametrize(
    "stream",
    [
        # setting attributes of what may be called would change this reader for the files that follow
        b"\x80\x02c_codecs\nencode\nN}" + text("__defaults__") + b")s\x86b.",
        b"\x80\x02c__builtin__\nobject\nN}" + text("__doc__") + b"Ns\x86b.",
        # an array that sees eight bytes a million times
        b"\x80\x02cnumpy\nndarray\n(J@B\x0f\x00\x85" + NUMBERS + BYTES + b"K\x00K\x00\x85tR.",
        # data that is a number, not bytes; fewer bytes than the shape; a negative size; a structured type
        b"\x80\x02" + EMPTY + b"(K\x01J\xff\xff\xff\x7f\x85" + NUMBERS + b"\x89J\xff\xff\xff\x7ftb.",
        b"\x80\x02" + EMPTY + b"(K\x01K\x09\x85" + NUMBERS + b"\x89" + text("abcdefgh") + b"tb.",
        b"\x80\x02" + EMPTY + b"(K\x01J\xff\xff\xff\xff\x85" + NUMBERS + b"\x89" + text("abcdefgh") + b"tb.",
        b"\x80\x02cnumpy\ndtype\n" + text("f8,f8") + b"\x85R.",
    ],
)
def test_numpys_own_unpickling_never_runs(stream):
    with pytest.raises(FileFormatError):
        load_restricted(stream, "x.pkl")


def test_a_data_type_cannot_be_changed_under_an_array():
    """With numpy's own unpickling the second state would let the array read memory that is not its own."""
    dtype = b"cnumpy\ndtype\n" + text("S8") + b"\x85Rq\x01"
    filled = EMPTY + b"(K\x01K\x02\x85h\x01\x89" + text("abcdefghabcdefgh") + b"tb"
    stream = b"\x80\x02(" + dtype + filled + b"h\x01(K\x03" + text("|") + b"NNNJ\x00\x10\x00\x00K\x01K\x00tbt."
    array = load_restricted(stream, "x.pkl")[1]
    assert array.nbytes == 16
    assert array.tolist() == [b"abcdefgh"] * 2


@pytest.mark.parametrize("wrap", ["plain", "chumpy"])
def test_shared_lists_that_would_fill_the_memory_are_refused(tmp_path, wrap):
    """Thirty lists of the same list twice are a kilobyte in the file and 8 GiB as an array."""
    rows = b"]q\x00(K\x00K\x01e" + b"".join(b"]q%c(h%ch%ce" % (i + 1, i, i) for i in range(30))
    value = b"h\x1e" if wrap == "plain" else b"cchumpy.ch\nCh\n)\x81}" + text("x") + b"h\x1esb"
    path = tmp_path / "flame.pkl"
    path.write_bytes(b"\x80\x02" + rows.replace(b"e]", b"e0]") + b"0}" + text("v_template") + value + b"s.")
    with pytest.raises(FileFormatError):
        read_flame_file(path)


@pytest.mark.parametrize(
    "stream",
    [
        b"cnumpy\nfromfile\n.",
        b"cnumpy.core.multiarray\n_reconstruct\n(cnumpy\nndarray\n(I1000000000000\ntS'd'\ntR.",
        b"cchumpy.utils\nsystem\n(S'id'\ntR.",
        b"\x80\x02ccopy_reg\n_reconstructor\ncnumpy\ndtype\nc__builtin__\nobject\nN\x87R.",
        b"\x80\x02r\xff\xff\xff\x7fN.",  # a memo index that would make the memo 16 GB large
        b"\x80\x04\x8e\xff\xff\xff\xff\xff\x00\x00\x00.",  # bytes of a length that lies
        b"\x80\x02(]q\x00h\x00a.",  # a list that holds itself
        b"",
        b"not a pickle",
    ],
)
def test_streams_made_by_hand_are_refused(stream):
    with pytest.raises(FileFormatError):
        load_restricted(stream, "x.pkl")


def test_nested_shared_lists_end():
    stream = b"\x80\x02]q\x00" + b"".join(b"]q%c(" % (i + 1) + b"h%c" % i * 9 + b"e" for i in range(60)) + b"."
    assert isinstance(load_restricted(stream, "x.pkl"), list)


def test_an_npz_that_hides_objects_or_a_bomb_is_refused(tmp_path, monkeypatch):
    path = tmp_path / "flame.npz"
    np.savez(path, v_template=np.array([Hostile(print, "x")], object))
    with pytest.raises(FileFormatError):
        read_flame_file(path)
    monkeypatch.setattr(flame_file, "MAX_FILE_BYTES", 1 << 20)  # a bomb of a gigabyte would take a while to write
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("v_template.npy", bytes(2 << 20))
    assert path.stat().st_size < 1 << 14
    with pytest.raises(FileFormatError, match="more than the"):
        read_flame_file(path)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"v_template": np.zeros((7, 3))}, "v_template"),
        ({"v_template": np.full((5023, 3), np.nan)}, "not numbers"),
        ({"f": np.full((9976, 3), 5023)}, "outside"),
        ({"weights": np.zeros((5023, 5))}, "sum to one"),
        ({"kintree_table": np.zeros((2, 5))}, "joints"),
        ({"shapedirs": np.zeros((5023, 3, 10))}, "shapedirs"),
        ({"posedirs": None}, "posedirs"),
    ],
)
def test_models_that_are_not_flame_say_why(tmp_path, fields, change, reason):
    path = tmp_path / "flame.npz"
    changed = {k: v for k, v in {**fields, **change}.items() if v is not None}
    np.savez(path, **changed)
    with pytest.raises(FileFormatError, match=reason):
        read_flame_file(path)


def test_missing_files_are_named(tmp_path):
    with pytest.raises(FileAccessError, match="does not exist"):
        read_flame_file(tmp_path / "none.pkl")


def test_damage_gives_typed_errors_only(tmp_path):
    """Flip and truncate bytes of a small pickle of the same object kinds."""
    from flame_files import chumpy_stand_in
    from scipy import sparse

    with chumpy_stand_in() as chumpy_array:
        whole = pickle.dumps(
            {"a": chumpy_array(np.arange(6.0)), "s": sparse.csc_matrix(np.eye(4)), "n": np.float64(1.5), "t": "text"}, 2
        )
    rng = np.random.default_rng(0)
    refused = 0
    for trial in range(2000):
        data = bytearray(whole)
        if trial % 4 == 0:
            data = data[: rng.integers(0, len(data))]
        else:
            for position in rng.integers(0, len(data), rng.integers(1, 5)):
                data[position] = rng.integers(256)
        try:
            load_restricted(bytes(data), "x.pkl")
        except GrmmError:
            refused += 1
    assert refused > 1000
