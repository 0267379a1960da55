"""What a photo does not show, or shows wrongly: how far its colors are known, and what stands where they are not.

``unclipped``       what one photo has burnt out another tells
``uncut``           what a picture's edge cuts through is not known either
``amid_own``        nor is the rim of lips, eyes and mouth
``facing``          skin that a photo sees edge-on tells nothing
``fill_colors``    change of skin and hair, spread along the surface; hair of no other color than the photo's

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from ..geometry.libraries import present
from ..model.grmm import GRMM, Attributes
from ..photo.widening import widened
from ..splat import rasterize
from .grain import grain
from .mouth_colors import plain_mouth
from .objective import contributions
from .photo_targets import FitView
from .surface import INNER, SCALP, SKIN, Surface

PART_RIM = 0.004  # of the picture's height: from the rim of lips, eyes and mouth, where tracking may show something else
PART_REST = 0.02  # pulls lips, eyes and mouth back to the prior: what was seen of them reaches some seven texels
EDGE_PIXELS = 4.0  # from a picture's edge on which a Gaussian lies wholly inside
GRAZING = (0.1, 0.4)  # cosine between normal and view below which colors say nothing, and above which they count fully
TONE_TEXELS = 40.0  # length above which colors are a general tone
COLOR_REST = 5e-4  # pulls unseen colors to the general tone; the reach is some 45 texels
SURELY_SEEN = (0.2, 0.6)  # below the first a texel's color counts as unknown, above the second as known
LID_SHADE = (0.05, 0.14)  # how much darker than the skin around folded skin may be, and from where on it is not believed
BARE_SKIN = 0.12  # how much darker than the middle tone skin may be that tells what lids look like, or changed otherwise
FEATHER_TEXELS, FADES = 5.0, (0.05, 0.45)  # how far what was seen goes on before plain skin stands: length, smoothed knowledge
EDGE_TEXELS, EDGE = 12.0, (0.5, 0.75)  # likewise beside the face where what was seen last is darker than plain skin
# beside the face: smooth shading over so many texels, how much of it is kept, and what more where it is well seen
SHADING_TEXELS, SHADING, WELL_SEEN = 5.0, 0.06, 0.5
# of a neck: texels over which it is smoothed, how light it may be beside plain skin of the face and of how different a tint,
# how light any place of it beside the rest, and smoothed knowledge up to which that fades out
NECK_TEXELS, NECK_LIGHT, NECK_TINT, NECK_SHADE, NECK_FADE = 5.0, (0.75, 1.0), 0.04, (0.8, 1.1), 0.3
# beside and below the face: how much lighter than plain skin any may be, from where on it is light from behind, and texels over
# which that is looked at
BURNT, BURNT_TEXELS = (0.06, 0.14), 2.0
GRAIN = (0.6, 0.2)  # of seen skin's detail that skin has which was not seen: of the face, and below the chin
HALF_KNOWN = 0.4  # knowledge from which on a texel counts fully in that
HAIR_REACH = 2.0  # unseen skin goes on as hair where half of what is known around it is hair
HAIR_RANGE = (0.1, 0.9)  # quantiles of the seen hair's lightness and tint that hair elsewhere keeps to
SEEN_HAIR_RANGE = (0.03, 0.97)  # likewise of the seen hair itself: extremes cancel out in the photo's view only
_FEW_TEXELS = 100


def facing(model: GRMM, view: FitView, vertices: Tensor, surface: Surface) -> Tensor:
    """How much each texel faces a photo's camera, 0..1, [N]; hair stands off and counts fully."""
    frames = model.anchor(vertices)
    centre = torch.as_tensor(view.camera.position, dtype=model.dtype, device=model.device)
    cosine = (frames.normals * torch.nn.functional.normalize(centre - frames.positions, dim=1)).sum(1)
    frontal = ((cosine - GRAZING[0]) / (GRAZING[1] - GRAZING[0])).clamp(0, 1)
    lids = model.head_model.marked("lids")[corners_of(model)].all(1) if model.config.hairless else np.zeros(len(frontal), bool)
    whole = (surface.group == SCALP) | torch.as_tensor(lids, device=frontal.device)  # lids end where they turn away
    return torch.where(whole, torch.ones_like(frontal), frontal)


def uncut(model: GRMM, view: FitView, vertices: Tensor) -> Tensor:
    """How far inside a picture each texel lies, 0..1, [N]: 0 at its edge, 1 from `EDGE_PIXELS` on."""
    _, pixels = view.camera.project(model.anchor(vertices).positions.cpu().numpy().astype(np.float64))
    size = np.array([view.camera.width, view.camera.height])
    within = np.minimum(pixels, size - pixels).min(1)
    return torch.as_tensor(np.clip(within / EDGE_PIXELS, 0.0, 1.0)).to(vertices)


