"""Training of what expressions change, on top of trained weights: how faces look at rest stays.

For captures that show more expressions of people whom the weights know. Free are the expression codes, what the mesh decoder
and the decoder of offsets make of them, and the maps by which colors change with them. At rest, codes are zero: colors and
offsets are those of before to the last bit, and vertices within some hundredths of a millimetre. So avatars that were made on
the weights before can be drawn with the new ones (`model.weights_file.WeightsInfo.draws`). Used by `trainer`.
"""

from __future__ import annotations

import dataclasses
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
FREE = ("aligned_codes", "mesh_decoder.film.", "mesh_decoder.expression.", "decoders.expression.", _FIRST)


def of_the_weights(config: TrainConfig) -> TrainConfig:
    """The configuration with the model's sizes of the weights that it starts from, and its own number of expression maps.

    Raises:
        FileAccessError, FileFormatError: The weights are missing, damaged, or a checkpoint.
    """
    known = read_info(resolve_weights(config.init_from)).config
    maps = max(known.expression_maps, config.model.expression_maps)
    return dataclasses.replace(config, model=known.replace(expression_maps=maps))


def begin(config: TrainConfig, model: GRMM, source: ViewSource, codes: Tensor) -> dict[str, nn.Parameter]:
    """Load the weights that a run starts from, and leave only what expressions change to train.

    Args:
        config: With `init_from`.
        model: Overwritten, and frozen but for that.
        source: Views of people whom the weights do not know are left out.
        codes: [P, Z], overwritten.

    Returns:
        What is free, by name.

    Raises:
        ConfigError: The weights know nobody of the data, or have no expression codes.
        FileAccessError, FileFormatError: The weights are missing or damaged.
    """
    known = warm_start(config.init_from, model, source.people, codes)
    theirs = np.isin(source.subjects, [row for row, name in enumerate(source.people) if name in known])
    source.training = source.training[theirs[source.training]]
    if not len(source.training) or model.aligned_codes is None:
        raise ConfigError(f"The weights {config.init_from!r} know nobody of this data; capture with their seed.")
    model.requires_grad_(False)
    free = {name: value for name, value in model.named_parameters() if name.startswith(FREE)}
    for value in free.values():
        value.requires_grad_(True)
    if _FIRST in free:
        free[_FIRST].register_hook(_of_expressions(model.z_id_size))
    return free


def continued(config: TrainConfig, head: HeadModel, provenance: dict[str, Any]) -> WeightsInfo:
    """What a file of the new weights says: people and tables of those that the run began with, which it continues."""
    info = read_weights(resolve_weights(config.init_from), head).info
    provenance = {**info.provenance, **provenance, "continues": [info.sha256, *info.continued]}
    return dataclasses.replace(info, name=config.name, provenance=provenance)


def _of_expressions(z_id: int) -> Any:
    """A gradient without its columns that read z_id."""

    def masked(gradient: Tensor) -> Tensor:
        return torch.cat([torch.zeros_like(gradient[:, :z_id]), gradient[:, z_id:]], 1)

    return masked
