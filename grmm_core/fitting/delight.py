"""The light of a photo taken out of fitted skin colors: colors = flat colors x light.

Skin of one person is taken as one tone with marks on it; what varies smoothly and with the normals is light. The light is
that of surroundings (nine coefficients a color) and of a few directions with shadows, none of which may take light away, found
by robust least squares; what it does not explain stays in the flat colors. Tone and light are known as a product only: the
tone keeps the colors' own median. Highlights are not taken out. Needs numpy only; `light.relight` and `Transport.light` are
what is differentiable.
"""

from __future__ import annotations

import dataclasses
from typing import NamedTuple

import numpy as np

from ..head import HeadModel
from ..light.lamps import STUDIO, Lighting, Sun
from ..light.materials import materials_of
from ..light.relight import to_display, to_linear
from ..light.shading import Response, Transport, ratio, reached, shade, transport
from ..light.shadows import Casters, Receivers, visible
from ..light.surroundings import TERMS, Surroundings, sphere
from ..light.transfer import transfer, vertex_normals

SUNS = tuple(Sun(direction=tuple(d), angle=0.35) for d in sphere(24)[0] if d[2] > -0.3 and d[1] > -0.5)
"""Directions that light may come from, in head axes."""
_RIDGE = 0.01  # of the mean square: keeps what the face does not show small
_ROUNDS, _CUT = 6, 2.5  # of robust weights
_RANGE = (0.2, 5.0)  # of light relative to the rig that is divided out
_MATT = Response(gloss=0.0)


class SkinParts(NamedTuple):
    """What light does at points of a head.

    Attributes:
        parts: Of `SUNS` and surroundings.
        rig: Irradiance of the studio's rig, [N, 3].
    """

    parts: Transport[np.ndarray]
    rig: np.ndarray


class Delit(NamedTuple):
    """Colors without light.

    Attributes:
        flat: As they would be in the studio's rig, display sRGB, [N, 3].
        light: That of the photo, head axes.
        relative: Its irradiance over the rig's, [N, 3].
    """

    flat: np.ndarray
    light: Lighting
    relative: np.ndarray


def skin_parts(head: HeadModel, vertices: np.ndarray, face: np.ndarray, barycentric: np.ndarray) -> SkinParts:
    """Work out what light does on a head.

    Args:
        head: Its model.
        vertices: Posed as in the photo, head space, [V, 3] metres.
        face: Face of each point, [N].
        barycentric: [N, 3].
    """
    normals = vertex_normals(vertices, head.faces)
    rows = transfer(vertices, normals, head.faces)

    def at(values: np.ndarray) -> np.ndarray:
        found: np.ndarray = np.einsum("nk,nkc->nc", barycentric, values[head.faces[face]])
        return found

    facing = at(normals)
    receivers = Receivers.around(at(vertices), facing / np.maximum(np.linalg.norm(facing, axis=1, keepdims=True), 1e-20))
    casters, materials, eye = Casters(vertices, head.faces), materials_of(head, face, barycentric), np.array([0.0, 0.0, 1.0])
    rows = at(rows)
    seen = [visible(sun, receivers, casters) for sun in SUNS]
    parts = transport(SUNS, receivers, seen, materials, rows, eye, _MATT)
    assert STUDIO.surroundings is not None
    hidden = np.stack([visible(lamp, receivers, casters) for lamp in STUDIO.lamps])
    studio = STUDIO.lamps, receivers, hidden, materials, rows, eye, STUDIO.surroundings.coefficients, _MATT
    return SkinParts(parts, shade(*studio).irradiance)


def delit(colors: np.ndarray, weights: np.ndarray, skin: SkinParts) -> Delit:
    """Split colors into flat colors and light.

    Args:
        colors: Fitted to the photo, display sRGB, [N, 3].
        weights: How much each point counts, 0 where it is no skin or was not seen, [N].
        skin: Of the same points.
    """
    linear = np.asarray(to_linear(np.asarray(colors, np.float64)))
    told = (skin.rig == reached(skin.rig)).all(1)
    counted = (weights > 0) & told
    tone = np.maximum(np.median(linear[counted], 0), 1e-4)
    lamps, harmonics = np.zeros((len(SUNS), 3)), np.zeros((TERMS, 3))
    for c in range(3):
        rig = skin.rig[counted, c].astype(np.float64)
        columns = np.concatenate([skin.parts.diffuse[:, counted, c].T, skin.parts.ambient[counted]], 1) / rig[:, None]
        found = _robust(columns, linear[counted, c] / tone[c], weights[counted])
        lamps[:, c], harmonics[:, c] = found[: len(SUNS)], found[len(SUNS) :]
    irradiance, _ = skin.parts.light(lamps.astype(np.float32), harmonics.astype(np.float32))
    # where the rig hardly reaches, in nostrils and mouth, colors tell nothing about light and stay
    relative = np.where(told[:, None], ratio(irradiance, skin.rig).clip(*_RANGE), 1.0)
    lit = (dataclasses.replace(sun, color=tuple(color)) for color, sun in zip(lamps, SUNS, strict=True) if color.any())
    return Delit(np.asarray(to_display(linear / relative)), Lighting(tuple(lit), Surroundings(harmonics)), relative)


def _robust(columns: np.ndarray, wanted: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Least squares of [K, U] unknowns, those of lamps not below zero; outliers (brows, marks, highlights) count little."""
    trust = np.ones(len(wanted))
    for _ in range(_ROUNDS):
        found = _not_below_zero(columns, wanted, weights * trust)
        off = columns @ found - wanted
        scale = max(1.48 * float(np.median(np.abs(off))), 1e-3)
        trust = 1.0 / (1.0 + (off / (_CUT * scale)) ** 2) ** 2
    return found


def _not_below_zero(columns: np.ndarray, wanted: np.ndarray, weights: np.ndarray) -> np.ndarray:
    weighted = columns * weights[:, None]
    square, right = weighted.T @ columns / weights.sum(), weighted.T @ wanted / weights.sum()
    square += np.diag(np.full(len(square), _RIDGE * np.trace(square) / len(square)))
    kept = np.ones(len(square), bool)
    while True:
        found = np.zeros(len(square))
        found[kept] = np.linalg.solve(square[np.ix_(kept, kept)], right[kept])
        worst = int(found[: len(SUNS)].argmin())
        if found[worst] >= 0.0:
            return found
        kept[worst] = False