def unclipped(model: GRMM, view: FitView, vertices: Tensor, attributes: Attributes) -> Tensor:
    """How far each texel's color is told by a photo that has not burnt it out, 0..1, [N]: of several, another may tell it."""
    clear, shown = (contributions(model, view, vertices, attributes, part) for part in (view.inside * view.clear, view.inside))
    return (clear / shown.clamp(min=1e-6)).clamp(0, 1).square()


def amid_own(
    model: GRMM, view: FitView, vertices: Tensor, attributes: Attributes, surface: Surface, every: Tensor
) -> Tensor:  # fmt: skip
    """How far a photo shows texels of lips, eyes and mouth amid their own part, 0..1, [N]; 1 elsewhere.

    Tracking is out by a pixel or two: at the rim of the lips a photo shows teeth, at that of an eye the lids.

    Args:
        model: Model.
        view: The photo.
        vertices: Posed, [V, 3].
        attributes: Of the Gaussians.
        surface: Texels.
        every: How many pixels each contributes to, [N].
    """
    corners = corners_of(model)
    eyes = torch.as_tensor(model.head_model.marked("left_eyeball", "right_eyeball")[corners].all(1)).to(surface.lips)
    own = torch.stack([surface.lips, eyes, (surface.group == INNER) & ~eyes], 1).to(every)
    parts = own.clone().requires_grad_(True)
    scene = replace(model.gaussians(vertices.detach(), attributes.detached()), features=parts)
    with torch.enable_grad():
        cover = present(rasterize(scene, view.camera, antialiased=model.config.antialias).features)
        reach = max(1, round(PART_RIM * view.camera.height))
        beside = widened((1.0 - cover.detach()).permute(2, 0, 1), reach)
        (within_own,) = torch.autograd.grad((cover * (1.0 - beside.permute(1, 2, 0))).sum(), parts)
    share = (within_own * own).sum(1) / every.clamp(min=1e-6)
    return torch.where(own.any(1), share, torch.ones_like(share))


def corners_of(model: GRMM) -> np.ndarray:
    """Vertices of the triangle under each texel, [N, 3]."""
    return np.ascontiguousarray(model.head_model.faces[model.layout.face])


def known_of(seen: Tensor) -> Tensor:
    """How far colors of texels count as known that were seen so well, 0..1 each, [N]."""
    return ((seen - SURELY_SEEN[0]) / (SURELY_SEEN[1] - SURELY_SEEN[0])).clamp(0, 1)


def fill_colors(
    surface: Surface, prior: Tensor, start: Tensor, changes: Tensor, seen: Tensor, folded: Tensor, hairy: Tensor
) -> Tensor:  # fmt: skip
    """Changes of color [N, 3] with those of unseen texels.

    A head without hair keeps what the prior decodes where nothing is seen, with the change of the skin around: the shade of
    neck, ears, nostrils and scalp is the prior's. Where the Gaussians have hair, what is filled in on skin is the tone, not
    the change: the decoded tone may be wrong just where nothing is seen, as on lids. Where hair falls over a cheek, unseen
    skin behind it goes on as hair, and does not take the other cheek's color. On the scalp and inside it is the change: the
    decoded hair at the back goes with that at the sides, but takes no tint that the seen hair does not have.

    Args:
        surface: Texels.
        prior: Colors of stage 1 in all their detail, [N, 3].
        start: Colors that the changes are added to: the same with smoothed skin, [N, 3].
        changes: [N, 3].
        seen: How well each texel was seen, 0..1, [N].
        folded: `lids.lid_exposure`, [N].
        hairy: Share of each texel's pixels that are hair before the face, 0..1, [N].
    """
    # what peeps out at the edge of something else, as a raised lid does, has not been seen
    known = known_of(seen)
    if not bool((surface.group == SCALP).any()):
        return _fill_surface(surface, prior, start, changes, known, known * (1.0 - folded))
    tone = surface.smooth(start, TONE_TEXELS)
    around = _bare_skin(surface, start + changes, known * (1.0 - folded))
    darker = around.mean(1) - (start + changes).mean(1)
    shade = ((darker - LID_SHADE[0]) / (LID_SHADE[1] - LID_SHADE[0])).clamp(0, 1)  # the fold's shadow, lashes, the iris
    shown = torch.lerp(start + changes, around, (folded * shade)[:, None])
    skin_known = torch.maximum(known, folded * shade)
    filled = tone + surface.fill(shown - tone, skin_known, rest=COLOR_REST)
    if bool((hairy > 0.0).any()):
        beside = tone + surface.fill(shown - tone, skin_known, mirrored=False, rest=COLOR_REST)
        covered = torch.where(surface.group == SCALP, torch.ones_like(hairy), hairy)[:, None]
        near_hair = surface.fill(covered, torch.maximum(known, (surface.group == SCALP).to(known)), mirrored=False)
        filled = torch.lerp(filled, beside, (HAIR_REACH * near_hair).clamp(0, 1))
    unseen = (1.0 - skin_known)[:, None]
    outer = (shown - start) * (1.0 - unseen) + (filled - start) * unseen
    other = _plausible_hair(surface, start, surface.fill(changes, known), known)
    return torch.where((surface.group == SKIN)[:, None], outer, other)


