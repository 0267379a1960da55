"""The border of the upper lip in colors that were learned from a studio that painted it in steps. Needs numpy only.

Along it colors become those of the skin above and of the lip below, blended over a smooth line (`head.lip_border`). Weights
that were trained on later pictures need nothing of it (`GRMMConfig.lip_line`).
"""

from __future__ import annotations

from typing import Generic, NamedTuple

import numpy as np

from ..compute.recent import Recent
from ..geometry.libraries import Array
from ..head import HeadModel
from ..head.lip_border import upper_lip
from .layout import TexelLayout

EDGE = 0.0009  # metres from the line within which lip becomes skin
REDRAWN, LEFT = 0.0017, 0.0025  # from the line: up to the first all is redrawn, from the second on nothing
TELLING = 0.0019, 0.0034  # where colors of lip and skin are taken from
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
    """Values of texels [..., N, C] with the border of the lip anew."""
    if line is None:
        return values
    drawn = line.kept * values[..., line.rows, :] + (line.weights * values[..., line.sources, :]).sum(-2)
    result: Array = values.copy() if isinstance(values, np.ndarray) else values.clone()
    result[..., line.rows, :] = drawn
    return result


_KNOWN: Recent[tuple[LipLine[np.ndarray] | None]] = Recent(2)


def _found(head: HeadModel, layout: TexelLayout) -> LipLine[np.ndarray] | None:
    border = upper_lip(head)
    if border is None:
        return None
    corners = head.faces[layout.face]
    outside = ~head.marked("mouth_interior", "upper_teeth", "lower_teeth", "tongue", "lashes")[corners].any(1)
    places = np.einsum("nk,nkx->nx", layout.barycentric, head.v_template[corners])
    near = np.flatnonzero(outside & (border.near(places, TELLING[1], 2.0 * TELLING[1]) > 0.0))
    places = places[near]
    beyond, share = border.beyond(places), border.near(places, REDRAWN, LEFT)
    some = share > 0.0
    tells = [np.flatnonzero((side * beyond > TELLING[0]) & (side * beyond < TELLING[1])) for side in (1.0, -1.0)]
    if not some.any() or min(len(side) for side in tells) < _SOURCES:
        return None
    lip = border.share(places[some], EDGE)
    lip = lip * lip * (3.0 - 2.0 * lip)
    sources, weights = [], []
    for side, much in zip(tells, (1.0 - lip, lip), strict=True):
        apart = np.abs(places[some, 0][:, None] - places[side, 0])
        nearest = np.argpartition(apart, _SOURCES - 1, 1)[:, :_SOURCES]
        weight = np.exp(-0.5 * (np.take_along_axis(apart, nearest, 1) / ALONG) ** 2) + 1e-6
        sources.append(near[side[nearest]])
        weights.append(weight / weight.sum(1, keepdims=True) * (share[some] * much)[:, None])
    return LipLine(
        near[some], (1.0 - share[some]).astype(np.float32)[:, None], np.concatenate(sources, 1),
        np.concatenate(weights, 1).astype(np.float32)[..., None],
    )  # fmt: skip
