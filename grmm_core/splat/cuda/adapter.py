"""Drawing with gsplat. Placeholder until the adapter is written: always raises a typed error."""

from __future__ import annotations

from torch import Tensor

from ...errors import BackendError
from ..rules import View
from ..types import Gaussians, RasterOutput


def rasterize_cuda(gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False) -> RasterOutput:
    """Raise `BackendError`: not available yet."""
    raise BackendError("The CUDA rasteriser is not available here; use the backend 'torch' for tensors on a GPU.")
