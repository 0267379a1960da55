"""Training for one captured person on top of trained weights: the person's own maps, everything else frozen.

What eq. 20 does with a photo, `Trainer` does here with many views of somebody whom the weights know: free maps of offsets,
opacity, color and features take up what networks and basis maps, shared by all people, leave out - strands, spots, a mouth's
own corner. Networks and codes stay, so that the rig moves the person as before. So do the maps by which colors change with
expression: a dozen expressions of one person are too few to learn these from. The result is an avatar with deltas.

Used by `trainer` and the command line.
"""

from __future__ import annotations

import dataclasses
import datetime
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import Tensor, nn

from ..avatar import AssetReference, Avatar, Hair, Provenance
from ..avatar.deltas import APPEARANCE, rounded
from ..avatar.types import MADE_BY, SHAPE_SIZE
from ..errors import ConfigError
from ..model.config import COLOR_CHANNELS
from ..model.weights import load_weights
from ..model.weights_file import read_info, resolve_weights
from .warm_start import warm_start

if TYPE_CHECKING:
    from ..model.grmm import GRMM
    from ..model.inputs import Person
    from .config import TrainConfig

OWN_MAPS = (
    "decoders.transform_mean",
    "decoders.opacity_mean",
    APPEARANCE,
)
MOUTH_REGIONS = ("upper_teeth", "lower_teeth", "tongue", "mouth_interior")
FRONT = (0.0, 0.0, 1.0)  # view direction, head space


def of_the_weights(config: TrainConfig) -> TrainConfig:
    """The configuration with the model's sizes of the weights that it starts from.

    Raises:
        FileAccessError, FileFormatError: The weights are missing, damaged, or a checkpoint, which no avatar can refer to.
    """
    return dataclasses.replace(config, model=read_info(resolve_weights(config.init_from)).config)


def begin(config: TrainConfig, model: GRMM, people: tuple[str, ...], codes: Tensor) -> dict[str, nn.Parameter]:
    """Load the weights that a run for one person starts from, and leave only the own maps to train.

    Args:
        config: With `person` and `init_from`.
        model: Overwritten, and frozen but for the own maps.
        people: Of the data; the person alone.
        codes: The person's code, [1, Z], overwritten.

    Returns:
        The own maps by name.

    Raises:
        ConfigError: The data or the weights do not have the person, or the model no maps of its own.
        FileAccessError, FileFormatError: The weights are missing or damaged.
    """
    person = config.person
    if people != (person,):
        raise ConfigError(f"The data has no training views of {person!r}; capture some, or name one of {_listed(people)}.")
    known = warm_start(config.init_from, model, people, codes)
    if person not in known:
        raise ConfigError(
            f"The weights {config.init_from!r} do not know {person!r}; make an avatar with grmm fit, or name one of "
            f"{_listed(sorted(known))}."
        )
    model.requires_grad_(False)
    codes.requires_grad_(False)
    own = {name: parameter for name, parameter in model.named_parameters() if name in OWN_MAPS}
    if not own:
        raise ConfigError("These weights have no mean maps, which a single person is trained with; use others.")
    for parameter in own.values():
        parameter.requires_grad_(True)
    return own


def person_avatar(
    weights: str, model: GRMM, person: Person, changes: Mapping[str, Tensor], name: str, licence: str = "",
    hair: Hair | None = None,
) -> Avatar:  # fmt: skip
    """Put together what a run for one person has trained.

    Args:
        weights: What the run began with.
        model: As trained.
        person: Whom the weights know.
        changes: Of the own maps, by name.
        name: Display name.
        licence: What may be done with the avatar.
        hair: What the person wears.

    Raises:
        FileAccessError, FileFormatError: The weights are gone.
    """
    info = load_weights(resolve_weights(weights), model.head_model)[1]
    shape = np.zeros(SHAPE_SIZE, np.float32)
    known = person.shape[:SHAPE_SIZE]
    shape[: known.size] = known
    # single teeth are seen a few times, in another shadow each time: what that teaches is blots
    seen = ~in_the_mouth(model)[:, None]
    changed = {key: value * seen for key, value in changes.items()}
    with torch.no_grad():
        z_id = torch.as_tensor(person.z_id, dtype=model.dtype, device=model.device)
        colors = changed[APPEARANCE][:, :COLOR_CHANNELS]
        colors += flesh_tones(model, z_id, colors - changes[APPEARANCE][:, :COLOR_CHANNELS])
    return Avatar(
        name=name,
        head=AssetReference(info.head_name, info.head_sha256),
        weights=AssetReference(info.name, info.sha256),
        z_id=person.z_id,
        z_exp=np.zeros(info.config.z_exp, np.float32),
        shape=shape,
        deltas={key: rounded(value.cpu().numpy()) for key, value in changed.items()},
        provenance=Provenance(
            made_by=MADE_BY,
            date=datetime.datetime.now(datetime.UTC).date().isoformat(),
            licence=licence,
        ),
        hair=hair,
    )


def in_the_mouth(model: GRMM) -> Tensor:
    """Which texels are teeth, gums, tongue and the mouth's inside, [N] bool."""
    return torch.from_numpy(model.layout.within(model.head_model, *MOUTH_REGIONS)).to(model.device)


def flesh_tones(model: GRMM, z_id: Tensor, moved: Tensor | None = None) -> Tensor:
    """What brings colors in the mouth to red >= green, blue: teeth, gums and tongue are never greener than red.

    Molars are seen rarely and in the dark; what else happens to be drawn there gives them any color.

    Args:
        model: As trained.
        z_id: The person's code, [Z].
        moved: Added to the model's colors before, [N, 3].

    Returns:
        To be added to the colors, display sRGB, [N, 3].
    """
    colors, _ = model.appearance(z_id, z_id.new_tensor(FRONT))
    colors = colors if moved is None else colors + moved
    limited = torch.minimum(colors, colors[:, :1])
    return torch.where(in_the_mouth(model)[:, None], limited - colors, torch.zeros_like(colors))


def _listed(names: Sequence[str], most: int = 8) -> str:
    return ", ".join(names[:most]) + (f" and {len(names) - most} more" if len(names) > most else "") if names else "none"
