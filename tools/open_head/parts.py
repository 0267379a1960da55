"""How the parts inside the head follow the skin: eyeballs stay spheres, teeth and tongue follow the lips.

The source's modelling targets move its helper teeth only loosely (the teeth of an average adult end up 7 mm behind the lips),
and deform its helper eyes (an eye that is no sphere cannot turn). Both are replaced by linear maps of the skin's offsets.
"""

from __future__ import annotations

import numpy as np

from .source import Source
from .topology import DECIMETRE, Topology

# Metres added to the base mesh: upper teeth a little below the lip line, lower teeth just behind them, tongue below the bite.
MOUTH_SHIFT = {"upper_teeth": (0.0, -0.0022, -0.0018), "lower_teeth": (0.0, 0.0016, -0.0003), "tongue": (0.0, -0.003, -0.001)}
TONGUE_WIDTH = 0.86  # between the lower teeth instead of in them
LIP_LINE = 0.6615  # metres, height at which the base mesh's lips meet
NEAR_TEETH = 0.012  # metres: skin and mouth lining this near to the teeth carries them

# The source's bite climbs by 12 degrees from the incisors to the molars, and its lower incisors end under the lip: a hardly
# open mouth shows molars behind a hidden front row, which reads as a lone tooth. Metres that a part rises at its back and its
# front, with the depths (z) where it rises by all of it and by nothing: a flatter bite, incisors that overlap by 2.5 mm, a
# tongue between the molars.
LEVEL_BITE = {
    "upper_teeth": ((-0.005, (0.055, 0.092)),),
    "lower_teeth": ((-0.005, (0.055, 0.092)), (0.0025, (0.095, 0.075))),
    "tongue": ((0.002, (0.06, 0.04)),),
}


class InnerParts:
    """The linear maps, prepared once on the base mesh.

    Attributes:
        base: Base mesh in metres with its teeth and tongue in place, [V, 3].
    """

    def __init__(self, source: Source, topology: Topology) -> None:
        self.topology = topology
        self.base = DECIMETRE * (topology.matrix @ source.vertices)
        for part, shift in MOUTH_SHIFT.items():
            self.base[topology.parts[part]] += shift
        self.base[topology.parts["tongue"], 0] *= TONGUE_WIDTH
        skin = topology.parts["skin"]
        mouth = topology.matrix @ (source.mask("lips") + source.mask("inside-mouth"))
        inner = skin[mouth[skin] > 0.5]
        self._carriers: list[tuple[np.ndarray, np.ndarray]] = []
        for part, carried, side in (("upper_teeth", ("upper_teeth",), 1), ("lower_teeth", ("lower_teeth", "tongue"), -1)):
            teeth = self.base[topology.parts[part]]
            distance = np.linalg.norm(self.base[inner][:, None] - teeth[None], axis=-1).min(1)
            near = inner[(distance < NEAR_TEETH) & (side * (self.base[inner, 1] - LIP_LINE) > 0)]
            self._carriers += [(near, topology.parts[name]) for name in carried]

    def follow(self, offsets: np.ndarray) -> np.ndarray:
        """Offsets of a modelling target [V, 3] with eyeballs, teeth and tongue replaced by what the skin carries."""
        result = self.keep_spheres(offsets)
        for near, part in self._carriers:
            centre = self.base[near].mean(0)
            arms = self.base[near] - centre
            shift = offsets[near].mean(0)
            growth = (arms * (offsets[near] - shift)).sum(0) / (arms**2).sum(0)  # one per axis
            arms = self.base[part] - centre
            if part is self.topology.parts["tongue"]:
                # long and deep, it would outgrow the mouth: it grows in width only and moves with the teeth's middle
                arms = arms * (1, 0, 0) + (0, *(self.base[self.topology.parts["lower_teeth"]].mean(0) - centre)[1:])
            result[part] = shift + growth * arms
        return result

    def keep_spheres(self, offsets: np.ndarray) -> np.ndarray:
        """Offsets [V, 3] with eyeballs that only move and grow."""
        result = offsets.copy()
        for side in ("left", "right"):
            part = self.topology.parts[f"{side}_eyeball"]
            arms = self.base[part] - self.base[part].mean(0)
            shift = offsets[part].mean(0)
            growth = ((offsets[part] - shift) * arms).sum() / (arms**2).sum()
            result[part] = shift + growth * arms
        return result


def level_bite(template: np.ndarray, topology: Topology) -> np.ndarray:
    """The template [V, 3] with the bite of `LEVEL_BITE`. For the last step: shapes are found on the source's bite, and stay."""
    result = template.copy()
    for part, rises in LEVEL_BITE.items():
        vertices = topology.parts[part]
        for height, (whole, none) in rises:  # the depths where it rises by all of it and not at all
            share = np.clip((template[vertices, 2] - none) / (whole - none), 0.0, 1.0)
            result[vertices, 1] += height * share**2 * (3.0 - 2.0 * share)
    return result
