"""The table of hair styles: one row of numbers and names each. `grooms` reads it. Needs nothing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Style:
    """One row.

    Lengths are metres. A `cut` says how long hair is where, a `comb` where it is led from the root, a `way` how it goes on
    from there; all three are names of functions in `grooms`.

    Attributes:
        cut: "even" (length), "graded" (top and sides), "fringe", "line" (one cutting line at `length`), "round", "tied".
        length: Of the longest hair of a woman of hair length 1.
        sides: Of the sides, where the cut has any.
        mens, mens_sides: Instead of `length` and `sides`, on a man.
        comb: "none", "forward", "aside", "back", "fringe", "parted", "knot".
        root_comb, root_down: Share of the comb and of downwards in the direction at the root.
        comb_on_top: The comb leads on top only.
        down_on_sides: Downwards leads on the sides only.
        way: "short", "fringe", "back", "hanging", "out", "drooping", "tied".
        lift: Share of the skin's normal in the direction at the root; `lift_volume`: times the person's volume.
        follow: How fast hair turns from the root's direction to the way's, 0..1.
        clearance: Height above the skin; `puff` more by the person's volume where `puffs` ("", "top", "crown") is.
        hug: How much hair is held at the skull, 0..1.
        messiness: Standard deviation of directions.
        clumps, clumping: Number of locks and how strongly strands join them, 0..1.
        curl: Radius of curls of hair without a person's own curl; `own_curl`: more by the person's.
        wavelength, curl_cell, curl_spread: Of a turn; of neighbours that curl together; of their phases (radians).
        receding: Share of the person's receding; 2 is receded on everybody.
        count: Strands.
        radius: Of a strand at its root.
    """

    cut: str
    length: float
    sides: float = 0.0
    mens: float | None = None
    mens_sides: float | None = None
    comb: str = "none"
    root_comb: float = 1.0
    root_down: float = 0.0
    comb_on_top: bool = False
    down_on_sides: bool = False
    way: str = "short"
    lift: float = 0.6
    lift_volume: bool = False
    follow: float = 0.35
    clearance: float = 0.0
    puff: float = 0.0
    puffs: str = ""
    hug: float = 0.0
    messiness: float = 0.12
    clumps: int = 500
    clumping: float = 0.5
    curl: float = 0.0
    own_curl: float = 0.0
    wavelength: float = 0.03
    curl_cell: float = 0.008
    curl_spread: float = 0.4
    receding: float = 0.0
    count: int = 8500
    radius: float = 0.00021


def _falling(length: float, curl: float, own_curl: float) -> Style:
    """Hair that hangs from a parting."""
    return Style(
        "line", length, comb="parted", way="hanging", lift=0.4, lift_volume=True, follow=0.6, clearance=0.003, puff=0.007,
        puffs="crown", hug=0.6, messiness=0.05, clumps=420, clumping=0.6, curl=curl, own_curl=own_curl, wavelength=0.085,
        curl_cell=0.016, curl_spread=0.35, radius=0.00025,
    )  # fmt: skip


def _cropped(receding: float) -> Style:
    return Style(
        "graded", 0.036, 0.013, comb="forward", root_comb=0.5, root_down=0.3, lift=1.0, lift_volume=True, follow=0.22,
        clearance=0.002, messiness=0.22, clumps=900, clumping=0.45, own_curl=0.0018, wavelength=0.018, receding=receding,
        count=8000,
    )  # fmt: skip


def _tied(name: str) -> Style:
    """Hair combed to a knot; what hangs from the knot is grown by `grooms.tail_points`."""
    return Style(
        "tied", 0.0, comb=name, way=name, lift=0.25, follow=0.75, clearance=0.0028, hug=0.5, messiness=0.04, clumps=350,
        clumping=0.35, count=7500, radius=0.00022,
    )  # fmt: skip


BALD = "bald"
STYLES: dict[str, Style] = {
    "buzz": Style(
        "even", 0.0055, comb="forward", root_comb=0.0, root_down=0.4, lift=1.0, follow=0.15, messiness=0.25, clumps=0,
        receding=1.0, count=9000, radius=0.00016,
    ),
    "crop": _cropped(1.0),
    "side_part": Style(
        "graded", 0.075, 0.017, comb="aside", root_comb=0.9, root_down=0.4, comb_on_top=True, down_on_sides=True, lift=0.75,
        lift_volume=True, follow=0.30, clearance=0.002, puff=0.009, puffs="top", hug=0.6, messiness=0.09, clumps=600,
        clumping=0.55, own_curl=0.002, wavelength=0.035, receding=1.0, count=8000,
    ),
    "slick_back": Style(
        "graded", 0.115, 0.055, comb="back", way="back", lift=0.45, follow=0.40, clearance=0.003, puff=0.006, puffs="top",
        hug=0.6, messiness=0.06, clumps=450, clumping=0.7, receding=0.7, count=8000,
    ),
    "fringe": Style(
        "fringe", 0.042, 0.13, mens_sides=0.03, comb="fringe", root_down=0.4, comb_on_top=True, way="fringe", lift=0.7,
        follow=0.38, clearance=0.003, puff=0.005, puffs="top", hug=0.5, messiness=0.07, clumps=600, clumping=0.55,
    ),
    "bob": _falling(0.20, 0.0, 0.25 * 0.0095),
    "long": _falling(0.275, 0.0, 0.35 * 0.0095),
    "wavy_long": _falling(0.27, 0.5 * 0.0095, 0.5 * 0.0095),
    "afro": Style(
        "round", 0.060, way="out", lift=1.0, follow=0.25, clearance=0.003, messiness=0.22, clumps=700, clumping=0.25,
        curl=0.0035, wavelength=0.013, curl_cell=0.006, curl_spread=0.9, receding=0.5, radius=0.00023,
    ),
    "curly": Style(
        "round", 0.13, mens=0.055, way="drooping", lift=1.0, follow=0.25, clearance=0.003, messiness=0.16, clumps=420,
        clumping=0.4, curl=0.0065, wavelength=0.026, curl_cell=0.006, curl_spread=0.5, receding=0.5, radius=0.00023,
    ),
    "ponytail": _tied("ponytail"),
    "bun": _tied("bun"),
    "receding": _cropped(2.0),
}  # fmt: skip
HAIR_STYLES: tuple[str, ...] = (*STYLES, BALD)
