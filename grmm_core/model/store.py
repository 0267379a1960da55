"""Trained models in memory: found by name or by an avatar's reference, loaded once, shared by their avatars.

What a model is made with, a `Loader` says: `torch_loader` for torch, `inference.loader` for numpy and onnxruntime. Called by
sessions, fitting and evaluation. Needs numpy only.
"""

from __future__ import annotations

import functools
import hashlib
import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np

from ..avatar import AssetReference, Avatar
from ..errors import FileAccessError, FileFormatError
from ..head import HeadModel, load_open_head, read_head
from ..splat.types import RasterOutput
from .config import GRMMConfig
from .inputs import InputSpace, ModelInputs
from .layout import TexelLayout
from .parameters import EXPRESSION_MAPS
from .renewed import carried_over
from .steps import Geometry, Mesh, Rest
from .weights_file import WEIGHTS_FOLDER, WEIGHTS_SUFFIX, WeightsInfo, read_info, resolve_weights, weights_path

AnyModel = TypeVar("AnyModel", bound="Model")
_log = logging.getLogger(__name__)


class Model(Protocol):
    """What a session asks of a model, whichever library computes it: `grmm.GRMM`, `inference.plain_model.PlainModel`."""

    config: GRMMConfig
    head_model: HeadModel
    z_id_size: int
    z_exp_size: int

    @property
    def gaussian_count(self) -> int:
        """Active texels N."""
        ...

    def input_space(self) -> InputSpace:
        """What persons and controls are added up in."""
        ...

    @property
    def layout(self) -> TexelLayout:
        """The Gaussians' texels."""
        ...

    def rest(self, shape: Any) -> Rest[Any]:
        """The shaped head before expression and pose, for coefficients [S]."""
        ...

    def mesh(self, inputs: ModelInputs[Any], rest: Rest[Any] | None = None) -> Mesh[Any]:
        """Posed mesh with the learned displacement, eq. 5-11."""
        ...

    def geometry(self, vertices: Any, offsets: Any) -> Geometry[Any]:
        """Place the Gaussians on posed vertices [V, 3] with offsets [N, 10] (eq. 12)."""
        ...

    def normals(self, vertices: Any) -> Any:
        """Outward unit normals of the mesh at the Gaussians' texels, [N, 3]."""
        ...

    def texels(self) -> np.ndarray:
        """Flat index row * grid + column of each Gaussian's texel, [N]."""
        ...

    def refine(self, raster: RasterOutput[Any], limits: Any = None, coarse: bool = False, cover: Any = None) -> Any:
        """Psi_ref (eq. 14) on a picture that was rasterised over black, [H, W, 3]; see `GRMM.refine`."""
        ...


Decoder = Callable[..., tuple[Any, ...]]
DECODERS = ("opacity", "appearance", "offsets", "expression_colors")


@dataclass(frozen=True)
class LoadedModel(Generic[AnyModel]):
    """A model ready for inference.

    Attributes:
        model: In evaluation mode on its device.
        info: What its weights file says.
        decoders: The model's methods named in `DECODERS`, as functions to tuples.
        shared: The weights without an avatar's own changes; None where there are none.
        space: What persons and controls are added up in.
    """

    model: AnyModel
    info: WeightsInfo
    decoders: Mapping[str, Decoder]
    shared: LoadedModel[AnyModel] | None = None
    space: InputSpace = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "space", self.model.input_space())

    @functools.cached_property
    def reach(self) -> float:
        """How far apart two training people's identity codes are, root mean square; infinite where fewer are known."""
        if len(self.info.people) < 2:
            return float("inf")
        return float(np.sqrt(2.0 * self.info.z_id.var(0, ddof=1).sum()))


class Loader(Protocol[AnyModel]):
    """Makes models of one library."""

    def load(self, path: Path, head: HeadModel | None) -> LoadedModel[AnyModel]:
        """Read weights; None as the head takes the open one. Raises `FileAccessError`, `FileFormatError`, `BackendError`."""
        ...

    def with_deltas(self, loaded: LoadedModel[AnyModel], deltas: Mapping[str, np.ndarray], path: Path) -> LoadedModel[AnyModel]:
        """Return a model with an avatar's changes; what is unchanged is shared. Raises `FileFormatError`."""
        ...


