"""Drawing 3D Gaussians with colour, cover, depth and feature channels, differentiable, on the CPU or a GPU.

    rasterize(gaussians, camera) -> RasterOutput(rgb, alpha, depth, features)

Map:
    api.py        checks, choice of the backend, `rasterize`, `rasterize_batch`, `available_backends`
    types.py      `Gaussians` in, `RasterOutput` out
    rules.py      the constants of 3DGS that all backends share, and a camera's numbers (`View`)
    reference.py  backend "torch": plain PyTorch, any device and float type; the others are tested against it
    cpu/          backend "cpu": numba. function.py (autograd wrapper), projection.py, binning.py, forward.py, backward.py, jit.py
    cuda/         backend "cuda": adapter to gsplat, where that is installed

Importing this package needs numpy only; torch, numba and gsplat are imported when a backend is used. Callers: the model's
renderer, training, fitting, sessions. It knows nothing of heads.
"""

from __future__ import annotations

from .api import BackendInfo, available_backends, choose_backend, rasterize, rasterize_batch
from .types import Gaussians, RasterOutput

__all__ = ["BackendInfo", "Gaussians", "RasterOutput", "available_backends", "choose_backend", "rasterize", "rasterize_batch"]
