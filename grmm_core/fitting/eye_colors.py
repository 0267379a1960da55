"""Irises, whites and the edges of lids: a dozen pixels of a photo, which people look at first.

Tracking is out by a pixel, lamps are mirrored in the cornea, lashes and the shade of lids lie over all of it. Painted texel by
texel an iris has no pupil but a smear of gloss, and a lid that the photo shows narrowed keeps the iris on its edge. At rest
eyes are the prior's, iris and white each in the tone that the photo shows of it, and the dark line of the lashes is even; what
else a photo shows there belongs to its light (`settling.locally_lit`).

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

import torch
from torch import Tensor

from ..light.eye_shade import LIMBUS, polar_angles
from ..model.grmm import GRMM

PUPIL_DEGREES = (8.0, 10.0)  # from the pole of an eyeball: up to which all is pupil, and from where on iris
TELLS_IRIS = (10.0, 20.0)  # likewise, what tells the iris's tone: neither the pupil nor the dark rim
TELLS_WHITE = (28.0, 50.0)
DETAIL = 0.03  # of a color, that eyes keep beside their tone
TONE = (0.25, 4.0)  # of an iris over the prior's: beyond it a photo shows something else
WHITE_TINT = 0.06  # how far the tint of a white may differ from the prior's
LINE = (0.8, 1.1)  # how dark and light a place of the lashes' line may be beside the middle of it
# quantiles of the lightness of what tells a tone: lamps in the cornea are brighter than an iris, lashes darker than a white
_OF_IRIS, _OF_WHITE, _OF_LINE = (0.2, 0.6), (0.4, 0.8), (0.3, 0.7)
_TOLD = 0.5  # knowledge from which on a texel tells the tone
_FEW_TEXELS = 24


def eye_angles(model: GRMM) -> Tensor:
    """Degrees of each texel from the pole of its eyeball, which looks ahead at rest, [N]; infinite beside eyeballs.

    Infinite everywhere where Gaussians have hair: no light at the texels keeps there what a photo shows of eyes.
    """
    if not model.config.hairless:
        return torch.full((model.gaussian_count,), torch.inf).to(model.anchor.barycentric)
    return torch.as_tensor(polar_angles(model.head_model, model.lit_texels)).to(model.anchor.barycentric)


def plain_eyes(angles: Tensor, colors: Tensor, decoded: Tensor, known: Tensor, amid: Tensor) -> Tensor:
    """Colors [N, 3] with eyes as the prior has them, in the person's tones; as they are where too little tells these.

    Args:
        angles: `eye_angles`, [N].
        colors: Of the person, [N, 3].
        decoded: By the weights, for this person, [N, 3].
        known: How far each texel's color is known, 0..1, [N]; at the rim of eyes by what may be lids.
        amid: Likewise, where eyes are seen around it.
    """
    told = known > _TOLD
    iris = _tone(colors, decoded, told & (angles >= TELLS_IRIS[0]) & (angles < TELLS_IRIS[1]), _OF_IRIS)
    white = _tone(colors, decoded, told & (angles >= TELLS_WHITE[0]) & (angles < TELLS_WHITE[1]), _OF_WHITE)
    if iris is None or white is None:
        return colors
    light = white.mean()
    white = light * (white / light).clamp(1.0 - WHITE_TINT, 1.0 + WHITE_TINT)
    iris = iris.clamp(*TONE)
    pupil = iris.mean().clamp(max=1.0).expand(3)
    tone = torch.lerp(torch.lerp(pupil, iris, _share(angles, PUPIL_DEGREES)), white, _share(angles, LIMBUS))
    plain = decoded * tone
    plain = plain + amid[:, None] * DETAIL * torch.tanh((colors - plain) / DETAIL)
    return torch.where(torch.isfinite(angles)[:, None], plain, colors)


def even_lash_line(share: Tensor, upper: Tensor, colors: Tensor, prior: Tensor, known: Tensor) -> Tensor:
    """Colors [N, 3] whose lids have one dark line along the lashes each, as dark as the photo shows it in the middle.

    Args:
        share: How far each texel lies on that line, 0..1, [N].
        upper: Whether it is of an upper lid, [N].
        colors: Of the person, [N, 3].
        prior: That the weights decode for this person, likewise.
        known: How far each texel's color is known, 0..1, [N].
    """
    for lid in (upper, ~upper):
        tone = _tone(colors, prior, lid & (share > 0.5) & (known > _TOLD), _OF_LINE)
        if tone is None:
            continue
        usual = prior * tone
        lightness = colors.mean(1, keepdim=True) / usual.mean(1, keepdim=True).clamp(min=1e-2)
        colors = torch.lerp(colors, usual * lightness.clamp(*LINE), (share * lid)[:, None])
    return colors


def _share(angles: Tensor, limits: tuple[float, float]) -> Tensor:
    """0 below the first limit, 1 from the second on, [N, 1]."""
    return ((angles - limits[0]) / (limits[1] - limits[0])).clamp(0, 1)[:, None]


def _tone(colors: Tensor, prior: Tensor, told: Tensor, middle: tuple[float, float]) -> Tensor | None:
    """Factor of the prior's colors that the told texels of middle lightness show, [3]; None where they are few."""
    rows = torch.nonzero(told)[:, 0]
    if len(rows) < _FEW_TEXELS:
        return None
    first, last = (round(share * len(rows)) for share in middle)
    rows = rows[colors[rows].mean(1).argsort()[first:last]]
    return colors[rows].mean(0) / prior[rows].mean(0).clamp(min=2e-2)
