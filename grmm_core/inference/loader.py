"""Trained models in numpy and onnxruntime, for `model.store.ModelStore`."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..model.parameters import mean_map_shapes, parameter_shapes
from ..model.store import Decoder, LoadedModel, checked_deltas
from ..model.weights_file import WeightsInfo, read_weights
from .plain_model import PlainModel

if TYPE_CHECKING:
    from ..head import HeadModel


class PlainLoader:
    """Loads models on the CPU.

    Args:
        threads: Threads of the networks; None leaves it to onnxruntime.
    """

    def __init__(self, threads: int | None = None) -> None:
        self._threads = threads

    def load(self, path: Path, head: HeadModel | None) -> LoadedModel[PlainModel]:
        """See `Loader.load`."""
        file = read_weights(path, head)
        return _loaded(PlainModel(file, self._threads), file.info)

    def with_deltas(
        self, loaded: LoadedModel[PlainModel], deltas: Mapping[str, np.ndarray], path: Path
    ) -> LoadedModel[PlainModel]:
        """See `Loader.with_deltas`."""
        model = loaded.model
        known = parameter_shapes(model.config, model.head_model, model.gaussian_count)
        deltas = checked_deltas(deltas, mean_map_shapes(model.config, model.gaussian_count) | known, path)
        return _loaded(model.changed(deltas), loaded.info, loaded)


def _loaded(model: PlainModel, info: WeightsInfo, shared: LoadedModel[PlainModel] | None = None) -> LoadedModel[PlainModel]:
    decoders: dict[str, Decoder] = {
        "opacity": lambda z_id: (model.opacity(z_id),),
        "appearance": model.appearance,
        "offsets": lambda z_id, z_exp: (model.offsets(z_id, z_exp),),
        "expression_colors": lambda z_id, z_exp: (model.expression_colors(z_id, z_exp),),
    }
    return LoadedModel(model, info, decoders, shared)
