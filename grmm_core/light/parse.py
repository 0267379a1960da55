"""Lights in words, for the command line: ``sun:30,45,3``, ``env:FILE.exr``, ``studio``.

======================================  ======================================================================================
``studio``                              the rig that colors were learned under (the default): nothing is relit
``photo[:NUMBER]``                      the light of a photo that the avatar was made from; by `cli.render`
``sun:YAW,PITCH,STRENGTH[,R,G,B]``      parallel light from a direction, W/m2
``lamp:YAW,PITCH,WATTS[,R,G,B]``        a soft box of half a metre, 1.5 m from the head
``world:STRENGTH[,R,G,B]``              even light from everywhere
``env:FILE[,STRENGTH[,ROTATION]]``      an equirectangular picture (.exr, linear); its middle is what the face looks at
======================================  ======================================================================================

Angles in degrees: yaw 0 is in front of the face, 90 at the person's left; pitch 90 is above.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ..errors import ConfigError
from .lamps import WHITE, Lamp, Lighting, Sun, Vector, soft_box
from .surroundings import Surroundings

STUDIO_WORD, PHOTO_WORD = "studio", "photo"
FORMS = "studio, photo, sun:YAW,PITCH,STRENGTH, lamp:YAW,PITCH,WATTS, world:STRENGTH or env:FILE.exr"
LAMP_DISTANCE, LAMP_SIDE = 1.5, 0.5  # metres
_ENVIRONMENT = re.compile(r"(.*?\.exr)(?:,([^,]*))?(?:,([^,]*))?", re.IGNORECASE)  # commas before the ending are the name's own
_NUMBERS = {"sun": 3, "lamp": 3, "world": 1}


def lighting_of(words: Sequence[str]) -> Lighting | None:
    """All light that words describe; None for the studio's, which is also what no words mean.

    Raises:
        ConfigError: A word that is none of `FORMS`, or the studio together with others.
        FileAccessError, FileFormatError: The picture of the surroundings cannot be read.
    """
    if not words or list(words) == [STUDIO_WORD]:
        return None
    lamps: list[Lamp] = []
    surroundings: list[Surroundings] = []
    for word in words:
        kind, _, rest = word.partition(":")
        if kind == "env" and rest:
            surroundings.append(_picture(rest))
        elif kind in _NUMBERS:
            numbers, color = _numbers(word, rest, _NUMBERS[kind])
            if kind == "world":
                surroundings.append(Surroundings.even(tuple(numbers[0] * c for c in color)))  # type: ignore[arg-type]
            elif kind == "sun":
                lamps.append(Sun(color, numbers[2], True, direction(numbers[0], numbers[1])))
            else:
                lamps.append(soft_box(numbers[0], numbers[1], LAMP_DISTANCE, LAMP_SIDE, numbers[2], color))
        elif word == STUDIO_WORD or kind == PHOTO_WORD:
            raise ConfigError(f"--light {word} stands alone; leave the others out.")
        else:
            raise ConfigError(f"--light {word} is not understood; use {FORMS}.")
    if len(surroundings) > 1:
        raise ConfigError("Only one surrounding light is possible; leave out all but one of world: and env:.")
    return Lighting(tuple(lamps), surroundings[0] if surroundings else None)


def direction(yaw: float, pitch: float) -> Vector:
    """Unit vector from the head in a direction in degrees, head axes."""
    turn, lift = math.radians(yaw), math.radians(pitch)
    return math.sin(turn) * math.cos(lift), math.sin(lift), math.cos(turn) * math.cos(lift)


def _numbers(word: str, rest: str, count: int) -> tuple[list[float], Vector]:
    try:
        values = [float(part) for part in rest.split(",")]
    except ValueError:
        values = []
    if len(values) not in (count, count + 3):
        raise ConfigError(f"--light {word} is not understood; use {FORMS}, each with R,G,B behind it if it is colored.")
    color = tuple(values[count:]) if len(values) > count else WHITE
    return values[:count], color  # type: ignore[return-value]  # three numbers


def _picture(rest: str) -> Surroundings:
    from ..pictures.images import read_exr_rgb

    found = _ENVIRONMENT.fullmatch(rest)
    try:
        if found is None:
            raise ValueError(rest)
        strength, turn = float(found[2] or 1.0), float(found[3] or 0.0)
    except ValueError as error:
        raise ConfigError(f"--light env:{rest} is not understood; use env:FILE.exr,STRENGTH,ROTATION.") from error
    around = Surroundings.of_picture(read_exr_rgb(Path(found[1])))
    angle = math.radians(turn)
    rotation = np.array([[math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]])
    return around.turned(rotation).scaled(strength)
