"""The table of hair styles: one row of numbers and names each. `grooms` reads it. Needs nothing."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any


@dataclass(frozen=True)
class Style:
    """One row.

    Lengths are metres. A `cut` says how long hair is where, a `comb` where it is led from the root, a `way` how it goes on
    from there; all three are names of functions in `grooms`.

    Attributes:
        cut: "even" (length), "graded" (top and sides), "crest", "fringe", "line" (one cutting line at `length`), "layers",
            "round", "tied".
        length: Of the longest hair of a woman of hair length 1.
        sides: Of the sides, where the cut has any.
        mens, mens_sides: Instead of `length` and `sides`, on a man.
        comb: "none", "forward", "aside", "side", "back", "swept", "quiff", "fringe", "parted", or a knot of `grooms.KNOTS`.
        root_comb, root_down: Share of the comb and of downwards in the direction at the root.
        comb_on_top: The comb leads on top only.
        down_on_sides: Downwards leads on the sides only.
        way: "short", "fringe", "back", "hanging", "out", "drooping", or a knot.
        lift: Share of the skin's normal in the direction at the root; `lift_volume`: times the person's volume.
        follow: How fast hair turns from the root's direction to the way's, 0..1.
        clearance: Height above the skin; `puff` more by the person's volume where `puffs` ("", "top", "crown") is.
        hug: How much hair is held at the skull, 0..1.
        messiness: Standard deviation of directions.
        clumps, clumping: Number of locks and how strongly strands join them, 0..1.
        gather: Share of the length at which the locks are formed.
        rope: Radius of the ropes that locks are wound to; 0: loose hair. `braided`: in three parts.
        wound: Share of the length on which hair joins its rope.
        curl: Radius of curls of hair without a person's own curl; `own_curl`: more by the person's.
        wavelength, curl_spread: Of a turn; how far a strand is out of step with its lock, radians.
        flat: How far curls reach out of the hair's surface, of how far they do along it: 1 are coils, less are waves.
        frizz: How far single hairs leave their course.
        flyaway: Share of the hairs that stand away from all locks.
        fade: Height on the sides below which hair is shorn shorter and shorter; 0: none.
        receding: Share of the person's receding; 2 is receded on everybody.
        count: Strands.
        points: Of a strand.
        width: Diameter of a strand at its root.
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
    gather: float = 1.0
    rope: float = 0.0
    braided: bool = False
    wound: float = 0.07
    curl: float = 0.0
    own_curl: float = 0.0
    wavelength: float = 0.03
    curl_spread: float = 0.4
    flat: float = 1.0
    frizz: float = 0.0003
    flyaway: float = 0.02
    fade: float = 0.0
    receding: float = 0.0
    count: int = 36000
    points: int = 16
    width: float = 0.00012


def _falling(length: float, **more: Any) -> Style:
    """Hair that hangs from a parting."""
    row = Style(
        "line", length, comb="parted", way="hanging", lift=0.4, lift_volume=True, follow=0.6, clearance=0.003, puff=0.007,
        puffs="crown", hug=0.6, messiness=0.07, clumps=380, clumping=0.62, gather=0.7, wavelength=0.085,
        curl_spread=0.35, flat=0.4, points=20, frizz=0.0004, width=0.00016,
    )  # fmt: skip
    return replace(row, **more)


def _shorn(length: float, **more: Any) -> Style:
    row = Style(
        "even", length, comb="forward", root_comb=0.0, root_down=0.4, lift=1.0, follow=0.15, messiness=0.25, clumps=0,
        receding=1.0, count=44000, points=4, frizz=0.0, flyaway=0.0,
    )  # fmt: skip
    return replace(row, **more)


def _cropped(**more: Any) -> Style:
    row = Style(
        "graded", 0.036, 0.013, comb="forward", root_comb=0.5, root_down=0.3, lift=1.0, lift_volume=True, follow=0.22,
        clearance=0.002, messiness=0.22, clumps=1500, clumping=0.45, own_curl=0.0018, wavelength=0.018, receding=1.0,
        points=10,
    )  # fmt: skip
    return replace(row, **more)


def _curled(length: float, **more: Any) -> Style:
    """Hair that stands away from the head in curls."""
    row = Style(
        "round", length, way="drooping", lift=1.0, follow=0.25, clearance=0.003, messiness=0.16, clumps=650, clumping=0.75,
        gather=0.35, curl=0.0065, wavelength=0.024, curl_spread=0.25, receding=0.5, count=32000, points=34, frizz=0.0006,
        flyaway=0.04,
    )  # fmt: skip
    return replace(row, **more)


