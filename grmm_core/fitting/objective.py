"""What both stages minimise: decoded attributes drawn into a photo's camera, and the reconstruction loss of eq. 19 and 20.

A person's `Attributes` are changed between decoding and drawing: stage 1 recolors them, stage 2 adds maps. The
loss is L_rec of the refined and of the splatted picture (eq. 16) over a plain background where the photo is a target, and the
L1 of the coverage, which keeps the outline.

Called by `recoloring`, `code_stage`, `decoder_stage`, `invert`. Imports torch.
"""

from __future__ import annotations

from dataclasses import replace

import torch
from torch import Tensor

from ..geometry.camera import Camera
from ..geometry.libraries import present
from ..light import relight
from ..model.grmm import GRMM, Attributes, Picture
from ..model.inputs import ModelInputs
from ..splat import rasterize
from ..training.losses import LossWeights, Perceptual, l1_loss, reconstruction_loss
from .photo_targets import FitView

_FEW_PIXELS = 0.2  # damps the step of Gaussians that hardly show
FIT_WEIGHTS = LossWeights(alpha=0.4)
"""The paper's factors of eq. 16, and one of the coverage (an addition; eq. 15 has the depth for it, which a photo lacks)."""


def photo_inputs(model: GRMM, view: FitView, z_id: Tensor, offset: Tensor) -> ModelInputs[Tensor]:
    """Inputs that draw a photo: its tracked frame with an identity code [Z] and an offset to the expression code [Y]."""
    return model.performed(z_id, view.shape, view.expression, view.pose, view.aligned, offset)


def decode(model: GRMM, inputs: ModelInputs[Tensor], camera: Camera) -> Attributes:
    """Attributes of all Gaussians with the colors that a camera's view direction gives them."""
    return model.attributes(inputs, model.view_direction(camera))


def relit(picture: Picture, light: Tensor) -> Picture:
    """A picture over black in a photo's own light (`recoloring.PhotoLight.picture`), [H, W, 3], as a session lights it."""
    spread = light * picture.alpha.detach()[..., None]
    raw = relight.relit(picture.raw, picture.alpha, spread)
    image = raw if picture.image is picture.raw else relight.relit(picture.image, picture.alpha, spread)
    return replace(picture, image=image, raw=raw)


def draw(model: GRMM, camera: Camera, vertices: Tensor, attributes: Attributes, refined: bool = True) -> Picture:
    """Place attributes on posed vertices [V, 3] and draw them over black (eq. 13 and 14), with colors 0..1 as sessions do.

    That is once they have what they lack (`GRMM.tones`): held before, lips could not be as light as a photo, and went on
    growing.
    """
    scene = model.gaussians(vertices, attributes)
    return model.draw(replace(scene, colors=scene.colors.clamp(0.0, 1.0)), camera, refined)


def fit_loss(
    drawn: Picture, view: FitView, background: Tensor, weights: LossWeights, perceptual: Perceptual | None,
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
    shown = drawn.over(background)
    total = weights.alpha * (l1_loss(drawn.alpha * view.weight, view.mask * view.weight) + (drawn.alpha * view.empty).mean())
    for name in pictures:
        picture = getattr(shown, name)
        total = total + reconstruction_loss((picture - view.excess(picture)) * counts, target, weights, perceptual)
    return total


def spread_to_colors(model: GRMM, view: FitView, vertices: Tensor, attributes: Attributes, picture: Tensor) -> Tensor:
    """Mean of a picture [H, W, C <= 3] over the pixels that each Gaussian contributes to, [N, C]: sum_p w_pi r_p / sum_p w_pi.

    Of the difference between photo and avatar this is a step that brings every Gaussian's color nearer at once (Jacobi's
    method for the least squares of colors; weights of a pixel sum to at most 1).
    """
    scene = model.gaussians(vertices.detach(), attributes.detached())
    width = picture.shape[-1]
    packed = torch.cat([picture, view.inside[..., None], torch.zeros_like(picture)], -1)[..., : width + 1]
    ones = torch.ones(len(scene), width + 1, dtype=model.dtype, device=model.device, requires_grad=True)
    with torch.enable_grad():
        raster = rasterize(replace(scene, features=ones), view.camera, antialiased=model.config.antialias)
        (gradient,) = torch.autograd.grad((present(raster.features) * packed).sum(), ones)
    return gradient[:, :width] / (gradient[:, width:] + _FEW_PIXELS)


def contributions(model: GRMM, view: FitView, vertices: Tensor, attributes: Attributes, pixels: Tensor) -> Tensor:
    """How many pixels each Gaussian contributes to: the derivative of the weighted picture by its color, [N].

    Args:
        model: Model.
        view: The photo.
        vertices: [V, 3].
        attributes: Of the Gaussians.
        pixels: Weight of each pixel, [H, W].
    """
    scene = model.gaussians(vertices.detach(), attributes.detached())
    ones = torch.ones(len(scene), 3, dtype=model.dtype, device=model.device, requires_grad=True)
    with torch.enable_grad():
        raster = rasterize(replace(scene, colors=ones, features=None), view.camera, antialiased=model.config.antialias)
        (gradient,) = torch.autograd.grad((raster.rgb * pixels[..., None]).sum(), ones)
    return gradient[:, 0]
