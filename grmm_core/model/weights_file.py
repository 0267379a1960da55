"""Weights files: a tensor file with the configuration, the head they belong to, the training people and the provenance.

Parameters are stored in half precision, basis maps in eight bits (`files.packing`), the texel layout exactly. Files are read
with numpy (`tensorfile`), never unpickled, and everything in them is checked against the configuration before memory is
allocated on their word. Version 1 had basis maps in half precision; it is read as well. Needs numpy only.

Used by `weights`, which makes a torch model of a file, and by inference without torch.
"""

from __future__ import annotations

import functools
import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import ConfigError, FileFormatError, ShapeError
from ..files.packing import pack, scales_shape
from ..files.tensorfile import read_metadata, read_tensors, write_tensors
from .config import GRMMConfig
from .layout import TexelLayout
from .parameters import code_sizes, parameter_shapes

if TYPE_CHECKING:
    from ..head import HeadModel

FORMAT = "grmm-weights"
VERSION = 2
READABLE = (1, 2)
WEIGHTS_FOLDER = Path(__file__).resolve().parent.parent / "assets" / "weights"
DEFAULT_WEIGHTS = "default"
WEIGHTS_SUFFIX = ".safetensors"
_METADATA_KEY = "grmm"
_MODEL = "model/"
_EXACT = ("anchor.",)  # parameters and buffers that are not rounded to half precision
_PACKED = ("decoders.basis.", "decoders.expression.maps")
_SCALES = ".scales"  # after the name of a packed parameter
_LAYOUT, _LAYOUT_UV = ("anchor.texel", "anchor.face", "anchor.barycentric"), "anchor.uv"
_TABLES = ("z_id", "shapes", "default_z_id", "default_shape")  # of the training people
_HALF_MAX = float(np.finfo(np.float16).max)


@dataclass(frozen=True)
class WeightsInfo:
    """What a weights file says besides the parameters.

    Attributes:
        name: Display name, such as "default".
        head_name, head_sha256: Head model that the weights are drawn on, with its `head_fingerprint`: of a file that was
            trained on an earlier form of the head, the form that continues it (`HeadModel.continues`).
        earlier_heads: Fingerprints of the forms that this head continues.
        config: Sizes.
        sha256: Hash of the file's content; empty before it is saved.
        people: Names of the training people.
        z_id: Their identity codes, [P, Z].
        shapes: Their shape coefficients, [P, S].
        default_z_id, default_shape: The default avatar, [Z] and [S].
        provenance: Data, command, seed, hours, measured quality: JSON values. "continues" lists the hashes of weights whose
            people and faces at rest these have: avatars made on them open with these. "renewed" lists by such a hash the
            regions of the head that were trained anew since.
    """

    name: str
    head_name: str
    head_sha256: str
    config: GRMMConfig
    sha256: str = ""
    people: tuple[str, ...] = ()
    z_id: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    shapes: np.ndarray = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    default_z_id: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    default_shape: np.ndarray = field(default_factory=lambda: np.zeros(0, np.float32))
    provenance: Mapping[str, Any] = field(default_factory=dict)
    earlier_heads: tuple[str, ...] = ()

    @property
    def continued(self) -> tuple[str, ...]:
        """Hashes of the weights that these continue."""
        found = self.provenance.get("continues")
        return tuple(one for one in found if isinstance(one, str)) if isinstance(found, list) else ()

    def renewed_since(self, sha256: str) -> tuple[str, ...]:
        """Regions of the head whose Gaussians were trained anew since the weights of a hash."""
        known = self.provenance.get("renewed")
        found = known.get(sha256) if isinstance(known, dict) else None
        return tuple(one for one in found if isinstance(one, str)) if isinstance(found, list) else ()

    def stands_on(self, head_sha256: str) -> bool:
        """Whether what was made on a head of a fingerprint fits the head of these weights; "" says nothing and fits."""
        return head_sha256 in ("", self.head_sha256, *self.earlier_heads)

    def draws(self, sha256: str) -> bool:
        """Whether avatars that were made on weights of a hash can be drawn with these."""
        return bool(sha256) and sha256 in (self.sha256, *self.continued)


def weights_path(name: str = DEFAULT_WEIGHTS) -> Path:
    """Return the path of weights that come with the package."""
    return WEIGHTS_FOLDER / f"{name}{WEIGHTS_SUFFIX}"


def resolve_weights(weights: str | os.PathLike[str] | None) -> Path:
    """Return the path of weights given by name or as a file name; the file may be missing."""
    if weights is None:
        return weights_path(DEFAULT_WEIGHTS)
    path = Path(weights)
    if path.suffix == WEIGHTS_SUFFIX or path.name != os.fspath(weights):
        return path.absolute()
    return weights_path(os.fspath(weights))


