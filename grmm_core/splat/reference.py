"""The rasteriser in plain PyTorch: any device, any floating type, differentiated by autograd.

The readable twin of the compiled backends; tests hold these to it. `api.rasterize` calls it as the backend "torch". It walks
over square blocks, blends each block's Gaussians as one [pixels, Gaussians] matrix, and recomputes that matrix in the backward
pass, so that memory stays at one block's matrix. Imports neither numba nor gsplat.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.utils.checkpoint import checkpoint

from ..geometry.rotations import quaternion_to_matrix
from .rules import ALPHA_MIN, COMPENSATION_MIN, DILATION, NEAR, TRANSMITTANCE_MIN, View
from .types import Gaussians, RasterOutput

MATRIX_ELEMENTS = 1 << 22  # entries of the largest [pixels, Gaussians] matrix held at a time
BLOCK = 32  # pixels: edge of the blocks that share one matrix


@dataclass
class Projected:
    """Gaussians on the picture plane; V of them can be seen, nearest first.

    Attributes:
        centres: [V, 2] pixels.
        conics: [V, 3] entries xx, xy, yy of the inverse of the dilated covariance, 1 / px^2.
        extents: [V, 2] half width and half height of the region where alpha reaches its threshold, pixels.
        depths: [V] camera z, metres.
        opacities: [V], after compensation.
        index: [V] int64, position in the input.
    """

    centres: Tensor
    conics: Tensor
    extents: Tensor
    depths: Tensor
    opacities: Tensor
    index: Tensor


def drawable(gaussians: Gaussians) -> Tensor:
    """Return the mask [N] of Gaussians whose numbers are all finite and whose quaternion has a length."""
    mask = gaussians.quats.square().sum(-1) > 0
    for tensor in (gaussians.means, gaussians.quats, gaussians.scales, gaussians.colors, gaussians.features):
        if tensor is not None:
            mask = mask & tensor.isfinite().all(-1)
    return mask & gaussians.opacities.isfinite()


def depth_keys(means: Tensor, view: View) -> Tensor:
    """Return the depths [N] as float32 by which all backends sort; computed in float64 so that they agree on ties."""
    axis = torch.as_tensor(view.rotation[2], device=means.device)
    return (means.double() @ axis + float(view.translation[2])).float()


def project(gaussians: Gaussians, view: View, antialiased: bool) -> Projected:
    """Project Gaussians onto the picture plane (EWA; 3DGS eq. 5) and keep those that can be seen, sorted by depth.

    Args:
        gaussians: The scene.
        view: The camera.
        antialiased: Scale opacities by sqrt(det / det_dilated), as Mip-Splatting does.
    """
    dtype, device = gaussians.means.dtype, gaussians.means.device
    keep = drawable(gaussians) & (depth_keys(gaussians.means.detach(), view) >= NEAR)
    index = keep.nonzero(as_tuple=True)[0]
    means, quats = gaussians.means[index], gaussians.quats[index]  # [V, 3], [V, 4]
    scales, opacities = gaussians.scales[index], gaussians.opacities[index].clamp(max=1)  # [V, 3], [V]

    rotation = torch.as_tensor(view.rotation, dtype=dtype, device=device)
    translation = torch.as_tensor(view.translation, dtype=dtype, device=device)
    x, y, z = (means @ rotation.T + translation).unbind(-1)
    one, zero = torch.ones_like(z), torch.zeros_like(z)
    if view.orthographic:
        centres = torch.stack([view.fx * x + view.cx, view.fy * y + view.cy], -1)
        jacobian = torch.stack([torch.stack([view.fx * one, zero, zero], -1), torch.stack([zero, view.fy * one, zero], -1)], -2)
    else:
        low_x, high_x, low_y, high_y = view.clamp.tolist()
        u, v = x / z, y / z
        centres = torch.stack([view.fx * u + view.cx, view.fy * v + view.cy], -1)
        u, v = u.clamp(low_x, high_x), v.clamp(low_y, high_y)
        jacobian = torch.stack(
            [
                torch.stack([view.fx / z, zero, -view.fx * u / z], -1),
                torch.stack([zero, view.fy / z, -view.fy * v / z], -1),
            ],
            -2,
        )
    # Rows of W = J R V with V = rotation * scales; the covariance is W W^T, its determinant |W0 x W1|^2 free of cancellation.
    spread = jacobian @ rotation @ (quaternion_to_matrix(quats) * scales[:, None, :])  # [V, 2, 3]
    first, second = spread.unbind(-2)
    a, b, c = first.square().sum(-1), (first * second).sum(-1), second.square().sum(-1)
    det = torch.linalg.cross(first, second).square().sum(-1)
    det_dilated = det + DILATION * (a + c) + DILATION**2
    a, c = a + DILATION, c + DILATION
    conics = torch.stack([c, -b, a], -1) / det_dilated[:, None]
    if antialiased:
        opacities = opacities * (det / det_dilated).clamp(min=COMPENSATION_MIN).sqrt()

    with torch.no_grad():
        # alpha >= ALPHA_MIN where d^T conic d <= 2 ln(opacity / ALPHA_MIN); its bounding box follows from the covariance.
        reach = 2 * (opacities / ALPHA_MIN).clamp(min=1e-30).log()
        extents = (reach.clamp(min=0)[:, None] * torch.stack([a, c], -1)).sqrt()
        low, high = centres - extents, centres + extents
        seen = (reach > 0) & conics.isfinite().all(-1) & centres.isfinite().all(-1) & extents.isfinite().all(-1)
        seen &= (high[:, 0] > 0) & (low[:, 0] < view.width) & (high[:, 1] > 0) & (low[:, 1] < view.height)
        chosen = seen.nonzero(as_tuple=True)[0]
        order = torch.argsort(depth_keys(means, view)[chosen], stable=True)  # ties stay in the order of their index
        chosen = chosen[order]
    return Projected(centres[chosen], conics[chosen], extents[chosen], z[chosen], opacities[chosen], index[chosen])


def blend(pixels: Tensor, centres: Tensor, conics: Tensor, opacities: Tensor, channels: Tensor) -> tuple[Tensor, Tensor]:
    """Blend Gaussians front to back.

    Args:
        pixels: [P, 2] pixel centres.
        centres: [M, 2] pixels, nearest first.
        conics: [M, 3].
        opacities: [M].
        channels: [M, K] values to blend.

    Returns:
        Sums of weight times value [P, K], and the transmittance left [P].
    """
    dx, dy = (pixels[:, None, :] - centres[None]).unbind(-1)  # [P, M]
    power = 0.5 * (conics[:, 0] * dx * dx + conics[:, 2] * dy * dy) + conics[:, 1] * dx * dy
    alpha = opacities * torch.exp(-power)
    alpha = torch.where(alpha >= ALPHA_MIN, alpha, torch.zeros_like(alpha))
    # Transmittance only falls, so the Gaussian that ends a pixel is the first whose own step goes below the limit: it covers
    # all that is left, and nothing passes to those behind it.
    ends = torch.cumprod(1 - alpha.detach(), dim=1) < TRANSMITTANCE_MIN  # [P, M], from that Gaussian on
    alpha = torch.where(ends, torch.ones_like(alpha), alpha)
    through = torch.cumprod(1 - alpha, dim=1)  # after each Gaussian
    before = torch.cat([torch.ones_like(through[:, :1]), through[:, :-1]], dim=1)
    return (alpha * before) @ channels, through[:, -1]


def rasterize_reference(
    gaussians: Gaussians, view: View, background: Tensor | None = None, antialiased: bool = False
) -> RasterOutput[Tensor]:
    """Draw Gaussians.

    Args:
        gaussians: The scene, validated.
        view: The camera.
        background: [3] or [H, W, 3] colors behind the scene; black when None.
        antialiased: Mip-Splatting's opacity compensation.
    """
    means = gaussians.means
    features = gaussians.features
    projected = project(gaussians, view, antialiased)
    channels = [gaussians.colors[projected.index], projected.depths[:, None]]
    if features is not None:
        channels.append(features[projected.index])
    values = torch.cat(channels, -1)  # [V, K]: color, depth, features
    low = (projected.centres - projected.extents).detach() - 0.5  # half a pixel of margin for rounding
    high = (projected.centres + projected.extents).detach() + 0.5

    rows = []
    for top in range(0, view.height, BLOCK):
        bottom = min(top + BLOCK, view.height)
        in_row = (high[:, 1] >= top) & (low[:, 1] <= bottom)
        blocks = []
        for left in range(0, view.width, BLOCK):
            right = min(left + BLOCK, view.width)
            hits = (in_row & (high[:, 0] >= left) & (low[:, 0] <= right)).nonzero(as_tuple=True)[0]
            total, through = _block(projected, values, hits, (left, top, right, bottom))
            blocks.append(torch.cat([total, through[:, None]], -1).reshape(bottom - top, right - left, -1))
        rows.append(torch.cat(blocks, 1))
    # An empty picture, too, is a function of the Gaussians: a loss of it can be differentiated.
    picture = torch.cat(rows, 0) + 0 * values.sum()  # [H, W, K + 1]

    through = picture[..., -1]
    alpha = 1 - through
    covered = alpha > 0
    depth = torch.where(covered, picture[..., 3] / torch.where(covered, alpha, torch.ones_like(alpha)), torch.zeros_like(alpha))
    rgb = picture[..., :3]
    if background is not None:
        rgb = rgb + through[..., None] * background.to(means)
    return RasterOutput(rgb, alpha, depth, None if features is None else picture[..., 4:-1])


def _block(projected: Projected, values: Tensor, hits: Tensor, box: tuple[int, int, int, int]) -> tuple[Tensor, Tensor]:
    """Blend the Gaussians `hits` [M] over the pixels of `box` (left, top, right, bottom): sums [P, K], transmittance [P]."""
    left, top, right, bottom = box
    pixel_count = (right - left) * (bottom - top)
    if len(hits) == 0:
        return values.new_zeros(pixel_count, values.shape[1]), values.new_ones(pixel_count)
    ys, xs = torch.meshgrid(
        torch.arange(top, bottom, dtype=values.dtype, device=values.device),
        torch.arange(left, right, dtype=values.dtype, device=values.device),
        indexing="ij",
    )
    pixels = torch.stack([xs.reshape(-1), ys.reshape(-1)], -1) + 0.5
    inputs = (projected.centres[hits], projected.conics[hits], projected.opacities[hits], values[hits])
    remember = torch.is_grad_enabled() and any(tensor.requires_grad for tensor in inputs)
    parts = []
    for some in pixels.split(max(1, MATRIX_ELEMENTS // len(hits))):
        if remember:
            parts.append(checkpoint(blend, some, *inputs, use_reentrant=False))
        else:
            parts.append(blend(some, *inputs))
    return torch.cat([total for total, _ in parts]), torch.cat([through for _, through in parts])
