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
from grmm_studio.fields import azimuth
from grmm_studio.grooms import KNOTS
from grmm_studio.styles import STYLES

STRANDS = 7000
AROUND = 12  # roots, as far as which says how dense hair is somewhere
# how high hair lies at most that falls from a parting or a whorl, and hair that is tied: metres at its root, a metre of its way
FALLS, TIED = {"parted": (0.001, 0.09), "fringe": (0.001, 0.09), "side": (0.001, 0.16)}, (0.0012, 0.02)
RELEASED, FREE = 0.06, 0.35  # metres of its way from which on hair may rise more, and by how much a metre
LYING = (0.045, 0.085)  # metres: height from which on hair lies on a head, and fully
PRESSED = 0.9  # share of what is higher that is taken away
KNOT = (0.02, 0.045)  # metres around a knot: hair rises to it
SHOWN, TOLD = 3.0, 0.015  # how much denser roots are where neighbours part, as seen so many metres from their roots
VEILED, OVERHANG, AHEAD = 1.2, (0.004, 0.014), (0.03, 0.06)  # likewise of ends so far from roots, before that depth, metres
RARE = 2.2  # how much denser at most where few grow
EAR = (0.06, 0.048, 0.005, 0.024)  # metres: what is farther out, lower, and so near to a place along the head is before an ear
BABY = 0.02  # metres: length of such hair at most
SHORN = (0.012, 0.024)  # metres: hair so short goes the way of those around it, longer hair its own
ALIKE, ONE_OF, ALIGNED = 48, 6, 0.75  # so many of every so manieth around one, and the share of their way that it takes on
STRAIGHT = 0.95  # way from its root to its end, of its length
# the hair's surface: of the heights of so many places around one, of so many in all, the share that is lower
CANOPY, BESIDE, TOLD_BY = 0.7, 40, 60_000
COILS = 0.2  # radius of a person's own curls, of their length, from which on these are coils, which photos of such hair ask for
SUNK = 0.85  # share of what is above that surface that is taken away
# hair that is combed back ends no lower beside the ears than this share of it does so far from the middle, unevenly: metres
LOWEST, MIDDLE, UNEVEN = 0.05, 0.03, 0.006
# falling hair ends in a line behind: roots at such heights, of strands so long with ends so far back, tell where, and a share
# of them ends lower; how uneven it is, and how much lower in front; its height at least, since a bust's back goes outwards
# there, on which hair lies as a shelf; and how long is what has its root below it: metres
SIDES, REACHING, BEHIND, HEM = (0.03, 0.085), 0.05, -0.03, 0.25
OVER_BACK = 0.35  # metres of hair that lies on the back down to the bust's rim, where it ends
RAGGED, TAPERED, BACK, DOWN = 0.007, 0.05, -0.106, 0.004
COMPANY, ALONE = 5, 1.7  # so many places of other strands are as far off at most, as a share of what is usual in the style
SIDEBURN = (0.022, 0.052)  # metres: height of roots before the ears below which curls are short, and above which they are not
SHORT_CURL = 0.15  # of their length
PEAK = (0.128, 0.148)  # metres: heights of roots before the receded temples where hair is thinnest, and as elsewhere
RECEDED_AZIMUTH = 48.0  # degrees from the front: as far out as the temples recede
PEAK_LENGTH, PEAK_SHARE = 0.45, 0.3  # of its length and of its roots there: a tuft in the middle of a forehead is a triangle


