"""Strands on one posed head without a session, and the pigments that make them look as in a picture. Imports torch.

Used where a person's hair comes from pictures: photos (`fitting.hair_stage`) and captures (`training.captured_hair`).
"""

from __future__ import annotations

import functools
import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch.nn import functional

from ..geometry.camera import Camera
from ..splat.api import rasterize, rasterize_arrays
from ..splat.types import GaussianArrays, Gaussians
from .body import on_person
from .drawing import Hiding, StrandGaussians, level_shares, strand_gaussians
from .groom import Groom
from .ready import ready
from .ribbons import Eye
from .roots import BEARD, SCALP
from .settings import HairSettings
from .strands import DENSE

if TYPE_CHECKING:
    from ..head import HeadModel

COLOR_SIDE = 256  # pixels of the picture whose colors are compared
_FULL = 0.8  # cover from which a pixel shows nothing but hair
_SOME = 0.4  # likewise where there are few of these
_FEW_PIXELS, _FEWEST = 20, 8  # of hair; of thin brows
_BARE, _NEAR = 0.05, 0.02  # cover below which a pixel is skin, and how near to hair that is looked for, of the picture's height
_CLOSED, _MOST_BETWEEN = 0.1, 0.35  # share of skin between strands below which none shows, and what is believed of it
_LONG = (0.009, 0.018)  # metres: lengths of strands on the face between which less and less skin shows
_AS_DARK = 0.25  # quantile of the colors of a beard's pixels: what is found for its hair alone is not darker
_PULL = 2e-3  # towards pigment alone, where grey and red explain a color as well
_ROUNDS = 4  # of finding a dye
UNLIKELY = 0.02  # of a display color; if no pigment comes nearer, hair is dyed
# share of what strands cover that a photo must show as hair to tell of red or dye: fewer pixels take color from beside
_TELLING = 0.1
MARGIN = 0.3  # of the head's height, around it


@dataclass(frozen=True, eq=False)
class HairView:
    """What one photo says about hair.

    Attributes:
        camera: In head space.
        vertices: Of the tracked head, posed, [V, 3].
        image: Display sRGB, [H, W, 3].
        hair: How much of each pixel is scalp hair, [H, W] 0..1.
        counts: 0 where the photo says nothing (beyond its edge, behind a hat or a hand), [H, W].
    """

    camera: Camera
    vertices: np.ndarray
    image: np.ndarray
    hair: np.ndarray
    counts: np.ndarray


def hiding_faces(head: HeadModel) -> np.ndarray:
    """Triangles behind which hair cannot be seen: all but lashes, [F, 3]."""
    faces: np.ndarray = np.asarray(head.faces)
    return faces[~head.marked("lashes")[faces].any(1)]


def around_head(view: HairView) -> HairView:
    """The part of a picture that a head with hair can fill."""
    _, pixels = view.camera.project(view.vertices)
    low, high = pixels.min(0), pixels.max(0)
    return _around(view, low, high, MARGIN * float(high[1] - low[1]))


def _around_hair(view: HairView) -> HairView:
    """The part of a picture that shows hair, as brows: a few pixels of a whole head."""
    rows, columns = np.nonzero(view.hair > _SOME)
    if not len(rows):
        return view
    low, high = (np.array([edge(columns), edge(rows)]) for edge in (np.min, np.max))
    return _around(view, low, high, max(MARGIN * float((high - low).max()), _FEW_PIXELS))


def _around(view: HairView, low: np.ndarray, high: np.ndarray, margin: float) -> HairView:
    """The part of a picture with corners [2] and a margin in pixels; all of it where that would be next to nothing."""
    left, top = (max(0, int(edge - margin)) for edge in low)
    right, bottom = (min(size, int(edge + margin) + 1) for edge, size in zip(high, view.hair.shape[::-1], strict=True))
    if right - left < _FEW_PIXELS or bottom - top < _FEW_PIXELS:  # the head is outside
        return view
    rows, columns = slice(top, bottom), slice(left, right)
    camera = view.camera.crop(left, top, right - left, bottom - top)
    parts = (part[rows, columns] for part in (view.image, view.hair, view.counts))
    return HairView(camera, view.vertices, *parts)


