"""The backend "cuda": hands Gaussians to gsplat, where that is installed. `api.py` calls it for tensors on a CUDA device.

It follows the documentation of gsplat's `rasterization` and has not been run in our tests, which have no CUDA device.
Known differences from `rules.py`: gsplat cuts a Gaussian at 3.33 standard deviations at most, bounds the expansion of the
perspective by the drawn region alone (`frame` has no effect), and has a guard of its own against dividing depth by zero.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ...errors import BackendError
from ..reference import drawable
from ..rules import DILATION, NEAR, View
from ..types import Gaussians, RasterOutput


def rasterize_cuda(
    gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False
) -> RasterOutput:
    """Draw Gaussians with gsplat; arguments as in `reference.rasterize_reference`.

    Raises:
        BackendError: gsplat is not installed, or the tensors are not on a CUDA device.
    """
    try:
        from gsplat import rasterization
    except ImportError as error:
        raise BackendError("The CUDA rasteriser needs gsplat: install it, or use the backend 'torch'.") from error
    device = gaussians.means.device
    if device.type != "cuda":
        raise BackendError(f"The CUDA rasteriser needs tensors on a CUDA device; these are on {device}.")

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
