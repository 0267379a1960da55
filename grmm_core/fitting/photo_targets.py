"""Tracked photos as fitting targets: cut around the head, reduced, with the pixels that the model can explain.

The model has a head, a neck and the top of the shoulders. What else of the person the photo shows (clothes, arms, hair that
falls far below the chin) is no target: such pixels get weight 0 in every loss. The background is one: nothing of the avatar
may be there, nor where clothes are seen beside the bust.

A model without hair is a closed surface of skin. Of it a photo shows what neither hair nor cloth nor the mesh's own outline
is near to; the rest is filled in later (`inpainting`), and nothing but skin is ever painted on it.

Called by `code_stage`, `decoder_stage`, `invert` and the evaluation. Imports torch.
"""

from __future__ import annotations

import functools
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ..geometry.camera import Camera
from ..geometry.zbuffer import EMPTY, triangle_depth
from ..head import HeadModel
from ..photo.glasses import worn_glasses
from ..photo.parser import MESH_PARTS, PhotoParts, parse, part_map
from ..photo.widening import widened
from .types import PhotoTrack

MARGIN_SIDE, MARGIN_TOP, MARGIN_BOTTOM = 0.18, 0.22, 0.03  # of the head's height in the picture, around the mesh
BODY_BELOW_CHIN = -0.1  # of the head's height: collars and shoulders may begin so far above the chin
SURELY_BODY = 0.12  # likewise: below this it is clothes
BODY_MASK = 0.05  # coverage above which a pixel counts as the person's
MESH_MARGIN = 0.015  # of the head's height by which the mesh is widened before what lies outside counts as body
_CHIN_LANDMARK = 152
_SIDE_LANDMARKS = (234, 454)  # the face's sides before the ears
_ALIEN = {"glasses": "What glasses cover", "hat": "The hat or scarf", "other": "What is in front of the person"}
_LIKELY = 0.5  # share of a pixel from which it is taken for a thing
ALIEN_RIM = 0.008  # of the head's height by which glasses, hats and things are widened: their shadow, and the picture's blur
HAIR_LATERAL = 0.6  # of the face's half width: nearer to the middle a fringe is short
RIM = 0.006  # of the picture's height: how far from the outline hair may have the background's colors
CLOTHES_RIM = 0.02  # of the head's height by which clothes are widened: there the coarse bust blurs their edge
_INNER = 0.9  # coverage
BARE = 0.15  # of a pixel: less hair, beard or cloth than this and it is skin
SKIN_RIM = 0.008  # of the head's height that skin keeps from cloth and the outline, whose colors the blur mixes in
HAIR_RIM = 0.016  # likewise from hair and hats
SHADOW_RIM = 0.05  # likewise: how far beside the face hair throws a shadow
SHADOW = 0.88  # of the face's lightness: less is shadow there
NECK_TINT, NECK_LIGHT = 0.05, 1.15  # how far a neck's chromaticity and how much its lightness may exceed the face's: collars do
# by so much more that of a redder neck, by the share of the face's lightness that it lacks: shade is redder
NECK_SHADE = 3.0
CLIPPED = 0.985  # of a channel: from here on a photo does not say how bright it was
BURNT, BURNT_RIM = 1.6, 0.016  # times the lightness of the face where it is lit; of the head's height
LIT = 0.75  # of the face's pixels are darker than where it is lit, although light from a side may leave most of it in shadow
_MULTIPLE = 16  # pixels: the refinement network folds and halves


