"""What a photo shows of hair, streaks, highlights, shade between locks, as colors of the strands themselves.

Strands have a color of few pigments; a photo shows more. What it adds at each place of each strand is found by least squares
through the rasteriser: the simultaneous algebraic reconstruction technique (Andersen and Kak 1984), in which every strand
takes the mean difference of the pixels that it shows in, and which, ended early, finds what is coarse and lasting first. Only
pixels that are hair count, and of these what faces the camera; along a strand colors change slowly. Strands that no photo
shows take what those near them have, then what is on the other side of the head, and with distance nothing: then the groom's
pigments alone are seen. Imports torch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..avatar import Avatar, Hair
from ..geometry.camera import Camera
from ..hair.coloring import WornHair, around_head, reduced
from ..hair.groom import TINTS, Groom, join
from ..hair.roots import BEARD, BROWS, GROUPS, SCALP
from ..hair.strands import between
from ..head import HeadModel
from ..model.grmm import GRMM
from ..photo.parser import PhotoParts
from ..photo.widening import widened
from ..splat.api import rasterize
from ..splat.types import Gaussians
from .blurring import blurred
from .face_hair import brow_cover
from .hair_view import hair_view, hardly_shown
from .inpainting import within
from .invert import photo_model_inputs
from .types import PhotoTrack

SIDE = 512  # pixels: longer side of the picture around the head
ROUNDS, RATE = 12, 1.5  # of the reconstruction, and how much of each of its steps is taken
HAIR = 0.9  # of a pixel, from where on its color is hair's
# of a pixel, from where on the parser is sure, and such colors tell which ones hair has: what it takes for hair far from the
# head, as the wall beside a shoulder, would be bright ends of dark hair
SURE, LEAST_SURE = 0.85, 0.2  # and of how many of the pixels at least
LEAST_COVER = 0.3  # of a pixel by strands: with less the step is not made larger
SURE_PIXELS = 0.4  # that a place of a strand shows in at which it is half believed
FEW_PIXELS = 0.15  # likewise from where on it takes whole steps
RANGE = (0.02, 0.98)  # quantiles of the photos' hair that colors keep to, in each channel
FULL = (0.6, 0.9)  # of a pixel: with less hair it does not count, with more wholly; outlines have the background's colors
RIM = 2  # pixels at the outline of hair that show what is behind as well: their colors would be drawn as a bright line
# metres along a strand over which it has one color: where it lies otherwise than a photo's locks, a streak that crosses it
# would be a row of blotches
ALONG = 0.02
# cosines between the view and the surface of hair below which a pixel tells no color, and above which wholly: at a slant a
# shadow of a few pixels, as in a parting or at the outline, is a stripe of centimetres on the head. Stricter, and hair at the
# sides loses the shade that a photo shows
SLANTS = (0.05, 0.3)
SOFT = 3.0  # pixels over which that surface is smoothed: locks are no slopes
OTHERS = 0.5  # share of what a place shows in that must be hair; what hangs before the face or the background is not believed
GUESS = 0.12  # that is added at most to a color that no photo shows
CELL = 0.006  # metres: of the grid on which colors spread
NEAR, FAR = 1.2, 4.0  # cells that colors spread to other strands, and to the other side of the head
THIN_NEAR, THIN_FAR = 0.15, 0.3  # how much must be known around a place to count as half known
_THIN = 1e-3  # cover, and metres of depth, that are divided by at least


class Photo(NamedTuple):
    """A photo and the avatar in it.

    Attributes:
        image: [H, W, 3].
        hair: How much of each pixel is hair, [H, W].
        sure: How sure that is, [H, W].
        counts: See `HairView`.
        skin: The avatar without hair, [H, W, 3].
        strands: As the photo's camera sees them, in the colors of pigments, G Gaussians.
        rows, places: See `WornHair.pieces`.
        camera: Of the picture.
        facing: Cosine between the skin under each strand and the direction to the camera, [N].
    """

    image: Tensor
    hair: Tensor
    sure: Tensor
    counts: Tensor
    skin: Tensor
    strands: Gaussians
    rows: Tensor
    places: Tensor
    camera: Camera
    facing: np.ndarray


def textured(
    model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], parts: Sequence[PhotoParts]
) -> Avatar:  # fmt: skip
    """Return an avatar whose brows, beard, and scalp hair if they show it, have the colors of its photos where they show them.

    Args:
        model: With the avatar's own changes.
        avatar: Fitted to the photos, with strands.
        tracks: Photos; the light of the first is kept.
        parts: What their pixels show.
    """
    hair = avatar.hair
    if hair is None or hair.groom is None:
        return avatar
    views = [hair_view(track, seen, model.head_model) for track, seen in zip(tracks, parts, strict=True)]
    hidden = all(map(hardly_shown, views, parts))
    own = np.isin(hair.groom.groups, (BROWS, BEARD) if hidden else (SCALP, BROWS, BEARD))
    if not own.any():
        return avatar
    groom = dataclasses.replace(hair.groom.select(own), tints=None)
    onto = [Onto(photo, len(groom)) for photo in photos_of(model, avatar, hair, groom, tracks, parts, RIM)]
    places = places_of(groom, model.head_model)
    tints, known = reconstructed(onto, places)
    colored = dataclasses.replace(groom, tints=spread(places, tints, known))
    return joined(avatar, hair, colored, hair.groom.select(~own))


def joined(avatar: Avatar, hair: Hair, some: Groom, others: Groom) -> Avatar:
    """An avatar with strands of two kinds."""
    return dataclasses.replace(avatar, hair=dataclasses.replace(hair, groom=join([some, others])))


def photos_of(
    model: GRMM, avatar: Avatar, hair: Hair, groom: Groom, tracks: Sequence[PhotoTrack], parts: Sequence[PhotoParts],
    rim: int = 0,
) -> list[Photo]:  # fmt: skip
    """Photos with the avatar in them, hair less a rim of so many pixels, on average as bright and as tinted as in the first."""
    photos = [
        _photo(model, avatar, hair, groom, track, seen, index, rim)
        for index, (track, seen) in enumerate(zip(tracks, parts, strict=True))
    ]
    means = [photo.image[photo.hair > HAIR].mean(0) for photo in photos]
    return [
        photo._replace(image=photo.image + (means[0] - mean).nan_to_num()) for photo, mean in zip(photos, means, strict=True)
    ]


def _photo(
    model: GRMM, avatar: Avatar, hair: Hair, groom: Groom, track: PhotoTrack, parts: PhotoParts, index: int, rim: int
) -> Photo:  # fmt: skip
    head = model.head_model
    view = hair_view(track, parts, head)
    scale = min(1.0, SIDE / max(around_head(view).hair.shape))
    if rim:
        reach = round(rim / scale)
        bare = torch.from_numpy(np.float32(1.0 - view.hair))[None]
        view = dataclasses.replace(view, hair=1.0 - widened(bare, reach)[0].numpy())
    sure = parts.hair
    if (groom.groups == BROWS).any():
        brows = brow_cover(track, parts, view, head)
        view, sure = dataclasses.replace(view, hair=np.maximum(view.hair, brows)), np.maximum(sure, brows)
    if (groom.groups == BEARD).any():
        view, sure = dataclasses.replace(view, hair=np.maximum(view.hair, parts.beard)), np.maximum(sure, parts.beard)
    sure = around_head(dataclasses.replace(view, hair=sure)).hair
    view = around_head(view)
    height, width = (max(16, round(size * scale / 16) * 16) for size in view.hair.shape)  # the refinement network halves
    camera = view.camera.resized(width, height)
    with torch.no_grad():
        inputs, resting = photo_model_inputs(model, avatar, track, index)
        drawn = model.render(camera, inputs, lit_later=True)
        vertices, still = (model.mesh(part).vertices.cpu().numpy() for part in (inputs, resting))
    image = np.stack([reduced(view.image[..., k], (height, width)) for k in range(3)], 2)
    cover, told, counts = (torch.from_numpy(reduced(part, (height, width))) for part in (view.hair, sure, view.counts))
    seen = []
    for group in np.unique(groom.groups):
        own = np.flatnonzero(groom.groups == group)
        settings = hair.settings if group == SCALP else hair.parts.get(GROUPS[group], hair.settings.for_part(group))
        worn = WornHair(groom.select(own), settings, vertices, camera, head, still)
        which, along = worn.pieces(settings)
        seen.append((*worn.gaussians(settings), own[which], along))
    *strands, rows, places = (torch.from_numpy(np.concatenate(part)) for part in zip(*seen, strict=True))
    origin, axes = groom.frames(np.asarray(head.v_template, np.float64), head.faces).at(vertices)
    way = camera.position - origin
    facing = (axes[:, 2] * way).sum(1) / np.linalg.norm(way, axis=1)
    skin = drawn.image.cpu()
    return Photo(torch.from_numpy(image), cover, told, counts, skin, Gaussians(*strands), rows, places, camera, facing)


def reconstructed(onto: Sequence[Onto], places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Find what photos add to colors of strands.

    Args:
        onto: Photos of one person, with the same strands.
        places: Of the strands on the mean head, metres, [N, TINTS, 3].

    Returns:
        Tints [N, TINTS, 3], and how well each place is known, 0..1 [N, TINTS].
    """
    count, beside = len(places), _beside(places)
    tints = torch.zeros(count * TINTS, 3)
    weight = sum((one.shown for one in onto), torch.zeros(count * TINTS))
    first = onto[0].photo
    full = first.hair > HAIR
    sure = full & (first.sure > SURE)
    sample = first.image[sure if sure.sum() > LEAST_SURE * full.sum() else full]
    base = onto[0].mean(first.strands.colors)
    for _ in range(ROUNDS):
        step = sum((one.step(tints) for one in onto), torch.zeros_like(tints))
        tints += RATE * step / (weight[:, None] + FEW_PIXELS)
        tints = _along(beside, tints, weight)
        if len(sample):
            tints = within(base + tints, sample, RANGE) - base
    known = weight / (weight + SURE_PIXELS) * torch.stack([one.pure for one in onto]).amax(0)
    return tints.reshape(count, TINTS, 3).numpy(), known.reshape(count, TINTS).numpy()


