"""Files of exactly FLAME's structure with random content, since no real one may be shipped.

The classes below stand in for chumpy's: an instance pickles under chumpy's module path, with its value in the state.
"""

from __future__ import annotations

import pickle
import sys
import types
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np


@contextmanager
def chumpy_stand_in() -> Iterator[type]:
    """Provide a class that pickles as `chumpy.ch.Ch`."""

    class Ch:
        def __init__(self, value: np.ndarray) -> None:
            self.value = value

        def __getstate__(self) -> dict[str, Any]:
            return {"x": self.value, "_dirty_vars": [], "label": None, "_status": "new"}

    Ch.__module__, Ch.__qualname__ = "chumpy.ch", "Ch"
    modules = {"chumpy": types.ModuleType("chumpy"), "chumpy.ch": types.ModuleType("chumpy.ch")}
    modules["chumpy.ch"].Ch = Ch
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


def write_flame_pickle(path: Path, fields: dict[str, np.ndarray], protocol: int = 2) -> None:
    """Pickle as the distributed files are: chumpy arrays and a sparse regressor among plain arrays."""
    from scipy import sparse

    with chumpy_stand_in() as chumpy_array:
        stored: dict[str, Any] = dict(fields)
        for name in ("v_template", "shapedirs"):
            stored[name] = chumpy_array(fields[name])
        stored["J_regressor"] = sparse.csc_matrix(fields["J_regressor"])
        stored["bs_style"], stored["bs_type"] = "lbs", "lrotmin"
        path.write_bytes(pickle.dumps(stored, protocol))
