"""The light of a shot: lamps around the head and a world of three colors, as data. Needs numpy only.

A `Light` is recorded with every shot; `scene` puts it into Blender.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from grmm_core.errors import ConfigError

Color = tuple[float, float, float]
WHITE: Color = (1.0, 1.0, 1.0)


@dataclass(frozen=True)
class Lamp:
    """A square area lamp that looks at the origin of head space.

    Attributes:
        yaw, pitch: Where it is seen from the head, degrees (0, 0 in front of the face; yaw to the person's left).
        distance, side: Metres.
        power: Watts, with Blender's meaning.
        color: Linear RGB.
    """

    yaw: float
    pitch: float
    distance: float
    side: float
    power: float
    color: Color = WHITE


@dataclass(frozen=True)
class Light:
    """All light of a shot.

    Attributes:
        lamps: At most `MAX_LAMPS`.
        strength: Of the world.
        zenith, horizon, ground: Linear RGB of the world above, level and below.
    """

    lamps: tuple[Lamp, ...]
    strength: float
    zenith: Color = WHITE
    horizon: Color = WHITE
    ground: Color = WHITE

    def to_json(self) -> dict[str, object]:
        """Plain values for a record."""
        return asdict(self)


# an even ring of soft boxes, a slightly stronger one at the front left: the flat light that trained colors stand for
RIG = Light(
    (
        Lamp(32, 28, 1.5, 0.9, 16.0), Lamp(-42, 18, 1.5, 0.9, 9.0), Lamp(120, 25, 1.6, 1.1, 8.0), Lamp(-120, 25, 1.6, 1.1, 8.0),
        Lamp(0, 75, 1.5, 1.0, 7.0), Lamp(180, 10, 1.7, 1.0, 6.0),
    ),
    0.42,
)  # fmt: skip
MAX_LAMPS = len(RIG.lamps)


def _single(yaw: float, pitch: float) -> Light:
    return Light((Lamp(yaw, pitch, 1.5, 0.35, 45.0),), 0.03)


# twelve lights to hold relighting against
SETUPS: dict[str, Light] = {
    "front": _single(0, 15), "left": _single(75, 10), "right": _single(-75, 10), "top": _single(0, 80),
    "below": _single(10, -45), "behind_left": _single(140, 20), "behind_right": _single(-140, 20), "key": _single(40, 40),
    "sunset": Light(
        (Lamp(80, 6, 3.0, 0.15, 260.0, (1.0, 0.45, 0.15)),), 0.25, (0.20, 0.32, 0.70), (0.9, 0.5, 0.3), (0.1, 0.08, 0.07)
    ),
    "two_colors": Light((Lamp(70, 10, 1.5, 0.5, 30.0, (1.0, 0.15, 0.5)), Lamp(-70, 10, 1.5, 0.5, 30.0, (0.1, 0.6, 1.0))), 0.04),
    "sky": Light((), 1.1, (0.35, 0.55, 1.0), (0.95, 0.95, 0.9), (0.12, 0.10, 0.08)),
    "snow": Light((), 0.9, (0.45, 0.55, 0.75), (0.6, 0.65, 0.75), (1.0, 1.0, 1.05)),
}  # fmt: skip


def lights_named(names: str) -> dict[str, Light]:
    """Setups of a comma-separated list; "all" are all of them. Raises `ConfigError` for an unknown name."""
    if names == "all":
        return dict(SETUPS)
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    unknown = [name for name in wanted if name not in SETUPS]
    if unknown:
        raise ConfigError(f"There is no light named {unknown[0]!r}; use all, or some of {', '.join(SETUPS)}.")
    return {name: SETUPS[name] for name in wanted}


def draw_light(seed: int) -> Light:
    """A random light: the rig's lamps anywhere, of other powers and colors."""
    g = np.random.default_rng([seed, 31])
    strength = float(g.uniform(0.15, 0.6))
    lamps = []
    for lamp in RIG.lamps:
        power, warm = lamp.power * float(np.exp(g.normal(0, 0.6))), float(g.normal(0, 0.10))
        cold = (1.0 + warm, 1.0 - 0.3 * abs(warm), 1.0)
        color = (1.0, 1.0 - 0.5 * abs(warm), 1.0 - warm) if warm > 0 else cold
        lamps.append(Lamp(float(g.uniform(-180, 180)), float(g.uniform(-10, 75)), 1.5, lamp.side, power, color))
    return Light(tuple(lamps), strength)
