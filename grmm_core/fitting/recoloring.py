"""Color and light: what of a photo's light an avatar keeps, and what is taken out.

What is kept is the exposure and white balance of the first photo: one picture cannot tell a dark skin in bright light from a
light one in the shade, and the avatar must look as the person does there. So skin, hair and the inner parts each get an
affine map of the decoded colors (3 x 3 and an offset) that brings them to the photo's; it is solved in closed form, because
splatting is linear in color. Stage 2 turns it into a map of colors.

What is taken out is the light of every photo (`photo_light`): the avatar's colors are flat, and pictures are compared with a
photo in its light (`PhotoLight`). What that does not explain goes where each photo shows it, into stage 2's map.

Called by `code_stage` and `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from ..geometry.libraries import as_like, present, to_numpy
from ..light.mesh_light import FRONT, LitSurface, TexelGrid
from ..light.relight import unlit
from ..light.resting import even_mouth, texel_grid
from ..model.grmm import GRMM, Attributes
from ..pictures.color import MIN_ALPHA
from ..splat import rasterize
from .photo_targets import FitView
from .surface import GROUPS, INNER, SCALP, SKIN, Surface

_PULL = {SKIN: 0.004, SCALP: 0.004, INNER: 0.05}  # towards no change, as a share of the person's pixels
_OFFSET_PULL = 0.3  # of an offset, relative to the pull of the matrix
DIM = (0.2, 0.5)  # of the rig's light: below the first colors are not believed, above the second wholly
_ROUNDS, _SOFTENING = 3, 0.06  # of iterated weights: photos have glasses, hats, highlights
_TOLD = 0.2  # of a photo's pixels that tell their color; where fewer do, all are believed
_MIN_PIXELS = 50.0
_COLUMNS = 4  # red, green, blue, one
_CHANNELS = (0, 1, 2, FRONT)  # of a session's light: of the others, highlights, a photo's light has none


@dataclass(frozen=True)
class PhotoLight:
    """Light of the photos at the texels.

    Attributes:
        spread: Irradiance relative to the rig's times how much a texel counts at a pixel, and that, [P, N, 4].
        grid: Where the texels lie on the mesh.
        trust: How much each photo tells of colors beside the one whose light is known best, 0..1, [P].
        told: How far each tells each texel's color by what it shows there, 0..1, [P, N].
    """

    spread: Tensor
    grid: TexelGrid
    trust: Tensor
    told: Tensor

    @staticmethod
    def of(model: GRMM, spread: np.ndarray, trust: np.ndarray) -> PhotoLight:
        """On a model's texels, of `spread` [P, N, 4] and `trust` [P]."""
        layout = model.layout
        grid = texel_grid(model.head_model, layout.uv, layout.grid, layout.texel)
        first, second = (torch.as_tensor(part, dtype=model.dtype, device=model.device) for part in (spread, trust))
        return PhotoLight(first, grid, second, torch.ones_like(first[..., 0]))

    def ratios(self) -> np.ndarray:
        """Irradiance relative to the rig's, [P, N, 3]."""
        spread = to_numpy(self.spread)
        ratios: np.ndarray = spread[..., :3] / spread[..., 3:]
        return ratios

    def times(
        self, factor: np.ndarray, told: np.ndarray, mouth: tuple[np.ndarray, np.ndarray], known: Sequence[bool]
    ) -> PhotoLight:  # fmt: skip
        """The light times a factor at the texels, [P, N, 3], with `told` [P, N].

        That in mouths, with rows as of `mouth_rows`, is the lips' again in photos whose light is known, as sessions have it.
        """
        spread = to_numpy(self.spread).copy()
        spread[..., :3] *= factor
        for photo, found in zip(spread, known, strict=True):
            if found:
                even_mouth(*mouth, photo, 3)
        return PhotoLight(as_like(spread, self.spread), self.grid, self.trust, as_like(told, self.spread))

    def tells(self, index: int) -> Tensor:
        """How far a photo tells the texels' colors, 0..1, [N]: in deep shadow, which light is never known well, it does not."""
        ratio = self.spread[index, :, :3] / self.spread[index, :, 3:]
        return ((ratio.amin(-1) - DIM[0]) / (DIM[1] - DIM[0])).clamp(0, 1) * self.told[index]

    @torch.no_grad()
    def picture(self, model: GRMM, view: FitView, vertices: Tensor, attributes: Attributes) -> Tensor:
        """A photo's light at its pixels as a session has it there, from the mesh (`light.mesh_light`), [H, W, 3]; 1 beside."""
        scene = model.gaussians(vertices, attributes)
        scene.features = self.spread[view.index]
        drawn = rasterize(scene, view.camera, antialiased=model.config.antialias)
        channels = np.zeros((*drawn.alpha.shape, FRONT + 1), np.float32)
        texels = np.zeros((len(scene), FRONT + 1), np.float32)
        channels[..., _CHANNELS], texels[:, _CHANNELS] = to_numpy(present(drawn.features)), to_numpy(scene.features)
        depth, alpha = to_numpy(drawn.depth), to_numpy(drawn.alpha)
        surface = LitSurface(self.grid, to_numpy(vertices), texels)
        surface.read_into(channels, slice(0, FRONT + 1), depth, alpha, None, view.camera)
        light = channels[..., :3] / channels[..., FRONT:].clip(MIN_ALPHA, None)
        return as_like(np.where(alpha[..., None] > MIN_ALPHA, light, 1.0), drawn.alpha)


def unchanged(like: Tensor) -> Tensor:
    """The maps that change nothing, [3, 4, 3]: rows are red, green, blue and the offset."""
    return torch.eye(_COLUMNS, 3, dtype=like.dtype, device=like.device).expand(GROUPS, -1, -1).clone()


def recolor(colors: Tensor, maps: Tensor, surface: Surface) -> Tensor:
    """Apply each group's map to colors [N, 3]."""
    own = maps[surface.group]  # [N, 4, 3]
    return torch.einsum("nc,ncd->nd", colors, own[:, :3]) + own[:, 3]


def solve_maps(
    model: GRMM, views: list[FitView], meshes: list[Tensor], decoded: list[Attributes], surface: Surface, lights: list[Tensor],
    trust: Tensor,
) -> Tensor:  # fmt: skip
    """The groups' color maps that bring the attributes nearest to the photos, robust least squares, [3, 4, 3].

    Args:
        model: Model.
        views: Photos.
        meshes: Posed vertices for each.
        decoded: Attributes for each.
        surface: Groups.
        lights: `PhotoLight.picture` of each.
        trust: `PhotoLight.trust` of each, [P].
    """
    rows, targets, counts = [], [], []
    for view, vertices, attributes, light, counted in zip(views, meshes, decoded, lights, trust, strict=True):
        columns = torch.cat([attributes.colors, torch.ones_like(attributes.colors[:, :1])], 1)  # [N, 4]
        spread = (surface.membership[:, :, None] * columns[:, None]).flatten(1)  # [N, 12]
        scene = model.gaussians(vertices, attributes)
        scene.features = spread
        parts = present(rasterize(scene, view.camera, antialiased=model.config.antialias).features)  # [H, W, 12]
        inside = view.inside > 0.5
        told = inside & (view.clear > 0.5)
        inside = told if int(told.sum()) > _TOLD * int(inside.sum()) else inside
        parts, image = parts[inside], unlit(view.image[inside], light[inside])
        alpha = parts[:, 3::_COLUMNS].sum(1, keepdim=True)  # uncovered pixels of the person say nothing
        rows.append(parts)
        targets.append(image * alpha)
        counts.append(alpha[:, 0] * counted)
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
