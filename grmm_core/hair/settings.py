"""What an animator can change about a groom: shape by a few modifiers, color by a few pigments. Needs numpy only.

Every setting is a number with a range (`SETTINGS`), so that hosts can make sliders of them and key them. All are deterministic
and continuous: neighbouring values give neighbouring pictures.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np

from ..errors import ControlError
from .roots import LASHES, SCALP

PIGMENTS = ("melanin", "redness", "grey", "dye", "dye_red", "dye_green", "dye_blue")
LASH_MELANIN = 0.9  # lashes are dark, also those of fair people
LASH_THICKNESS = 1.3  # the studio's are half as many as people have, and pale rims of lids show through them
DARKER = 0.15  # melanin that brows and beards have more: their hairs are coarser, and none shades another
FACE_SHEEN = 0.3  # of hair of the face: with scalp hair's black brows are grey on dark skin, and none is brown


def _setting(default: float, low: float, high: float, text: str) -> Any:
    return field(default=default, metadata={"low": low, "high": high, "text": text})


@dataclass(frozen=True)
class HairSettings:
    """Modifiers of a groom; the defaults of the shape change nothing.

    Attributes: see the texts, which are also what users read. `dye_red` to `dye_blue` are display sRGB.
    """

    length: float = _setting(1.0, 0.15, 1.6, "Length, as a factor; below 1 hair is cut")
    density: float = _setting(1.0, 0.0, 1.0, "Share of the hairs that are there")
    thickness: float = _setting(1.0, 0.2, 3.0, "Thickness of each hair, as a factor")
    curl: float = _setting(0.0, -1.0, 1.0, "Waves added, or below 0 taken out")
    frizz: float = _setting(0.0, 0.0, 1.0, "How far single hairs leave their course")
    melanin: float = _setting(0.75, 0.0, 1.0, "Pigment: 0 very light blond, 0.5 brown, 1 black")
    redness: float = _setting(0.1, 0.0, 1.0, "Share of red pigment")
    grey: float = _setting(0.0, 0.0, 1.0, "Share of the hairs that are grey")
    tips: float = _setting(0.1, -1.0, 1.0, "How much lighter tips are than roots; darker below 0")
    variation: float = _setting(0.3, 0.0, 1.0, "How much color differs from lock to lock and from hair to hair")
    dye: float = _setting(0.0, 0.0, 1.0, "Share of dye over the natural color")
    dye_red: float = _setting(0.5, 0.0, 1.0, "Red of the dye")
    dye_green: float = _setting(0.1, 0.0, 1.0, "Green of the dye")
    dye_blue: float = _setting(0.3, 0.0, 1.0, "Blue of the dye")
    sheen: float = _setting(1.0, 0.0, 3.0, "Strength of the glints along the hairs, as a factor")

    def __post_init__(self) -> None:
        for entry in fields(self):
            value = getattr(self, entry.name)
            if not isinstance(value, (int, float, np.floating, np.integer)) or not np.isfinite(value):
                raise ControlError(f"Hair's {entry.name} is {value!r}; it must be a finite number.")
            low, high = entry.metadata["low"], entry.metadata["high"]
            object.__setattr__(self, entry.name, float(min(max(value, low), high)))

    def changed(self, **values: float) -> HairSettings:
        """The same with other values. Raises `ControlError` for a name that there is not."""
        known = {entry.name for entry in fields(self)}
        unknown = sorted(set(values) - known)
        if unknown:
            raise ControlError(f"Hair has no setting {unknown[0]!r}; it has {', '.join(sorted(known))}.")
        return replace(self, **values)

    def for_part(self, group: int) -> HairSettings:
        """What brows, beard or lashes start from beside scalp hair: its pigments, darker, less sheen; lashes black, thick."""
        if group == SCALP:
            return self
        own = HairSettings(**dict(zip(PIGMENTS, self.color_key, strict=True)), sheen=FACE_SHEEN)
        if group == LASHES:
            return replace(own, melanin=max(self.melanin, LASH_MELANIN), grey=0.0, dye=0.0, thickness=LASH_THICKNESS)
        return replace(own, melanin=self.melanin + DARKER)

    def to_json(self) -> dict[str, float]:
        """Plain numbers by name."""
        return {entry.name: getattr(self, entry.name) for entry in fields(self)}

    @property
    def shape_key(self) -> tuple[float, ...]:
        """What the strands' shape depends on."""
        return self.length, self.density, self.thickness, self.curl, self.frizz

    @property
    def keeps_shape(self) -> bool:
        """Whether strands keep the course that they have."""
        return self.length == 1.0 and self.curl == self.frizz == 0.0

    @property
    def shading(self) -> float:
        """How much of the optical depth of hair as it is stored is left, 0..1: fewer and shorter hairs let more light in.

        The power is that of light traced anew in seven grooms, cut to 0.6, 0.3 and 0.1 of their length.
        """
        return self.density * min(self.length, 1.0) ** 0.5

    @property
    def color_key(self) -> tuple[float, ...]:
        """What the strands' color depends on, besides light and eye."""
        return tuple(getattr(self, name) for name in PIGMENTS)


@dataclass(frozen=True)
class Setting:
    """A row of `SETTINGS`: its name, default, range and what it does, for people."""

    name: str
    default: float
    low: float
    high: float
    text: str


SETTINGS: tuple[Setting, ...] = tuple(
    Setting(f.name, float(f.default), f.metadata["low"], f.metadata["high"], f.metadata["text"])  # type: ignore[arg-type]
    for f in fields(HairSettings)
)