def _fill_surface(
    surface: Surface, prior: Tensor, start: Tensor, changes: Tensor, known: Tensor, plain_known: Tensor
) -> Tensor:  # fmt: skip
    """Changes of color [N, 3] of a head without hair, which fades from what was seen into the prior, changed as the skin is.

    Only what plain skin has in common is spread far, and the strength of its detail (`grain`): shadows of hair and chin stay
    where they were seen, and fade out beyond.
    Lips, teeth and eyes have colors of their own, and a little beside where they were seen they keep the prior's.
    """
    skin = surface.group == SKIN
    change = start + changes - prior
    plain_known = plain_known * (1.0 - surface.lip_rim) * ~surface.lips  # at their rim a photo shows lips, or teeth
    sample = change[skin & (plain_known > 0.5)].mean(1)
    plain = plain_known
    if len(sample) >= _FEW_TEXELS:
        odd = (change.mean(1) - torch.quantile(sample, 0.5)).abs()
        plain = plain_known * (1.0 - odd / BARE_SKIN).clamp(0, 1)
    plain = plain * (1.0 - surface.below)  # a neck has a tone of its own
    beyond, between = (surface.fill(change, part, rest=COLOR_REST) for part in (plain, plain_known))
    seen = torch.lerp(between, change, plain_known[:, None])  # with its small gaps, as between the lips
    far = surface.smooth((plain_known / HALF_KNOWN).clamp(0, 1)[:, None], EDGE_TEXELS)
    dark = ((beyond - seen).mean(1, keepdim=True) / BARE_SKIN).clamp(0, 1)
    edge = surface.beside[:, None] * ((EDGE[1] - far) / (EDGE[1] - EDGE[0])).clamp(0, 1)
    seen = torch.lerp(seen, beyond, edge * dark)
    lighter = (seen - beyond).mean(1, keepdim=True)
    lighter = torch.maximum(surface.smooth(lighter, BURNT_TEXELS), lighter - BURNT[0])  # single texels may be lighter: pores
    burnt = ((lighter - BURNT[0]) / (BURNT[1] - BURNT[0])).clamp(0, 1) * (surface.beside * skin)[:, None]
    seen = torch.lerp(seen, beyond, burnt)  # a rim of light is none of the person's colors, nor is its tint
    off = surface.smooth(seen, SHADING_TEXELS) - beyond  # shadows of hair, chin and collar would turn with the head
    doubted = surface.beside[:, None] * (1.0 - WELL_SEEN * far.clamp(0, 1))
    seen = seen - doubted * (off - SHADING * torch.tanh(off / SHADING))
    outer = torch.lerp(beyond, seen, _fading(surface, plain_known))
    outer = torch.lerp(outer, _plain_neck(surface, prior, change, beyond, plain_known), surface.below[:, None])
    plain_skin = skin & ~surface.lips & (plain > 0.5)
    if int(plain_skin.sum()) >= _FEW_TEXELS:
        below = surface.below
        own = (known * (1.0 - below)).square()  # variances of own detail and of what is carried add up
        strength = (1.0 - own).sqrt() * (GRAIN[0] + (GRAIN[1] - GRAIN[0]) * below)
        outer = outer + strength[:, None] * grain(surface, change, plain_skin)
    outer = _with_both_brows(surface, change, known, outer)
    parts = surface.lips | (surface.group == INNER)
    alone = surface.fill(change, known * parts, rest=PART_REST)
    return prior - start + plain_mouth(surface, prior, change, known, outer, alone)


def _fading(surface: Surface, known: Tensor) -> Tensor:
    """How far texels have what was seen of skin: a little beyond what is known [N], 0..1 [N, 1]."""
    inner = surface.smooth((known / HALF_KNOWN).clamp(0, 1)[:, None], FEATHER_TEXELS)
    return ((inner - FADES[0]) / (FADES[1] - FADES[0])).clamp(0, 1)


