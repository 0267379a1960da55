"""Hair curves of a host as a groom: points in head space and where each curve stands on the head's UV map. Needs numpy only."""

from __future__ import annotations

import numpy as np

from ..errors import ShapeError
from ..head import HeadModel
from .groom import MAX_POINTS, Groom, bind
from .roots import BEARD, BROWS, GROUPS, LASHES, SCALP

OFF_SURFACE = 0.03  # metres between a curve's first point and its place on the head: more is another head
_CELLS = 96  # of the UV map along a side, in which triangles are looked up
_OUTSIDE = -0.05  # barycentric coordinate below which a place is beside the map
_LOST = 0.02  # share of curves beside the map that is forgiven
WIDTH = 1.2e-4  # metres, where a host has no radii
BROW = 0.015  # metres from the region of the brows, of the mean head: roots so near are of brows
CHIN, FRONT = 0.010, 0.0  # metres, head space: roots below the first and before the second are of a beard
# metres: before an ear a beard goes up to the scalp's hair; depths, and heights below which roots there are of it
SIDEBURN_Z, SIDEBURN_Y = (0.018, 0.022, 0.026, 0.030, 0.034, 0.040, 0.044), (CHIN, 0.016, 0.016, 0.024, 0.036, 0.036, CHIN)
SCALP_ABOVE = 0.001  # metres above these heights, from which on they are of the scalp


def groom_from_curves(
    head: HeadModel, vertices: np.ndarray, points: np.ndarray, offsets: np.ndarray, surface_uv: np.ndarray | None,
    radii: np.ndarray | None = None, groups: np.ndarray | None = None, tints: np.ndarray | None = None,
) -> Groom:  # fmt: skip
    """Bind curves to a head.

    Args:
        head: Whose UV map the curves stand on.
        vertices: The head as it is where `points` are, for example at rest, metres, [V, 3].
        points: Of all curves one after the other, root first, head space, metres, [P, 3].
        offsets: First row of each curve in `points`, and the number of points, [N + 1].
        surface_uv: Place of each root on the UV map, [N, 2].
        radii: Half the diameter at each point, metres, [P], or None; curves that have none are as wide as the others.
        groups: Of `roots.GROUPS` by number, [N]; other numbers, or None: by where the roots are.
        tints: Own colors at each point, see `Groom.tints`, [P, 3], or None.

    Raises:
        ShapeError: There is no surface, a curve has one point, values are not finite, there are too many points, or the curves
            stand on another head; the sentence says what to do.
    """
    if surface_uv is None or not len(np.atleast_1d(surface_uv)):
        raise ShapeError("The curves have no surface coordinates; attach them to the head's surface with its UV map.")
    points, offsets, surface_uv = np.asarray(points), np.asarray(offsets, np.int64), np.asarray(surface_uv, np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) > MAX_POINTS:
        raise ShapeError(
            f"The curves have points of size {points.shape}; use fewer hairs or points: at most {MAX_POINTS} rows of x, y, z."
        )
    count = len(offsets) - 1
    if offsets.ndim != 1 or count < 1 or offsets[0] != 0 or offsets[-1] != len(points) or np.diff(offsets).min() < 2:
        raise ShapeError("Every hair needs two points or more; delete single points or resample the curves.")
    if surface_uv.shape != (count, 2):
        raise ShapeError(f"{count} curves have surface coordinates of size {surface_uv.shape}; one pair each is needed.")
    if not (np.isfinite(points).all() and np.isfinite(surface_uv).all()):
        raise ShapeError("The curves have values that are not finite; undo what made them, or delete these hairs.")
    triangles, weights, beside = find_on_map(np.asarray(head.uv, float), np.asarray(head.uv_faces), surface_uv)
    corners = np.asarray(vertices, float)[np.asarray(head.faces)[triangles]]
    off = np.linalg.norm((corners * weights[..., None]).sum(1) - points[offsets[:-1]], axis=1)
    if beside.mean() > _LOST or float(np.median(off)) > OFF_SURFACE:
        raise ShapeError("The curves do not stand on this head; choose the head that they were made on as their surface.")
    keep = ~beside
    widths = np.full((count, 2), WIDTH)
    if radii is not None:
        radii = np.asarray(radii, float).reshape(-1)
        if len(radii) != len(points) or not np.isfinite(radii).all():
            raise ShapeError("The curves' radii must be one finite number for each point.")
        told = np.maximum.reduceat(radii, offsets[:-1]) > 0.0  # hairs that a host adds have none
        widths[told] = 2.0 * np.stack([radii[offsets[:-1]], radii[offsets[1:] - 1]], 1)[told]
        if told.any():
            widths[~told] = np.median(widths[told], 0)
    parts = groups_at(head, triangles, weights)
    if groups is not None and len(groups) == count:
        parts = np.where((groups >= 0) & (groups < len(GROUPS)), groups, parts)
    groom = bind(
        np.asarray(head.v_template, float), np.asarray(head.faces), np.asarray(vertices, float), triangles, weights,
        points.astype(float), offsets, widths.clip(1e-6, 0.01), parts,
    )  # fmt: skip
    if tints is not None and tints.any() and np.isfinite(tints).all():
        groom = groom.tinted(tints.clip(-1.0, 1.0))
    return groom if keep.all() else groom.select(keep)