def finished(groom: Groom, vertices: np.ndarray, head: HeadModel, name: str) -> Groom:
    """Some `STRANDS` of a style's strands on the mean head [V, 3], as the package has them."""
    style = STYLES[name]
    coils = bool(style.curl) or style.own_curl >= COILS * style.wavelength
    strands = _posed(groom, vertices, head)
    if name in KNOTS:
        hangs = groom.triangles == np.bincount(groom.triangles).argmax()  # the tail, all of it from one triangle
        whole, tail = len(groom), groom.select(hangs).level(STRANDS / len(groom))
        groom, strands = groom.select(~hangs), strands[~hangs]
        strands = _level(_laid(_behind_ears(strands), vertices, head, *TIED, KNOTS[name]), vertices, head)
        some = _even(_bound(groom, strands, vertices, head), vertices, head, _rarity(strands), STRANDS * len(groom) // whole)
        return join([some, tail])
    if style.comb in FALLS and not style.rope:
        strands = _laid(strands, vertices, head, *FALLS[style.comb])
    if style.way in ("out", "drooping"):
        strands = _short_sideburns(strands)
    elif style.comb != "none" and style.cut != "layers" and not style.rope and not coils:  # layers end at many heights
        strands = _level(strands, vertices, head)
    if style.comb == "swept":
        strands = _trimmed(strands)
    if style.comb in ("parted", "fringe") and not style.rope and style.length < OVER_BACK:
        strands = _hemmed(strands)
    if not style.curl:
        strands = _combed(strands, straight=not coils)
    if style.receding > 1.0:
        strands, groom = _without_tuft(strands, groom)
    weight = np.ones(len(groom)) if style.rope else _rarity(strands)
    if style.comb in ("parted", "fringe", "aside", "side", "forward"):
        weight = np.maximum(weight, _parting(strands))
    if style.comb in ("fringe", "forward"):
        weight = np.maximum(weight, _over_skin(strands))
    some = _even(_bound(groom, strands, vertices, head), vertices, head, weight, STRANDS)
    if style.comb == "parted" and not style.rope and not style.curl:
        some = some.select(_accompanied(_posed(some, vertices, head)))
    return some


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


def _level(strands: np.ndarray, vertices: np.ndarray, head: HeadModel) -> np.ndarray:
    """Strands [N, K, 3] that end in a surface on top of the head: few hairs above it are hooks and beads, seen along them."""
    result = strands.copy()
    high = (strands[..., 1] > LYING[0]) & (np.arange(strands.shape[1]) > 0)
    points = strands[high]
    heights, up = Body.of(head, vertices, near=points).heights(points)
    feet = points - heights[:, None] * up
    some = np.random.default_rng(5).permutation(len(points))[:TOLD_BY]
    beside = cKDTree(feet[some]).query(feet, BESIDE)[1]
    surface = np.quantile(heights[some][beside], CANOPY, axis=1)
    lies = smoothstep(*LYING, points[:, 1])
    result[high] -= (SUNK * lies * np.maximum(heights - surface, 0.0))[:, None] * up
    return result


def _combed(strands: np.ndarray, straight: bool) -> np.ndarray:
    """Strands [N, K, 3] of which the shorn ones go the way of those around them, and are `straight`: else skin shows."""
    long = lengths_of(strands)
    short = np.flatnonzero(long < SHORN[1])
    if len(short) < ALIKE:
        return strands
    t = np.linspace(0.0, 1.0, strands.shape[1])[None, :, None]
    root, way = strands[short, 0], strands[short, -1] - strands[short, 0]
    some = np.arange(0, len(short), ONE_OF)
    beside = cKDTree(root[some]).query(root, min(ALIKE, len(some)))[1]
    turned = (way / long[short, None])[some][beside].mean(1)
    far = STRAIGHT * long[short, None] if straight else np.linalg.norm(way, axis=1, keepdims=True)
    turned *= far / np.maximum(np.linalg.norm(turned, axis=1, keepdims=True), 1e-9)
    share = smoothstep(SHORN[1], SHORN[0], long[short])[:, None]
    bend = strands[short] - root[:, None] - t * way[:, None]
    way += ALIGNED * share * (turned - way)
    result = strands.copy()
    result[short] = root[:, None] + t * way[:, None] + (1.0 - straight * share[..., None]) * bend
    return result


def _trimmed(strands: np.ndarray) -> np.ndarray:
    """Strands [N, K, 3] combed back of which none hangs lower at the sides than in the middle: these would be two points."""
    end, long = strands[:, -1], lengths_of(strands) > SHORN[1]
    line = np.quantile(end[long & (np.abs(end[:, 0]) < MIDDLE) & (end[:, 2] < 0.0), 1], LOWEST)
    lines = line + np.random.default_rng(6).uniform(0.0, UNEVEN, len(strands))[:, None]
    above = strands[..., 1] - lines
    last = np.maximum((above < 0.0).argmax(1) - 1, 0)  # point before the line
    row = np.arange(len(strands))
    part = above[row, last] / np.maximum(above[row, last] - above[row, last + 1], 1e-9)
    hangs = long & (above[:, 0] > 0.0) & (above < 0.0).any(1)
    return cut(strands, np.where(hangs, (last + part) / (strands.shape[1] - 1), 1.0))


def _hemmed(strands: np.ndarray) -> np.ndarray:
    """Falling strands [N, K, 3] that end behind in one line: what roots at the nape have below it would stand out as a tail."""
    end, root, long = strands[:, -1], strands[:, 0], lengths_of(strands)
    falls = (root[:, 1] > SIDES[0]) & (root[:, 1] < SIDES[1]) & (end[:, 2] < BEHIND) & (long > REACHING)
    if falls.sum() < ALIKE:
        return strands
    behind = smoothstep(0.0, BEHIND, end[:, 2])
    hem = max(np.quantile(end[falls, 1], HEM), BACK) - TAPERED * (1.0 - behind)
    hem = hem + np.random.default_rng(7).uniform(-RAGGED, RAGGED, len(strands))
    below = strands[..., 1] < hem[:, None]
    last = np.maximum(below.argmax(1) - 1, 0)  # point before the hem
    row = np.arange(len(strands))
    above = strands[row, last, 1] - hem
    part = np.clip(above / np.maximum(strands[row, last, 1] - strands[row, last + 1, 1], 1e-9), 0.0, 1.0)
    share = np.maximum((last + part) / (strands.shape[1] - 1), np.minimum(DOWN / np.maximum(long, DOWN), 1.0))
    return cut(strands, np.where(below.any(1) & (behind > 0.0), share, 1.0))


def _accompanied(strands: np.ndarray) -> np.ndarray:
    """Rows of those of smooth hair [N, K, 3] that have others beside them to their ends: single ones are wires."""
    own = np.repeat(np.arange(len(strands)), strands.shape[1])
    apart, near = cKDTree(strands.reshape(-1, 3)).query(strands.reshape(-1, 3), AROUND * 2)
    others = np.sort(np.where(own[near] == own[:, None], np.inf, apart), axis=1)[:, COMPANY]
    lonely = others.reshape(strands.shape[:2])[:, 2:].max(1)
    return np.flatnonzero(lonely < ALONE * np.median(lonely))


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


def _without_tuft(strands: np.ndarray, groom: Groom) -> tuple[np.ndarray, Groom]:
    """Strands [N, K, 3] of a receded hairline, and their groom, of which those of the peak between the temples are fewer."""
    root = strands[:, 0]
    ahead = smoothstep(PEAK[1], PEAK[0], root[:, 1]) * smoothstep(RECEDED_AZIMUTH, 0.8 * RECEDED_AZIMUTH, azimuth(root))
    kept = np.random.default_rng(8).random(len(groom)) > (1.0 - PEAK_SHARE) * ahead
    shorter = cut(strands, 1.0 - (1.0 - PEAK_LENGTH) * ahead)
    return shorter[kept], groom.select(kept)


def _parting(strands: np.ndarray) -> np.ndarray:
    """How much denser roots of strands [N, K, 3] are: where neighbours go different ways, at partings and whorls."""
    along = np.cumsum(np.linalg.norm(np.diff(strands, axis=1, prepend=strands[:, :1]), axis=2), 1)
    row, at = np.arange(len(strands)), np.minimum((along < TOLD).sum(1), strands.shape[1] - 1)
    way = strands[row, at] - strands[:, 0]
    way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
    near = cKDTree(strands[:, 0]).query(strands[:, 0], 4 * AROUND)[1]
    alike = np.linalg.norm(way[near].mean(1), axis=1)
    return 1.0 + SHOWN * smoothstep(0.92, 0.7, alike) * smoothstep(*SHORN, along[:, -1])


def _over_skin(strands: np.ndarray) -> np.ndarray:
    """How much denser roots of strands [N, K, 3] are whose ends lie before a face where no hair grows: else it is a veil."""
    apart = cKDTree(strands[:, 0]).query(strands[:, -1])[0]
    before = smoothstep(*AHEAD, strands[:, -1, 2])
    result: np.ndarray = 1.0 + VEILED * before * smoothstep(*OVERHANG, apart)
    return result


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
