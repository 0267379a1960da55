"""What of a photo's colors belongs to its expression: folds of a smile, furrows of a brow.

The coarse mesh has no normals for them. They lie where the expression stretches or folds the skin, and stand out from the skin
around. Painted on the person they would stay in the neutral face. So they become a color map of the person that comes and goes
with the expression code, as the trained ones do (`model.decoders.ExpressionMaps`): whole in the photo's expression, a part of
them (`STAYS`) at rest. Of several photos each has its own, for what it shows otherwise than the calmer ones.

Called by `decoder_stage`. Imports torch.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch
from torch import Tensor

from ..head import HeadModel
from ..model.decoders import ExpressionMaps
from ..model.grmm import GRMM
from .photo_targets import FitView
from .surface import SKIN, Surface

FEATURES = ("lips", "lids", "brows")
STRAIN = (0.08, 0.25)  # share by which skin is stretched or folded: below the first nothing is a crease, above the second all
DEEP_STRAIN = (0.015, 0.05)  # likewise of dark folds, as beside a nose: the photo's light throws their shadow
DEEP, FOLD_TEXELS = (0.03, 0.08), 1.5  # how dark these are beside the skin around, smoothed over so many texels
STRONG, SOFT_TEXELS = (0.1, 0.25), 0.7  # folds so strong are smoothed over so many texels
OWN_STRAIN = (0.03, 0.12)  # likewise where other photos show the skin otherwise
OWN_TEXELS = 16.0  # length below which that is a fold
MOST_BROUGHT = 1.0  # of what a photo shows otherwise than others: no trained expression brings more of it
SPREAD = 3  # times that the strain is averaged over neighbouring vertices: folds lie beside what moves
WIDTH_TEXELS = 10.0  # length below which colors are creases
STAYS = 0.5  # of creases that are seen at rest, too: a face that smiles much is known by them
PORES = 0.03  # of the detail that stays in every expression: about so much of it
RIM_TEXELS, AWAY = 2.0, (0.6, 0.95)  # from features: smoothed share of plain skin
# strength of the expression, in the trained maps' weights: below the first a photo counts as neutral, above the second not
FAINT = (0.04, 0.06)
FOLDED_TELLS = 0.3  # how much strained skin tells of the colors at rest beside skin at rest
MOST = 0.6  # of a color, as that of teeth where another photo shows lips
WRONG_WAY = 0.1  # of a fold that other expressions may have as a ridge
_ROUNDS, _BEYOND = 8, 15.0  # of the least squares, and how much what lies beyond these limits counts in them
_ALIKE = 0.02  # of the mean square of the photos' weights
_RIDGE = 0.02  # of the other expressions' weights: keeps creases out of those that are unlike


def strained(head: HeadModel, resting: np.ndarray, posed: np.ndarray) -> np.ndarray:
    """How far an expression stretches or folds the skin around each vertex, as a share of its length, [V].

    Args:
        head: Head model.
        resting: Vertices at rest, [V, 3] metres.
        posed: In the expression, likewise.
    """
    faces = head.faces
    before, after = (_plane_edges(np.asarray(vertices, np.float64)[faces]) for vertices in (resting, posed))
    inverse = np.linalg.inv(before + 1e-9 * np.eye(2))
    stretch = np.linalg.svd(after @ inverse, compute_uv=False)  # [F, 2]
    change = np.abs(np.log(np.clip(stretch, 0.2, 5.0))).max(1)
    count = np.bincount(faces.ravel(), minlength=len(resting)).clip(1)
    at = np.bincount(faces.ravel(), np.repeat(change, 3), len(resting)) / count
    for _ in range(SPREAD):
        at = np.bincount(faces.ravel(), np.repeat(at[faces].mean(1), 3), len(resting)) / count
    return at


def _plane_edges(corners: np.ndarray) -> np.ndarray:
    """Two edges of each triangle [F, 3, 3] in its own plane, as columns, [F, 2, 2]."""
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    length = np.linalg.norm(first, axis=1).clip(1e-9)
    along = first / length[:, None]
    x = (second * along).sum(1)
    y = np.linalg.norm(second - x[:, None] * along, axis=1)
    return np.stack([np.stack([length, x], -1), np.stack([np.zeros_like(y), y], -1)], 1)


class Folding:
    """How the expressions of a person's photos strain the skin.

    Args:
        model: Model.
        surface: Texels.
        views: Photos.
        parts: Lips, eyes and mouth, [N] bool.
        z_id: Of the person, [Z].
        offsets: z_exp of each photo less that of the face at rest, [P, Y].

    Attributes:
        strains: `strained` at the texels, by photo, [P, N].
        features: Lips, lids and brows, [N] bool.
        parts: These and eyes and mouth, likewise.
        calm: How much a photo tells of the colors that the skin has at rest, beside the photo that tells most, 0..1 [P, N].
    """

    def __init__(
        self, model: GRMM, surface: Surface, views: Sequence[FitView], parts: Tensor, z_id: Tensor, offsets: Tensor
    ) -> None:  # fmt: skip
        head, like = model.head_model, model.anchor.barycentric
        corners = head.faces[model.layout.face]
        strains = []
        for view in views:
            shape, expression, pose = (part.cpu().numpy() for part in (view.shape, view.expression, view.pose))
            resting = head.vertices(shape, np.zeros_like(expression), np.zeros_like(pose))
            strains.append(torch.as_tensor(strained(head, resting, head.vertices(shape, expression, pose))).to(like))
        self.strains = (torch.stack(strains)[:, corners] * like).sum(-1)
        features = head.marked(*(name for name in FEATURES if name in head.regions))[corners].any(1)
        self.features = torch.as_tensor(features, device=like.device)
        self.parts = parts | self.features
        trained = model.decoders.expression
        if trained is None:  # nothing can come and go
            self.calm = torch.ones_like(self.strains)
            return
        strength = (trained.weights(offsets) * (1.0 + trained.gains(z_id))).norm(dim=1)  # [P]
        moved = ((strength - FAINT[0]) / (FAINT[1] - FAINT[0])).clamp(0, 1)[:, None]
        skin = (surface.group == SKIN).to(like)
        calm = 1.0 - (1.0 - FOLDED_TELLS) * moved * torch.where(self.parts, 1.0, skin * share_of(self.strains, OWN_STRAIN))
        self.calm = (calm / calm.amax(0)).detach()


def share_of(strain: Tensor, strains: tuple[float, float] = STRAIN) -> Tensor:
    """How much of what stands out of the skin belongs to the expression that strains it so, 0..1."""
    return ((strain - strains[0]) / (strains[1] - strains[0])).clamp(0, 1)


def crease_colors(surface: Surface, colors: Tensor, strain: Tensor, features: Tensor) -> Tensor:
    """The part of the skin's colors [N, 3] that belongs to the photos' expression.

    Args:
        surface: Texels.
        colors: As the photos show them.
        strain: `strained` at the texels, [N].
        features: Lips, lids and brows, [N] bool: their detail is the person's.
    """
    detail, plain = skin_detail(surface, colors, features), plain_skin(surface, features)
    lasting = PORES * torch.tanh(detail / PORES)
    deep = share_of(-surface.smooth(detail, FOLD_TEXELS).mean(1), DEEP)
    share = torch.maximum(share_of(strain), deep * share_of(strain, DEEP_STRAIN))
    return (1.0 - STAYS) * (share * _away(surface, plain))[:, None] * (detail - lasting)


def plain_skin(surface: Surface, features: Tensor) -> Tensor:
    """1 on skin but lips, lids and brows, [N, 1]."""
    return ((surface.group == SKIN) & ~features).to(surface.degrees)[:, None]


def skin_detail(surface: Surface, colors: Tensor, features: Tensor) -> Tensor:
    """What of colors [N, 3] stands out from the plain skin around, [N, 3]; 0 elsewhere."""
    plain = plain_skin(surface, features)
    around = surface.smooth(colors * plain, WIDTH_TEXELS) / surface.smooth(plain, WIDTH_TEXELS).clamp(min=1e-3)
    return (colors - around) * plain


def soft_folds(surface: Surface, colors: Tensor, strain: Tensor, features: Tensor) -> Tensor:
    """Colors [N, 3] within what screens show, with strong folds smoothed along the surface.

    A fold is a line of a texel or two: oblique to their rows it is one of dark and light texels in turn, from near a comb.

    Args:
        surface: Texels.
        colors: As the photos show them.
        strain: `strained` at the texels, [N].
        features: Lips, lids and brows, [N] bool.
    """
    plain = plain_skin(surface, features)
    colors = torch.where(plain > 0.0, colors.clamp(0.0, 1.0), colors)
    detail = skin_detail(surface, colors, features)
    depth = surface.smooth(detail.mean(1, keepdim=True).abs(), FOLD_TEXELS)[:, 0]
    share = share_of(depth, STRONG) * share_of(strain, DEEP_STRAIN)
    return colors + share[:, None] * plain * (surface.smooth(detail, SOFT_TEXELS) - detail)


def folds_brought(
    surface: Surface, maps: ExpressionMaps, z_id: Tensor, resting: Tensor, shown: Sequence[Tensor], features: Tensor
) -> Tensor:  # fmt: skip
    """Folds that the trained expression maps bring to plain skin with each photo's expression, [P, N, 3].

    Args:
        surface: Texels.
        maps: The trained ones.
        z_id: Of the person, [Z].
        resting: z_exp of the face at rest, [Y].
        shown: Of each photo, [Y].
        features: Lips, lids and brows, [N] bool.
    """
    rest = maps(z_id, resting)
    return torch.stack([skin_detail(surface, maps(z_id, one) - rest, features) for one in shown])


def own_colors(surface: Surface, difference: Tensor, strain: Tensor, parts: Tensor, trust: Tensor) -> Tensor:
    """The part of what one photo shows otherwise than the calmest does [N, 3] that belongs to its expression.

    Args:
        surface: Texels.
        difference: As the photo shows it, [N, 3].
        strain: `strained` at the texels, [N].
        parts: Lips, lids, brows, eyes and mouth, [N] bool: they move, and are never tracked to the texel.
        trust: In the photo's light, 0..1: of a light that is not known well edges of shadows are left, which are no folds.
    """
    skin = (surface.group == SKIN).to(difference)
    detail = difference - surface.smooth(difference * skin[:, None], OWN_TEXELS)  # what is wide is the photo's light
    share = trust * skin * share_of(strain, OWN_STRAIN)
    moved = torch.where(skin > 0.0, trust * difference.T, difference.T).T  # teeth are no matter of light
    return torch.where(parts[:, None], moved, share[:, None] * detail).clamp(-MOST, MOST)


def _away(surface: Surface, plain: Tensor) -> Tensor:
    """1 on plain skin [N, 1] away from lips, lids and brows, [N]."""
    away = ((surface.smooth(plain, RIM_TEXELS)[:, 0] - AWAY[0]) / (AWAY[1] - AWAY[0])).clamp(0, 1)
    return away * plain[:, 0]


class Bringing(NamedTuple):
    """How expressions bring what photos show in theirs, through the trained expression maps.

    Attributes:
        told: Photos whose expression differs from rest, [P] bool.
        directions: Of each of these T among the K maps' weights, [K, T].
        shares: How much of what a photo alone shows can be brought, so that no trained expression overdoes it, [P].
    """

    told: Tensor
    directions: Tensor
    shares: Tensor

    def maps(self, creases: Tensor) -> Tensor:
        """Change of the maps [K, N * 3] that brings creases of each photo, [P, N, 3]."""
        return self.directions @ creases[self.told].flatten(1)


def bringing(
    maps: ExpressionMaps, z_id: Tensor, resting: Tensor, shown: Sequence[Tensor], others: Tensor
) -> Bringing | None:  # fmt: skip
    """How the expressions of photos bring what these show.

    Args:
        maps: The trained ones.
        z_id: Of the person, [Z].
        resting: z_exp of the face at rest, [Y].
        shown: Of each photo, [Y].
        others: Of expressions that should have none but what is like the photos', [E, Y], added to `resting`.

    Returns:
        None where the photos are neutral. What it brings is to be made up for at rest by `weights(resting) @ change`.
    """
    gains = 1.0 + maps.gains(z_id)
    weights = maps.weights(torch.stack(list(shown)) - resting) * gains  # [P, K]
    told = weights.norm(dim=1) >= 0.5 * sum(FAINT)
    if not bool(told.any()):
        return None
    weights = weights[told]
    rest = maps.weights(others) * gains  # [E, K]
    own = weights @ weights.T
    own = own + _ALIKE * own.trace() / len(own) * torch.eye(len(own)).to(own)  # photos that are alike share
    alike = torch.linalg.solve(own, weights @ rest.T).T.clamp(0, 1)  # [E, T]
    directions = torch.stack([_direction(weights, index, rest, alike[:, index]) for index in range(len(weights))], 1)
    if len(weights) == 1:  # of several, reaching each exactly would overdo what is unlike all of them
        directions = directions / (weights @ directions)
    shares = torch.ones(len(told)).to(weights)
    shares[told] = (MOST_BROUGHT / (rest @ directions).amax(0).clamp(min=1e-3)).clamp(max=1.0)
    return Bringing(told, directions, shares)


def _direction(weights: Tensor, index: int, rest: Tensor, alike: Tensor) -> Tensor:
    """Among the maps' weights, [K]: 1 for one photo, 0 for the others, and for other expressions `alike` [E] and little more.

    Least squares in rounds: what an expression would have the wrong way round, folds as ridges, or more of than a photo shows
    counts much.
    """
    wanted, counts = alike, torch.ones_like(alike)
    fitted, own = weights.T @ weights + 1e-4 * torch.eye(weights.shape[1]).to(weights), weights[index]
    for _ in range(_ROUNDS):
        told = _RIDGE * rest.T * counts  # [K, E]
        direction = torch.linalg.solve(fitted + told @ rest, own + told @ wanted)
        reached = rest @ direction
        inside = reached.clamp(-WRONG_WAY, MOST_BROUGHT)
        wanted = torch.where(reached == inside, alike, inside)
        counts = torch.where(reached == inside, 1.0, _BEYOND)
    return direction
