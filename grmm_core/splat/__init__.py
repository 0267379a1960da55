"""Drawing 3D Gaussians with color, cover, depth and feature channels, differentiable, on the CPU or a GPU.

    rasterize(gaussians, camera) -> RasterOutput(rgb, alpha, depth, features)      tensors, any backend
    rasterize_arrays(gaussians, camera) -> PictureArrays(rgb, alpha, depth, features)   arrays, without torch

Map:
    api.py        checks, `rasterize`, `rasterize_arrays`
    backends.py   the table of backends, `available_backends`, `register_backend`
    types.py      `Gaussians` in, `RasterOutput` out; the same as arrays
    rules.py      the constants of 3DGS that all backends share, and a camera's numbers (`View`)
    motion.py     gradients for the camera's pose
    compensation.py   the opacities of antialiasing apart from a backend, for a part of a scene
    reference.py  backend "torch": plain PyTorch, any device and float type; the others are tested against it
    autograd.py   the PyTorch operation around a backend that has gradients of its own
    cpu/          backend "cpu": compiled with numba
        engine.py      the backend for PyTorch
        drawing.py     arrays in, arrays out, and gradients, without torch; calls the others in this order
        records.py     what stands where in the arrays that they share
        projection.py, projection_gradient.py  Gaussians onto the picture plane, and the gradient of that
        binning.py     lists of Gaussians per tile, sorted by depth
        tiling.py, blocks.py   a tile's blocks of pixels, and which Gaussian reaches which
        forward.py     blending of a tile
        backward.py    gradients of a tile, and their sums per Gaussian
        simd.py, jit.py   vectors in kernels, how kernels compile
        count.py       how much work a drawing was, for `grmm bench`
    cuda/         backend "cuda": gsplat where that is installed, else own kernels without nvcc
        adapter.py     the choice between them; a check of the graphics card
        drawing.py     drawing and gradients by the kernels
        kernels.cu     the kernels; source.py puts the constants in front of them
        compile.py, launch.py   NVRTC and the CUDA driver

Importing this package needs numpy only; torch, numba and gsplat are imported when a backend is used. Callers: the model's
renderer, training, fitting, sessions. It knows nothing of heads.
"""

from __future__ import annotations

from .api import rasterize, rasterize_arrays
from .backends import Backend, BackendInfo, available_backends, choose_backend, register_backend
from .types import GaussianArrays, Gaussians, PictureArrays, RasterOutput

__all__ = [
    "Backend",
    "BackendInfo",
    "GaussianArrays",
    "Gaussians",
    "PictureArrays",
    "RasterOutput",
    "available_backends",
    "choose_backend",
    "rasterize",
    "rasterize_arrays",
    "register_backend",
]
