"""The hair of a person drawn at random where the Gaussians have none: from `hair.prior`, with usual brows and lashes."""

from __future__ import annotations

import numpy as np

from ..avatar import Hair
from ..hair.groom import join
from ..hair.packaged import library_groom
from ..hair.prior import random_groom
from ..hair.settings import HairSettings
from .scalp import ramp
from .wearing import USUAL

DARK_SKIN = (0.62, 0.45)  # middle display color: from where on people have dark hair, and wholly
LEAST_MELANIN = 0.8  # of their hair


def random_hair(seed: int, skin: float) -> Hair:
    """Hair of a seed; `skin` is the person's middle display color, 0..1."""
    g, dark = np.random.default_rng([abs(seed), 31]), float(ramp(np.asarray(skin), *DARK_SKIN))
    grey = float(np.clip(g.normal(-0.3, 0.4), 0.0, 0.9))
    melanin, redness = float(g.beta(2.2, 1.2)), float(0.6 * g.beta(0.6, 3.0))
    least = LEAST_MELANIN * dark
    settings = HairSettings(melanin=least + (1.0 - least) * melanin, redness=(1.0 - dark) * redness, grey=grey)
    usual = [library_groom(name, part=part) for part, name in USUAL.items()]
    return Hair(join([random_groom(str(abs(seed) % 10**9)), *usual]), settings)
