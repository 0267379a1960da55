"""What each photo shows of its light that no lamp explains: shadows of hair and chin, highlights, edges of shadows.

What a photo shows otherwise than flat colors in its light, as far as it is wide, is either color that was not known or light
that was not: d_k = f + r_k in logarithms, f of the person and r_k of photo k. With f ~ N(0, `_COLOR`^2) and r_k ~ N(0, s_k^2),
where s_k is how uneven the photo's light leaves skin of one tone (`person_lights.doubts`), the likeliest f is the mean of the
d_k weighted by 1 / s_k^2, less a part: that of the surest photo, for the r_k are alike. So in skin that a hard light alone
shows the person keeps the prior's wide shades, and takes the detail. Lightness and tint are told apart each by itself, since
gloss and shade change lightness much more than tint, and people's skin both alike.

What is narrower than a centimetre or two in a face is what people are known by: sockets, folds beside the nose, ruddy cheeks,
a shaved beard. Most of it is color (`_FEATURES`). Taken for light it left every face, in any other light than its photo's, that
of one wax figure; soft shades that a lamp threw there are the lesser evil. Used by `invert` and `settling`. Needs
numpy only.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..head import HeadModel
from ..light.relight import to_linear
from ..light.resting import Texels
from .chin import below_chin
from .photo_light import FACING, FINE_MOST, FINE_STEP, Seen

_COLOR = 0.08, 0.04  # expected wide error of the person's colors, of their logarithm: lightness; tint that does not go with it
_TINT = 0.03  # likewise of tint where several photos show it
_CREASE, _AGAIN = 0.1, 2  # of the logarithm: what is so far from its surroundings is a fold or a mark; rounds of such weights
_FEATURES = 0.9  # of what is narrower than so many rounds of averaging in a face, a centimetre or two, that is color
_FEATURE_ROUNDS, _FACE_RIM = 24, 4
_EDGE = 0.3  # deviation of the logarithm of a light within the reach of a feature, from which half of it is an edge of shade
_DARKEST_LIGHT = 0.02  # of the rig's, as of all that is darker
_ROUNDS = (3,)  # of averaging over neighbouring vertices, which lie 5 mm apart in a face
_LAST_ROUNDS = (0, 1, 4, 16)  # likewise once colors are known: light goes on where skin is seen at a slant
_BUST_ROUNDS = 8  # from skin that is seen, to where it ends on a bust that is not: the bright rim of a neck is no light on that
_THROAT_ROUNDS = 2  # likewise on the throat, after each step
_THROAT, _THROAT_RIM = (0.4, 0.8), 4  # share of throat after so many rounds: below the first light stays, above the second none
_STEPS = 6  # of it, each by what the last has left (simultaneous algebraic reconstruction)
_LIP_ROUNDS = 12  # of averaging, in which light on skin reaches the middle of lips
_HALF_SEEN = 0.3  # texels of a vertex at which it is half believed
_WEAKER = 10.0  # of wider means so much fewer are
_GLARE = (0.2, 0.5)  # of the logarithm: brighter by the first a photo is believed less, from the second on not at all
_ALIKE = 2.0  # doubt of a photo's light over another's, up to which its shadows tell that the other is too bright
_MOST, _MOST_TINT = 2.5, 0.4  # of the logarithm: of the whole, and of a channel beside their mean
_SLANT = (0.5 * FACING, 2.0 * FACING)  # weights below which texels tell no fine light, and above which all
_MOST_FINE_TINT = 0.5  # likewise in folds: what comes out of them has passed through skin, and is red
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
    found, precision, narrow, features = [], [], [], _Features(head)
    for seen, ratio, own in zip(every, ratios, doubt, strict=True):
        off, told = _off(seen, ratio * flat)
        light = ratio.min(1)
        dim = np.clip(light / np.median(light[told > 0]), 0.0, 1.0) if told.any() else light * 0.0
        strength = np.log(np.maximum(ratio.mean(1), _DARKEST_LIGHT))
        both, counted = np.concatenate([off, dim[:, None], strength[:, None]], 1), told
        wide, sure = _at_vertices(head, texels, both, counted, _ROUNDS)
        for _ in range(_AGAIN if len(every) == 1 else 0):
            counted = told / (1.0 + ((off - texels.at(wide[:, :3])).mean(1) / _CREASE) ** 2)
            wide, sure = _at_vertices(head, texels, both, counted, _ROUNDS)
        found.append((wide[:, :3], sure))
        precision.append(sure * (wide[:, 3:4] / own) ** 2)
        narrow.append(features.of(wide[:, :3], wide[:, 4:], sure))
    wider = [(off - own, sure) for (off, sure), own in zip(found, narrow, strict=True)]
    color = _alone(*wider[0], precision[0]) if len(every) == 1 else _together(wider, precision)
    color = color + _FEATURES * _mean(narrow, precision)
    local = [_factor(_over_lips(head, sure * (off - color), sure)) for off, sure in found]
    shown = np.stack([seen.weights > 0 for seen in every])
    if len(every) == 1:  # what stands out from its surroundings is as likely a mark
        return local, np.ones(shown.shape)
    lit = (ratio * texels.factor(own) for ratio, own in zip(ratios, local, strict=True))
    flat = flat * np.exp(texels.at(color))
    left = np.stack([_off(seen, light * flat)[0].mean(1) for seen, light in zip(every, lit, strict=True)])
    doubtful = (doubt > _ALIKE * doubt[:, None])[..., None]  # beside each photo; edges of shadows there make no highlights here
    least = np.where(shown, np.maximum(left, np.where(doubtful, 0.0, -np.inf)), np.inf).min(1)
    bright = left - np.where(shown.sum(0) > 1, least, 0.0)  # what all show is a mark
    return local, np.where(shown, np.clip((_GLARE[1] - bright) / (_GLARE[1] - _GLARE[0]), 0.0, 1.0), 1.0)


def _over_lips(head: HeadModel, values: np.ndarray, sure: np.ndarray) -> np.ndarray:
    """Values of vertices [V, C] that are sure by [V, 1], those of the skin around gone on over lips, which tell none."""
    lips = head.marked("lips")
    if not lips.any():
        return values
    around = _averaged(np.concatenate([sure * values, sure], 1) * ~lips[:, None], _edges(head), _LIP_ROUNDS)
    gone_on = around[:, :-1] / np.maximum(around[:, -1:], 1e-9)
    return np.where(lips[:, None], gone_on, values)


def _alone(wide: np.ndarray, sure: np.ndarray, precision: np.ndarray) -> np.ndarray:
    """The part of what one photo shows otherwise that is color, at vertices [V, 3]; arguments of [V, 3], [V, 1], [V, 1]."""
    light, tint, spread = _apart(wide, sure)
    own: np.ndarray = precision / (precision + _COLOR[0] ** -2)
    color: np.ndarray = own * light + sure * min(1.0, _COLOR[1] ** 2 / spread) * tint
    return color


def _together(found: Sequence[tuple[np.ndarray, np.ndarray]], precision: Sequence[np.ndarray]) -> np.ndarray:
    """Likewise of several photos, arguments of each.

    What is wrong with one light is often wrong with the next one. So of the photos' mean no more is believed than the surest
    photo would tell alone.
    """
    parts = [_apart(*one) for one in found]
    tint_precision = [sure / spread for (_, sure), (_, _, spread) in zip(found, parts, strict=True)]
    tint_shares = [sure * min(1.0, _TINT**2 / spread) for (_, sure), (_, _, spread) in zip(found, parts, strict=True)]
    light = _mean([one for one, _, _ in parts], precision)
    own: np.ndarray = np.max(precision, 0)
    color: np.ndarray = own / (own + _COLOR[0] ** -2) * light
    return color + np.max(tint_shares, 0) * _mean([one for _, one, _ in parts], tint_precision)


def _mean(values: Sequence[np.ndarray], weights: Sequence[np.ndarray]) -> np.ndarray:
    """Mean over photos of values [V, 3] with weights [V, 1]."""
    counted = np.stack(weights)
    mean: np.ndarray = (counted * np.stack(values)).sum(0) / counted.sum(0).clip(1e-9)
    return mean


def _apart(wide: np.ndarray, sure: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
    """Lightness of what a photo shows otherwise, with the tint that goes with it, and other tint, [V, 3] each; its mean square.

    Gloss is paler and shade is redder than skin: the tint that goes with lightness is as much light as that.
    """
    light = wide.mean(1, keepdims=True)
    tint = wide - light
    along = (sure * light * tint).sum(0) / max(float((sure * light**2).sum()), 1e-9) * light
    other = tint - along
    return light + along, other, max(float((sure * other**2).sum() / max(3.0 * float(sure.sum()), 1e-9)), 1e-9)


def more_local(head: HeadModel, texels: Texels, seen: Seen, drawn: np.ndarray, local: np.ndarray) -> np.ndarray:
    """`Lighting.local` of a photo with what its light still lacks once the person is known, [V, 3] float32.

    Args:
        head: Head model.
        texels: Of the avatar.
        seen: What the photo shows, lips and eyes, too.
        drawn: Colors of the texels as the avatar is drawn in the photo's light, display sRGB, [N, 3].
        local: As it was, [V, 3].
    """
    now = np.asarray(to_linear(np.asarray(drawn, np.float64)))
    logarithm = np.log(np.maximum(local, _DARKEST))
    before = texels.at(logarithm)
    shows = np.asarray(drawn, np.float64).mean(1) ** 2  # a logarithm's error shows the less the darker it is
    shows /= max(float(np.median(shows[seen.weights > 0])), 1e-6) if (seen.weights > 0).any() else 1.0
    even = _EvenThroat(head)
    for _ in range(_STEPS):
        off, told = _off(seen, now * np.exp(texels.at(logarithm) - before))
        told = told * np.minimum(shows, 1.0)
        wide, sure = _at_vertices(head, texels, off, told, _LAST_ROUNDS)
        logarithm = even.of(np.log(_factor(logarithm + sure * wide)))
    return np.exp(logarithm * _near(head, texels, seen)).astype(np.float32)


def _near(head: HeadModel, texels: Texels, seen: Seen) -> np.ndarray:
    """How near vertices are to skin that a photo shows, 0..1 [V, 1]; 1 but on neck and bust."""
    shown = texels.corners[seen.weights > 0].reshape(-1)
    there = (np.bincount(shown, minlength=head.vertex_count) > 0)[:, None].astype(np.float64)
    edges = _edges(head)
    there = (_averaged(there, edges, 1) > 0.0).astype(np.float64)  # with all corners of the faces that end there
    near = np.maximum(there, (2.0 * _averaged(there, edges, _BUST_ROUNDS)).clip(0.0, 1.0))
    below: np.ndarray = (below_chin(head) * head.marked("neck"))[:, None]
    return 1.0 - below * (1.0 - near)


class _EvenThroat:
    """Makes light on the throat smooth: faces are long there, and what differs from one to the next is a line.

    Attributes:
        share: How far a vertex is of the throat, 0..1, [V, 1].
    """

    def __init__(self, head: HeadModel) -> None:
        self._edges, self._neck = _edges(head), head.marked("neck")[:, None].astype(np.float64)
        inside = _averaged(self._neck, self._edges, _THROAT_RIM)
        self.share = self._neck * ((inside - _THROAT[0]) / (_THROAT[1] - _THROAT[0])).clip(0.0, 1.0)

    def of(self, values: np.ndarray) -> np.ndarray:
        """Values of vertices [V, C]; those of the face, the chin's underside among them, stay."""
        smooth = _averaged(np.concatenate([self._neck * values, self._neck], 1), self._edges, _THROAT_ROUNDS)
        means = smooth[:, :-1] / np.maximum(smooth[:, -1:], 1e-9)
        return np.where(self.share > 0.0, values + self.share * (means - values), values)


