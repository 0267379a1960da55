"""The training objective, eq. 15-18, and the terms that this project adds.

Every term is a pure function of tensors, so that tests can check it on its own; `total_loss` weighs them by `LossWeights`.
The fitting uses the same functions. Pictures are [H, W, 3] display sRGB.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import torch
from torch import Tensor

from ..errors import ShapeError
from .blur import blur

if TYPE_CHECKING:
    from ..model.grmm import Rendering
    from ..model.sparse import FixedSparse

SSIM_C1, SSIM_C2 = 0.01**2, 0.03**2  # for values 0..1
SCALE_MIN_MM, SCALE_MAX_MM = 0.1, 10.0  # eq. 18
OPAQUE = 0.9
_SCALE_EPSILON = 1e-7
_MM_PER_METRE = 1e3

TERMS = (
    "raw_l1", "raw_ssim", "raw_perceptual", "image_l1", "image_ssim", "image_perceptual", "depth", "alpha", "scale", "code",
    "laplacian", "position", "rotation", "log_scale", "vertices", "color", "opacity",
    "raw_detail", "image_detail",
)  # fmt: skip
"""Names of all terms that `total_loss` can return."""

Perceptual = Callable[[Tensor, Tensor], Tensor]


@dataclass(frozen=True)
class LossWeights:
    """Factors of the terms; zero switches a term off and saves its time.

    The first eight are the paper's (section 3.4); the others are additions.

    Attributes:
        l1, ssim, perceptual: Of the reconstruction loss, eq. 16, applied to the refined and to the splatted picture.
        depth: Mean squared depth error in squared decimetres (metres times 10), see `depth_loss`.
        scale: Range of the Gaussians' sizes, eq. 18.
        code: Squared length of z_id and z_exp.
        laplacian: Smoothness of the learned displacement.
        raw: Factor of the whole reconstruction loss of the splatted picture (paper: 1).
        alpha: L1 between the alpha and the mask.
        position, rotation, log_scale: Mean squared decoded offsets.
        vertices: Mean squared distance of the posed vertices from the true ones, square millimetres, where the data knows them.
        color: Mean squared excess of the Gaussians' colors beyond 0..1: such colors cancel out here and clip elsewhere.
        opacity: Mean of what the Gaussians' opacities lack to `OPAQUE`: keeps a surface from dissolving into fog.
        detail: L1 again of both pictures where eyes, teeth and the inner mouth are: few pixels that everybody looks at.
    """

    l1: float = 0.8
    ssim: float = 0.2
    perceptual: float = 0.04
    depth: float = 0.5
    scale: float = 0.1
    code: float = 0.001
    laplacian: float = 0.01
    raw: float = 1.0
    alpha: float = 0.0
    position: float = 0.0
    rotation: float = 0.0
    log_scale: float = 0.0
    vertices: float = 0.0
    color: float = 0.0
    opacity: float = 0.0
    detail: float = 0.0


@dataclass
class Target:
    """What a picture should be.

    Attributes:
        image: Over the same background as the rendering, [H, W, 3].
        mask: Coverage 0..1, [H, W], or None.
        depth: Metres, 0 where unknown or empty, [H, W], or None.
        vertices: Of the posed mesh, metres, [V, 3], or None.
        detail: Coverage 0..1 by eyes, teeth and inner mouth, [H, W], or None.
    """

    image: Tensor
    mask: Tensor | None = None
    depth: Tensor | None = None
    vertices: Tensor | None = None
    detail: Tensor | None = None


def total_loss(
    rendering: Rendering,
    target: Target,
    laplacian: Callable[[Tensor], Tensor],
    weights: LossWeights,
    refined: bool = True,
    perceptual: Perceptual | None = None,
) -> tuple[Tensor, dict[str, Tensor]]:
    """Eq. 15 and 17.

    Args:
        rendering: Of `GRMM.render`.
        target: Ground truth.
        laplacian: Operator of `vertex_laplacian`.
        weights: Factors.
        refined: Whether the refinement network ran; without it the splatted picture counts once.
        perceptual: Distance of two pictures, or None.

    Returns:
        The loss and its terms (unweighted, detached) by name.
    """
    terms: dict[str, tuple[float, Tensor]] = {}
    pictures = [("raw", rendering.raw, weights.raw if refined else 1.0)]
    if refined:
        pictures.append(("image", rendering.image, 1.0))
    for name, picture, factor in pictures:
        if factor:
            parts = reconstruction_terms(picture, target.image, weights, perceptual)
            terms |= {f"{name}_{part}": (factor * weight, value) for part, (weight, value) in parts.items()}
            if weights.detail and target.detail is not None:
                within = target.detail[..., None]
                terms[f"{name}_detail"] = (factor * weights.detail, l1_loss(picture * within, target.image * within))
    if weights.depth and target.depth is not None:
        terms["depth"] = (weights.depth, depth_loss(rendering.depth, rendering.alpha, target.depth))
    if weights.alpha and target.mask is not None:
        terms["alpha"] = (weights.alpha, l1_loss(rendering.alpha, target.mask))
    if weights.scale:
        terms["scale"] = (weights.scale, scale_loss(rendering.gaussians.scales * _MM_PER_METRE))
    if weights.code:
        terms["code"] = (weights.code, code_loss(rendering.inputs.z_id, rendering.inputs.z_exp))
    if weights.laplacian:
        terms["laplacian"] = (weights.laplacian, laplacian(rendering.mesh.displacement * _MM_PER_METRE).square().sum(-1).mean())
    for name, columns in (("position", slice(0, 3)), ("rotation", slice(3, 7)), ("log_scale", slice(7, 10))):
        factor = getattr(weights, name)
        if factor:
            terms[name] = (factor, rendering.offsets[:, columns].square().mean())
    if weights.vertices and target.vertices is not None:
        apart = (rendering.mesh.vertices - target.vertices) * _MM_PER_METRE
        terms["vertices"] = (weights.vertices, apart.square().sum(-1).mean())
    if weights.color:
        colors = rendering.gaussians.colors
        terms["color"] = (weights.color, (colors - colors.clamp(0, 1)).square().mean())
    if weights.opacity:
        terms["opacity"] = (weights.opacity, (OPAQUE - rendering.gaussians.opacities).clamp(min=0.0).mean())
    loss = torch.stack([factor * value for factor, value in terms.values()]).sum()
    return loss, {name: value.detach() for name, (_, value) in terms.items()}


def reconstruction_terms(
    picture: Tensor, truth: Tensor, weights: LossWeights, perceptual: Perceptual | None = None
) -> dict[str, tuple[float, Tensor]]:
    """The terms of L_rec, eq. 16, each with its factor: l1, and ssim and perceptual where they count.

    Args:
        picture: [H, W, 3].
        truth: [H, W, 3].
        weights: Of which l1, ssim and perceptual are read.
        perceptual: Distance of two pictures, or None.
    """
    terms = {"l1": (weights.l1, l1_loss(picture, truth))}
    if weights.ssim:
        terms["ssim"] = (weights.ssim, 1.0 - ssim(picture, truth))
    if weights.perceptual and perceptual is not None:
        terms["perceptual"] = (weights.perceptual, perceptual(picture, truth))
    return terms


def reconstruction_loss(picture: Tensor, truth: Tensor, weights: LossWeights, perceptual: Perceptual | None = None) -> Tensor:
    """L_rec, eq. 16: the weighted sum of `reconstruction_terms`."""
    terms = reconstruction_terms(picture, truth, weights, perceptual)
    return torch.stack([weight * value for weight, value in terms.values()]).sum()


def l1_loss(a: Tensor, b: Tensor) -> Tensor:
    """Mean absolute difference."""
    return (a - b).abs().mean()


def ssim(a: Tensor, b: Tensor) -> Tensor:
    """Mean structural similarity of two pictures [H, W, C] with values 0..1; see `ssim_map`."""
    return ssim_map(a, b).mean()


def ssim_map(a: Tensor, b: Tensor) -> Tensor:
    """Structural similarity at each pixel of two pictures [H, W, C], [C, H, W] (Gaussian window, sigma 1.5, 11 pixels).

    Windows that leave the picture are cut and renormalised.
    """
    if a.shape != b.shape or a.ndim != 3:
        raise ShapeError(f"SSIM compares two pictures [H, W, C]; these have shapes {tuple(a.shape)} and {tuple(b.shape)}.")
    channels = a.shape[2]
    planes = torch.cat([a, b, a * a + b * b, a * b], -1).permute(2, 0, 1)  # [4C, H, W]; s_a + s_b is all that is needed
    mean_a, mean_b, squares, product = blur(planes).split(channels)
    mean_product, mean_squares = mean_a * mean_b, mean_a.square() + mean_b.square()
    contrast = (2.0 * (product - mean_product) + SSIM_C2) / (squares - mean_squares + SSIM_C2)
    luminance = (2.0 * mean_product + SSIM_C1) / (mean_squares + SSIM_C1)
    return luminance * contrast


def depth_loss(depth: Tensor, alpha: Tensor, target: Tensor) -> Tensor:
    """L2 loss of the expected depth (eq. 15), in squared decimetres so that centimetres of error weigh like colors.

    Args:
        depth: Metres, [H, W].
        alpha: [H, W]; pixels that the model hardly covers have no depth of their own.
        target: Metres, 0 where unknown, [H, W].
    """
    valid = (target > 0) & (alpha.detach() > 0.5)
    if not valid.any():
        return depth.sum() * 0.0
    return ((depth - target)[valid] * 10.0).square().mean()


def scale_loss(scales: Tensor) -> Tensor:
    """Eq. 18 on sizes in millimetres, any shape: zero between 0.1 and 10."""
    small = 1.0 / scales.clamp(min=_SCALE_EPSILON)
    large = (scales - SCALE_MAX_MM).square()
    zero = torch.zeros_like(scales)
    return torch.where(scales < SCALE_MIN_MM, small, torch.where(scales > SCALE_MAX_MM, large, zero)).mean()


def code_loss(*codes: Tensor) -> Tensor:
    """L_z: mean over rows of the squared lengths of the codes, summed over the codes given."""
    return torch.stack([code.square().sum(-1).mean() for code in codes]).sum()


def vertex_laplacian(faces: Tensor, vertex_count: int) -> FixedSparse:
    """Uniform Laplacian of a mesh.

    Args:
        faces: [F, 3] int.
        vertex_count: V.

    Returns:
        A map from [V, 3] to each vertex minus the mean of its neighbours, [V, 3] (zero for loose vertices).
    """
    import numpy as np

    from ..model.sparse import FixedSparse

    f = faces.cpu().numpy().astype(np.int64)
    edges = np.concatenate([f[:, [0, 1]], f[:, [1, 2]], f[:, [2, 0]]])
    edges = np.unique(np.concatenate([edges, edges[:, ::-1]]), axis=0)
    degree = np.bincount(edges[:, 0], minlength=vertex_count)
    used = np.flatnonzero(degree)
    rows = np.concatenate([used, edges[:, 0]])
    columns = np.concatenate([used, edges[:, 1]])
    values = np.concatenate([np.ones(len(used)), -1.0 / degree[edges[:, 0]]])
    return FixedSparse((rows, columns, values), (vertex_count, vertex_count)).to(faces.device)


def psnr(a: Tensor, b: Tensor, mask: Tensor | None = None) -> float:
    """Peak signal-to-noise ratio in dB of pictures [H, W, C], inside `mask` [H, W] > 0.5 if given."""
    error = (a - b).square().mean(-1)
    if mask is not None:
        error = error[mask > 0.5]
    return psnr_of(float(error.mean()) if error.numel() else math.nan)


def psnr_of(mean_squared: float) -> float:
    """PSNR in dB of a mean squared error of values 0..1; infinite for zero."""
    return math.inf if mean_squared == 0.0 else -10.0 * math.log10(mean_squared)


def weights_from(values: dict[str, float]) -> LossWeights:
    """Build `LossWeights` from a table of a configuration file. Raises `ConfigError` for unknown names or bad numbers."""
    from ..errors import ConfigError

    known = {f.name for f in fields(LossWeights)}
    for name, value in values.items():
        good = isinstance(value, (int, float)) and not isinstance(value, bool) and math.isfinite(value) and value >= 0
        if name not in known or not good:
            raise ConfigError(f"The loss weight {name} = {value!r} is not usable; known are {', '.join(sorted(known))}.")
    return LossWeights(**{name: float(value) for name, value in values.items()})