@dataclass(frozen=True)
class FitView:
    """One photo at one resolution.

    Attributes:
        index: Number of the photo.
        camera: Of this picture, in head space.
        image: Photo, display sRGB 0..1, [H, W, 3].
        mask: Coverage by the person, [H, W].
        weight: 0 where a pixel is no target, else 1, [H, W].
        empty: 1 where the person's clothes are seen beside the bust, so that nothing of the avatar may be there, [H, W].
        hair: 1 where hair falls over the side of the face: such pixels say nothing about skin, [H, W].
        clothes: 1 where clothes cover neck or bust, [H, W]: they are painted, not measured.
        lenses: 1 where skin is seen through lenses of glasses, [H, W]: it is no target.
        shape: [S]. expression: [E]. pose: with the part that the expression turns, [5, 3].
        aligned: Weights of the aligned expressions that the tracked expression stands for, [60].
    """

    index: int
    camera: Camera
    image: Tensor
    mask: Tensor
    weight: Tensor
    empty: Tensor
    hair: Tensor
    clothes: Tensor
    lenses: Tensor
    shape: Tensor
    expression: Tensor
    pose: Tensor
    aligned: Tensor

    @property
    def inside(self) -> Tensor:
        """Pixels of the person that are targets, [H, W] 0..1."""
        return self.mask * self.weight

    @property
    def inner(self) -> Tensor:
        """`inside` without its rim, where between hairs the background shows, [H, W] 0..1."""
        reach = max(1, round(RIM * self.camera.height))
        outside = (self.inside < _INNER).to(self.inside)[None]
        return self.inside * (1.0 - widened(outside, reach)[0])

    @property
    def clear(self) -> Tensor:
        """Pixels whose colors the photo tells, no channel at its end, [H, W] 0..1."""
        return (self.image.amax(-1) < CLIPPED).to(self.image)

    def excess(self, shown: Tensor) -> Tensor:
        """What of a picture [H, W, 3] is brighter than the photo where this is at its end: no error, but unknown."""
        return torch.where(self.image >= CLIPPED, (shown - self.image).clamp(min=0.0), torch.zeros_like(shown))

    @property
    def measured(self) -> Tensor:
        """Pixels of the head and of the bare neck, [H, W] 0..1: what of `inside` is no cloth."""
        return self.inside * (1.0 - self.clothes)

    def through_lenses(self) -> FitView:
        """The same with skin behind lenses as a target: its features are the person's, if not its colors."""
        return replace(self, weight=torch.maximum(self.weight, self.lenses))

    def target(self, background: Tensor) -> Tensor:
        """The photo's person over a color [3]: [H, W, 3]."""
        mask = self.mask[..., None]
        return self.image * mask + (1.0 - mask) * background


def bare_pixels(view: FitView) -> np.ndarray:
    """Pixels that show skin and no hair before it, and tell its color, 0..1, [H, W]."""
    bare: np.ndarray = (view.measured * view.clear * (1.0 - view.hair)).cpu().numpy()
    return bare


def aligned_weights(expression: np.ndarray, head: HeadModel, count: int) -> np.ndarray:
    """Weights 0..1 of the first 52 aligned expressions that come nearest to coefficients [E]; [count].

    For the open head these are its first 52 coefficients.
    """
    recipe = np.asarray(head.arkit_to_expression, np.float64)  # [52, E]
    given = np.zeros(recipe.shape[1])
    given[: len(expression)] = expression
    solution, *_ = np.linalg.lstsq(recipe.T, given, rcond=None)
    weights = np.zeros(count, np.float32)
    weights[: len(solution)] = np.clip(solution, 0.0, 1.0)
    return weights


def fit_view(
    track: PhotoTrack, head: HeadModel, index: int, side: int, aligned_count: int, dtype: torch.dtype,
    device: torch.device | str = "cpu", hairless: bool = False,
) -> FitView:  # fmt: skip
    """Prepare a photo.

    Args:
        track: Tracked photo.
        head: Mesh model.
        index: Number of the photo.
        side: Longer side of the picture, pixels; a photo that shows the head smaller is not enlarged.
        aligned_count: Number of aligned expressions.
        dtype: Of the tensors.
        device: Of the tensors.
        hairless: The model has no hair: hair and beard are no targets, but strands that are found elsewhere (`hair_stage`).
    """
    pose = head.pose_of(track.expression, track.pose)
    (left, top, right, bottom), parts, weight, empty = _targets(track, head, hairless)
    camera = track.camera.crop(left, top, right - left, bottom - top)
    scale = min(1.0, side / max(camera.width, camera.height))
    width, height = (max(_MULTIPLE, round(n * scale / _MULTIPLE) * _MULTIPLE) for n in (camera.width, camera.height))

    def resized(array: np.ndarray) -> Tensor:
        planes = torch.tensor(np.ascontiguousarray(array[top:bottom, left:right]), dtype=dtype)
        planes = (planes if planes.ndim == 3 else planes[..., None]).permute(2, 0, 1)[None]
        small = functional.interpolate(planes, (height, width), mode="bilinear", antialias=True, align_corners=False)
        return small[0].permute(1, 2, 0).to(device)

    def flags(array: np.ndarray) -> Tensor:
        return (resized(array)[..., 0] > 0.5).to(dtype)

    def numbers(array: np.ndarray) -> Tensor:
        return torch.tensor(array, dtype=dtype, device=device)

    return FitView(
        index, camera.resized(width, height), resized(track.image), resized(track.mask)[..., 0],
        flags(weight), flags(empty), flags(parts.hair), flags(parts.clothes), flags(parts.lenses),
        numbers(track.shape), numbers(track.expression), numbers(pose),
        numbers(aligned_weights(track.expression, head, aligned_count)),
    )  # fmt: skip


