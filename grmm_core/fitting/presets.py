"""How much work a fit is: `fast`, `standard`, `high`. Used by the whole inversion; needs the standard library only."""

from __future__ import annotations

from dataclasses import dataclass

from ..errors import ConfigError
from ..jobs.stages import FIT, JobStages


@dataclass(frozen=True)
class CodeSettings:
    """Stage 1.

    Attributes:
        side: Longer side of the picture, pixels.
        small_side: Of the picture on which starts are compared.
        candidates: Training people who are compared.
        starts: Starts that are followed.
        trial_steps: Steps of each.
        steps: Steps of the best.
        goes_on: Start from the code of the quick avatar that the photos were tracked by, where there is one; no other is tried.
    """

    side: int
    small_side: int
    candidates: int
    starts: int
    trial_steps: int
    steps: int
    goes_on: bool = False


@dataclass(frozen=True)
class DecoderSettings:
    """Stage 2.

    Attributes:
        levels: Longer side of the picture and steps, one after another; colors are matched at last at the last one, which may
            have no steps.
        networks: Tune the decoders' networks too, not their maps only.
    """

    levels: tuple[tuple[int, int], ...]
    networks: bool


@dataclass(frozen=True)
class Preset:
    """A named amount of work.

    Attributes:
        name: "fast", "standard" or "high".
        codes: Stage 1.
        decoders: Stage 2.
        seconds: That the two stages take on two cores, for the first estimate of the time left.
    """

    name: str
    codes: CodeSettings
    decoders: DecoderSettings
    seconds: tuple[float, float] = (30.0, 85.0)


PRESETS: dict[str, Preset] = {
    "fast": Preset(
        "fast",
        CodeSettings(192, 96, 24, 2, 6, 16, goes_on=True),
        DecoderSettings(((192, 8), (384, 12), (512, 0)), False),
        (4.0, 10.0),
    ),
    "standard": Preset(
        "standard",
        CodeSettings(256, 128, 64, 3, 16, 60),
        DecoderSettings(((256, 70), (384, 120), (512, 120)), True),
        (30.0, 85.0),
    ),
    "high": Preset(
        "high",
        CodeSettings(320, 160, 256, 4, 24, 120),
        DecoderSettings(((256, 150), (512, 350), (768, 400)), True),
        (84.0, 315.0),
    ),
}


def preset_named(name: str) -> Preset:
    """Return a preset of `PRESETS`. Raises `ConfigError` for an unknown name."""
    if name not in PRESETS:
        raise ConfigError(f"There is no preset {name!r}; use {', '.join(PRESETS)}.")
    return PRESETS[name]


def fit_stages(preset: Preset, photos: int = 1) -> JobStages:
    """The stages of a fit of so many photos, weighted by the time that they take with a preset."""
    codes, decoders = preset.seconds
    return FIT.weighted({
        "analyse": photos * FIT["analyse"].weight, "track": photos * FIT["track"].weight, "codes": codes, "decoders": decoders,
    })  # fmt: skip
