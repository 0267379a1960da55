"""Damaged avatars, weights, head and FLAME files: only one-sentence errors, bounded memory.

The slow version reads many more copies and reports its counts with `-s`. Splat and animation files: `test_formats_fuzz`.
"""

from __future__ import annotations

import functools
import pickle
import sys
import time

import numpy as np
import pytest
import torch
from flame_files import flame_fields, write_flame_pickle
from fuzzing import fuzz
from grmm_files import make_avatar

from grmm_core.avatar import load_avatar, save_avatar
from grmm_core.head.flame import read_landmark_embedding
from grmm_core.head.flame_file import read_flame_file

pytestmark = [
    pytest.mark.skipif(sys.platform != "linux", reason="limits memory through /proc and setrlimit"),
    pytest.mark.filterwarnings("ignore::RuntimeWarning"),  # arithmetic on damaged numbers that is refused afterwards
]

QUICK, MANY = 40, 1000  # damaged copies of each format
LARGE = 4  # fewer of a file of ten megabytes by this factor


def make_grmm(folder):
    save_avatar(make_avatar(), folder / "a.grmm")
    return folder / "a.grmm", load_avatar


def make_weights(folder):
    from model_fixtures import SHAPES, small_head

    from grmm_core.model.config import PRESETS
    from grmm_core.model.grmm import GRMM
    from grmm_core.model.weights import load_weights, save_weights
    from grmm_core.model.weights_file import WeightsInfo

    torch.manual_seed(0)
    head = small_head()
    model = GRMM(head, PRESETS["tiny"])
    rng = np.random.default_rng(0)
    info = WeightsInfo(
        "test", "", "", model.config, people=("a", "b"), z_id=rng.random((2, 6)), shapes=rng.random((2, SHAPES)),
        default_z_id=rng.random(6), default_shape=rng.random(SHAPES),
    )  # fmt: skip
    save_weights(folder / "a.safetensors", model, info)
    return folder / "a.safetensors", functools.partial(load_weights, head=head)


@functools.cache
def small_flame():
    """FLAME's arrays with one expression only and in half precision, to keep the file small."""
    fields = flame_fields()
    return fields | {name: fields[name][..., :301].astype(np.float16) for name in ("shapedirs", "posedirs")}


def make_flame_pickle(protocol, folder):
    write_flame_pickle(folder / "flame.pkl", small_flame(), protocol)
    return folder / "flame.pkl", read_flame_file


def make_flame_npz(folder):
    np.savez(folder / "flame.npz", **small_flame())
    return folder / "flame.npz", read_flame_file


def embedding():
    return {"lmk_face_idx": np.arange(68), "lmk_b_coords": np.full((68, 3), 1.0 / 3.0)}


def make_landmark_npz(folder):
    np.savez(folder / "landmarks.npz", **embedding())
    return folder / "landmarks.npz", read_landmark_embedding


def make_landmark_pickle(folder):
    (folder / "landmarks.pkl").write_bytes(pickle.dumps(embedding(), 2))
    return folder / "landmarks.pkl", read_landmark_embedding


FORMATS = {
    "grmm": make_grmm,
    "weights": make_weights,
    "flame pickle 0": functools.partial(make_flame_pickle, 0),
    "flame pickle 2": functools.partial(make_flame_pickle, 2),
    "flame npz": make_flame_npz,
    "landmark npz": make_landmark_npz,
    "landmark pickle": make_landmark_pickle,
}


@pytest.mark.parametrize("name", [name for name in FORMATS if name != "flame pickle 0"])
def test_damaged_files_give_one_sentence(tmp_path, name):
    path, read = FORMATS[name](tmp_path)
    count = QUICK // LARGE if name.startswith("flame") else QUICK
    assert fuzz(read, path, count, seed=1).total() == count


@pytest.mark.slow
@pytest.mark.parametrize("name", FORMATS)
def test_many_damaged_files_give_one_sentence(tmp_path, name):
    path, read = FORMATS[name](tmp_path)
    count = MANY // LARGE if name.startswith("flame") else MANY
    start = time.perf_counter()
    outcomes = fuzz(read, path, count, seed=2)
    sys.stdout.write(f"\n{name}: {outcomes['refused']} refused, {outcomes['read']} read, {time.perf_counter() - start:.1f} s")
    assert outcomes.total() == count
    assert outcomes["refused"] > 0, "the mutations do nothing"
