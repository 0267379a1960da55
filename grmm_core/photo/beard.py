"""Whether the chin in a photo has a beard. Numpy only.

The parser alone sees one in colored light from below and misses dark ones of real people. A beard that it is sure of is one; of
others the photo's light decides, in which chin and jaws are much darker than the cheeks of the same side.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

Ends = tuple[float, float]

# metres beside the middle of the lips and below them of the chin, and the parser's share there that is sure: shaven chins
# have up to 0.17 in the shade and 0.52 in colored light, full beards 0.66 and more, dark ones of real people 0.06 to 0.4
CHIN: tuple[Ends, Ends] = (-0.016, 0.016), (0.008, 0.022)
SURE, SOME = 0.55, 0.04
# metres beside the lips and below them of jaws, beside and above them of cheeks, and how much of the cheeks' light the
# lightest of chin and jaws has at most: dark beards 0.1 to 0.5, stubble and chins without 0.55 and more
JAWS: tuple[Ends, Ends] = (0.018, 0.04), (0.0, 0.025)
CHEEKS: tuple[Ends, Ends] = (0.025, 0.05), (0.012, 0.04)
DARK = 0.5
REACH = 0.06, 0.1  # metres beside and below the lips that a beard may cover
LIGHT: Ends = 0.35, 0.75  # of the cheeks' light: pixels that are surely beard, and that are none
TRUSTED = 6.0  # times the parser's share that a pixel's darkness counts


@dataclass(frozen=True)
class Place:
    """Where pixels of a small picture lie on a face, [S, S] each.

    Attributes:
        across, below: Metres beside the middle of the lips, and below their lower edge.
        above: Metres above their upper edge.
        on_skin, on_neck: They show the mesh's skin or neck.
    """

    across: np.ndarray
    below: np.ndarray
    above: np.ndarray
    on_skin: np.ndarray
    on_neck: np.ndarray

    def zone(self, sideways: Ends, away: Ends, *, above: bool = False, side: int = 1) -> np.ndarray:
        """Skin so far beside (of one side, -1 or 1) and below or above the lips, [S, S] bool."""
        beside, apart = side * self.across, self.above if above else self.below
        found: np.ndarray = self.on_skin & _within(beside, sideways) & _within(apart, away)
        return found


@dataclass(frozen=True)
class Beard:
    """Where a beard may be, [S, S].

    Attributes:
        around: Pixels that one may cover, bool.
        dark: How much of the skin of each is one by its darkness, 0..1.
    """

    around: np.ndarray
    dark: np.ndarray


def beard_on_chin(share: np.ndarray, place: Place, light: np.ndarray) -> Beard | None:
    """Find out whether there is a beard on the chin.

    Args:
        share: The parser's of each pixel, 0..1, [S, S].
        place: Of the pixels.
        light: Linear, of the pixels, [S, S].

    Returns:
        Where it may be; None for a shaven chin, or one that is not seen.
    """
    chin = place.zone(*CHIN)
    if not chin.any():
        return None
    cheeks = np.array([_median(light, place.zone(*CHEEKS, above=True, side=side)) for side in (-1, 1)])
    jaws = np.array([_median(light, place.zone(*JAWS, side=side)) for side in (-1, 1)])
    if np.isnan(cheeks).all():
        return None
    cheeks = np.where(np.isnan(cheeks), np.nanmax(cheeks), cheeks).clip(1e-4)
    lightest = np.nanmax([*(jaws / cheeks), _median(light, chin) / cheeks.mean()])
    found = float(share[chin].mean())
    if found < (SOME if lightest < DARK else SURE):
        return None
    around = _within(place.across, (-REACH[0], REACH[0])) & _within(place.below, (0.0, REACH[1]))
    around &= place.on_skin | place.on_neck
    of_right = np.clip(0.5 + place.across / (CHIN[0][1] - CHIN[0][0]), 0.0, 1.0)
    relative = light / (cheeks[0] * (1.0 - of_right) + cheeks[1] * of_right)
    dark = np.clip((LIGHT[1] - relative) / (LIGHT[1] - LIGHT[0]), 0.0, 1.0) * np.clip(TRUSTED * share, 0.0, 1.0)
    return Beard(around, (dark * (around & place.on_skin)).astype(np.float32))


def _within(plane: np.ndarray, ends: Ends) -> np.ndarray:
    found: np.ndarray = (plane > ends[0]) & (plane < ends[1])
    return found


def _median(plane: np.ndarray, where: np.ndarray) -> float:
    return float(np.median(plane[where])) if where.any() else float("nan")
