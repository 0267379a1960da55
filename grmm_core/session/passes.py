"""What is handed out of one rasterised picture: where its channels are, and the passes made of them. Called by `compose`."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..geometry.camera import Camera
from ..geometry.libraries import Array, as_like, library_of, present, to_numpy, zeros
from ..light.relight import over_cover, to_linear
from ..pictures.color import MIN_ALPHA
from ..splat.types import RasterOutput
from .engines import Engine
from .lit import HIGHLIGHTS, SHADOW
from .values import EMPTY_DEPTH, LIGHT_PASSES, LINEAR_PASS, RAW_LINEAR_PASS, RenderOptions

ROUNDING = 1e-5  # of sums of many Gaussians' weights


@dataclass(frozen=True)
class Channels:
    """Where the extra channels of the joint rasterisation are.

    Attributes:
        features: Slice of each model's features, by the identity of the model.
        normals: Slice of the normals, or None.
        coverage: Slice of the coverages, one channel an instance, or None for a single instance.
        skin: Number of the channel that is 1 on all but strands, or None where nobody has any or nobody asks.
        light: Slice of the light (`lit`), or None where nobody is lit and nobody asks.
        count: All channels.
    """

    features: dict[int, slice]
    normals: slice | None
    coverage: slice | None
    skin: int | None
    light: slice | None
    count: int

    @property
    def last(self) -> int:
        """How many channels models' features are, the last ones."""
        return self.count - min((part.start for part in self.features.values()), default=self.count)

    @property
    def vary(self) -> bool:
        """Whether they hold what differs between frames and instances of an avatar."""
        return any(part is not None for part in (self.normals, self.coverage, self.light))


def buffers(
    raster: RasterOutput[Any], refined: Any, channels: Channels, options: RenderOptions, engine: Engine
) -> dict[str, np.ndarray]:
    """The passes that `options` ask for, of a picture rasterised, refined and lit."""
    alpha = raster.alpha
    behind: Any = 0.0
    if options.background is not None:
        behind = (1.0 - alpha)[..., None] * as_like(options.background, alpha)
    nothing = as_like((EMPTY_DEPTH,), alpha)
    makers: dict[str, Callable[[], Any]] = {
        "rgb": lambda: refined + behind,
        LINEAR_PASS: lambda: _linear(refined, alpha, engine, channels.light is not None),
        RAW_LINEAR_PASS: lambda: engine.scene_linear(raster.rgb, alpha),
        "alpha": lambda: alpha[..., None],
        "depth": lambda: library_of(alpha).where(alpha >= MIN_ALPHA, raster.depth, nothing)[..., None],
        "raw": lambda: raster.rgb + behind,
        "normal": lambda: _unit_normals(present(raster.features)[..., channels.normals], alpha),
        "features": lambda: _all_features(raster, channels),
        "hair": lambda: (alpha * 0.0 if channels.skin is None else strands_of(raster, channels.skin))[..., None],
        "mask": lambda: alpha[..., None] if channels.coverage is None else present(raster.features)[..., channels.coverage],
    }
    makers |= {name: functools.partial(_light_pass, name, raster, refined, channels) for name in LIGHT_PASSES}
    return {name: to_numpy(makers[name]()) for name in dict.fromkeys(options.passes)}


def strands_of(raster: RasterOutput[Array], skin: int) -> Array:
    """How much of each pixel strands cover, [H, W]: what the channel `skin` does not."""
    cover: Array = raster.alpha - present(raster.features)[..., skin]
    return cover * (cover > ROUNDING)


def _linear(refined: Any, alpha: Any, engine: Engine, lit: bool) -> Any:
    if not lit:
        return engine.scene_linear(refined, alpha)
    cover = alpha[..., None]  # light may be brighter than display white
    linear = to_linear(refined / library_of(cover).clip(cover, MIN_ALPHA, None)) * cover
    return library_of(cover).concatenate([linear, cover], -1)


def light_of(raster: RasterOutput, which: slice) -> Any:
    """Channels of the light at each pixel, premultiplied by alpha, [H, W, LIGHT_CHANNELS]."""
    return over_cover(present(raster.features)[..., which], raster.alpha)


def _light_pass(name: str, raster: RasterOutput, lit: Any, channels: Channels) -> Any:
    """One of `LIGHT_PASSES`; diffuse and specular add up to the picture in linear light."""
    alpha = raster.alpha[..., None]
    clip = library_of(alpha).clip
    straight = lit / clip(alpha, MIN_ALPHA, None)
    whole = to_linear(clip(straight, 0.0, 1.0) if channels.light is None else straight) * alpha  # light alone goes beyond white
    if channels.light is None:
        return {"diffuse": whole, "specular": whole * 0.0, "shadow": alpha}[name]
    light = light_of(raster, channels.light)
    if name == "shadow":
        return light[..., SHADOW]
    mirrored = library_of(alpha).minimum(clip(light[..., HIGHLIGHTS], 0.0, None), whole)
    return mirrored if name == "specular" else whole - mirrored


def _unit_normals(summed: Array, alpha: Array) -> Array:
    library = library_of(summed)
    length = (summed * summed).sum(-1)[..., None] ** 0.5
    seen = (alpha[..., None] >= MIN_ALPHA) & (length > 0)
    return library.where(seen, summed / library.clip(length, 1e-12, None), zeros((1,), summed))


def _all_features(raster: RasterOutput[Any], channels: Channels) -> Any:
    """Return the features of all models, added up where their numbers differ (they cover different pixels)."""
    width = max((part.stop - part.start for part in channels.features.values()), default=0)
    total = zeros((*raster.alpha.shape, width), raster.alpha)
    for part in channels.features.values():
        total[..., : part.stop - part.start] += present(raster.features)[..., part]
    return total


def empty(camera: Camera, options: RenderOptions) -> dict[str, np.ndarray]:
    """The picture of no avatars."""
    sizes = {
        "rgb": 3,
        LINEAR_PASS: 4,
        RAW_LINEAR_PASS: 4,
        "alpha": 1,
        "depth": 1,
        "raw": 3,
        "normal": 3,
        "features": 0,
        "mask": 0,
        "hair": 1,
        "diffuse": 3,
        "specular": 3,
        "shadow": 1,
    }
    buffers = {name: np.zeros((camera.height, camera.width, sizes[name]), np.float32) for name in options.passes}
    for name, buffer in buffers.items():
        if name == "depth":
            buffer[:] = EMPTY_DEPTH
        elif name in ("rgb", "raw") and options.background is not None:
            buffer[:] = options.background
    return buffers
