"""Color and light: what of a photo's light an avatar keeps, and what is taken out.

What is baked: the first photo's light, exposure and white balance. One picture cannot tell a dark skin in bright light from a
light one in the shade, and the avatar must look as the person does there. So skin, hair and the inner parts each get an
affine map of the decoded colors (3 x 3 and an offset) that brings them to the photo's; it is solved in closed form, because
splatting is linear in color. Stage 2 turns it into a map of colors.

What is removed: the light of each further photo relative to the first, a factor of the colors that varies with the normals as
nine spherical harmonics (`PhotoLight`). What that does not explain goes where each photo shows it, into stage 2's map.

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

GAIN_RANGE = (0.2, 4.0)
HARMONICS = 9
_DARK, _LIGHT_RIDGE, _UNLIKELY = 0.03, 0.003, 0.2
_PULL = {SKIN: 0.004, SCALP: 0.004, INNER: 0.05}  # towards no change, as a share of the person's pixels
_OFFSET_PULL = 0.3  # of an offset, relative to the pull of the matrix
_ROUNDS, _SOFTENING = 3, 0.06  # of iterated weights: photos have glasses, hats, highlights
_MIN_PIXELS = 50.0
_COLUMNS = 4  # red, green, blue, one


@dataclass(frozen=True)
class PhotoLight:
    """Light of the photos relative to the first.

    A ratio r of light is r^(1/2.2) of display values, nearly, so that the factor is applied to these; its logarithm is a sum of
    harmonics, so that it is above 0 however they are found.

    Attributes:
        coefficients: Of the factor's logarithm, those of the first photo 0, [P, 9, 3].
    """

    coefficients: Tensor

    @staticmethod
    def even(count: int, like: Tensor) -> PhotoLight:
        """The light of `count` photos that do not differ."""
        return PhotoLight(like.new_zeros((count, HARMONICS, 3)))

    def gain(self, index: int, normals: Tensor) -> Tensor:
        """Factor of a photo's colors at unit normals in head space [..., 3]: [..., 3]."""
        return (harmonics(normals) @ self.coefficients[index]).exp().clamp(*GAIN_RANGE)


def harmonics(normals: Tensor) -> Tensor:
    """`photo_light.harmonics` of tensors, [..., 3] to [..., 9]."""
    x, y, z = normals.unbind(-1)
    ones = torch.ones_like(x)
    return torch.stack([ones, x, y, z, x * y, x * z, y * z, x * x - y * y, 3.0 * z * z - 1.0], -1)


@torch.no_grad()
def normal_picture(model: GRMM, view: FitView, vertices: Tensor, attributes: Attributes) -> Tensor:
    """Normals of the mesh in head space as a photo sees them, of length 1 or 0, [H, W, 3]."""
    scene = model.gaussians(vertices, attributes)
    scene.features = model.anchor(vertices).normals
    seen = present(rasterize(scene, view.camera, antialiased=model.config.antialias).features)
    return torch.nn.functional.normalize(seen, dim=-1)


def unchanged(like: Tensor) -> Tensor:
    """The maps that change nothing, [3, 4, 3]: rows are red, green, blue and the offset."""
    return torch.eye(_COLUMNS, 3, dtype=like.dtype, device=like.device).expand(GROUPS, -1, -1).clone()


def recolor(colors: Tensor, maps: Tensor, surface: Surface) -> Tensor:
    """Apply each group's map to colors [N, 3]."""
    own = maps[surface.group]  # [N, 4, 3]
    return torch.einsum("nc,ncd->nd", colors, own[:, :3]) + own[:, 3]


def solve_maps(
    model: GRMM, views: list[FitView], meshes: list[Tensor], decoded: list[Attributes], surface: Surface, gains: list[Tensor]
) -> Tensor:
    """The groups' color maps that bring the attributes nearest to the photos, robust least squares, [3, 4, 3].

    Args:
        model: Model.
        views: Photos.
        meshes: Posed vertices for each.
        decoded: Attributes for each.
        surface: Groups.
        gains: Factor of each photo's light, [H, W, 3] or anything that spreads to that.
    """
    rows, targets, counts = [], [], []
    for view, vertices, attributes, gain in zip(views, meshes, decoded, gains, strict=True):
        columns = torch.cat([attributes.colors, torch.ones_like(attributes.colors[:, :1])], 1)  # [N, 4]
        spread = (surface.membership[:, :, None] * columns[:, None]).flatten(1)  # [N, 12]
        scene = model.gaussians(vertices, attributes)
        scene.features = spread
        parts = present(rasterize(scene, view.camera, antialiased=model.config.antialias).features)  # [H, W, 12]
        inside = view.inside > 0.5
        parts, image = parts[inside], (view.image / gain)[inside]
        alpha = parts[:, 3::_COLUMNS].sum(1, keepdim=True)  # uncovered pixels of the person say nothing
        rows.append(parts)
        targets.append(image * alpha)
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
    """Light of each photo relative to the avatar's colors; that of the first is none by definition.

    Args:
        pictures: For each photo the view, the avatar's picture over black [H, W, 3] and `normal_picture` [H, W, 3].
    """
    light = PhotoLight.even(len(pictures), pictures[0][1])
    for view, picture, normals in pictures[1:]:
        inside = (view.inside > 0.5) & (normals.norm(dim=-1) > 0.5)
        if int(inside.sum()) < _MIN_PIXELS:
            continue
        ratio = ((view.image[inside] + _DARK) / (picture[inside].clamp(min=0.0) + _DARK)).log()
        columns = harmonics(normals[inside])
        ridge = torch.diag(columns.new_tensor([0.0] + [_LIGHT_RIDGE] * (HARMONICS - 1))) * len(columns)
        weight = torch.ones_like(ratio[:, :1])
        for _ in range(_ROUNDS):  # teeth, glints and shadows say little
            found = torch.linalg.solve(columns.T @ (weight * columns) + ridge, columns.T @ (weight * ratio))
            weight = 1.0 / (1.0 + ((columns @ found - ratio).norm(dim=1, keepdim=True) / _UNLIKELY) ** 2)
        light.coefficients[view.index] = found
    return light
