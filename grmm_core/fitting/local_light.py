"""What each of several photos shows of its light that no lamp explains: shadows of hair, highlights, edges of shadows.

What a photo shows otherwise than flat colors in its light, as far as it is wide, is either color that was not known or light
that was not: d_k = f + r_k in logarithms, f of the person and r_k of photo k. With f ~ N(0, `_COLOR`^2) and r_k ~ N(0, s_k^2),
where s_k is how uneven the photo's light leaves skin of one tone (`person_lights.doubts`), the likeliest f is the mean of the
d_k weighted by 1 / s_k^2, less a part. So in skin that a hard light alone shows the person keeps the prior's wide shades, and
takes the detail. Used by `invert` and `settling`. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..head import HeadModel
from ..light.relight import to_linear
from ..light.resting import Texels
from .photo_light import Seen

_COLOR = 0.05  # expected wide error of the person's colors, of their logarithm
_ROUNDS = (3,)  # of averaging over neighbouring vertices, which lie 5 mm apart in a face
_LAST_ROUNDS = (1, 4, 16)  # likewise once colors are known: light goes on where skin is seen at a slant
_HALF_SEEN = 0.3  # texels of a vertex at which it is half believed
_WEAKER = 10.0  # of wider means so much fewer are
_GLARE = (0.2, 0.5)  # of the logarithm: brighter by the first a photo is believed less, from the second on not at all
_MOST = 1.5  # of the logarithm
_DARKEST = 5e-4  # linear color below which nothing is told
_BURNT, _DARK = 0.99, 0.01  # display values that tell no light


def local_lights(
    head: HeadModel, texels: Texels, every: Sequence[Seen], ratios: Sequence[np.ndarray], flat: np.ndarray, doubt: np.ndarray,
) -> tuple[list[np.ndarray], np.ndarray]:  # fmt: skip
    """Find them.

    Args:
        head: Head model.
        texels: Of the avatar.
        every: Skin of each photo.
        ratios: Light of each, relative to the rig's, [N, 3].
        flat: Colors of the texels, linear RGB, [N, 3].
        doubt: Of each photo, [P].

    Returns:
        `Lighting.local` of each photo, [V, 3] float32, and how far each tells the texels' colors, 0..1, [P, N]: not where it is
        much brighter than that and than what the others show, in highlights and rims of light.
    """
    found, precision = [], []
    for seen, ratio, own in zip(every, ratios, doubt, strict=True):
        off, told = _off(seen, ratio * flat)
        light = ratio.min(1)
        dim = np.clip(light / np.median(light[told > 0]), 0.0, 1.0) if told.any() else light * 0.0
        wide, sure = _at_vertices(head, texels, np.concatenate([off, dim[:, None]], 1), told, _ROUNDS)
        found.append((wide[:, :3], sure))
        precision.append(sure * (wide[:, 3:] / own) ** 2)
    total = sum(precision) + _COLOR**-2
    color = sum(weight * off for weight, (off, _) in zip(precision, found, strict=True)) / total
    local = [np.exp(sure * (off - color)).astype(np.float32) for off, sure in found]
    lit = (ratio * texels.factor(own) for ratio, own in zip(ratios, local, strict=True))
    flat = flat * np.exp(texels.at(color))
    left = np.stack([_off(seen, light * flat)[0].mean(1) for seen, light in zip(every, lit, strict=True)])
    shown = np.stack([seen.weights > 0 for seen in every])
    least = np.where(shown, left, np.inf).min(0)
    bright = left - np.where(shown.sum(0) > 1, least, 0.0)  # what all show is a mark
    return local, np.where(shown, np.clip((_GLARE[1] - bright) / (_GLARE[1] - _GLARE[0]), 0.0, 1.0), 1.0)


def more_local(head: HeadModel, texels: Texels, seen: Seen, drawn: np.ndarray) -> np.ndarray:
    """What is left of a photo's light once the person is known, a factor as `Lighting.local`, [V, 3] float32.

    Args:
        head: Head model.
        texels: Of the avatar.
        seen: What the photo shows, lips and eyes, too.
        drawn: Colors of the texels as the avatar is drawn in the photo's light, display sRGB, [N, 3].
    """
    off, told = _off(seen, np.asarray(to_linear(np.asarray(drawn, np.float64))))
    wide, sure = _at_vertices(head, texels, off, told, _LAST_ROUNDS)
    return np.exp(sure * wide).astype(np.float32)


def _off(seen: Seen, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm of a photo's colors over drawn ones, both linear RGB [N, 3], and how much it counts, [N]."""
    told = (seen.colors < _BURNT).all(1) & (seen.colors > _DARK).all(1) & (drawn > _DARKEST).all(1)
    linear = np.asarray(to_linear(np.asarray(seen.colors, np.float64)))
    off = np.log(np.maximum(linear, _DARKEST) / np.maximum(drawn, _DARKEST))
    return off.clip(-_MOST, _MOST), seen.weights * told


def _at_vertices(
    head: HeadModel, texels: Texels, values: np.ndarray, weights: np.ndarray, rounds: Sequence[int]
) -> tuple[np.ndarray, np.ndarray]:  # fmt: skip
    """Smooth means of texels' values [N, C] at vertices, [V, C], and how sure they are, 0..1, [V, 1]; an eye has one value.

    Means are over neighbours, so many `rounds`; where little is told, the next, wider ones take their place.
    """
    count = head.vertex_count
    corners, shares = texels.corners.reshape(-1), (texels.barycentric * weights[:, None]).reshape(-1).astype(np.float64)
    spread = np.repeat(np.concatenate([values, np.ones((len(values), 1))], 1), 3, 0) * shares[:, None]
    sums = np.stack([np.bincount(corners, column, count) for column in spread.T], 1)
    edges = np.concatenate([head.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    first, second = np.unique(np.sort(edges, 1), axis=0).T
    degree = np.maximum(np.bincount(first, minlength=count) + np.bincount(second, minlength=count), 1)[:, None]
    for side in ("left", "right"):
        eye = head.marked(f"{side}_eyeball")
        sums[eye] = sums[eye].sum(0)
    means, sure, half = np.zeros((count, values.shape[1])), np.zeros((count, 1)), _HALF_SEEN
    for more in np.diff(rounds, prepend=0):
        for _ in range(more):
            around = [np.bincount(first, c[second], count) + np.bincount(second, c[first], count) for c in sums.T]
            sums = 0.5 * sums + 0.5 * np.stack(around, 1) / degree
        here = (1.0 - sure) * sums[:, -1:] / (sums[:, -1:] + half)
        means, sure, half = means + here * sums[:, :-1] / np.maximum(sums[:, -1:], 1e-9), sure + here, half / _WEAKER
    return means / np.maximum(sure, 1e-9), sure
