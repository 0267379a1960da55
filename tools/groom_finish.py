"""What the package's grooms have that the studio's do not: hair that lies where it is combed, denser where scalp would show.

Called by `grooms` with the scalp's strands that a generator of the studio drew on the mean head. Captures keep theirs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.spatial import cKDTree

from grmm_core.hair.body import Body, cut
from grmm_core.hair.groom import Groom, bind, join
from grmm_core.hair.strands import lengths_of
from grmm_core.head import HeadModel
from grmm_core.wrinkles.noise import smoothstep
from grmm_studio.grooms import KNOTS
from grmm_studio.styles import STYLES

STRANDS = 7000
AROUND = 12  # roots, as far as which says how dense hair is somewhere
# how high hair lies at most that falls from a parting or a whorl, and hair that is tied: metres at its root, a metre of its way
FALLEN, TIED = (0.001, 0.09), (0.0012, 0.02)
RELEASED, FREE = 0.06, 0.35  # metres of its way from which on hair may rise more, and by how much a metre
LYING = (0.045, 0.085)  # metres: height from which on hair lies on a head, and fully
PRESSED = 0.9  # share of what is higher that is taken away
KNOT = (0.02, 0.045)  # metres around a knot: hair rises to it
SHOWN, TOLD = 3.0, 0.015  # how much denser roots are where neighbours part, as seen so many metres from their roots
RARE = 2.2  # how much denser at most where few grow
EAR = (0.06, 0.048, 0.005, 0.024)  # metres: what is farther out, lower, and so near to a place along the head is before an ear
BABY = 0.02  # metres: length of such hair at most
SIDEBURN = (0.022, 0.052)  # metres: height of roots before the ears below which curls are short, and above which they are not
SHORT_CURL = 0.15  # of their length


def finished(groom: Groom, vertices: np.ndarray, head: HeadModel, name: str) -> Groom:
    """Some `STRANDS` of a style's strands on the mean head [V, 3], as the package has them."""
    style = STYLES[name]
    strands = _posed(groom, vertices, head)
    if name in KNOTS:
        hangs = groom.triangles == np.bincount(groom.triangles).argmax()  # the tail, all of it from one triangle
        whole, tail = len(groom), groom.select(hangs).level(STRANDS / len(groom))
        groom, strands = groom.select(~hangs), strands[~hangs]
        strands = _laid(_behind_ears(strands), vertices, head, *TIED, KNOTS[name])
        some = _even(_bound(groom, strands, vertices, head), vertices, head, _rarity(strands), STRANDS * len(groom) // whole)
        return join([some, tail])
    weight = _rarity(strands) if not style.rope else np.ones(len(groom))
    if style.comb in ("parted", "fringe", "aside", "forward") and not style.rope:
        if style.comb in ("parted", "fringe"):
            strands = _laid(strands, vertices, head, *FALLEN)
        weight = np.maximum(weight, _parting(strands))
    elif style.way in ("out", "drooping"):
        strands = _short_sideburns(strands)
    return _even(_bound(groom, strands, vertices, head), vertices, head, weight, STRANDS)


def _posed(groom: Groom, vertices: np.ndarray, head: HeadModel) -> np.ndarray:
    """Strands of a groom of one number of points on the head, [N, K, 3]."""
    points = groom.posed(groom.frames(vertices, head.faces), vertices)
    return np.asarray(points, float).reshape(len(groom), -1, 3)


def _bound(groom: Groom, strands: np.ndarray, vertices: np.ndarray, head: HeadModel) -> Groom:
    """The groom with its strands at [N, K, 3]."""
    return bind(
        np.asarray(head.v_template), head.faces, vertices, groom.triangles, groom.weights, strands.reshape(-1, 3),
        groom.offsets, groom.widths, groom.groups,
    )  # fmt: skip


def _laid(
    strands: np.ndarray, vertices: np.ndarray, head: HeadModel, low: float, rise: float, knot: np.ndarray | None = None
) -> np.ndarray:
    """Strands [N, K, 3] none of which stands over the others: single high ones are arcs, seen from the side."""
    along = np.cumsum(np.linalg.norm(np.diff(strands, axis=1, prepend=strands[:, :1]), axis=2), 1)
    heights, up = Body.of(head, vertices, near=strands.reshape(-1, 3)).heights(strands.reshape(-1, 3))
    most = low + rise * along
    if knot is None:
        most += FREE * np.maximum(along - RELEASED, 0.0)
        lies = smoothstep(*LYING, strands[..., 1])
    else:
        lies = smoothstep(*KNOT, np.linalg.norm(strands - knot, axis=2))
    press = PRESSED * lies * np.maximum(heights.reshape(along.shape) - most, 0.0)
    result: np.ndarray = strands - press[..., None] * up.reshape(strands.shape)
    return result


def _behind_ears(strands: np.ndarray) -> np.ndarray:
    """Tied hair [N, K, 3] of which ends before an ear what would go over it."""
    x, y, z = np.abs(strands[..., 0]), strands[..., 1], strands[..., 2]
    over = (x > EAR[0]) & (y < EAR[1]) & (np.abs(z - EAR[2]) < EAR[3])
    over[:, 0] = False
    share = np.maximum(over.argmax(1) - 1, 1) / (strands.shape[1] - 1)
    share = np.minimum(share, BABY / np.maximum(lengths_of(strands), BABY))
    return cut(strands, np.where(over.any(1), share, 1.0))


def _short_sideburns(strands: np.ndarray) -> np.ndarray:
    """Curls [N, K, 3] that are short before the ears, where single ones would stand before a face."""
    root = strands[:, 0]
    before = smoothstep(-0.02, 0.0, root[:, 2]) * (1.0 - smoothstep(*SIDEBURN, root[:, 1]))
    return cut(strands, 1.0 - (1.0 - SHORT_CURL) * before)


def _parting(strands: np.ndarray) -> np.ndarray:
    """How much denser roots of strands [N, K, 3] are: where neighbours go different ways, at partings and whorls."""
    along = np.cumsum(np.linalg.norm(np.diff(strands, axis=1, prepend=strands[:, :1]), axis=2), 1)
    row, at = np.arange(len(strands)), np.minimum((along < TOLD).sum(1), strands.shape[1] - 1)
    way = strands[row, at] - strands[:, 0]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    near = cKDTree(strands[:, 0]).query(strands[:, 0], 4 * AROUND)[1]
    alike = np.linalg.norm(way[near].mean(1), axis=1)
    return 1.0 + SHOWN * smoothstep(0.92, 0.7, alike)


def _rarity(strands: np.ndarray) -> np.ndarray:
    """How much denser roots of strands [N, K, 3] are where few grow, as at the hairline."""
    apart = cKDTree(strands[:, 0]).query(strands[:, 0], AROUND + 1)[0][:, -1]
    return np.clip((apart / np.median(apart)) ** 2, 1.0, RARE)


def _even(groom: Groom, vertices: np.ndarray, head: HeadModel, weight: np.ndarray, count: int) -> Groom:
    """Some `count` strands of a groom, wider by what is missing, whose roots keep apart the more the thinner hair grows there.

    Where `weight` [N] is above 1 they are so many times denser.
    """
    roots = groom.frames(vertices, head.faces).at(vertices)[0]
    tree = cKDTree(roots)
    apart = tree.query(roots, AROUND + 1)[0][:, -1] / np.sqrt(weight)
    low, high = 0.0, 4.0
    while True:  # in all of these rounds the same strands are asked first
        factor, taken, free = 0.5 * (low + high), [], np.ones(len(roots), bool)
        for i, near in enumerate(tree.query_ball_point(roots, factor * apart)):
            if free[i]:
                taken.append(i)
                free[near] = False
        if abs(len(taken) - count) < 0.01 * count or high - low < 1e-3:
            some = groom.select(np.array(taken))
            wider = float(weight.mean()) * len(groom) / len(some)
            return replace(some, widths=(some.widths * wider).astype(np.float32))
        low, high = (factor, high) if len(taken) > count else (low, factor)
