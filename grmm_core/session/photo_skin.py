"""How far what a photo shows of skin under its own hair still holds: not where that hair is cut off, thinned, dyed or another.

A fitted person's texels show the photo's hair at temples, hairline and nape, and brows and beard where these are. Under the
same strands they belong there; a host's curves may have lost some of these, the panel's sliders give them another color, and
other brows or none bare the skin. Called by `wardrobe`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..avatar.deltas import APPEARANCE, rounded
from ..compute.recent import Recent
from ..controls.frame import Controls
from ..geometry.libraries import to_numpy
from ..geometry.points import squared_distances
from ..hair.brows import painted
from ..hair.groom import Groom
from ..hair.pigment import albedos
from ..hair.roots import SCALP
from ..hair.settings import HairSettings
from ..head import HeadModel
from ..pictures.color import linear_to_srgb
from .evaluator import FRONT, Evaluator, Inputs, OpenAvatar, at_rest
from .scalp import places_of, ramp, seen_colors, smoothed

REACH = 0.02  # metres of a strand from its root on that cover the skin there
SPREAD = 6  # triangles over which roots count: painted hair lies beside them, too
FEW = 0.05  # of the middle density of roots: where there are fewer, nothing of a photo's hair is missed
GONE, THERE = 0.2, 0.7  # of what covers the skin: up to where the photo's hair is gone, and from where on it is there
ALIKE, UNLIKE = 0.04, 0.16  # of full brightness, by which hair may differ from the photo's before its paint is not hair's
THIN = 0.02  # of a texel by the scalp, up to which it is none
# metres from strands of brows or a beard: up to the first skin is theirs, from the second on not; and of the skin around, from
# how dark on it is painted hair, and wholly. What photos paint; the tint that weights have of brows, about their roots alone
PLUCKED, DARKER = (0.0025, 0.0055), (0.97, 0.85)
TINTED, FAINTER = (0.003, 0.0045), (1.0, 0.97)
MOLE = (0.55, 0.65)  # of the skin around: what is darker than a tint is a mole, wholly and from where on
# metres beside these strands in which skin tells what plain skin is there, and over which that is smoothed; texels of it
BESIDE, NEAR, SAMPLES = 0.015, 0.004, 3000
LEAST = 0.02  # display color that may be that of hair


def still_there(target: OpenAvatar, photo: Groom | None, worn: Sequence[Groom], settings: HairSettings) -> np.ndarray:
    """How far the hair of a photo still covers the skin of each texel, 0..1, float32 [N].

    Args:
        target: Whose texels.
        photo: The groom of its file, None where that has none.
        worn: What is worn instead, made of it.
        settings: That this is drawn with; less density covers less.
    """
    layout, head = target.model.layout, target.model.head_model
    if photo is None:
        return np.ones(len(layout), np.float32)
    before = _roots(head, [photo])
    few = FEW * float(np.median(before[before > 0])) if (before > 0).any() else 1.0
    left = (_roots(head, worn) * min(settings.density, 1.0) + few) / (before + few)
    there = (left[np.asarray(head.faces)[layout.face]] * layout.barycentric).sum(1)
    return np.asarray(ramp(there, GONE, THERE), np.float32)


def as_found(settings: HairSettings, photo: HairSettings) -> float:
    """How far hair has the color that it has in the photo, 0..1."""
    colors = [linear_to_srgb(albedos(one, np.zeros(1), np.full((1, 2), 0.5))[0].mean(0)) for one in (settings, photo)]
    return float(ramp(np.abs(colors[0] - colors[1]).max(), UNLIKE, ALIKE))


def plucked(evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, gone: Groom) -> np.ndarray:
    """Factor of display colors that makes plain skin of what a photo painted of hair on the face that is not worn, [N, 3].

    Args:
        evaluator: Of the session.
        target: Made from photos.
        inputs: At rest.
        gone: Its own brows, beard, or both.
    """
    template = np.asarray(target.model.head_model.v_template, np.float64)
    hairs = gone.posed(gone.frames(template, target.model.head_model.faces), template)
    return _plain(target, seen_colors(evaluator, target, inputs, 1.0), hairs, PLUCKED, DARKER)


def untinted(evaluator: Evaluator, target: OpenAvatar, inputs: Inputs) -> np.ndarray:
    """Likewise without the tint of brows that weights have learned on bare skin."""
    head = target.model.head_model
    brows = _TINT.get((head,), lambda: painted(head))
    return _plain(target, seen_colors(evaluator, target, inputs, 1.0), brows, TINTED, FAINTER, MOLE)


_TINT: Recent[np.ndarray] = Recent(2)


def _plain(
    target: OpenAvatar, seen: np.ndarray, hairs: np.ndarray, reach: tuple[float, float], darker: tuple[float, float],
    mole: tuple[float, float] = (0.0, 0.0),
) -> np.ndarray:  # fmt: skip
    """Factor that gives colors [N, 3] near points of hairs those of the skin around, where they are darker, float32 [N, 3]."""
    places = places_of(target)
    hairs = hairs[:: max(1, len(hairs) // SAMPLES)]
    low, high = hairs.min(0) - reach[1], hairs.max(0) + reach[1]
    there = np.flatnonzero(places.outer & ((places.points > low) & (places.points < high)).all(1))
    zone, color = np.zeros(len(seen), np.float32), seen.copy()
    apart = [np.sqrt(squared_distances(places.points[part], hairs).min(1)) for part in _parts(there)]
    zone[there] = ramp(np.concatenate(apart), *reach[::-1]) if apart else 0.0
    around = ((places.points > low - BESIDE) & (places.points < high + BESIDE)).all(1)
    bare = np.flatnonzero(places.outer & around & (places.scalp < THIN) & (zone <= 0.0) & ~_eyes_and_lips(target))
    bare = bare[:: max(1, len(bare) // SAMPLES)]
    there = there[zone[there] > 0.0] if len(bare) else there[:0]
    for part in _parts(there):
        near = 1.0 / (squared_distances(places.points[part], places.points[bare]) + NEAR**2) ** 2
        color[part] = (near @ seen[bare]) / near.sum(1, keepdims=True)
    left = seen.mean(1) / np.maximum(color.mean(1), 1e-4)
    dark = ramp(left, *darker) * (ramp(left, *mole) if mole[1] else 1.0)
    own, plain = (linear_to_srgb(part).clip(LEAST, 1.0) for part in (seen, color))
    factor: np.ndarray = 1.0 + (zone * dark)[:, None] * (plain / own - 1.0)
    return factor.astype(np.float32)


def unpainted(evaluator: Evaluator, target: OpenAvatar, gone: Groom) -> dict[str, np.ndarray]:
    """An avatar's changes of the weights without what a photo painted of hair on the face, as of `plucked`, for its file."""
    deltas = dict(target.avatar.deltas)
    if APPEARANCE in deltas:
        still = at_rest(target, evaluator.inputs(target, Controls()))
        shown = to_numpy(evaluator.appearance(target, still, FRONT)[0]).clip(0.0, 1.0)
        colors = np.array(deltas[APPEARANCE], np.float32)
        colors[:, :3] += (plucked(evaluator, target, still, gone) - 1.0) * shown
        deltas[APPEARANCE] = rounded(colors)
    return deltas


def _eyes_and_lips(target: OpenAvatar) -> np.ndarray:
    """Texels of the outer skin that are no skin, bool [N]."""
    head = target.model.head_model
    marked: np.ndarray = head.marked("lips", "lashes", "left_eyeball", "right_eyeball", "mouth_interior")
    return marked[np.asarray(head.faces)[target.model.layout.face]].any(1)


def _parts(rows: np.ndarray) -> list[np.ndarray]:
    return [part for part in np.array_split(rows, max(1, len(rows) // 256)) if len(part)]


def _roots(head: HeadModel, grooms: Sequence[Groom]) -> np.ndarray:
    """Area of strands near their roots, by the vertices that these stand on, of one unit or another, [V]."""
    faces, found = np.asarray(head.faces), np.zeros(len(head.v_template))
    for whole in grooms:
        groom = whole.select(whole.groups == SCALP)
        if not len(groom):
            continue
        lengths = groom.lengths.clip(max=REACH)
        np.add.at(found, faces[groom.triangles], groom.weights * (lengths * groom.widths[:, 0])[:, None])
    for _ in range(SPREAD):
        found = smoothed(found, faces)
    return found
