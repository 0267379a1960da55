"""Drawing 3D Gaussians with color, cover, depth and feature channels, differentiable, on the CPU or a GPU.

    rasterize(gaussians, camera) -> RasterOutput(rgb, alpha, depth, features)

Map:
    api.py        checks, choice of the backend, `rasterize`, `rasterize_batch`, `available_backends`
    types.py      `Gaussians` in, `RasterOutput` out
    rules.py      the constants of 3DGS that all backends share, and a camera's numbers (`View`)
    motion.py     gradients for the camera's pose
    reference.py  backend "torch": plain PyTorch, any device and float type; the others are tested against it
    cpu/          backend "cpu": compiled with numba
        function.py    the PyTorch operation; calls the others in this order
        projection.py  Gaussians onto the picture plane, and the gradient of that
        binning.py     lists of Gaussians per tile, sorted by depth
        blocks.py      a tile's blocks of pixels: which Gaussian reaches which
        forward.py     blending of a tile
        backward.py    gradients of a tile, and their sums per Gaussian
        simd.py, threads.py, buffers.py, jit.py   vectors in kernels, threads, memory of pictures, how kernels compile
        count.py       how much work a drawing was, for `grmm bench`
    cuda/         backend "cuda": gsplat where that is installed, else own kernels without nvcc
        adapter.py     the choice between them; a check of the graphics card
        function.py    the PyTorch operation around the kernels
        kernels.cu     the kernels; source.py puts the constants in front of them
        compile.py, launch.py   NVRTC and the CUDA driver

Importing this package needs numpy only; torch, numba and gsplat are imported when a backend is used. Callers: the model's
renderer, training, fitting, sessions. It knows nothing of heads.
"""

from __future__ import annotations

from .api import BackendInfo, available_backends, choose_backend, rasterize, rasterize_batch
from .types import Gaussians, RasterOutput

__all__ = ["BackendInfo", "Gaussians", "RasterOutput", "available_backends", "choose_backend", "rasterize", "rasterize_batch"]
