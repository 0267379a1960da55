"""The engine of torch: any device, the reference for every other engine. Importing this module imports torch."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager

import numpy as np
import torch
from torch import Tensor

from ..compute.devices import choose_device, describe_device, limit_rasteriser_threads, one_thread
from ..geometry.camera import Camera
from ..model.grmm import GRMM
from ..model.store import ModelStore
from ..model.torch_loader import TorchLoader
from ..pictures.color import MIN_ALPHA, SRGB_GAMMA, SRGB_OFFSET, SRGB_TOE, SRGB_TOE_SLOPE
from ..splat import Gaussians, RasterOutput, rasterize


class TorchEngine:
    """See `Engine`.

    Args:
        weights: Name of installed weights, or a file; None for the embedded ones.
        device: "auto", "cpu", "cuda" or "mps".
        threads: CPU threads; None leaves it to the libraries.
        head: Head file for weights of another head model than the open one.

    Raises:
        BackendError: The device is not there.
    """

    name = "torch"
    torch = str(torch.__version__)

    def __init__(
        self,
        weights: str | os.PathLike[str] | None,
        device: str = "auto",
        threads: int | None = None,
        head: str | os.PathLike[str] | None = None,
    ) -> None:
        self._device, self._threads = choose_device(device), threads
        self.device = describe_device(self._device)
        self.threads = threads or torch.get_num_threads()
        if threads is not None:
            limit_rasteriser_threads(threads)
        self.store: ModelStore[GRMM] = ModelStore(weights, TorchLoader(self._device), head)

    @contextmanager
    def calling(self) -> Iterator[None]:
        """See `Engine.calling`."""
        with torch.inference_mode():
            if self._threads is not None:
                torch.set_num_threads(self._threads)  # a setting of the calling thread
            try:
                yield
            except RuntimeError as error:
                # Torch reports a failed allocation on the CPU as a plain RuntimeError.
                if isinstance(error, torch.OutOfMemoryError) or "alloc" in str(error):
                    raise MemoryError(str(error)) from error
                raise

    def one_thread(self) -> AbstractContextManager[None]:
        """See `Engine.one_thread`."""
        return one_thread()

    def array(self, values: np.ndarray) -> Tensor:
        """See `Engine.array`."""
        return torch.as_tensor(values, dtype=torch.float32, device=self._device)

    def rasterize(self, gaussians: Gaussians, camera: Camera, halved: int = 0) -> RasterOutput[Tensor]:
        """See `Engine.rasterize`."""
        return rasterize(gaussians, camera)

    def scene_linear(self, rgb: Tensor, alpha: Tensor) -> Tensor:
        """See `Engine.scene_linear`; on all cores."""
        result = rgb.new_zeros((*alpha.shape, 4))
        bounds = [torch.nonzero(alpha.amax(axis) >= MIN_ALPHA) for axis in (1, 0)]
        if not len(bounds[0]):
            result[..., 3] = alpha.clamp(0.0, 1.0)
            return result
        rows, columns = (slice(int(hit[0]), int(hit[-1]) + 1) for hit in bounds)  # outside colors are black
        cover = alpha.clamp(0.0, 1.0)
        result[..., 3] = cover
        cover = cover[rows, columns, None]
        straight = rgb[rows, columns] * ((cover >= MIN_ALPHA) / cover.clamp(min=MIN_ALPHA))
        straight.clamp_(0.0, 1.0)
        curve = straight.add(SRGB_OFFSET).mul_(1.0 / (1.0 + SRGB_OFFSET)).pow_(SRGB_GAMMA)
        toe = straight <= SRGB_TOE * SRGB_TOE_SLOPE
        torch.mul(torch.where(toe, straight.div_(SRGB_TOE_SLOPE), curve), cover, out=result[rows, columns, :3])
        return result
