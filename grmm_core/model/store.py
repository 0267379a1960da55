"""Trained models in memory: found by name or by an avatar's reference, loaded once, shared by their avatars.

Called by sessions, fitting and evaluation. Imports torch.
"""

from __future__ import annotations

import copy
import functools
import hashlib
import logging
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch

from ..avatar import AssetReference, Avatar
from ..compute.graphs import Replayed
from ..errors import BackendError, FileAccessError, FileFormatError
from ..head import HeadModel, load_open_head, read_head
from .config import COLOR_CHANNELS, TRANSFORM_CHANNELS
from .grmm import GRMM
from .inputs import InputSpace
from .weights import load_weights
from .weights_file import WEIGHTS_FOLDER, WEIGHTS_SUFFIX, WeightsInfo, read_info, resolve_weights, weights_path

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class LoadedModel:
    """A model ready for inference.

    Attributes:
        model: In evaluation mode on its device.
        info: What its weights file says.
        space: What persons and controls are added up in.
        shared: The weights without an avatar's own changes; None where there are none.
        opacity, appearance, offsets, tint: The model's decoders as functions to tuples of tensors, replayed on a graphics card;
            the tint is `GRMM.expression_colors`.
    """

    model: GRMM
    info: WeightsInfo
    shared: LoadedModel | None = None
    space: InputSpace = field(init=False, repr=False)
    opacity: Replayed = field(init=False, repr=False)
    appearance: Replayed = field(init=False, repr=False)
    offsets: Replayed = field(init=False, repr=False)
    tint: Replayed = field(init=False, repr=False)

    def __post_init__(self) -> None:
        model = self.model
        object.__setattr__(self, "space", model.input_space())
        object.__setattr__(self, "opacity", Replayed(lambda z_id: (model.opacity(z_id),)))
        object.__setattr__(self, "appearance", Replayed(lambda z_id, view: model.appearance(z_id, view)))
        object.__setattr__(self, "offsets", Replayed(lambda z_id, z_exp: (model.offsets(z_id, z_exp),)))
        object.__setattr__(self, "tint", Replayed(lambda z_id, z_exp: (model.expression_colors(z_id, z_exp),)))

    @functools.cached_property
    def reach(self) -> float:
        """How far apart two training people's identity codes are, root mean square; infinite where fewer are known."""
        if len(self.info.people) < 2:
            return float("inf")
        return float(np.sqrt(2.0 * self.info.z_id.var(0, ddof=1).sum()))


