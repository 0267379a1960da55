"""New avatars from what weights files know about the training people. Needs numpy only; called by sessions and evaluation."""

from __future__ import annotations

import datetime
from typing import TYPE_CHECKING

import numpy as np

from ..avatar import AssetReference, Avatar, Provenance
from ..avatar.types import MADE_BY, SHAPE_SIZE
from ..errors import ConfigError
from ..head.usual_face import rested

if TYPE_CHECKING:
    from ..head import HeadModel
    from .weights_file import WeightsInfo

NEIGHBOURS = 4  # people whom a drawn person's code is mixed with
CODE_VARIATION = 0.3  # of the Gaussian, in a drawn code
_OWN_SHARE, _OTHERS_SHARE = 3.0, 2.0  # of a Dirichlet distribution: 60 % of a code are one person's on the average


def default_avatar(weights: WeightsInfo, z_exp_size: int) -> Avatar:
    """Return the avatar that comes with weights.

    Args:
        weights: What the weights file says.
        z_exp_size: Length of the model's residual expression code.
    """
    return made_avatar(f"{weights.name.capitalize()} head", weights, z_exp_size, weights.default_z_id, weights.default_shape)


def sampled_avatar(weights: WeightsInfo, z_exp_size: int, seed: int, head: HeadModel | None) -> Avatar:
    """Draw a new person near one of the training people.

    Hair styles and beards lie apart in the space of codes: a Gaussian over all people would draw what is between them, ghosts
    of hair. So the code mixes a training person with a few who are alike, as SMOTE does (Chawla et al. 2002), and a part of
    the Gaussian varies it. Shapes have no such gaps; the Gaussian's part is as large there as it takes to keep the covariance
    of the training people. Both parts use the same numbers for code and shape, so that they stay related.

    Args:
        weights: What the weights file says.
        z_exp_size: Length of the model's residual expression code.
        seed: Equal seeds give equal people.
        head: Of the weights, for how people rest (`head.usual_face`); None: shapes as the training people's.

    Raises:
        ConfigError: The weights know fewer than two people.
    """
    count = len(weights.people)
    if count < 2:
        raise ConfigError(f"The weights {weights.name!r} know fewer than two people to draw new ones from; choose others.")
    rng = np.random.default_rng([abs(seed), int(seed < 0)])
    # with P people the covariance has rank P - 1, and sum_p n_p (x_p - mean) / sqrt(P - 1) has exactly that covariance
    normal = rng.standard_normal(count) / np.sqrt(count - 1)
    distances = np.linalg.norm(weights.z_id - weights.z_id[rng.integers(count)], axis=1)
    alike = np.argsort(distances, kind="stable")[: 1 + NEIGHBOURS]  # the person first
    mix = np.zeros(count)
    mix[alike] = rng.dirichlet([_OWN_SHARE, *[_OTHERS_SHARE / (len(alike) - 1)] * (len(alike) - 1)])
    rest = np.sqrt(1.0 - np.square(mix).sum())
    z_id, shape = (
        mix @ table + share * rest * (normal @ (table - table.mean(0)))
        for table, share in ((weights.z_id, CODE_VARIATION), (weights.shapes, 1.0))
    )
    return made_avatar(f"Sample {seed}", weights, z_exp_size, z_id, shape if head is None else rested(head, shape))


def made_avatar(name: str, weights: WeightsInfo, z_exp_size: int, z_id: np.ndarray, shape: np.ndarray) -> Avatar:
    """An avatar of a given name, code [Z] and shape [S] on weights."""
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
