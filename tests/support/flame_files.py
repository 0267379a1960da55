"""Files of exactly FLAME's structure with random content, since no real one may be shipped.

The classes below stand in for chumpy's: an instance pickles under chumpy's module path, with its value in the state.
"""

from __future__ import annotations

import io
import pickle
import struct
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, ClassVar

import numpy as np


@contextmanager
def chumpy_stand_in() -> Iterator[type]:
    """Provide a class that pickles as `chumpy.ch.Ch`, and as its attribute one that pickles as `chumpy.reordering.Select`."""

    class Ch:
        def __init__(self, value: np.ndarray) -> None:
            self.value = value

        def __getstate__(self) -> dict[str, Any]:
            return {"x": self.value, **bookkeeping}

    class Select:
        def __init__(self, value: Any, indices: np.ndarray, shape: tuple[int, ...]) -> None:
            self.terms = {"a": value, "idxs": indices, "preferred_shape": shape}

        def __getstate__(self) -> dict[str, Any]:
            return {**self.terms, **bookkeeping, "_cached_column_indices": None}

    # what chumpy's objects carry beside their value; the sets are the trap: pickles name them as a global
    bookkeeping = {
        "_dirty_vars": {"x"}, "_itr": None, "_make_dense": False, "_make_sparse": False, "_status": "new", "label": None,
        "_depends_on_deps": {"dr": {"deps": {"a", "idxs"}, "value": None, "out_of_date": True}},
    }  # fmt: skip
    Ch.__module__, Ch.__qualname__ = "chumpy.ch", "Ch"
    Select.__module__, Select.__qualname__ = "chumpy.reordering", "Select"
    Ch.Select = Select
    modules = {name: types.ModuleType(name) for name in ("chumpy", "chumpy.ch", "chumpy.reordering")}
    modules["chumpy.ch"].Ch, modules["chumpy.reordering"].Select = Ch, Select
    sys.modules.update(modules)
    try:
        yield Ch
    finally:
        for name in modules:
            del sys.modules[name]


def flame_fields(seed: int = 0) -> dict[str, np.ndarray]:
    """Arrays with FLAME's names, shapes and constraints; a bumpy sphere in place of the head."""
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(5023, 3))
    weights = rng.uniform(0.1, 1.0, (5023, 5))
    regressor = np.zeros((5, 5023))
    for joint in range(5):
        regressor[joint, rng.choice(5023, 8, replace=False)] = 1.0 / 8.0
    return {
        "v_template": 0.1 * directions / np.linalg.norm(directions, axis=1, keepdims=True),
        "f": rng.integers(0, 5023, (9976, 3)).astype(np.uint32),
        "shapedirs": rng.normal(0.0, 1e-3, (5023, 3, 400)),
        "posedirs": rng.normal(0.0, 1e-4, (5023, 3, 36)),
        "J_regressor": regressor,
        "kintree_table": np.array([[4294967295, 0, 1, 1, 1], [0, 1, 2, 3, 4]], np.int64),
        "weights": weights / weights.sum(1, keepdims=True),
    }


class Python2Pickler(pickle._Pickler):
    """Writes text and bytes as Python 2's strings, as the distributed files have them."""

    dispatch: ClassVar[dict[type, Any]] = dict(pickle._Pickler.dispatch)

    def save_string(self, text: str | bytes) -> None:
        raw = text.encode("latin1") if isinstance(text, str) else text
        if not self.bin:
            self.write(b"S" + repr(raw)[1:].encode() + b"\n")
        elif len(raw) < 256:
            self.write(b"U" + bytes([len(raw)]) + raw)
        else:
            self.write(b"T" + struct.pack("<i", len(raw)) + raw)
        self.memoize(text)

    dispatch[str] = dispatch[bytes] = save_string


def python2_pickle(value: Any, protocol: int) -> bytes:
    """The stream that Python 2 would have written, protocol 0 to 2."""
    stream = io.BytesIO()
    Python2Pickler(stream, protocol, fix_imports=True).dump(value)
    return stream.getvalue()


def write_flame_pickle(path: Path, fields: dict[str, np.ndarray], protocol: int = 2, python: int = 3) -> None:
    """Pickle as the distributed files are: chumpy arrays and a sparse regressor among plain arrays."""
    from scipy import sparse

    with chumpy_stand_in() as chumpy_array:
        stored: dict[str, Any] = dict(fields)
        for name in ("v_template", "shapedirs"):
            stored[name] = chumpy_array(fields[name])
        # SMPL's family cuts some arrays out of larger ones: chumpy keeps the source and the numbers
        every = np.arange(fields["posedirs"].size)
        stored["posedirs"] = chumpy_array.Select(chumpy_array(fields["posedirs"]), every, fields["posedirs"].shape)
        stored["J_regressor"] = sparse.csc_matrix(fields["J_regressor"])
        stored["bs_style"], stored["bs_type"] = "lbs", "lrotmin"
        path.write_bytes(python2_pickle(stored, protocol) if python == 2 else pickle.dumps(stored, protocol))
