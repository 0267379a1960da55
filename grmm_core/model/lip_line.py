"""The borders of lips in colors that were learned from a studio that painted them elsewhere. Needs numpy only.

It painted the head's region of lips, which is too large and ends in steps. Along the borders (`head.lip_border`) colors become
those of the skin beyond and of the lip, blended over a smooth line. Weights that are trained on later pictures need nothing of
it (`GRMMConfig.lip_line`).
"""

from __future__ import annotations

from typing import Generic, NamedTuple

import numpy as np

from ..compute.recent import Recent
from ..geometry.libraries import Array
from ..head import HeadModel
from ..head.lip_border import lip_borders
from .layout import TexelLayout

EDGE = 0.0009  # metres from the line within which lip becomes skin
REDRAWN, LEFT = 0.0025, 0.0032  # from the line: up to the first all is redrawn, from the second on nothing
SKIN, LIP = (0.0028, 0.0044), (0.0026, 0.0040)  # from the line: where colors of either side are taken from
ALONG = 0.0010  # metres along the line within which they are a mean
_SOURCES = 10  # texels that tell one side of one texel


class LipLine(NamedTuple, Generic[Array]):
    """Texels that are redrawn.

    Attributes:
        rows: Numbers of them, [M].
        kept: Share of the color that each keeps, [M, 1] float32.
        sources: Numbers of texels that the rest comes from, [M, K].
        weights: Of them, [M, K, 1] float32.
    """

    rows: Array
    kept: Array
    sources: Array
    weights: Array


def lip_line(head: HeadModel, layout: TexelLayout) -> LipLine[np.ndarray] | None:
    """What is redrawn of the colors of a layout's texels; None where too few lie there."""
    return _KNOWN.get((head, layout.face, layout.barycentric), lambda: (_found(head, layout),))[0]


def redrawn(values: Array, line: LipLine[Array] | None) -> Array:
    """Values of texels [..., N, C] with the borders of lips anew."""
    if line is None:
        return values
    drawn = line.kept * values[..., line.rows, :] + (line.weights * values[..., line.sources, :]).sum(-2)
    result: Array = values.copy() if isinstance(values, np.ndarray) else values.clone()
    result[..., line.rows, :] = drawn
    return result


_KNOWN: Recent[tuple[LipLine[np.ndarray] | None]] = Recent(2)


def _found(head: HeadModel, layout: TexelLayout) -> LipLine[np.ndarray] | None:
    corners = head.faces[layout.face]
    outside = ~head.marked("mouth_interior", "upper_teeth", "lower_teeth", "tongue", "lashes")[corners].any(1)
    places = np.einsum("nk,nkx->nx", layout.barycentric, head.v_template[corners])
    parts, borders = [], lip_borders(head)
    if not borders:
        return None
    nearer = np.abs([border.beyond(places) for border in borders]).argmin(0)
    for number, border in enumerate(borders):
        near = np.flatnonzero(outside & (border.near(places, SKIN[1], 2.0 * SKIN[1]) > 0.0))
        beyond, share = border.beyond(places[near]), border.near(places[near], REDRAWN, LEFT)
        rows = np.flatnonzero((share > 0.0) & (nearer[near] == number))
        sides = (beyond, SKIN), (-beyond, LIP)
        tells = [np.flatnonzero((off > limits[0]) & (off < limits[1])) for off, limits in sides]
        if not len(rows) or min(len(side) for side in tells) < _SOURCES:
            continue
        lip = border.share(places[near[rows]], EDGE)
        lip = lip * lip * (3.0 - 2.0 * lip)
        sources, weights = [], []
        for side, much in zip(tells, (1.0 - lip, lip), strict=True):
            along = np.abs(places[near[rows], 0][:, None] - places[near[side], 0])
            nearest = np.argpartition(along, _SOURCES - 1, 1)[:, :_SOURCES]
            weight = np.exp(-0.5 * (np.take_along_axis(along, nearest, 1) / ALONG) ** 2) + 1e-6
            sources.append(near[side[nearest]])
            weights.append(weight / weight.sum(1, keepdims=True) * (share[rows] * much)[:, None])
        each = near[rows], 1.0 - share[rows][:, None], np.concatenate(sources, 1), np.concatenate(weights, 1)[..., None]
        parts.append(each)
    if not parts:
        return None
    rows, kept, sources_, weights_ = (np.concatenate(part) for part in zip(*parts, strict=True))
    return LipLine(rows, kept.astype(np.float32), sources_, weights_.astype(np.float32))
