"""The hair of a person drawn at random where the Gaussians have none: from `hair.prior`, with usual brows and lashes.

Who is told a man by the shape of the head may have a beard, and mostly short hair; hair is grey as people of that age have it.
"""

from __future__ import annotations

import numpy as np

from ..avatar import Hair
from ..hair.groom import Groom, join
from ..hair.packaged import library_groom
from ..hair.prior import hair_prior, random_groom
from ..hair.settings import HairSettings
from ..head.open_head import load_people_model
from .scalp import ramp
from .wearing import USUAL

DARK_SKIN = (0.62, 0.45)  # middle display color: from where on people have dark hair, and wholly
LEAST_MELANIN = 0.8  # of their hair
MAN = 0.5  # of `PeopleModel.macros`' share of a woman, below which a person is drawn as a man
BEARDED = 0.6  # of men
BEARDS = {"stubble": 0.35, "short": 0.25, "full": 0.15, "goatee": 0.10, "moustache": 0.10, "chinstrap": 0.05}
SHORT, LONG = 0.075, 0.040  # metres in the mean: most men's hair is no longer, most women's no shorter
MOSTLY = 0.85
GREYING, GREY_SPREAD = (42.0, 85.0), 0.18  # years in which hair turns grey, and how much that differs from person to person
_TRIES, _STRIDE = 12, 7919


def random_hair(seed: int, skin: float, shape: np.ndarray) -> Hair:
    """Hair of a seed.

    Args:
        seed: Of the person.
        skin: The person's middle display color, 0..1.
        shape: Coefficients of the open head, [S].
    """
    g, dark = np.random.default_rng([abs(seed), 31]), float(ramp(np.asarray(skin), *DARK_SKIN))
    person = load_people_model().macros(shape)
    age = (person["age"] - GREYING[0]) / (GREYING[1] - GREYING[0])
    grey = float(np.clip(age + g.normal(-0.1, GREY_SPREAD), 0.0, 0.9))
    melanin, redness = float(g.beta(2.2, 1.2)), float(0.6 * g.beta(0.6, 3.0))
    least = LEAST_MELANIN * dark
    settings = HairSettings(melanin=least + (1.0 - least) * melanin, redness=(1.0 - dark) * redness, grey=grey)
    man = person["female"] < MAN
    parts = [_scalp(seed, man, g), *(library_groom(name, part=part) for part, name in USUAL.items())]
    if man and g.random() < BEARDED:
        parts.append(library_groom(str(g.choice(list(BEARDS), p=list(BEARDS.values()))), part="beard"))
    return Hair(join(parts), settings)


def _scalp(seed: int, man: bool, g: np.random.Generator) -> Groom:
    """A hairstyle of a seed: the first of some as long as most men's, or most women's; now and then the very first."""
    prior, number = hair_prior(), abs(seed) % 10**9
    tries = _TRIES if g.random() < MOSTLY else 0
    for later in range(tries):
        drawn = (number + later * _STRIDE) % 10**9
        length = prior.describe(prior.draw(drawn)).length
        if length < SHORT if man else length > LONG:
            return random_groom(str(drawn))
    return random_groom(str(number))
