"""Damaged files of every kind: a typed sentence or a result, within bounds. `make fuzz` reads as many as there is time for."""

from __future__ import annotations

import importlib
import json
import random
import sys
from collections import Counter

import bad_readers
import good_files
import pytest
from fuzzing import mutate

from grmm_core.errors import GrmmError

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="limits memory through /proc and setrlimit")

COPIES, LARGE_COPIES = 30, 8  # of each kind; of kinds whose files are large


@pytest.fixture(scope="module")
def fuzz(repository):
    """The module `tests/fuzz.py`, which is a program; its processes look for it on the path."""
    sys.path.insert(0, str(repository / "tests"))
    try:
        yield importlib.import_module("fuzz")
    finally:
        sys.path.remove(str(repository / "tests"))


@pytest.mark.parametrize("name", good_files.KINDS)
def test_damaged_files_give_one_sentence(fuzz, tmp_path, name):
    numbers = range(LARGE_COPIES if name in good_files.LARGE else COPIES)
    outcomes = Counter()
    fuzz.read_slice(name, good_files.KINDS[name], 1, numbers, tmp_path, lambda _, outcome, __: outcomes.update([outcome]))
    assert not outcomes["failed"], "\n".join(path.read_text() for path in tmp_path.glob("*/reason.txt"))
    assert outcomes["refused"] > 0, "the mutations do nothing"


@pytest.mark.parametrize("name", good_files.KINDS)
def test_good_files_are_good(tmp_path, name):
    good = good_files.KINDS[name](tmp_path)
    if name in ("grmm render", "grmm export", "grmm fit"):
        with pytest.raises(GrmmError, match="does not exist"):
            good.read(good.path)
    else:
        good.read(good.path)


@pytest.mark.parametrize("name", ["raises", "takes memory"])
def test_readers_that_misbehave_are_noticed_and_their_files_kept(fuzz, tmp_path, name):
    outcomes = Counter()
    fuzz.read_slice(name, bad_readers.KINDS[name], 0, range(3), tmp_path, lambda _, outcome, __: outcomes.update([outcome]))
    assert outcomes["failed"] == 3
    case = sorted(tmp_path.iterdir())[0]
    assert json.loads((case / "case.json").read_text())["kind"] == name
    assert (case / "files" / "a.bin").read_bytes() != bad_readers.GOOD
    assert ("ValueError" if name == "raises" else "MemoryError") in (case / "reason.txt").read_text()


@pytest.mark.parametrize(("name", "reason"), [("leaves", "ended with code 3"), ("hangs", "hangs")])
def test_a_reader_that_takes_its_process_down_costs_one_file(fuzz, tmp_path, name, reason):
    outcomes, _ = fuzz.watch_slice(name, 0, range(3), tmp_path, "bad_readers", patience=2.0)
    assert outcomes.total() == 3
    assert outcomes["failed"] >= 1, "the others are like the good file by chance"
    assert [reason in (case / "reason.txt").read_text() for case in tmp_path.iterdir()] == [True] * outcomes["failed"]


def test_a_kept_case_is_read_again(fuzz, tmp_path):
    (tmp_path / "folder").mkdir()
    (tmp_path / "folder" / "a.ply").write_bytes(b"ply")
    fuzz.keep(tmp_path, "ply", 0, 7, tmp_path / "folder", "because")
    assert fuzz.replay(tmp_path / "ply-0-7") == "refused"


def test_mutations_are_the_same_every_time():
    data = bytes(range(256)) * 4
    assert [mutate(data, random.Random(3)) for _ in range(3)] == [mutate(data, random.Random(3)) for _ in range(3)]
    assert mutate(data, random.Random(3)) != mutate(data, random.Random(4))