class ModelStore:
    """Loads weights on demand and keeps them."""

    def __init__(
        self, weights: str | os.PathLike[str] | None, device: torch.device, head: str | os.PathLike[str] | None = None
    ) -> None:
        """Remember which weights are the default; nothing is read yet.

        Args:
            weights: Name of installed weights, or a file; None for the embedded ones.
            device: Where models go.
            head: Head file for weights of another head model than the open one.
        """
        self._default_path = resolve_weights(weights)
        self.embedded = self._default_path == resolve_weights(None)
        self._head_path = None if head is None else Path(head)
        self._device = device
        self._models: dict[Path, LoadedModel] = {}

    def default(self) -> LoadedModel:
        """Return the default weights. Raises `FileAccessError`, `FileFormatError`."""
        if not self._default_path.exists():
            raise FileAccessError(
                f"The trained weights {self._default_path} are not installed; install them or choose other weights."
            )
        return self._load(self._default_path)

    def for_avatar(self, avatar: Avatar, path: Path) -> LoadedModel:
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
        if avatar.head.sha256 and avatar.head.sha256 != loaded.info.head_sha256:
            raise FileFormatError(f"{path} belongs to another version of the head model {avatar.head.name!r}; make it anew.")
        model = loaded.model
        if model.config.residuals and (avatar.z_id.size, avatar.z_exp.size) != (model.z_id_size, model.z_exp_size):
            raise FileFormatError(f"The codes in {path} do not fit the weights {wanted.name!r}; make the avatar anew.")
        if not avatar.deltas:
            return loaded
        return LoadedModel(with_deltas(model, avatar.deltas, path), loaded.info, loaded)

    def _find(self, wanted: AssetReference) -> LoadedModel | None:
        """Look for weights by hash: the default ones first, then installed ones of the same name, then all others."""
        own_name = Path(wanted.name).name == wanted.name  # a file may name anything; it must not lead out of the folder
        candidates = [self._default_path, *([weights_path(wanted.name)] if own_name else [])]
        candidates += sorted(WEIGHTS_FOLDER.glob(f"*{WEIGHTS_SUFFIX}")) if wanted.sha256 else []
        for candidate in dict.fromkeys(path for path in candidates if path.is_file()):
            if wanted.sha256:
                if self._hash(candidate) == wanted.sha256:
                    return self._load(candidate)
            elif self._load(candidate).info.name == wanted.name:
                return self._load(candidate)
        return None

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

    def _load(self, path: Path) -> LoadedModel:
        if path not in self._models:
            model, info = load_weights(path, self._head_of(path))
            model.requires_grad_(False)
            try:
                model.to(self._device)
            except RuntimeError as error:  # torch's only type for a device that is broken or full
                reason = first_line(error)
                raise BackendError(f"The device {self._device} cannot hold the model ({reason}); use cpu.") from error
            # For the convolutions of a card that has bfloat16 units; not measured on CPUs, whose path stays in float32.
            model.half_refinement = self._device.type == "cuda" and torch.cuda.is_bf16_supported()
            self._models[path] = LoadedModel(model, info)
            _log.info("loaded weights %s (%s), %d Gaussians", info.name, info.sha256[:12], model.gaussian_count)
        return self._models[path]


def with_deltas(model: GRMM, deltas: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> GRMM:
    """Return a copy of a model with an avatar's changes added; everything unchanged is shared (eq. 20's result).

    Args:
        model: Of the weights that the avatar was made with; it is returned itself where there are no changes.
        deltas: `Avatar.deltas`.
        path: The avatar's file, for messages.

    Raises:
        FileFormatError: A parameter is unknown or of another shape.
    """
    if not deltas:
        return model
    parameters = dict(model.named_parameters())
    maps = _absent_maps(model)
    for name, delta in deltas.items():
        shape = tuple(parameters[name].shape) if name in parameters else maps.get(name)
        if shape != delta.shape:
            raise FileFormatError(f"{path} changes the parameter {name[:80]!r}, which the weights do not have; make it anew.")
    memo: dict[int, object] = {id(value): value for name, value in parameters.items() if name not in deltas}
    memo |= {id(value): value for value in model.buffers()}
    memo[id(model.head_model)] = model.head_model
    changed = copy.deepcopy(model, memo)
    for name in deltas:
        if name in maps:  # the paper's form has no mean maps; an avatar may still bring its own
            empty = torch.zeros(maps[name], dtype=model.dtype, device=model.device)
            setattr(changed.decoders, name.rpartition(".")[2], torch.nn.Parameter(empty, requires_grad=False))
    with torch.no_grad():
        for name, value in changed.named_parameters():
            if name in deltas:
                value.add_(torch.tensor(deltas[name], dtype=value.dtype, device=value.device))
    return changed


def _absent_maps(model: GRMM) -> dict[str, tuple[int, int]]:
    """Mean maps that the model's configuration leaves out, by parameter name, with the shapes they would have."""
    config = model.config
    widths = {"transform": TRANSFORM_CHANNELS, "opacity": 1, "appearance": COLOR_CHANNELS + config.features}
    count = model.gaussian_count
    return {} if config.mean_maps else {f"decoders.{name}_mean": (count, width) for name, width in widths.items()}


def first_line(error: BaseException) -> str:
    """Return the first line of a library's message, without its final full stop."""
    text = str(error).strip() or type(error).__name__
    return text.splitlines()[0].rstrip(".")