@functools.lru_cache(maxsize=4)
def head_fingerprint(head: HeadModel) -> str:
    """Hash of what trained weights depend on in a head model: names, mesh, UV map, shape and expression directions."""
    digest = hashlib.sha256(head.name.encode())
    for array in (head.v_template, head.faces, head.uv, head.uv_faces, head.shape_dirs, head.expression_dirs):
        digest.update(str((array.shape, array.dtype.str)).encode())
        digest.update(np.ascontiguousarray(array).data)
    return digest.hexdigest()


def write_weights(
    path: str | os.PathLike[str], parameters: Mapping[str, np.ndarray], config: GRMMConfig, head: HeadModel, info: WeightsInfo
) -> None:
    """Write parameters by name and their information; head and configuration are those given, not those of `info`.

    Raises:
        ShapeError: A parameter is not finite or too large for half precision.
        FileAccessError: The file cannot be written; an earlier one stays as it was.
    """
    tensors: dict[str, np.ndarray] = {}
    for name, array in parameters.items():
        if array.dtype.kind == "f" and not name.startswith(_EXACT):
            if not np.isfinite(array).all() or np.abs(array).max(initial=0.0) > _HALF_MAX:
                raise ShapeError(f"The parameter {name} is not finite or too large to store; go back to an earlier checkpoint.")
            if name.startswith(_PACKED):
                array, tensors[_MODEL + name + _SCALES] = pack(array)
            else:
                array = array.astype(np.float16)
        tensors[_MODEL + name] = array
    for name in _TABLES:
        array = np.asarray(getattr(info, name), np.float32)
        if not np.isfinite(array).all():
            raise ShapeError(f"The weights' {name} holds numbers that are not finite; go back to an earlier checkpoint.")
        tensors[f"people/{name}"] = array
    header = {
        "format": FORMAT,
        "version": VERSION,
        "name": info.name,
        "config": json.loads(config.to_json()),
        "head": {"name": head.name, "sha256": head_fingerprint(head)},
        "people": list(info.people),
        "provenance": dict(info.provenance),
    }
    write_tensors(path, tensors, {_METADATA_KEY: json.dumps(header, sort_keys=True)})


def read_info(path: str | os.PathLike[str]) -> WeightsInfo:
    """Read name, head, configuration and provenance without the arrays (they are empty). Raises as `load_weights`."""
    return _info(path, _header(path, read_metadata(path)), "")


@dataclass(frozen=True)
class WeightsFile:
    """What a file holds, checked.

    Attributes:
        info: Name, configuration, people.
        head: Head model that it belongs to.
        layout: Active texels.
        arrays: Parameters by name, float32.
        packed: Basis maps as they are stored: whole numbers [K, M] int8 and scales of blocks [K, B] float32 (`files.packing`).
    """

    info: WeightsInfo
    head: HeadModel
    layout: TexelLayout
    arrays: Mapping[str, np.ndarray]
    packed: Mapping[str, tuple[np.ndarray, np.ndarray]]


def read_weights(path: str | os.PathLike[str], head: HeadModel | None = None) -> WeightsFile:
    """Read and check a file.

    Args:
        path: Weights file.
        head: Head model that the weights belong to; None takes the open head where the file asks for it.

    Raises:
        FileAccessError: Missing or unreadable.
        FileFormatError: Damaged, of another format or version, for another head model, or with parameters that are missing,
            of another shape or not finite.
    """
    tensors, metadata = read_tensors(path)
    header = _header(path, metadata)
    info = _info(path, header, _hash(path))
    if head is None:
        head = _own_head(path, info.head_name)
    fingerprint = head_fingerprint(head)
    if info.head_sha256 not in (fingerprint, *head.continues):
        raise FileFormatError(
            f"{path} was trained on another version of the head model {info.head_name!r}; get weights for the installed one."
        )
    stored = {name[len(_MODEL):]: array for name, array in tensors.items() if name.startswith(_MODEL)}  # fmt: skip
    layout = _layout(path, stored, info.config, head)
    arrays: dict[str, np.ndarray] = {}
    packed: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, shape in parameter_shapes(info.config, head, len(layout)).items():
        if name not in stored:
            raise _damaged(path, f"the parameter {name} is missing")
        array = stored[name]
        if array.shape != shape:
            raise _damaged(path, f"the parameter {name} has shape {array.shape} instead of {shape}")
        if array.dtype == np.int8 and name.startswith(_PACKED):
            packed[name] = array, _checked_scales(path, name, array, stored.get(name + _SCALES))
        elif array.dtype.kind == "f":
            array = array.astype(np.float32, copy=False)
            if not np.isfinite(array).all():
                raise _damaged(path, f"the parameter {name} holds numbers that are not finite")
            arrays[name] = array
        elif name not in _LAYOUT:
            raise _damaged(path, f"the parameter {name} has data type {array.dtype}")
    info = replace(info, head_sha256=fingerprint, earlier_heads=head.continues, **_people(path, info, tensors, head))
    return WeightsFile(info, head, layout, arrays, packed)