def reduced(values: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """A picture [H, W] at a smaller size."""
    planes = torch.from_numpy(np.ascontiguousarray(values, np.float32))[None, None]
    small: np.ndarray = functional.interpolate(planes, size, mode="bilinear", antialias=True)[0, 0].numpy()
    return small


def with_colors(
    settings: HairSettings, groom: Groom, views: Sequence[HairView], head: HeadModel, *, even: bool = False
) -> HairSettings:
    """Settings whose drawn colors are in the mean those of the first photo's hair, as bright and as tinted as it shows them.

    Of hair that hardly shows, as beside a hat, only how dark and how grey it is is believed. `even` hair has no white hairs
    among dark ones: where it is grey, it is dyed so.
    """
    on_face = len(groom) > 0 and bool((groom.groups != SCALP).all())
    view = _around_hair(views[0]) if on_face else around_head(views[0])
    side = min(1.0, COLOR_SIDE / max(view.hair.shape))
    size = max(1, round(view.camera.height * side)), max(1, round(view.camera.width * side))
    hair, counts = reduced(view.hair, size), reduced(view.counts, size)
    full = (hair > _FULL) & (counts > _FULL)
    if full.sum() < _FEW_PIXELS:  # little is seen, as under a hat
        full = (hair > _SOME) & (counts > _FULL)
    if full.sum() < (_FEWEST if on_face else _FEW_PIXELS):
        return settings
    image = np.stack([reduced(view.image[..., k], size) for k in range(3)], 2)
    strands = WornHair(groom, settings, view.vertices, view.camera.resized(size[1], size[0]), head)
    weights = strands.weights(full)
    wanted, cover = image[full].mean(0), strands.drawn(settings)[1]
    plain = full.sum() < _TELLING * cover.sum()
    if on_face:  # brows and beards let the skin through, and so do drawn ones
        least = np.quantile(image[full], _AS_DARK, axis=0) if (groom.groups == BEARD).all() else np.zeros(3)
        wanted = _without_skin(image, hair, full, cover, _open(groom), least)

    @functools.cache  # each is asked for by several of its neighbours
    def distance(tried: HairSettings) -> float:
        off = weights @ strands.gaussians(tried).colors - wanted
        return float((off**2).sum() + _PULL * (tried.grey + 0.3 * tried.redness))

    def nearest(found: HairSettings) -> HairSettings:
        for step in (0.2, 0.1, 0.05, 0.1, 0.05, 0.025):
            for name in ("melanin", "grey") if plain else ("melanin", "grey", "redness"):
                around = [found.changed(**{name: getattr(found, name) + sign * step}) for sign in (-1, 1)]
                found = min([found, *around], key=distance)
        return found

    grid = itertools.product(np.linspace(0, 1, 6), (0.0, 0.4, 0.8), (0.0,) if plain else (0.0, 0.4))
    tried = [settings.changed(melanin=m, grey=g, redness=r, dye=0.0) for m, g, r in grid]
    simple = [one for one in tried if not one.grey and not one.redness]  # grey and red together look nearly like neither
    best = min((nearest(min(starts, key=distance)) for starts in (simple, tried)), key=distance)
    off = weights @ strands.gaussians(best).colors - wanted
    if (plain or float(np.abs(off).max()) <= UNLIKELY) and not (even and best.grey > 0.0):
        return best
    best = best.changed(dye=1.0)  # no pigment makes it
    color = np.clip(wanted, 0.0, 1.0)
    for _ in range(_ROUNDS):
        best = best.changed(dye_red=float(color[0]), dye_green=float(color[1]), dye_blue=float(color[2]))
        color = np.clip(color - (weights @ strands.gaussians(best).colors - wanted), 0.0, 1.0)
    return best


def _open(groom: Groom) -> float:
    """Share of the skin between strands that may show: none between long ones, which lie over one another."""
    return float(np.interp(groom.lengths.mean(), _LONG, (_MOST_BETWEEN, 0.0)))


def _without_skin(
    image: np.ndarray, hair: np.ndarray, full: np.ndarray, cover: np.ndarray, most: float, least: np.ndarray
) -> np.ndarray:
    """Mean color [3] of hair in the pixels `full` of a photo, less the skin that shows between strands that cover so much.

    `most` is the share of skin that is believed, `least` the darkest color.
    """
    mean, between = image[full].mean(0), 1.0 - float(cover[full].mean())
    near = np.zeros_like(full)
    rows, columns = np.nonzero(full)
    reach = max(2, round(_NEAR * len(full)))
    near[max(0, rows.min() - reach) : rows.max() + reach, max(0, columns.min() - reach) : columns.max() + reach] = True
    skin = near & (hair < _BARE)
    if between < _CLOSED or skin.sum() < _FEW_PIXELS:
        return mean
    between = min(between, most)
    color: np.ndarray = np.clip((mean - between * np.median(image[skin], 0)) / (1.0 - between), np.minimum(least, mean), 1.0)
    return color


class WornHair:
    """A groom on a posed head before a camera.

    Args:
        groom: The strands.
        settings: Of their shape.
        vertices: Posed, [V, 3].
        camera: In head space.
        head: Whose mesh it is.
        still: The person at rest, [V, 3], outside of whose skin scalp hair is kept as sessions do it; None leaves it.
    """

    def __init__(
        self, groom: Groom, settings: HairSettings, vertices: np.ndarray, camera: Camera, head: HeadModel,
        still: np.ndarray | None = None,
    ) -> None:  # fmt: skip
        self._camera, self._eye = camera, Eye.of(camera)
        blocks = ready(groom, head)
        shares = level_shares(blocks, self._eye.pixels_per_metre())
        self._hiding = Hiding.of(vertices, hiding_faces(head), camera)
        self._posed = []
        for block, share in zip(blocks, shares, strict=True):
            origin, axes = (part.astype(np.float32) for part in block.frames.at(vertices))
            local, crowded = block.styled(settings), None
            if still is not None and block.group == SCALP:
                local = on_person(head, still, block.frames, local, block.lock)
            if still is not None:  # every stored strand is drawn, so that each can be seen
                share = max(share, len(block.points) / len(block))
            points = np.matmul(local, axes) + origin[:, None]
            if block.group in DENSE:
                crowded = block.crowded(points, axes)
            self._posed.append((block, points, axes, share, crowded))

    def gaussians(self, settings: HairSettings) -> StrandGaussians:
        """In the colors of settings."""
        parts = [
            strand_gaussians(block, points, axes, settings, share, self._eye, self._hiding, whole=True, crowded=crowded)
            for block, points, axes, share, crowded in self._posed
        ]
        return StrandGaussians(*(np.concatenate(arrays) for arrays in zip(*parts, strict=True)))

    def pieces(self, settings: HairSettings) -> tuple[np.ndarray, np.ndarray]:
        """The groom's strand of each Gaussian of `gaussians`, [G], and where on it that is, 0..1 [G]."""
        rows, places = [], []
        for block, _, _, share, _ in self._posed:
            owner = block.rows[block.owner[: len(block.level(share, settings)[1])]]
            rows.append(np.repeat(owner, block.segments))
            middles = (np.arange(block.segments) + 0.5) / block.segments
            places.append(np.tile(np.minimum(settings.length * middles, 1.0), len(owner)))
        return np.concatenate(rows), np.concatenate(places)

    def drawn(self, settings: HairSettings) -> tuple[np.ndarray, np.ndarray]:
        """Premultiplied display sRGB [H, W, 3] and cover [H, W]."""
        made = self.gaussians(settings)
        picture = rasterize_arrays(GaussianArrays(*made[:5], np.zeros((len(made.means), 0), np.float32)), self._camera)
        return picture.rgb, picture.alpha

    def weights(self, pixels: np.ndarray) -> np.ndarray:
        """How much each Gaussian's color counts in the mean of some pixels [H, W], of those that strands cover; sums to 1."""
        made = Gaussians(*(torch.from_numpy(part) for part in self.gaussians(HairSettings())[:5]))
        made.colors = torch.zeros_like(made.colors, requires_grad=True)
        shown = rasterize(made, self._camera).rgb[..., 0] * torch.from_numpy(pixels)
        (gradient,) = torch.autograd.grad(shown.sum(), made.colors)
        weights: np.ndarray = gradient[:, 0].numpy()
        return weights / max(float(weights.sum()), 1e-6)