def on_face(head: HeadModel, texels: Texels) -> np.ndarray:
    """Texels that tell fine light, 0..1 [N]: those of the throat are long, too, and would be lines."""
    return 1.0 - texels.at(_EvenThroat(head).share)[:, 0]


def more_fine(seen: Seen, drawn: np.ndarray, fine: np.ndarray) -> np.ndarray:
    """`Light.fine` of a photo with what its light still lacks at the texels of skin that it shows, [N, 3] float32.

    Args:
        seen: Skin alone.
        drawn: Colors of the texels as the avatar is drawn in the photo's light, display sRGB, [N, 3].
        fine: As it was, [N, 3].
    """
    linear = np.asarray(to_linear(np.asarray(drawn, np.float64)))
    off, told = _off(seen, linear)
    sure = np.clip((told - _SLANT[0]) / (_SLANT[1] - _SLANT[0]), 0.0, 1.0)[:, None]
    shade = np.log(_factor(FINE_STEP * fine + sure * off, _MOST_FINE_TINT, np.maximum(linear, _DARKEST)))
    found: np.ndarray = np.round(shade / FINE_STEP).clip(-FINE_MOST, FINE_MOST).astype(np.float32)
    return found


def _factor(logarithm: np.ndarray, most_tint: float = _MOST_TINT, drawn: np.ndarray | float = 1.0) -> np.ndarray:
    """A factor of the light, [V, 3] float32: shade and gloss have hardly another tint than the light around them.

    Channels tell lightness as much as they have of what is `drawn`, linear RGB [V, 3]: two that are black would ask for light
    that makes the third glow.
    """
    counts = np.broadcast_to(drawn, logarithm.shape)
    light = (counts * logarithm).sum(1, keepdims=True) / counts.sum(1, keepdims=True)
    tint = (logarithm - light).clip(-most_tint, most_tint)
    factor: np.ndarray = np.exp(light.clip(-_MOST, _MOST) + tint).astype(np.float32)
    return factor