def faced(strands: Gaussians, camera: Camera) -> Tensor:
    """How well a picture shows each pixel of hair by how its surface is turned, 0..1 [H, W] (`SLANTS`)."""
    with torch.no_grad():
        picture = rasterize(strands, camera)
    cover, depth = blurred(torch.stack([picture.alpha, picture.depth * picture.alpha]).numpy(), SOFT)
    depth /= np.maximum(cover, _THIN)
    rise, along = np.gradient(depth)  # of depth from pixel to pixel, which are depth / focal length wide
    slope = np.hypot(rise * camera.fy, along * camera.fx) / np.maximum(depth, _THIN)
    facing = 1.0 / np.hypot(1.0, slope)
    return torch.from_numpy(((facing - SLANTS[0]) / (SLANTS[1] - SLANTS[0])).clip(0.0, 1.0).astype(np.float32))


def _beside(places: np.ndarray) -> Tensor:
    """How much places of strands [N, T, 3] share of their color with each other place of the same strand, [N, T, T]."""
    steps = np.linalg.norm(np.diff(places, axis=1, prepend=places[:, :1]), axis=2).cumsum(1)
    return torch.from_numpy(np.exp(-0.5 * ((steps[:, :, None] - steps[:, None]) / ALONG) ** 2).astype(np.float32))