def gone_on(surface: Surface, values: Tensor, known: Tensor) -> Tensor:
    """Values [N, 3] as those of seen skin go on beyond where they are known [N], and fade out."""
    filled = surface.fill(values, known, rest=COLOR_REST)
    return torch.lerp(filled, values, known[:, None]) * _fading(surface, known)


def _with_both_brows(surface: Surface, change: Tensor, known: Tensor, outer: Tensor) -> Tensor:
    """Changes of color [N, 3] with what is hidden of a brow, as by hair, like the other one: skin below has its color, too."""
    told = known * surface.brows
    values = torch.cat([change, torch.ones_like(change[:, :1])], 1)
    brow, shown = surface.fill(values, told, rest=PART_REST).split((3, 1), 1)
    share = (surface.brows * (1.0 - known))[:, None] * (shown / HALF_KNOWN).clamp(0, 1)
    return torch.lerp(outer, brow / shown.clamp(min=HALF_KNOWN), share)


def _plain_neck(surface: Surface, prior: Tensor, change: Tensor, beyond: Tensor, known: Tensor) -> Tensor:
    """Changes of color [N, 3] to plain skin of the neck's own tone, for what is below the chin.

    A neck is darker and redder than the face above it, evenly: what the photo shows of it gives one tone for all of it. Around
    that it is smoothly darker where it was seen so. What else a photo shows there is the tint of shadows, which light never
    explains to the end, and the rims of collars and necklaces.

    Args:
        surface: Texels.
        prior: Colors of stage 1, [N, 3].
        change: To what the photo shows, [N, 3].
        beyond: To plain skin, [N, 3].
        known: How well plain skin is known, 0..1, [N].
    """
    plain = prior + surface.smooth(beyond, NECK_TEXELS)
    told = known * surface.below
    ratio = (prior + change) / plain.clamp(min=1e-2)
    sample = ratio[told > HALF_KNOWN]
    if len(sample) < _FEW_TEXELS:
        return plain - prior
    tone = torch.quantile(sample, 0.5, dim=0)
    light = tone.mean()
    tint = (tone / light).clamp(1.0 - NECK_TINT, 1.0 + NECK_TINT)
    own = ((ratio.mean(1, keepdim=True) / light).clamp(*NECK_SHADE) - 1.0) * told[:, None]
    shade, weight = surface.smooth(torch.cat([own, told[:, None]], 1), NECK_TEXELS).split(1, 1)
    shade = 1.0 + shade / weight.clamp(min=NECK_FADE)
    return plain * tint * (light * shade).clamp(*NECK_LIGHT) - prior


def _bare_skin(surface: Surface, colors: Tensor, known: Tensor) -> Tensor:
    """Colors [N, 3] of the known skin, spread over everything; brows, lashes and stubble are left out."""
    skin = surface.group == SKIN
    sample = colors[skin & (known > 0.5)]
    if len(sample) < _FEW_TEXELS:
        return colors
    middle = torch.quantile(sample, 0.5, dim=0)
    bare = skin & (colors.mean(1) > middle.mean() - BARE_SKIN)
    return middle + surface.fill(colors - middle, known * bare, mirrored=False, rest=COLOR_REST)


def _plausible_hair(surface: Surface, start: Tensor, changes: Tensor, known: Tensor) -> Tensor:
    """Changes [N, 3] with the scalp brought into the range of its seen texels: narrowly where it was not seen itself."""
    colors = start + changes
    scalp = surface.group == SCALP
    sample = colors[scalp & (known > 0.5)]
    if len(sample) < _FEW_TEXELS:
        return changes
    unseen, seen = (within(colors, sample, limits) for limits in (HAIR_RANGE, SEEN_HAIR_RANGE))
    return torch.where(scalp[:, None], torch.lerp(unseen, seen, known[:, None]) - start, changes)


def within(colors: Tensor, sample: Tensor, quantiles: tuple[float, float]) -> Tensor:
    """Colors [N, 3] whose lightness and tint keep to the quantiles of a sample's [M, 3]."""

    def parts(values: Tensor) -> tuple[Tensor, Tensor]:
        lightness = values.mean(1, keepdim=True)
        return lightness, values - lightness

    kept = []
    for known, every in zip(parts(sample), parts(colors), strict=True):
        low, high = torch.quantile(known, sample.new_tensor(quantiles), dim=0)
        kept.append(torch.minimum(torch.maximum(every, low), high))
    return kept[0] + kept[1]
