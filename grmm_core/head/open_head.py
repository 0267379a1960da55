"""Reading the open head from its asset, and the relation of its shape space to age, gender, ethnicity and weight.

The asset is a tensor file written by `tools/open_head`. Directions are stored as integers with one scale per component: the
leading shape components and all expression components in 16 bits, the many small shape components in 8 bits (largest rounding
error 0.005 mm per unit). Needs numpy only.
"""

from __future__ import annotations

import functools
import json
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..errors import FileFormatError, ShapeError
from ..files.tensorfile import read_tensors
from .head_model import HeadModel

FORMAT = "grmm-head"
VERSION = 1
_LEAST_STD = 1e-3
ASSET = Path(__file__).resolve().parent.parent / "assets" / "open_head.safetensors"


@dataclass(frozen=True)
class PeopleModel:
    """What a person's age, gender, ethnicity, muscle and weight say about the shape coefficients.

    Attributes:
        names: age (years, 18 to 80), female, african, asian, caucasian, muscle, weight (all 0..1; the ethnicities sum to 1).
        mean: Mean of each over the people the shape space was made of, [M].
        std: Standard deviation of each, [M].
        macro_to_shape: Expected shape coefficients per unit of (macro - mean), [M, S].
        residual_std: Standard deviation of each coefficient among people of the same macros, [S].
    """

    names: tuple[str, ...]
    mean: np.ndarray
    std: np.ndarray
    macro_to_shape: np.ndarray
    residual_std: np.ndarray

    def macros(self, shape: np.ndarray) -> dict[str, float]:
        """What a person of shape coefficients [<=S] most probably is, by name; values may lie a little beyond their ranges.

        Of the 131 people of the embedded weights all are told women or men as they were drawn; their age by a correlation of
        0.81. The posterior mean of a linear model with normal noise.
        """
        known = np.zeros(self.macro_to_shape.shape[1])
        known[: len(shape)] = shape[: len(known)]
        weighed = self.macro_to_shape / np.maximum(self.residual_std, _LEAST_STD) ** 2
        spread = weighed @ self.macro_to_shape.T + np.diag(self.std**-2.0)
        found = self.mean + np.linalg.solve(spread, weighed @ known)
        return dict(zip(self.names, found.tolist(), strict=True))


@functools.lru_cache(maxsize=1)
def load_open_head() -> HeadModel:
    """Return the open head (read once; its arrays are read-only). Raises as `read_head_file`."""
    return read_head_file(ASSET)


@functools.lru_cache(maxsize=1)
def load_people_model() -> PeopleModel:
    """Return the open head's relation of macros and shape (read once). Raises as `read_head_file`."""
    tensors, metadata = _read(ASSET)
    try:
        return PeopleModel(
            tuple(json.loads(metadata["macro_names"])),
            *(tensors[f"macro_{name}"] for name in ("mean", "std", "to_shape", "residual_std")),
        )
    except (KeyError, ValueError, TypeError) as error:
        raise _corrupt(ASSET, error) from error


def read_head_file(path: str | os.PathLike[str]) -> HeadModel:
    """Read a head model of this project's format.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Corrupt, another format, or a version that is not known.
    """
    tensors, metadata = _read(path)
    try:
        regions = {name.partition(".")[2]: tensors[name] for name in tensors if name.startswith("region.")}
        head = HeadModel(
            name=metadata["name"],
            v_template=tensors["v_template"],
            faces=tensors["faces"],
            shape_dirs=np.concatenate([_dequantise(tensors, "shape_dirs_16"), _dequantise(tensors, "shape_dirs_8")], 2),
            expression_dirs=_dequantise(tensors, "expression_dirs_16"),
            posedirs=tensors.get("posedirs"),
            J_regressor=_dense(tensors, len(tensors["v_template"])),
            parents=tensors["parents"],
            weights=tensors["weights"],
            uv=tensors["uv"],
            uv_faces=tensors["uv_faces"].astype(np.int32),
            uv_islands=tensors["uv_islands"].astype(np.int32),
            regions=regions,
            shape_names=tuple(json.loads(metadata["shape_names"])),
            expression_names=tuple(json.loads(metadata["expression_names"])),
            expression_pose=tensors["expression_pose"],
            arkit_to_expression=tensors["arkit_to_expression"],
            landmarks68=_landmarks(tensors, "landmarks68"),
            landmarks478=_landmarks(tensors, "landmarks478"),
            continues=tuple(json.loads(metadata.get("continues", "[]"))),
        )
    except (KeyError, ValueError, TypeError, IndexError, ShapeError) as error:
        raise _corrupt(path, error) from error
    if not all(np.isfinite(array).all() for array in (head.v_template, head.shape_dirs, head.expression_dirs, head.weights)):
        raise _corrupt(path, "numbers that are not finite")
    return head


def _read(path: str | os.PathLike[str]) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    tensors, metadata = read_tensors(path)
    if metadata.get("format") != FORMAT:
        raise FileFormatError(f"{path} is not a head model; choose a head model file.")
    if metadata.get("version") != str(VERSION):
        raise FileFormatError(
            f"{path} is a head model of version {metadata.get('version')}, this program reads {VERSION}; update the add-on."
        )
    return tensors, metadata


def _dequantise(tensors: dict[str, np.ndarray], name: str) -> np.ndarray:
    """Integers [V, 3, K] times scales [K], float32."""
    return tensors[name] * tensors[f"{name}_scale"].astype(np.float32)


def _dense(tensors: dict[str, np.ndarray], count: int) -> np.ndarray:
    """The joint regressor [5, V] from its non-zero entries."""
    regressor = np.zeros((len(tensors["parents"]), count), np.float32)
    regressor[tensors["regressor_joint"], tensors["regressor_vertex"]] = tensors["regressor_weight"]
    return regressor


def _landmarks(tensors: dict[str, np.ndarray], name: str) -> tuple[np.ndarray, np.ndarray] | None:
    if f"{name}_faces" not in tensors:
        return None
    return tensors[f"{name}_faces"], tensors[f"{name}_barycentric"]


def _corrupt(path: str | os.PathLike[str], reason: object) -> FileFormatError:
    return FileFormatError(f"{path} is a damaged head model ({reason}); install the add-on again or rebuild the file.")
