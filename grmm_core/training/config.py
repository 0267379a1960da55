"""Training configurations: model sizes, schedule and loss weights, read from TOML.

A file has the tables ``[model]`` (``preset`` and any field of `GRMMConfig`), ``[training]`` (fields of `TrainConfig`) and
``[losses]`` (fields of `LossWeights`). Those of the project are in the folder ``configs`` beside this file.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import ConfigError, FileAccessError
from ..files.access import read_bytes
from ..model.config import PRESETS, GRMMConfig
from .losses import LossWeights

CONFIG_FOLDER = Path(__file__).resolve().parent / "configs"
PRECISIONS = ("float32", "bfloat16")
_MAX_FILE_BYTES = 1 << 20
# what a resumed run may change without becoming another one: when it ends, what it uses, what it shows
_FREE = {
    "minutes", "threads", "checkpoint_every", "preview_every", "evaluate_every", "evaluate_views", "refresh_every",
    "tensorboard", "name",
}  # fmt: skip


@dataclass(frozen=True)
class TrainConfig:
    """One training run.

    Progress p runs from 0 to 1: by steps, or by time when `minutes` is set.

    Attributes:
        model: Sizes.
        losses: Factors by name, see `LossWeights`.
        name: Of the weights.
        steps: Optimiser steps of the schedule.
        minutes: If above 0, the schedule follows the time spent instead, so that a run ends when it must.
        seed: Of initial weights, views, crops, backgrounds.
        views_per_step: Pictures whose gradients are averaged before a step, over all processes.
        image_size: Longer side in pixels to which pictures are reduced; 0 keeps them.
        half_until: Progress up to which pictures are halved once more.
        refine_from: Progress from which the refinement network takes part.
        crop_size: Side of square crops in pixels; 0 for none.
        margin: Pixels kept around the person; views are cut to that. 0 keeps them whole.
        crop_share: Share of the steps that use a crop.
        lr_networks, lr_maps, lr_codes: Peak learning rates of convolutions and linear layers, of mean and basis maps, of codes.
        lr_offsets: Of the mean and basis maps of position, rotation and scale; 0: as the other maps. At the colors' rate
            Gaussians wander off the surface before the colors have settled.
        lr_end: Factor of the learning rates at the end of the cosine.
        warmup_steps: Steps of linear growth.
        beta1, beta2: Of Adam.
        clip_norm: Largest norm of the whole gradient.
        ema: Decay of the moving average a step; 0 for none.
        ema_every: Steps between its updates.
        code_init: Standard deviation of identity codes before training.
        checkpoint_every, preview_every, evaluate_every: Steps; 0 for never.
        refresh_every: Steps between looks for new shots of a capture that is still running; 0 for never.
        evaluate_views: Held-out views in an evaluation.
        threads: Of torch; 0 leaves its choice.
        precision: float32, or bfloat16 for the convolutions, see `precision`.
        bare: Train on the pictures without hair, where the capture has them; the model is `hairless` then unless it says else.
        person: Name of the one person to train for: only that person's own maps change, see `personal`; needs `init_from`.
        expressions: Train only what expressions change, see `partial`; needs `init_from`.
        regions: Train only the Gaussians of these regions of the head, names with commas, see `partial`; needs `init_from`.
        init_from: Weights file or checkpoint whose networks, maps and expression codes a new run starts from, see `warm_start`.
        perceptual_network: See `perceptual.load_perceptual`; needed where the perceptual loss counts.
        tensorboard: Also write curves for TensorBoard into the run's folder.
    """

    model: GRMMConfig
    losses: Mapping[str, float] = field(default_factory=dict)
    name: str = "default"
    steps: int = 10000
    minutes: float = 0.0
    seed: int = 0
    views_per_step: int = 1
    image_size: int = 0
    half_until: float = 0.0
    refine_from: float = 0.0
    crop_size: int = 0
    crop_share: float = 0.0
    margin: int = 0
    lr_networks: float = 1.5e-3
    lr_maps: float = 5e-3
    lr_codes: float = 3e-3
    lr_offsets: float = 0.0
    lr_end: float = 0.02
    warmup_steps: int = 50
    beta1: float = 0.9
    beta2: float = 0.99
    clip_norm: float = 1.0
    ema: float = 0.999
    ema_every: int = 8
    code_init: float = 0.1
    checkpoint_every: int = 500
    preview_every: int = 500
    evaluate_every: int = 1000
    evaluate_views: int = 16
    refresh_every: int = 0
    threads: int = 0
    precision: str = "float32"
    bare: bool = False
    person: str = ""
    expressions: bool = False
    regions: str = ""
    init_from: str = ""
    perceptual_network: str = ""
    tensorboard: bool = False

    def __post_init__(self) -> None:
        """Check ranges. Raises `ConfigError`."""
        shares = ("half_until", "refine_from", "crop_share", "lr_end", "ema", "beta1", "beta2")
        for name in shares:
            if not 0.0 <= getattr(self, name) <= 1.0:
                raise ConfigError(f"The training setting {name} is {getattr(self, name)}; it must be from 0 to 1.")
        for f in dataclasses.fields(self):
            value = getattr(self, f.name)
            if f.type in ("int", "float") and not (math.isfinite(value) and value >= 0):
                raise ConfigError(f"The training setting {f.name} is {value}; it must be a number of 0 or more.")
        if self.person and not self.init_from:
            raise ConfigError(f"Training for {self.person!r} alone needs the weights to start from; add init_from=default.")
        if self.expressions and self.region_names:
            raise ConfigError("Expressions and regions are trained one after the other; set one of them.")
        if self.partial and (self.person or not self.init_from):
            raise ConfigError("Training of a part alone starts from weights and is for all people; add init_from=default.")
        if self.partial and self.refresh_every:
            raise ConfigError("Training of a part alone cannot follow a capture; wait until it is complete.")
        if self.precision not in PRECISIONS:
            raise ConfigError(f"The training setting precision is {self.precision!r}; use {' or '.join(PRECISIONS)}.")
        for name in ("steps", "views_per_step", "ema_every"):
            if getattr(self, name) < 1:
                raise ConfigError(f"The training setting {name} is {getattr(self, name)}; it must be at least 1.")

    @property
    def partial(self) -> bool:
        """Whether only a part of weights is trained."""
        return self.expressions or bool(self.region_names)

    @property
    def region_names(self) -> tuple[str, ...]:
        """Names in `regions`."""
        return tuple(name.strip() for name in self.regions.split(",") if name.strip())

    def to_json(self) -> str:
        """Return the configuration as JSON with sorted keys."""
        return json.dumps(dataclasses.asdict(self), sort_keys=True)


def load_config(source: str | os.PathLike[str], overrides: Mapping[str, Any] | None = None) -> TrainConfig:
    """Read a training configuration.

    Args:
        source: TOML file, or the name of one in `CONFIG_FOLDER`.
        overrides: Settings of ``[training]`` that take precedence.

    Raises:
        FileAccessError: Missing file.
        ConfigError: Not TOML, an unknown setting, or a value out of range.
    """
    path = Path(source)
    named = CONFIG_FOLDER / f"{source}.toml"
    if not path.exists():
        if not named.exists():
            known = ", ".join(sorted(file.stem for file in CONFIG_FOLDER.glob("*.toml")))
            raise FileAccessError(f"There is no configuration {str(source)!r}; choose a TOML file, or one of {known}.")
        path = named
    try:
        values = tomllib.loads(read_bytes(path, _MAX_FILE_BYTES).decode("utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path} is not a TOML file ({error}); correct it.") from error
    unknown = set(values) - {"model", "training", "losses"}
    if unknown or not all(isinstance(table, dict) for table in values.values()):
        raise ConfigError(f"{path} has {sorted(unknown) or 'values'} outside the tables [model], [training] and [losses].")
    return train_config(values.get("model", {}), {**values.get("training", {}), **(overrides or {})}, values.get("losses", {}))


def train_config(model: Mapping[str, Any], training: Mapping[str, Any], losses: Mapping[str, float]) -> TrainConfig:
    """Build a configuration from its three tables. Raises `ConfigError`."""
    model = dict(model)
    preset = model.pop("preset", "paper")
    if preset not in PRESETS:
        raise ConfigError(f"There is no model preset {preset!r}; use one of {', '.join(PRESETS)}.")
    config = PRESETS[preset].replace(**{"hairless": training.get("bare") is True, **model})
    known = {f.name: str(f.type) for f in dataclasses.fields(TrainConfig) if f.name not in ("model", "losses")}
    kinds: dict[str, type | tuple[type, ...]] = {"int": int, "float": (int, float), "str": str, "bool": bool}
    for name, value in training.items():
        if name not in known:
            raise ConfigError(f"Unknown training setting {name!r}; known are {', '.join(sorted(known))}.")
        if isinstance(value, bool) != (known[name] == "bool") or not isinstance(value, kinds[known[name]]):
            raise ConfigError(f"The training setting {name} is {value!r}; it must be of type {known[name]}.")
    return TrainConfig(config, dict(losses), **training)


def changed_settings(earlier: object, config: TrainConfig, tables: Sequence[str]) -> list[str]:
    """Settings that differ from those of an earlier run, in words, without those that any run may change (`minutes`, previews).

    Args:
        earlier: What `TrainConfig.to_json` returned then; anything else has no settings to compare.
        config: Of now.
        tables: Which to compare of model, training and losses.
    """
    try:
        values = json.loads(earlier) if isinstance(earlier, str) else {}
    except ValueError:
        values = {}
    then, now = _tables(values), _tables(json.loads(config.to_json()))
    return [
        f"{name} {now[table][name]!r} instead of {value!r}"
        for table in tables
        for name, value in sorted(then[table].items())
        if name in now[table] and now[table][name] != value and name not in _FREE
    ]


def _tables(values: object) -> dict[str, dict[str, Any]]:
    """The tables of a configuration as JSON; loss weights that are not given are their defaults."""
    values = values if isinstance(values, dict) else {}
    model, losses = (value if isinstance(value := values.get(name), dict) else {} for name in ("model", "losses"))
    training = {name: value for name, value in values.items() if name not in ("model", "losses")}
    return {"model": model, "training": training, "losses": dataclasses.asdict(LossWeights()) | losses if values else {}}
