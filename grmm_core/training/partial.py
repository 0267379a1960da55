"""Training of a part of trained weights, on captures of people whom they know; everything else stays.

*What expressions change*: free are the expression codes, what the mesh decoder and the decoder of offsets make of them, and the
maps by which colors change with them. At rest, codes are zero: colors and offsets are those of before to the last bit, and
vertices within some hundredths of a millimetre.

*What lies in some regions of the head*, such as teeth: free are the mean, basis and expression maps of the Gaussians there;
networks, codes and every other Gaussian stay, but for those that share a block of eight bits with them in the file
(`files.packing`): these move by its rounding.

Avatars that were made on the weights before can be drawn with the new ones (`model.weights_file.WeightsInfo.draws`,
`model.renewed`). Used by `trainer`.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from ..errors import ConfigError
from ..model.weights_file import WeightsInfo, read_info, read_weights, resolve_weights
from .warm_start import warm_start

if TYPE_CHECKING:
    from ..head import HeadModel
    from ..model.grmm import GRMM
    from .config import TrainConfig
    from .views import ViewSource

_FIRST = "decoders.transform.first.weight"  # reads z_id and z_exp
OF_EXPRESSIONS = ("aligned_codes", "mesh_decoder.film.", "mesh_decoder.expression.", "decoders.expression.", _FIRST)
_MEAN_MAPS = ("decoders.transform_mean", "decoders.opacity_mean", "decoders.appearance_mean")
_OTHER_MAPS = ("decoders.basis.", "decoders.expression.maps")
OF_REGIONS = (*_MEAN_MAPS, *_OTHER_MAPS)


def of_the_weights(config: TrainConfig) -> TrainConfig:
    """The configuration with the model's sizes of the weights that it starts from, and its own number of expression maps.

    Raises:
        FileAccessError, FileFormatError: The weights are missing, damaged, or a checkpoint.
    """
    known = read_info(resolve_weights(config.init_from)).config
    maps = max(known.expression_maps, config.model.expression_maps)
    return dataclasses.replace(config, model=known.replace(expression_maps=maps))


def begin(config: TrainConfig, model: GRMM, source: ViewSource, codes: Tensor) -> dict[str, nn.Parameter]:
    """Load the weights that a run starts from, and leave only its part to train.

    Args:
        config: With `init_from`, and `expressions` or `regions`.
        model: Overwritten, and frozen but for that part.
        source: Views of people whom the weights do not know are left out.
        codes: [P, Z], overwritten.

    Returns:
        What is free, by name.

    Raises:
        ConfigError: The weights know nobody of the data, or have no expression codes or maps, or the head no such region.
        FileAccessError, FileFormatError: The weights are missing or damaged.
    """
    known = warm_start(config.init_from, model, source.people, codes)
    theirs = np.isin(source.subjects, [row for row, name in enumerate(source.people) if name in known])
    source.training = source.training[theirs[source.training]]
    if not len(source.training) or (config.expressions and model.aligned_codes is None):
        raise ConfigError(f"The weights {config.init_from!r} know nobody of this data; capture with their seed.")
    model.requires_grad_(False)
    part = OF_EXPRESSIONS if config.expressions else OF_REGIONS
    free = {name: value for name, value in model.named_parameters() if name.startswith(part)}
    if not free:
        raise ConfigError(f"The weights {config.init_from!r} have no maps of their own that a region could be trained in.")
    for value in free.values():
        value.requires_grad_(True)
    if config.expressions:
        if _FIRST in free:
            free[_FIRST].register_hook(_of_expressions(model.z_id_size))
        return free
    inside = torch.from_numpy(texels_of(model, config.region_names).astype(np.float32)).to(model.device)
    for name, value in free.items():
        value.register_hook(_of_rows(inside) if name in _MEAN_MAPS else _of_columns(inside))
    return free


def texels_of(model: GRMM, regions: Sequence[str]) -> np.ndarray:
    """Which Gaussians lie in regions of the head, [N] bool. Raises `ConfigError` for a region that the head has not."""
    head = model.head_model
    for name in regions:
        if not head.marked(name).any():
            raise ConfigError(f"The head has no region named {name!r}; there are {', '.join(sorted(head.regions))}.")
    return model.layout.within(head, *regions)


def continued(config: TrainConfig, head: HeadModel, provenance: dict[str, Any]) -> WeightsInfo:
    """What a file of the new weights says: people and tables of those that the run began with, which it continues."""
    info = read_weights(resolve_weights(config.init_from), head).info
    before = [info.sha256, *info.continued]
    renewed = {sha256: sorted({*info.renewed_since(sha256), *config.region_names}) for sha256 in before}
    provenance = {**info.provenance, **provenance, "continues": before, "renewed": renewed}
    return dataclasses.replace(info, name=config.name, provenance=provenance)


def _of_expressions(z_id: int) -> Callable[[Tensor], Tensor]:
    """A gradient without its columns that read z_id."""

    def masked(gradient: Tensor) -> Tensor:
        return torch.cat([torch.zeros_like(gradient[:, :z_id]), gradient[:, z_id:]], 1)

    return masked


def _of_rows(inside: Tensor) -> Callable[[Tensor], Tensor]:
    """A gradient [N, C] of the Gaussians inside [N] alone."""
    return lambda gradient: gradient * inside[:, None]


def _of_columns(inside: Tensor) -> Callable[[Tensor], Tensor]:
    """A gradient [K, N * C] of the Gaussians inside [N] alone."""
    return lambda gradient: (gradient.unflatten(1, (len(inside), -1)) * inside[:, None]).flatten(1)