def _along(beside: Tensor, tints: Tensor, weight: Tensor) -> Tensor:
    """Tints [N * T, 3] evened along each strand, those places most that show in most pixels, [N * T]."""
    shown = weight.reshape(beside.shape[:2])[..., None]
    total = beside @ torch.cat([tints.reshape(*shown.shape[:2], 3) * shown, shown], 2)
    return (total[..., :3] / total[..., 3:].clamp_min(1e-6)).reshape(-1, 3)


class Onto:
    """From tints of strands to a photo and back: the operator of the reconstruction."""

    def __init__(self, photo: Photo, count: int) -> None:
        self.photo, self.size = photo, count * TINTS
        at = photo.places * (TINTS - 1)
        base = at.long().clamp(0, TINTS - 2)
        self.part = (at - base).float()[:, None]
        self.first = photo.rows * TINTS + base
        self.hair = ((photo.hair - FULL[0]) / (FULL[1] - FULL[0])).clamp(0, 1) * photo.counts
        self.hair *= faced(photo.strands, photo.camera)
        planes = torch.stack([self.hair, torch.ones_like(self.hair), photo.counts], -1)
        self.shown, every, self.counted = self._back(planes, photo.strands.colors).unbind(1)
        self.pure = ((self.shown / every.clamp_min(1e-6) - OTHERS) / (1.0 - OTHERS)).clamp(0, 1)

    def shares(self) -> tuple[np.ndarray, np.ndarray]:
        """How many pixels each place shows in that count, and what share of these is hair, [N, TINTS] each."""
        photo = self.photo
        hair = self._back((photo.hair * photo.counts)[..., None].expand(-1, -1, 3), photo.strands.colors)[:, 0]
        share = hair / self.counted.clamp_min(1e-6)
        return self.counted.reshape(-1, TINTS).numpy(), share.reshape(-1, TINTS).numpy()

    def step(self, tints: Tensor) -> Tensor:
        """Sum of the difference to the photo over the pixels that each place shows in, [N * TINTS, 3]."""
        photo = self.photo
        own = tints[self.first] * (1.0 - self.part) + tints[self.first + 1] * self.part
        colors = (photo.strands.colors + own).clamp(0, 1)
        rgb, alpha = self._drawn(colors)
        off = photo.image - rgb - (1.0 - alpha)[..., None] * photo.skin
        return self._back(off * (self.hair / alpha.clamp_min(LEAST_COVER))[..., None], colors)

    def mean(self, values: Tensor) -> Tensor:
        """Mean of what Gaussians have, [G, 3], at the places that they belong to, [N * TINTS, 3]."""
        total, count = torch.zeros(self.size, 3), torch.full((self.size, 1), 1e-6)
        for number, part in ((self.first, 1.0 - self.part), (self.first + 1, self.part)):
            total.index_add_(0, number, values * part)
            count.index_add_(0, number, part)
        return total / count

    def _drawn(self, colors: Tensor) -> tuple[Tensor, Tensor]:
        with torch.no_grad():
            picture = rasterize(dataclasses.replace(self.photo.strands, colors=colors), self.photo.camera)
        return picture.rgb, picture.alpha

    def _back(self, pixels: Tensor, colors: Tensor) -> Tensor:
        """Transposed: values of pixels [H, W, 3] summed over what each place shows in, [N * TINTS, 3]."""
        colors = colors.clone().requires_grad_(True)
        picture = rasterize(dataclasses.replace(self.photo.strands, colors=colors), self.photo.camera)
        (gradient,) = torch.autograd.grad((picture.rgb * pixels).sum(), colors)
        result = torch.zeros(self.size, 3)
        result.index_add_(0, self.first, gradient * (1.0 - self.part))
        return result.index_add_(0, self.first + 1, gradient * self.part)