def groups_at(head: HeadModel, triangles: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Of which part hairs are that stand in triangles [N] at barycentric coordinates [N, 3]: numbers in `roots.GROUPS`, [N].

    All roots of the package's grooms lie on their part's side. Heads whose brows are not known have scalp hair alone.
    """
    groups = np.full(len(triangles), SCALP)
    if "brows" not in head.regions:
        return groups
    card = np.zeros(len(head.v_template), bool)
    card[np.asarray(head.regions.get("lashes", np.zeros(0, int)), int)] = True
    mean = np.asarray(head.v_template, float)
    places = (mean[np.asarray(head.faces)[triangles]] * weights[..., None]).sum(1)
    top = np.maximum(CHIN, np.interp(places[:, 2], SIDEBURN_Z, SIDEBURN_Y) + SCALP_ABOVE)
    groups[(places[:, 1] < top) & (places[:, 2] > FRONT)] = BEARD
    brows = mean[np.asarray(head.regions["brows"])]
    low, high = brows.min(0) - BROW, brows.max(0) + BROW
    around = np.flatnonzero(((places > low) & (places < high)).all(1))
    far = np.linalg.norm(places[around, None] - brows, axis=2).min(1) if len(around) else np.zeros(0)
    groups[around[far < BROW]] = BROWS
    groups[card[np.asarray(head.faces)[triangles]].all(1)] = LASHES
    return groups


def find_on_map(uv: np.ndarray, uv_faces: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the triangles of a UV map that hold places.

    Args:
        uv: [T, 2].
        uv_faces: Rows of `uv`, [F, 3].
        places: [N, 2].

    Returns:
        Triangle of each place [N], its barycentric coordinates [N, 3] (of the nearest triangle, clamped, beside the map), and
        whether it lies beside the map [N].
    """
    corners = uv[uv_faces] * _CELLS  # [F, 3, 2] in cells
    low = np.floor(corners.min(1)).astype(int) - 1
    extent = np.floor(corners.max(1)).astype(int) + 2 - low
    counts = extent.prod(1)
    face = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(face)) - np.repeat(np.cumsum(counts) - counts, counts)
    column = np.clip(low[face, 0] + within % extent[face, 0], -1, _CELLS) + 1
    row = np.clip(low[face, 1] + within // extent[face, 0], -1, _CELLS) + 1
    cell = row * (_CELLS + 2) + column
    order = np.argsort(cell, kind="stable")
    face, start = face[order], np.searchsorted(cell[order], np.arange((_CELLS + 2) ** 2 + 1))
    at = np.clip(np.floor(places * _CELLS).astype(int), -1, _CELLS) + 1
    own = at[:, 1] * (_CELLS + 2) + at[:, 0]
    number = start[own + 1] - start[own]
    place = np.repeat(np.arange(len(places)), number)
    candidate = face[np.arange(number.sum()) - np.repeat(np.cumsum(number) - number, number) + start[own][place]]
    a, b, c = (corners[candidate, k] for k in range(3))
    p = places[place] * _CELLS
    area = _cross(b - a, c - a)
    area = np.where(np.abs(area) < 1e-12, np.inf, area)
    second, third = _cross(p - a, c - a) / area, _cross(b - a, p - a) / area
    weights = np.stack([1 - second - third, second, third], 1)
    score = np.where(np.isinf(area), -np.inf, weights.min(1))
    best = np.lexsort((score, place))
    last = np.searchsorted(place[best], np.arange(len(places)), side="right") - 1
    found = (last >= 0) & (number > 0)
    chosen = best[np.where(found, last, 0)] if len(best) else np.zeros(len(places), int)
    if not len(best):
        return np.zeros(len(places), int), np.full((len(places), 3), 1 / 3), np.ones(len(places), bool)
    weights, beside = weights[chosen], ~found | (score[chosen] < _OUTSIDE)
    weights = np.clip(weights, 0.0, 1.0)
    return np.where(found, candidate[chosen], 0), weights / weights.sum(1, keepdims=True), beside


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