@functools.lru_cache(maxsize=8)
def _targets(
    track: PhotoTrack, head: HeadModel, hairless: bool
) -> tuple[tuple[int, int, int, int], _Areas, np.ndarray, np.ndarray]:  # fmt: skip
    """Window of the head, what the whole working picture shows, and its weight and empty pixels, [H, W].

    The last few answers are kept, for a fit asks at every resolution.
    """
    vertices = head.vertices(track.shape, track.expression, head.pose_of(track.expression, track.pose))
    pixels = project(vertices, track.camera)
    seen = parse(track, head)
    parts = _areas(track, seen, vertices[head.faces], pixels)
    weight, empty = track.valid * (1.0 - parts.body), parts.empty
    if hairless:
        weight, empty = _bare(track, seen, vertices[head.faces], float(np.ptp(pixels[:, 1])), weight, empty)
    if parts.lenses.any():  # eyes are what they are
        eyes = part_map(head, vertices, track.camera)[0] == tuple(MESH_PARTS).index("eyes")
        parts = replace(parts, lenses=weight * parts.lenses * ~eyes)
        weight = weight * (1.0 - parts.lenses)
    return head_window(pixels, track.camera), parts, weight, empty


def project(points: np.ndarray, camera: Camera) -> np.ndarray:
    """Pixel coordinates of points [N, 3] in head space: [N, 2]."""
    local = np.asarray(points, np.float64) @ camera.world_to_camera[:3, :3].T + camera.world_to_camera[:3, 3]
    divisor = np.ones(len(local)) if camera.orthographic else np.maximum(local[:, 2], 1e-6)
    return np.stack([camera.fx * local[:, 0] / divisor + camera.cx, camera.fy * local[:, 1] / divisor + camera.cy], -1)


def head_window(pixels: np.ndarray, camera: Camera) -> tuple[int, int, int, int]:
    """Left, top, right, bottom of the part of a picture that the head with hair can fill."""
    low, high = pixels.min(0), pixels.max(0)
    height = float(high[1] - low[1])
    left, top = max(0, int(low[0] - MARGIN_SIDE * height)), max(0, int(low[1] - MARGIN_TOP * height))
    right = min(camera.width, int(np.ceil(high[0] + MARGIN_SIDE * height)))
    bottom = min(camera.height, int(np.ceil(high[1] + MARGIN_BOTTOM * height)))
    if right - left < _MULTIPLE or bottom - top < _MULTIPLE:  # the head is outside: leave the picture as it is
        return 0, 0, camera.width, camera.height
    return left, top, right, bottom


@dataclass(frozen=True)
class _Areas:
    """What a working picture shows of the person, each [H, W] of 0 and 1.

    Attributes:
        body: Parts that the model does not have, and what is in front of the person.
        empty: Of these, clothes beside the bust.
        hair: Hair over the side of the face.
        clothes: On neck and bust.
        lenses: Skin behind lenses of glasses, and beside their frames.
    """

    body: np.ndarray
    empty: np.ndarray
    hair: np.ndarray
    clothes: np.ndarray
    lenses: np.ndarray


def _areas(track: PhotoTrack, parts: PhotoParts, triangles: np.ndarray, pixels: np.ndarray) -> _Areas:
    """Tell what can be a target from what cannot, by where it is and what the parser says."""
    camera = track.camera
    height = float(np.ptp(pixels[:, 1]))
    covered = torch.tensor(triangle_depth(triangles, camera) < EMPTY, dtype=torch.float32)
    reach = max(1, round(MESH_MARGIN * height))
    widened, widened_rest = (_widened(part, reach) for part in (covered, 1.0 - covered))
    (columns, rows), down = _grid(track)
    chin = track.landmarks_fitted[_CHIN_LANDMARK]
    below = (columns - chin[0]) * down[0] + (rows - chin[1]) * down[1]
    person = track.mask > BODY_MASK
    body = person & ~widened & (below > BODY_BELOW_CHIN * height)
    body &= ~((parts.hair > _LIKELY) & (below < SURELY_BODY * height))
    empty = body.copy()
    # nor does the rim where the model's bust ends and the person goes on
    body |= person & widened_rest & (below > SURELY_BODY * height)
    glasses = worn_glasses(track, parts)
    alien = ((parts.glasses * ~glasses.lenses + parts.hat + parts.other) > _LIKELY) | glasses.covered
    body |= _widened(_plane(alien), max(1, round(ALIEN_RIM * height)))
    dressed = _widened(_plane(parts.clothes > _LIKELY), max(1, round(CLOTHES_RIM * height)))
    side = (parts.hair > _LIKELY) & _before_the_face(track, (columns, rows), down) & (below < 0.0) & (track.mask > 0.5)
    return _Areas(*(part.astype(np.float32) for part in (body, empty, side, dressed & (below > 0.0), glasses.lenses)))


