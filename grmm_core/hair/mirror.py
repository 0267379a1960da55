"""The other way round: a groom parted on the right from one parted on the left. Needs numpy only."""

from __future__ import annotations

import dataclasses
import functools
from typing import TYPE_CHECKING

import numpy as np

from ..errors import ShapeError
from .groom import Groom, bind

if TYPE_CHECKING:
    from ..head import HeadModel

_FLIP = np.array([-1.0, 1.0, 1.0])
_CHUNK = 128  # vertices whose distances to all others fit into the cache
_FEW = 0.02  # of the triangles may be without a partner; their strands are left out


@functools.lru_cache(maxsize=2)
def mirrored_triangles(head: HeadModel) -> tuple[np.ndarray, np.ndarray]:
    """Return each triangle's partner on the other side [F], and which of its corners is whose [F, 3].

    Raises:
        ShapeError: The head's mesh is not the same on both sides.
    """
    vertices = np.asarray(head.v_template, np.float64)
    square = (vertices**2).sum(1)
    parts = np.array_split(vertices * _FLIP, len(vertices) // _CHUNK + 1)
    partner = np.concatenate([(square - 2.0 * part @ vertices.T).argmin(1) for part in parts])
    faces = np.asarray(head.faces)
    number = {tuple(sorted(face)): i for i, face in enumerate(faces.tolist())}
    across = partner[faces]
    found = np.array([number.get(tuple(sorted(face)), -1) for face in across.tolist()])
    if (found < 0).mean() > _FEW:
        raise ShapeError("This head's mesh is not the same on both sides; a groom cannot be mirrored on it.")
    corners = (faces[found][:, :, None] == across[:, None, :]).argmax(2)
    return found, corners


def mirrored(groom: Groom, head: HeadModel) -> Groom:
    """Return a groom the other way round.

    Args:
        groom: Of this head.
        head: Whose mesh is the same on both sides.

    Raises:
        ShapeError: The mesh is not.
    """
    triangles, corners = mirrored_triangles(head)
    groom = groom.select(np.flatnonzero(triangles[groom.triangles] >= 0))
    other = triangles[groom.triangles]
    weights = np.take_along_axis(groom.weights, corners[groom.triangles], 1)
    vertices = np.asarray(head.v_template, np.float64)
    points = groom.posed(groom.frames(vertices, head.faces), vertices) * _FLIP
    across = bind(vertices, head.faces, vertices, other, weights, points, groom.offsets, groom.widths, groom.groups)
    return dataclasses.replace(across, tints=groom.tints)
