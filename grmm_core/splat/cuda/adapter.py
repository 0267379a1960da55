"""The backend "cuda", for tensors on a CUDA device: gsplat where it is installed with its compiled kernels, else our own.

`api.py` calls `rasterize_cuda`. Neither way has run on a graphics card in our tests, which have none; see `drawing.py` for
what is proven of our own kernels without one, and `check_device` for the check that `grmm info` makes where there is a card.
Known differences of gsplat from `rules.py`: it cuts a Gaussian at 3.33 standard deviations at most, bounds the expansion of the
perspective by the drawn region alone (`frame` has no effect), and has a guard of its own against dividing depth by zero.
"""

from __future__ import annotations

import functools
import importlib.util

import torch
from torch import Tensor

from ...errors import BackendError
from ...geometry.camera import Camera
from ..autograd import rasterize_with
from ..reference import drawable, rasterize_reference
from ..rules import DILATION, NEAR, View
from ..types import Gaussians, RasterOutput
from .drawing import CudaEngine
from .launch import device_kernels

CHECK_GAUSSIANS, CHECK_FEATURES, CHECK_SIZE = 300, 32, 64


@functools.cache
def gsplat_usable() -> bool:
    """Return whether gsplat is installed together with its compiled kernels (without these it would ask for nvcc)."""
    if importlib.util.find_spec("gsplat") is None:
        return False
    try:
        from gsplat.cuda import _backend
    except ImportError:
        return False
    return getattr(_backend, "_C", None) is not None


def rasterize_cuda(
    gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False
) -> RasterOutput[Tensor]:
    """Draw Gaussians on a CUDA device; arguments as in `reference.rasterize_reference`.

    Raises:
        BackendError: The tensors are not on a CUDA device, or neither gsplat nor the run-time compiler is there.
    """
    device = gaussians.means.device
    if device.type != "cuda":
        raise BackendError(f"The CUDA rasteriser needs tensors on a CUDA device; these are on {device}.")
    if gsplat_usable():
        return _rasterize_gsplat(gaussians, view, background, antialiased)
    kernels = device_kernels(device, 0 if gaussians.features is None else gaussians.features.shape[1])
    return rasterize_with(CudaEngine(kernels), gaussians, view, background, antialiased)


def check_device(device: torch.device) -> float:
    """Draw a small scene on a device and return the largest difference from the reference, pictures and gradients.

    Differences are relative to the largest value of each tensor. Takes seconds: the kernels are compiled.

    Raises:
        BackendError: It cannot be drawn there.
    """
    random = torch.Generator().manual_seed(0)
    sizes = ((3,), (4,), (3,), (), (3,), (CHECK_FEATURES,))
    parts = [torch.randn(CHECK_GAUSSIANS, *size, generator=random) for size in sizes]
    parts[0], parts[2], parts[3] = 0.1 * parts[0], 0.01 * parts[2].exp(), parts[3].sigmoid()
    view = View.of(Camera.orbit(CHECK_SIZE, CHECK_SIZE, distance=0.6, fov=25.0))
    results = []
    for there in (torch.device("cpu"), device):
        leaves = [part.to(there).requires_grad_() for part in parts]
        draw = rasterize_reference if there.type == "cpu" else rasterize_cuda
        out = draw(Gaussians(*leaves), view)
        pictures = [picture for picture in (out.rgb, out.alpha, out.depth, out.features) if picture is not None]
        gradients = torch.autograd.grad([picture.square().sum() for picture in pictures], leaves)
        results.append([tensor.detach().cpu() for tensor in (*pictures, *gradients)])
    return max(float((a - b).abs().max() / b.abs().max()) for b, a in zip(*results, strict=True))


def _rasterize_gsplat(gaussians: Gaussians, view: View, background: Tensor | None, antialiased: bool) -> RasterOutput[Tensor]:
    from gsplat import rasterization

    device = gaussians.means.device
    keep = drawable(gaussians).nonzero(as_tuple=True)[0]
    means, quats, scales = (tensor[keep].float() for tensor in (gaussians.means, gaussians.quats, gaussians.scales))
    opacities = gaussians.opacities[keep].float().clamp(max=1)
    values = [gaussians.colors[keep].float()]
    if gaussians.features is not None:
        values.append(gaussians.features[keep].float())
    world_to_camera = torch.eye(4, device=device)
    world_to_camera[:3, :3] = torch.as_tensor(view.rotation, dtype=torch.float32)
    world_to_camera[:3, 3] = torch.as_tensor(view.translation, dtype=torch.float32)
    intrinsics = torch.tensor([[view.fx, 0, view.cx], [0, view.fy, view.cy], [0, 0, 1]], dtype=torch.float32, device=device)
    picture, alpha, _ = rasterization(
        means,
        quats,
        scales,
        opacities,
        torch.cat(values, -1),  # [N, 3 + C]
        world_to_camera[None],
        intrinsics[None],
        view.width,
        view.height,
        near_plane=NEAR,
        eps2d=DILATION,
        render_mode="RGB+ED",
        rasterize_mode="antialiased" if antialiased else "classic",
        camera_model="ortho" if view.orthographic else "pinhole",
    )
    picture, alpha = picture[0], alpha[0, ..., 0]  # [H, W, 3 + C + 1], [H, W]
    rgb = picture[..., :3]
    if background is not None:
        rgb = rgb + (1 - alpha)[..., None] * background.float()
    depth = torch.where(alpha > 0, picture[..., -1], torch.zeros_like(alpha))
    return RasterOutput(rgb, alpha, depth, None if gaussians.features is None else picture[..., 3:-1])