class ModelStore(Generic[AnyModel]):
    """Loads weights on demand and keeps them."""

    def __init__(
        self,
        weights: str | os.PathLike[str] | None,
        loader: Loader[AnyModel],
        head: str | os.PathLike[str] | None = None,
    ) -> None:
        """Remember which weights are the default; nothing is read yet.

        Args:
            weights: Name of installed weights, or a file; None for the embedded ones.
            loader: Makes the models.
            head: Head file for weights of another head model than the open one.
        """
        self._default_path = resolve_weights(weights)
        self.embedded = self._default_path == resolve_weights(None)
        self._head_path = None if head is None else Path(head)
        self._loader = loader
        self._models: dict[Path, LoadedModel[AnyModel]] = {}

    def default(self) -> LoadedModel[AnyModel]:
        """Return the default weights. Raises `FileAccessError`, `FileFormatError`."""
        if not self._default_path.exists():
            raise FileAccessError(
                f"The trained weights {self._default_path} are not installed; install them or choose other weights."
            )
        return self._load(self._default_path)

    def knows(self, avatar: Avatar) -> bool:
        """Whether the weights that an avatar was made for are installed."""
        return self._find(avatar.weights) is not None

    def for_avatar(self, avatar: Avatar, path: Path) -> LoadedModel[AnyModel]:
        """Return the model that an avatar was made for, with the avatar's own changes of the weights.

        Args:
            avatar: What was read.
            path: Its file, for messages.

        Raises:
            FileFormatError: The weights or the head model are not installed, or the codes do not fit them.
        """
        wanted = avatar.weights
        loaded = self._find(wanted)
        if loaded is None:
            raise FileFormatError(
                f"{path} needs the trained weights {wanted.name!r} ({wanted.sha256[:12] or 'any version'}), which are not "
                "installed; install them or make the avatar anew with the installed ones."
            )
        if not loaded.info.stands_on(avatar.head.sha256):
            raise FileFormatError(f"{path} belongs to another version of the head model {avatar.head.name!r}; make it anew.")
        model = loaded.model
        if model.config.residuals and (avatar.z_id.size, avatar.z_exp.size) != (model.z_id_size, model.z_exp_size):
            raise FileFormatError(f"The codes in {path} do not fit the weights {wanted.name!r}; make the avatar anew.")
        if not avatar.deltas:
            return loaded
        deltas = carried_over(avatar.deltas, wanted.sha256, loaded.info, model.layout, model.head_model)
        return self._loader.with_deltas(loaded, deltas, path)

    def _find(self, wanted: AssetReference) -> LoadedModel[AnyModel] | None:
        """Look for weights by hash: the default ones first, then installed ones of the same name, then all others."""
        own_name = Path(wanted.name).name == wanted.name  # a file may name anything; it must not lead out of the folder
        candidates = [self._default_path, *([weights_path(wanted.name)] if own_name else [])]
        candidates += sorted(WEIGHTS_FOLDER.glob(f"*{WEIGHTS_SUFFIX}")) if wanted.sha256 else []
        for candidate in dict.fromkeys(path for path in candidates if path.is_file()):
            if wanted.sha256:
                if self._hash(candidate) == wanted.sha256 or self._continues(candidate, wanted.sha256):
                    return self._load(candidate)
            elif self._load(candidate).info.name == wanted.name:
                return self._load(candidate)
        return None

    def _continues(self, path: Path, sha256: str) -> bool:
        try:
            return read_info(path).draws(sha256)
        except (FileAccessError, FileFormatError):  # who needs these weights will hear of it
            return False

    def _hash(self, path: Path) -> str:
        """Return the SHA-256 of a weights file; of one that is loaded, that of what was loaded."""
        if path in self._models:
            return self._models[path].info.sha256
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()

    def _head_of(self, path: Path) -> HeadModel | None:
        """Return the head model that weights ask for; None for the open head, and where the user named no other one."""
        if self._head_path is None or read_info(path).head_name == load_open_head().name:
            return None
        return read_head(self._head_path)

    def _load(self, path: Path) -> LoadedModel[AnyModel]:
        if path not in self._models:
            loaded = self._models[path] = self._loader.load(path, self._head_of(path))
            info, count = loaded.info, loaded.model.gaussian_count
            _log.info("loaded weights %s (%s), %d Gaussians", info.name, info.sha256[:12], count)
        return self._models[path]


def checked_deltas(
    deltas: Mapping[str, np.ndarray], shapes: Mapping[str, tuple[int, ...]], path: str | os.PathLike[str]
) -> dict[str, np.ndarray]:
    """Refuse changes of parameters that do not exist or have another shape. Raises `FileFormatError`.

    Weights that continue others may have more expression maps: those stay as they are.
    """
    found = dict(deltas)
    for name, delta in deltas.items():
        wanted = shapes.get(name)
        if name == EXPRESSION_MAPS and wanted is not None and delta.shape[1:] == wanted[1:] and len(delta) < wanted[0]:
            found[name] = np.pad(delta, ((0, wanted[0] - len(delta)), (0, 0)))
        elif wanted != delta.shape:
            raise FileFormatError(f"{path} changes the parameter {name[:80]!r}, which the weights do not have; make it anew.")
    return found
