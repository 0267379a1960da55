"""What both stages minimise: decoded attributes drawn into a photo's camera, and the reconstruction loss of eq. 19 and 20.

A person's attributes can be changed between decoding and drawing (`Look`): stage 1 recolors them, stage 2 adds maps. The
loss is L_rec of the refined and of the splatted picture (eq. 16) over a plain background where the photo is a target, and the
L1 of the coverage, which keeps the outline.

Called by `color`, `codes`, `decoders`, `invert`. Imports torch.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from torch import Tensor

from ..geometry.camera import Camera
from ..model.grmm import GRMM, JAW, NECK, euler_to_rotvec
from ..splat import Gaussians, rasterize
from ..training.losses import LossWeights, Perceptual, l1_loss, ssim
from .views import FitView

_FEW_PIXELS = 0.2  # damps the step of Gaussians that hardly show
FIT_WEIGHTS = LossWeights(alpha=0.4)
"""The paper's factors of eq. 16, and one of the coverage (an addition; eq. 15 has the depth for it, which a photo lacks)."""


@dataclass(frozen=True)
class Look:
    """Decoded attributes of a person's Gaussians.

    Attributes:
        offsets: Position, rotation, log scale, [N, 10].
        logits: Of the opacities, [N].
        colors: Display sRGB, [N, 3].
        features: [N, F].
    """

    offsets: Tensor
    logits: Tensor
    colors: Tensor
    features: Tensor

    def detached(self) -> Look:
        """The same without gradients."""
        return Look(self.offsets.detach(), self.logits.detach(), self.colors.detach(), self.features.detach())

    def recolored(self, colors: Tensor) -> Look:
        """The same with other colors [N, 3]."""
        return replace(self, colors=colors)


@dataclass(frozen=True)
class Drawn:
    """A picture over black.

    Attributes:
        image: Refined, premultiplied, [H, W, 3].
        raw: Splatted, premultiplied, [H, W, 3].
        alpha: [H, W].
    """

    image: Tensor
    raw: Tensor
    alpha: Tensor

    def relit(self, gain: Tensor, offset: Tensor) -> Drawn:
        """The same under a photo's own exposure: gain [3] and offset [3] of the straight colors."""
        added = self.alpha[..., None] * offset
        return Drawn(self.image * gain + added, self.raw * gain + added, self.alpha)


def decode(model: GRMM, z_id: Tensor, z_exp: Tensor, camera: Camera) -> Look:
    """Attributes of codes z_id [Z], z_exp [Y] seen by a camera."""
    colors, features = model.appearance(z_id, model.view_direction(camera))
    colors = colors + model.expression_colors(z_id, z_exp)
    return Look(model.offsets(z_id, z_exp), model.decoders.opacity_logits(z_id), colors, features)


def mesh(model: GRMM, view: FitView, z_id: Tensor, z_exp: Tensor) -> Tensor:
    """Posed vertices with the learned displacement, [V, 3] metres."""
    turns = euler_to_rotvec(view.pose[[NECK, JAW]])
    expression = view.expression[None]
    displacement = model.displacement(z_id[None], z_exp[None], turns[:1], turns[1:], expression)
    return model.vertices(view.shape[None], expression, view.pose[None], displacement)[0]


def gaussians(model: GRMM, vertices: Tensor, look: Look) -> Gaussians:
    """Place a look on posed vertices [V, 3]."""
    placed = model.geometry(vertices, look.offsets)
    features = look.features if model.config.features else None
    return Gaussians(placed.means, placed.quats, placed.scales, torch.sigmoid(look.logits), look.colors, features)


def draw(model: GRMM, camera: Camera, vertices: Tensor, look: Look, refined: bool = True) -> Drawn:
    """Draw and refine (eq. 13 and 14); without refinement `image` is `raw` and the features are not even drawn."""
    scene = gaussians(model, vertices, look)
    if not refined:
        scene.features = None
    raster = rasterize(scene, camera)
    return Drawn(model.refine(raster) if refined else raster.rgb, raster.rgb, raster.alpha)


def fit_loss(
    drawn: Drawn, view: FitView, background: Tensor, weights: LossWeights, perceptual: Perceptual | None,
    pictures: tuple[str, ...] = ("image", "raw"),
) -> Tensor:  # fmt: skip
    """L_rec(I, I*) + L_rec(I_rgb, I*) and the coverage, where the photo is a target; nothing may cover clothes beside the bust.

    Args:
        drawn: Over black.
        view: The photo.
        background: Color put behind both, [3].
        weights: Factors.
        perceptual: Distance of two pictures, or None.
        pictures: Which of the two terms to compute; stage 2 takes them in turn, which halves the time of a step.
    """
    counts = view.weight[..., None]
    target = view.target(background) * counts
    behind = (1.0 - drawn.alpha)[..., None] * background
    total = weights.alpha * (l1_loss(drawn.alpha * view.weight, view.mask * view.weight) + (drawn.alpha * view.empty).mean())
    for name in pictures:
        shown = (getattr(drawn, name) + behind) * counts
        total = total + weights.l1 * l1_loss(shown, target) + weights.ssim * (1.0 - ssim(shown, target))
        if perceptual is not None and weights.perceptual:
            total = total + weights.perceptual * perceptual(shown, target)
    return total


def spread_to_colors(model: GRMM, view: FitView, vertices: Tensor, look: Look, picture: Tensor) -> Tensor:
    """Mean of a picture [H, W, C <= 3] over the pixels that each Gaussian contributes to, [N, C]: sum_p w_pi r_p / sum_p w_pi.

    Of the difference between photo and avatar this is a step that brings every Gaussian's color nearer at once (Jacobi's
    method for the least squares of colors; weights of a pixel sum to at most 1).
    """
    scene = gaussians(model, vertices.detach(), look.detached())
    width = picture.shape[-1]
    packed = torch.cat([picture, view.inside[..., None], torch.zeros_like(picture)], -1)[..., : width + 1]
    ones = torch.ones(len(scene), width + 1, dtype=model.dtype, device=model.device, requires_grad=True)
    with torch.enable_grad():
        raster = rasterize(replace(scene, features=ones), view.camera)
        (gradient,) = torch.autograd.grad((raster.features * packed).sum(), ones)
    return gradient[:, :width] / (gradient[:, width:] + _FEW_PIXELS)


def contributions(model: GRMM, view: FitView, vertices: Tensor, look: Look, pixels: Tensor) -> Tensor:
    """How many pixels each Gaussian contributes to: the derivative of the weighted picture by its color, [N].

    Args:
        model: Model.
        view: The photo.
        vertices: [V, 3].
        look: Attributes.
        pixels: Weight of each pixel, [H, W].
    """
    scene = gaussians(model, vertices.detach(), look.detached())
    ones = torch.ones(len(scene), 3, dtype=model.dtype, device=model.device, requires_grad=True)
    with torch.enable_grad():
        raster = rasterize(replace(scene, colors=ones, features=None), view.camera)
        (gradient,) = torch.autograd.grad((raster.rgb * pixels[..., None]).sum(), ones)
    return gradient[:, 0]
