"""Color and light: what of a photo's light an avatar keeps, and what is taken out.

What is baked: the first photo's light, exposure and white balance. One picture cannot tell a dark skin in bright light from a
light one in the shade, and the avatar must look as the person does there. So skin, hair and the inner parts each get an
affine map of the decoded colors (3 x 3 and an offset) that brings them to the photo's; it is solved in closed form, because
splatting is linear in color. Stage 2 turns it into a map of colors.

What is removed: the difference of each further photo from the first, a gain and an offset a channel (`PhotoLight`).
What is left of the light (its direction) goes where each photo shows it, into stage 2's map.

Called by `code_stage` and `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from ..geometry.libraries import present
from ..model.grmm import GRMM, Attributes
from ..splat import rasterize
from .photo_targets import FitView
from .surface import GROUPS, INNER, SCALP, SKIN, Surface

GAIN_RANGE = (0.4, 2.5)
OFFSET_LIMIT = 0.3
_PULL = {SKIN: 0.004, SCALP: 0.004, INNER: 0.05}  # towards no change, as a share of the person's pixels
_OFFSET_PULL = 0.3  # of an offset, relative to the pull of the matrix
_ROUNDS, _SOFTENING = 3, 0.06  # of iterated weights: photos have glasses, hats, highlights
_MIN_PIXELS = 50.0
_COLUMNS = 4  # red, green, blue, one


@dataclass(frozen=True)
class PhotoLight:
    """Exposure of the photos relative to the first.

    Attributes:
        gain: [P, 3]. offset: [P, 3].
    """

    gain: Tensor
    offset: Tensor

    @staticmethod
    def even(count: int, like: Tensor) -> PhotoLight:
        """The exposure of `count` photos that do not differ: gain 1, offset 0."""
        return PhotoLight(like.new_ones((count, 3)), like.new_zeros((count, 3)))


def unchanged(like: Tensor) -> Tensor:
    """The maps that change nothing, [3, 4, 3]: rows are red, green, blue and the offset."""
    return torch.eye(_COLUMNS, 3, dtype=like.dtype, device=like.device).expand(GROUPS, -1, -1).clone()


def recolor(colors: Tensor, maps: Tensor, surface: Surface) -> Tensor:
    """Apply each group's map to colors [N, 3]."""
    own = maps[surface.group]  # [N, 4, 3]
    return torch.einsum("nc,ncd->nd", colors, own[:, :3]) + own[:, 3]


def solve_maps(
    model: GRMM, views: list[FitView], meshes: list[Tensor], decoded: list[Attributes], surface: Surface, light: PhotoLight
) -> Tensor:
    """The groups' color maps that bring the attributes nearest to the photos, robust least squares, [3, 4, 3].

    Args:
        model: Model.
        views: Photos.
        meshes: Posed vertices for each.
        decoded: Attributes for each.
        surface: Groups.
        light: Exposure that each photo adds.
    """
    rows, targets, counts = [], [], []
    for view, vertices, attributes in zip(views, meshes, decoded, strict=True):
        columns = torch.cat([attributes.colors, torch.ones_like(attributes.colors[:, :1])], 1)  # [N, 4]
        spread = (surface.membership[:, :, None] * columns[:, None]).flatten(1)  # [N, 12]
        scene = model.gaussians(vertices, attributes)
        scene.features = spread
        parts = present(rasterize(scene, view.camera, antialiased=model.config.antialias).features)  # [H, W, 12]
        inside = view.inside > 0.5
        gain, offset = light.gain[view.index], light.offset[view.index]
        parts, image = parts[inside], view.image[inside]
        alpha = parts[:, 3::_COLUMNS].sum(1, keepdim=True)  # uncovered pixels of the person say nothing
        rows.append(parts)
        targets.append((image - offset) / gain * alpha)
        counts.append(alpha[:, 0])
    a, b, count = torch.cat(rows).double(), torch.cat(targets).double(), torch.cat(counts).double()
    identity = unchanged(a).flatten(0, 1)  # [12, 3]
    if float(count.sum()) < _MIN_PIXELS:
        return unchanged(meshes[0])
    pull = torch.tensor([_PULL[g] * (1.0 if c < 3 else _OFFSET_PULL) for g in range(GROUPS) for c in range(_COLUMNS)])
    ridge = torch.diag(pull.to(a) * count.sum())
    solution = identity
    for _ in range(_ROUNDS):
        residual = (a @ solution - b).norm(dim=1)
        weight = (count / (residual + _SOFTENING) * _SOFTENING)[:, None]
        solution = torch.linalg.solve(a.T @ (weight * a) + ridge, a.T @ (weight * b) + ridge @ identity)
    return solution.view(GROUPS, _COLUMNS, 3).to(meshes[0])


def solve_light(pictures: list[tuple[FitView, Tensor, Tensor]]) -> PhotoLight:
    """Exposure of each photo relative to the avatar's colors; that of the first is none by definition.

    Args:
        pictures: For each photo the view, the avatar's picture over black [H, W, 3] and its coverage [H, W].
    """
    light = PhotoLight.even(len(pictures), pictures[0][1])
    for view, picture, alpha in pictures[1:]:
        inside = (view.inside > 0.5) & (alpha > 0.5)
        if int(inside.sum()) < _MIN_PIXELS:
            continue
        ours, photo = picture[inside], view.image[inside]
        mean, wanted = ours.mean(0), photo.mean(0)
        gain = (photo.std(0) / ours.std(0).clamp(min=1e-4)).clamp(*GAIN_RANGE)
        light.gain[view.index] = gain
        light.offset[view.index] = (wanted - gain * mean).clamp(-OFFSET_LIMIT, OFFSET_LIMIT)
    return light