def _grid(track: PhotoTrack) -> tuple[tuple[np.ndarray, np.ndarray], np.ndarray]:
    """Columns and rows of the pixels, [H, W] each, and the direction of the head's down on the picture, [2]."""
    rows, columns = np.mgrid[: track.camera.height, : track.camera.width] + 0.5
    down = track.head_down
    return (columns, rows), down / max(float(np.linalg.norm(down)), 1e-6)


def _bare(
    track: PhotoTrack, parts: PhotoParts, triangles: np.ndarray, height: float, weight: np.ndarray, empty: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Weight and empty pixels of a model without hair: skin that surely is, and the background."""
    covered = triangle_depth(triangles, track.camera) < EMPTY
    hair = parts.hair + parts.hat > BARE
    lenses = worn_glasses(track, parts).lenses
    other = (parts.clothes + parts.glasses * ~lenses > BARE) | (track.mask < _INNER) | ~covered | _foreign(track.image, parts)
    skin = ~_widened(_plane(other), max(1, round(SKIN_RIM * height))) & ~_widened(
        _plane(hair), max(1, round(HAIR_RIM * height))
    )
    background = (track.mask < BODY_MASK) & (track.valid > 0.5)
    dark, burnt = _shaded(track, parts, hair, height), _burnt(track, parts, height) & ~lenses
    return weight * (skin & ~dark & ~burnt), np.maximum(empty, background).astype(np.float32)


def _shaded(track: PhotoTrack, parts: PhotoParts, hair: np.ndarray, height: float) -> np.ndarray:
    """Pixels beside the face's middle on which hair throws its shadow, [H, W] bool."""
    face = parts.skin > _LIKELY
    if not face.any() or not hair.any():
        return np.zeros(face.shape, bool)
    light = track.image.mean(2)
    grid, down = _grid(track)
    near = _widened(_plane(hair), max(1, round(SHADOW_RIM * height)))
    return near & (light < SHADOW * np.median(light[face])) & _before_the_face(track, grid, down)


def _burnt(track: PhotoTrack, parts: PhotoParts, height: float) -> np.ndarray:
    """Pixels so bright beside the face, as where light comes from behind, that they tell no color of skin, [H, W] bool."""
    face, light = parts.skin > _LIKELY, track.image.mean(2)
    if not face.any():
        return np.zeros(face.shape, bool)
    bright = (light > BURNT * np.quantile(light[face], LIT)) & (parts.mouth + parts.eyes < BARE)
    return _widened(_plane(bright), max(1, round(BURNT_RIM * height)))


def _foreign(image: np.ndarray, parts: PhotoParts) -> np.ndarray:
    """Pixels that were taken for neck and have colors that the face's skin does not, [H, W] bool."""
    face = parts.skin > _LIKELY
    if not face.any():
        return np.zeros(face.shape, bool)
    light = image.mean(2)
    tint, usual = image / np.maximum(image.sum(2, keepdims=True), 1e-3), np.median(light[face])
    off = tint - np.median(tint[face], 0)
    shade = np.where(off[..., 0] > 0.0, np.clip(1.0 - light / max(float(usual), 1e-3), 0.0, 1.0), 0.0)
    allowed = NECK_TINT * (1.0 + NECK_SHADE * shade)
    return (parts.neck > _LIKELY) & ((np.abs(off).max(2) > allowed) | (light > NECK_LIGHT * usual))


def _plane(mask: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(mask.astype(np.float32))


def _before_the_face(track: PhotoTrack, pixels: tuple[np.ndarray, np.ndarray], down: np.ndarray) -> np.ndarray:
    """Pixels above the chin and to the side of the face's middle, [H, W] bool."""
    marks = track.landmarks_fitted
    middle = 0.5 * (marks[_SIDE_LANDMARKS[0]] + marks[_SIDE_LANDMARKS[1]])
    half = 0.5 * float(np.linalg.norm(marks[_SIDE_LANDMARKS[1]] - marks[_SIDE_LANDMARKS[0]]))
    across = (pixels[0] - middle[0]) * -down[1] + (pixels[1] - middle[1]) * down[0]
    return np.abs(across) > HAIR_LATERAL * half


def left_out(tracks: Sequence[PhotoTrack], head: HeadModel) -> list[str]:
    """Sentences for the user about what of the photos is not painted on the person."""
    sentences = []
    for track in tracks:
        parts = parse(track, head)
        for name, text in _ALIEN.items():
            seen = (getattr(parts, name) > _LIKELY).any()
            if seen or (name == "glasses" and worn_glasses(track, parts).covered.any()):
                sentences.append(f"{text} in {track.source or 'the photo'} is left out of the skin.")
    return sentences


def _widened(mask: torch.Tensor, reach: int) -> np.ndarray:
    """Pixels within `reach` of a mask [H, W], bool."""
    return widened(mask[None], reach)[0].numpy() > 0.5