def _off(seen: Seen, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Logarithm of a photo's colors over drawn ones, both linear RGB [N, 3], and how much it counts, [N]."""
    told = (seen.colors < _BURNT).all(1) & (seen.colors > _DARK).all(1) & (drawn > _DARKEST).all(1)
    linear = np.asarray(to_linear(np.asarray(seen.colors, np.float64)))
    off = np.log(np.maximum(linear, _DARKEST) / np.maximum(drawn, _DARKEST))
    return off.clip(-_MOST, _MOST), seen.weights * told


class _Features:
    """What of a face is too narrow for light."""

    def __init__(self, head: HeadModel) -> None:
        self._edges = _edges(head)
        face = head.marked("face")[:, None].astype(np.float64)
        self._share = _averaged(face, self._edges, _FACE_RIM) * face

    def of(self, values: np.ndarray, light: np.ndarray, sure: np.ndarray) -> np.ndarray:
        """The narrow part of values of vertices [V, C] that are sure by [V, 1].

        It is believed less where the logarithm of the light [V, 1] changes within its reach: edges of shadows are there.
        """
        columns = np.concatenate([values, light, light**2, np.ones_like(light)], 1) * sure
        smooth = _averaged(columns, self._edges, _FEATURE_ROUNDS)
        smooth = smooth[:, :-1] / np.maximum(smooth[:, -1:], 1e-9)
        uneven = (smooth[:, -1:] - smooth[:, -2:-1] ** 2).clip(0.0)
        narrow: np.ndarray = self._share * sure * (values - smooth[:, :-2]) / (1.0 + uneven / _EDGE**2)
        return narrow


def _edges(head: HeadModel) -> np.ndarray:
    """Pairs of vertices that a face's edge joins, each once, [2, E]."""
    edges = np.concatenate([head.faces[:, pair] for pair in ([0, 1], [1, 2], [2, 0])])
    return np.unique(np.sort(edges, 1), axis=0).T


def _averaged(values: np.ndarray, edges: np.ndarray, rounds: int) -> np.ndarray:
    """Values of vertices [V, C], half of each its neighbours' mean, so many times."""
    (first, second), count = edges, len(values)
    degree = np.maximum(np.bincount(first, minlength=count) + np.bincount(second, minlength=count), 1)[:, None]
    for _ in range(rounds):
        around = [np.bincount(first, c[second], count) + np.bincount(second, c[first], count) for c in values.T]
        values = 0.5 * values + 0.5 * np.stack(around, 1) / degree
    return values


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
    edges = _edges(head)
    for side in ("left", "right"):
        eye = head.marked(f"{side}_eyeball")
        sums[eye] = sums[eye].sum(0)
    means, sure, half = np.zeros((count, values.shape[1])), np.zeros((count, 1)), _HALF_SEEN
    for more in np.diff(rounds, prepend=0):
        sums = _averaged(sums, edges, int(more))
        here = (1.0 - sure) * sums[:, -1:] / (sums[:, -1:] + half)
        means, sure, half = means + here * sums[:, :-1] / np.maximum(sums[:, -1:], 1e-9), sure + here, half / _WEAKER
    return means / np.maximum(sure, 1e-9), sure