def _checked_scales(path: str | os.PathLike[str], name: str, whole: np.ndarray, scales: np.ndarray | None) -> np.ndarray:
    usable = scales is not None and scales.dtype == np.float16 and scales.shape == scales_shape(whole.shape)
    if scales is None or not usable or not np.isfinite(scales).all():
        raise _damaged(path, f"the scales of the parameter {name} are missing, not finite or of another shape")
    return scales.astype(np.float32)


def _header(path: str | os.PathLike[str], metadata: Mapping[str, str]) -> dict[str, Any]:
    try:
        header = json.loads(metadata.get(_METADATA_KEY, ""))
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path} is not a GRMM weights file; choose one that `grmm train` wrote.") from error
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise FileFormatError(f"{path} is not a GRMM weights file; choose one that `grmm train` wrote.")
    version = header.get("version")
    if version not in READABLE:
        raise FileFormatError(f"{path} has version {version!r}, this program reads 1 to {VERSION}; update one of them.")
    return header


def _info(path: str | os.PathLike[str], header: Mapping[str, Any], sha256: str) -> WeightsInfo:
    head, people, provenance = header.get("head"), header.get("people"), header.get("provenance")
    if not isinstance(head, dict) or not all(isinstance(head.get(key), str) for key in ("name", "sha256")):
        raise _damaged(path, "its description is incomplete")
    if not isinstance(people, list) or not all(isinstance(p, str) for p in people):
        raise _damaged(path, "its description is incomplete")
    if not isinstance(header.get("name"), str) or not isinstance(provenance, dict):
        raise _damaged(path, "its description is incomplete")
    try:
        config = GRMMConfig.from_dict(header.get("config"))  # type: ignore[arg-type]  # checked there
    except (ConfigError, TypeError) as error:
        raise _damaged(path, f"its configuration cannot be used: {error}") from error
    return WeightsInfo(
        header["name"], head["name"], head["sha256"], config, sha256, people=tuple(people), provenance=provenance
    )


def _layout(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray], config: GRMMConfig, head: HeadModel) -> TexelLayout:
    """Check the stored texels, whose indices are used without further checks."""
    try:
        texel, face, barycentric = (arrays[name] for name in _LAYOUT)
        uv = arrays[_LAYOUT_UV] if config.focus else head.uv
    except KeyError as error:
        raise _damaged(path, f"the parameter {error.args[0]} is missing") from error
    count = len(texel) if texel.ndim == 1 else 0
    fits = (
        count > 0
        and texel.dtype == np.int32 and face.dtype == np.int32 and barycentric.dtype == np.float32
        and face.shape == (count,) and barycentric.shape == (count, 3)
        and texel.min() >= 0 and texel.max() < config.grid**2 and bool((np.diff(texel) > 0).all())
        and face.min() >= 0 and face.max() < len(head.uv_faces)
        and bool(np.isfinite(barycentric).all())
        and uv.shape == head.uv.shape and uv.dtype.kind == "f" and bool(np.isfinite(uv).all())
    )  # fmt: skip
    if not fits:
        raise _damaged(path, "its texel layout does not fit the head model")
    return TexelLayout(config.grid, texel, face, barycentric, uv)


def _people(
    path: str | os.PathLike[str], info: WeightsInfo, tensors: Mapping[str, np.ndarray], head: HeadModel
) -> dict[str, Any]:
    count, shape_size, z_id_size = len(info.people), head.shape_dirs.shape[-1], code_sizes(info.config, head)[0]
    expected = {
        "z_id": (count, z_id_size), "shapes": (count, shape_size),
        "default_z_id": (z_id_size,), "default_shape": (shape_size,),
    }  # fmt: skip
    arrays: dict[str, np.ndarray] = {}
    for name, shape in expected.items():
        array = tensors.get(f"people/{name}")
        if array is None or array.shape != shape or array.dtype.kind != "f" or not np.isfinite(array).all():
            raise _damaged(path, f"the table people/{name} is missing, not finite or of another shape than {shape}")
        arrays[name] = array.astype(np.float32)
    return arrays


def _own_head(path: str | os.PathLike[str], name: str) -> HeadModel:
    from ..head import load_open_head

    head = load_open_head()
    if head.name != name:
        raise FileFormatError(f"{path} was trained on the head model {name!r}; give the file of that head model (--head).")
    return head


def _hash(path: str | os.PathLike[str]) -> str:
    with Path(path).open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _damaged(path: str | os.PathLike[str], reason: str) -> FileFormatError:
    return FileFormatError(f"{path} is not usable ({reason}); get the weights again from where they came from.")
