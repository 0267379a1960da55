"""New avatars from what weights files know about the training people. Needs numpy only; called by sessions."""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING

import numpy as np

from .. import __version__
from ..errors import ConfigError
from .types import SHAPE_SIZE, AssetReference, Avatar, Provenance

if TYPE_CHECKING:
    from ..model.weights import WeightsInfo

MADE_BY = f"grmm {__version__}"


def default_avatar(weights: WeightsInfo, z_exp_size: int) -> Avatar:
    """Return the avatar that comes with weights.

    Args:
        weights: What the weights file says.
        z_exp_size: Length of the model's residual expression code.
    """
    return _avatar(f"{weights.name.capitalize()} head", weights, z_exp_size, weights.default_z_id, weights.default_shape)


def sampled_avatar(weights: WeightsInfo, z_exp_size: int, seed: int) -> Avatar:
    """Draw a person from the Gaussian fitted jointly to the training people's codes and shapes.

    With P people the fitted covariance has rank P - 1, and x = mean + sum_p n_p (x_p - mean) / sqrt(P - 1) with standard
    normal n has exactly this distribution; codes and shape use the same n, so that they stay related.

    Args:
        weights: What the weights file says.
        z_exp_size: Length of the model's residual expression code.
        seed: Equal seeds give equal people.

    Raises:
        ConfigError: The weights know fewer than two people.
    """
    count = len(weights.people)
    if count < 2:
        raise ConfigError(f"The weights {weights.name!r} know fewer than two people to draw new ones from; choose others.")
    draw = np.random.default_rng([abs(seed), int(seed < 0)]).standard_normal(count) / np.sqrt(count - 1)
    z_id, shape = (table.mean(0) + draw @ (table - table.mean(0)) for table in (weights.z_id, weights.shapes))
    return _avatar(f"Sample {seed}", weights, z_exp_size, z_id, shape)


def _avatar(name: str, weights: WeightsInfo, z_exp_size: int, z_id: np.ndarray, shape: np.ndarray) -> Avatar:
    licence = weights.provenance.get("licence", "")
    padded = np.zeros(SHAPE_SIZE, np.float32)
    padded[: shape.size] = shape[:SHAPE_SIZE]
    return Avatar(
        name=name,
        head=AssetReference(weights.head_name, weights.head_sha256),
        weights=AssetReference(weights.name, weights.sha256),
        z_id=z_id,
        z_exp=np.zeros(z_exp_size, np.float32),
        shape=padded,
        provenance=Provenance(
            made_by=MADE_BY,
            from_photos=False,
            date=datetime.datetime.now(datetime.UTC).date().isoformat(),
            licence=licence if isinstance(licence, str) else "",
        ),
    )