def _tied(name: str) -> Style:
    """Hair combed to a knot; what hangs from the knot is grown by `grooms.tail_points`."""
    return Style(
        "tied", 0.0, comb=name, way=name, lift=0.25, follow=0.75, clearance=0.0028, hug=0.5, messiness=0.04, clumps=700,
        clumping=0.35, count=30000, points=14, frizz=0.0002, width=0.00016,
    )  # fmt: skip


_SWEPT = Style(
    "graded", 0.115, 0.055, comb="back", way="back", lift=0.45, follow=0.40, clearance=0.003, puff=0.006, puffs="top", hug=0.6,
    messiness=0.06, clumps=800, clumping=0.7, receding=0.7, width=0.00015,
)  # fmt: skip
_ASIDE = Style(
    "graded", 0.075, 0.017, comb="aside", root_comb=0.9, root_down=0.4, comb_on_top=True, down_on_sides=True, lift=0.75,
    lift_volume=True, follow=0.30, clearance=0.002, puff=0.009, puffs="top", hug=0.6, messiness=0.09, clumps=1000,
    clumping=0.55, own_curl=0.002, wavelength=0.035, receding=1.0, points=14, width=0.00015,
)  # fmt: skip

BALD = "bald"
STYLES: dict[str, Style] = {
    "stubble": _shorn(0.0022),
    "buzz": _shorn(0.006),
    "crop": _cropped(),
    "fade": _cropped(length=0.042, sides=0.010, fade=0.075, messiness=0.3, own_curl=0.004, receding=0.7),
    "side_part": _ASIDE,
    "slick_back": _SWEPT,
    "undercut": replace(_SWEPT, length=0.13, sides=0.005, fade=0.080, clumping=0.6),
    "quiff": replace(_SWEPT, length=0.085, sides=0.014, comb="quiff", lift=1.3, hug=0.25, follow=0.3, puff=0.016, fade=0.03),
    "mohawk": _cropped(cut="crest", length=0.075, sides=0.004, comb="none", lift=1.4, follow=0.06, clumping=0.7, points=12),
    "fringe": Style(
        "fringe", 0.042, 0.13, mens_sides=0.03, comb="fringe", root_down=0.4, comb_on_top=True, way="fringe", lift=0.7,
        follow=0.38, clearance=0.003, puff=0.005, puffs="top", hug=0.5, messiness=0.07, clumps=1000, clumping=0.55,
        width=0.00015,
    ),
    "pixie": replace(_ASIDE, length=0.085, sides=0.042, messiness=0.14, hug=0.7, clumping=0.6),
    "curtains": _falling(0.155, lift=0.6, hug=0.4, own_curl=0.004, wavelength=0.07),
    "bob": _falling(0.20, own_curl=0.0036),
    "long": _falling(0.275, own_curl=0.0033),
    "chest_length": _falling(0.45, own_curl=0.0033, points=28),
    "chest_waves": _falling(0.45, curl=0.010, own_curl=0.003, wavelength=0.10, clumps=190, clumping=0.8, gather=0.45,
                            curl_spread=0.18, flat=0.5, points=36, frizz=0.0003),
    "layered": _falling(0.25, cut="layers", own_curl=0.005, wavelength=0.07, messiness=0.09, clumps=500),
    "wavy_long": _falling(0.27, curl=0.0075, own_curl=0.004, wavelength=0.07, clumps=300, clumping=0.72, gather=0.45,
                          points=28),
    "ringlets": _falling(0.25, curl=0.0065, own_curl=0.0005, wavelength=0.046, clumps=420, clumping=0.85, gather=0.3,
                         curl_spread=0.3, flat=1.0, hug=0.35, lift=0.7, points=48, count=30000, frizz=0.0004, flyaway=0.03),
    "curly": _curled(0.10, mens=0.055),
    "coily": _curled(0.034, way="out", curl=0.0022, wavelength=0.0085, clumps=1800, clumping=0.65, points=28),
    "afro": _curled(0.068, way="out", curl=0.003, wavelength=0.011, clumps=1500, clumping=0.35, messiness=0.22, points=40,
                    curl_spread=0.9),
    "locs": _falling(0.195, rope=0.0034, clumps=170, clumping=1.0, hug=0.3, lift=0.7, curl_spread=3.0, points=24, frizz=0.0004),
    "braids": _falling(0.20, rope=0.0032, braided=True, clumps=190, clumping=1.0, hug=0.5, points=44, count=30000, frizz=0.0001,
                       flyaway=0.004),
    "ponytail": _tied("ponytail"),
    "bun": _tied("bun"),
    "receding": _cropped(receding=2.0),
}  # fmt: skip
HAIR_STYLES: tuple[str, ...] = (*STYLES, BALD)