def places_of(groom: Groom, head: HeadModel) -> np.ndarray:
    """Where the tints of strands are on the mean head, metres, [N, TINTS, 3]."""
    vertices = np.asarray(head.v_template, np.float64)
    even = groom.resampled(2 * TINTS - 1)
    posed = even.posed(even.frames(vertices, head.faces), vertices).reshape(len(groom), -1, 3)
    return between(posed, np.linspace(0, 1, TINTS))


def spread(places: np.ndarray, tints: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Complete tints of places that no photo shows.

    Args:
        places: On the mean head, metres, [N, T, 3].
        tints: [N, T, 3].
        known: How well each is known, 0..1 [N, T].

    Returns:
        [N, T, 3].
    """
    reach = np.abs(places.reshape(-1, 3)).max(0) + 4.0 * FAR * CELL
    size = 2 * np.ceil(reach / CELL).astype(int) + 1  # the middle cell is on the plane of symmetry
    cell = tuple(np.round(places.reshape(-1, 3) / CELL).astype(int).T + (size[:, None] - 1) // 2)
    number = np.ravel_multi_index(cell, tuple(size))
    columns = np.concatenate([tints * known[..., None], known[..., None]], 2).reshape(-1, 4)
    grids = np.stack([np.bincount(number, column, int(size.prod())).reshape(size) for column in columns.T])
    count = np.bincount(number, minlength=int(size.prod())).reshape(size)

    def around(grid: np.ndarray, others: np.ndarray, cells: float, thin: float) -> tuple[np.ndarray, np.ndarray]:
        *soft, there = (part[cell] for part in _softened(np.concatenate([grid, others[None]]), cells))
        soft = np.stack(soft, 1)
        return soft[:, :3] / np.maximum(soft[:, 3:], 1e-9), (soft[:, 3] / np.maximum(soft[:, 3] + thin * there, 1e-9))[:, None]

    near, near_known = around(grids, count, NEAR, THIN_NEAR)
    both = grids + grids[:, ::-1]
    far, far_known = around(both, count + count[::-1], FAR, THIN_FAR)
    guessed = near_known * near + (1.0 - near_known) * far_known * far
    guessed = GUESS * np.tanh(guessed / GUESS)
    sure = known.reshape(-1, 1)
    result: np.ndarray = (sure * tints.reshape(-1, 3) + (1.0 - sure) * guessed).reshape(tints.shape).astype(np.float32)
    return result


def _softened(grids: np.ndarray, cells: float) -> np.ndarray:
    """Grids [C, X, Y, Z] blurred by a Gaussian of so many cells; nothing is outside."""
    reach = int(np.ceil(3.0 * cells))
    bell = torch.exp(-0.5 * (torch.arange(-reach, reach + 1) / cells) ** 2)
    planes = torch.from_numpy(grids.astype(np.float32))[:, None]
    for axis in range(3):
        shape, padding = [1, 1, 1, 1, 1], [0, 0, 0]
        shape[2 + axis], padding[axis] = len(bell), reach
        planes = functional.conv3d(planes, (bell / bell.sum()).reshape(shape), padding=tuple(padding))
    softened: np.ndarray = planes[:, 0].numpy()
    return softened
