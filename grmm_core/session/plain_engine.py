"""The engine without torch: numpy, numba and onnxruntime, on the CPU. What stock Blender draws with."""

from __future__ import annotations

import functools
import os
from contextlib import AbstractContextManager, nullcontext

import numpy as np

from ..compute.devices import limit_rasteriser_threads
from ..errors import BackendError
from ..geometry.camera import Camera
from ..inference.loader import PlainLoader
from ..inference.plain_model import PlainModel
from ..model.store import ModelStore
from ..pictures.color import MIN_ALPHA, srgb_to_linear
from ..splat.api import rasterize_arrays
from ..splat.types import GaussianArrays, Gaussians, RasterOutput

_BAND = 32  # rows of a picture, in a task of a thread
_STEPS = 8192


class PlainEngine:
    """See `Engine`; arguments and errors as for `TorchEngine`, with the device "auto" or "cpu"."""

    name = "plain"
    torch = ""
    device = "cpu"

    def __init__(
        self,
        weights: str | os.PathLike[str] | None,
        device: str = "auto",
        threads: int | None = None,
        head: str | os.PathLike[str] | None = None,
    ) -> None:
        if device not in ("auto", "cpu"):
            raise BackendError(f"The device {device!r} needs torch; install the runtime with torch, or use auto or cpu.")
        if threads is not None:
            limit_rasteriser_threads(threads)
        self.threads = threads or os.cpu_count() or 1
        self.store: ModelStore[PlainModel] = ModelStore(weights, PlainLoader(threads), head)

    def calling(self) -> AbstractContextManager[None]:
        """See `Engine.calling`."""
        return nullcontext()

    def one_thread(self) -> AbstractContextManager[None]:
        """See `Engine.one_thread`."""
        return nullcontext()

    def array(self, values: np.ndarray) -> np.ndarray:
        """See `Engine.array`."""
        return np.ascontiguousarray(values, np.float32)

    def rasterize(self, gaussians: Gaussians, camera: Camera, halved: int = 0) -> RasterOutput[np.ndarray]:
        """See `Engine.rasterize`."""
        own = gaussians
        features = np.zeros((len(own), 0), np.float32) if own.features is None else own.features
        parts = (own.means, own.quats, own.scales, own.opacities, own.colors, features)
        drawn = rasterize_arrays(GaussianArrays(*map(np.asarray, parts)), camera, halved=halved)
        return RasterOutput(drawn.rgb, drawn.alpha, drawn.depth, drawn.features, drawn.halves if halved else None)

    def scene_linear(self, rgb: np.ndarray, alpha: np.ndarray) -> np.ndarray:
        """See `Engine.scene_linear`."""
        from ..compute.threads import for_rows
        from ..inference.loops import premultiplied_linear

        result = np.empty((*alpha.shape, 4), np.float32)
        for_rows(premultiplied_linear, len(alpha), rgb, alpha, np.float32(MIN_ALPHA), _curve(), result, smallest=_BAND)
        return result


@functools.cache
def _curve() -> np.ndarray:
    """Linear values of display sRGB in even steps, so many that a straight line between two is exact to 1e-7."""
    return srgb_to_linear(np.linspace(0.0, 1.0, _STEPS))
