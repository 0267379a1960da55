"""How evenly a face is lit in a picture: what of its lightness follows the way that skin faces.

Marks, wrinkles and make-up lie anywhere; light follows the normals, and slowly: nine spherical harmonics hold what a matt form
shows of any surroundings (Ramamoorthi and Hanrahan 2001). So they are laid through the logarithm of the luminance of bare skin,
and what they say is read off. Skin of one tone has other colors below brows and chin in the studio's rig, as trained colors do:
this is taken off before, so that 0 is one tone in the rig.

Called by `photo_fits` and by tools. Needs numpy, and torch through `cleanliness`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..head import HeadModel
from ..light.relight import to_linear
from ..light.resting import rig_at_vertices
from ..light.surroundings import basis
from ..light.transfer import vertex_normals
from ..pictures.sampling import bilinear
from .cleanliness import SEEN, STRANDS, Shot, seen_vertices

LUMINANCE = (0.2126, 0.7152, 0.0722)  # of linear RGB, Rec. 709
ASIDE, UP = np.array([0.7, 0.0, 0.714]), np.array([0.0, 0.7, 0.714])  # normals that are compared with their mirror images
_NOT_PLAIN = ("lips", "lids", "brows", "lashes", "mouth_interior")
_ROUNDS, _CUT = 8, 2.0  # of robust weights; in median deviations
_DARK = 1e-3  # linear luminance that is black
_PULL = 1e-3  # of the mean square, to no light: keeps what a face hardly shows small


class Evenness(NamedTuple):
    """What of a face's lightness follows its normals, beyond what does in the studio's rig.

    Attributes:
        spread: Standard deviation of the logarithm of luminance over the skin; 0.1 is light that varies by 10 %.
        aside: Luminance of skin that faces 44 degrees to the person's left over that to the right.
        up: Of skin that faces 44 degrees up over down.
    """

    spread: float
    aside: float
    up: float


def evenness(picture: np.ndarray, shot: Shot, head: HeadModel) -> Evenness:
    """How a face is lit in a picture.

    Args:
        picture: Display sRGB, [H, W, 3]: a photo, or `shot` itself.
        shot: The avatar in the same place and view; it tells where bare skin is.
        head: Its mesh.
    """
    bare = (shot.alpha > SEEN) & (shot.hair < STRANDS)
    skin = head.marked("face") & ~head.marked(*_NOT_PLAIN) & seen_vertices(shot.vertices, shot.camera, bare, head)
    pixels = shot.camera.project(shot.vertices[skin])[1]
    colors = bilinear(picture, pixels).astype(np.float64)
    rig = rig_at_vertices(head, shot.vertices, colors)[skin]
    lightness = np.log(np.maximum(to_linear(colors) @ LUMINANCE, _DARK) / (rig @ LUMINANCE))
    normals = vertex_normals(shot.vertices, head.faces)[skin]
    columns, trust = basis(normals), np.ones(len(normals))
    for _ in range(_ROUNDS):
        weighted = columns * trust[:, None]
        square = weighted.T @ columns
        square[1:, 1:] += np.eye(columns.shape[1] - 1) * (_PULL * np.trace(square) / len(square))  # the level is free
        found = np.linalg.solve(square, weighted.T @ lightness)
        off = np.abs(columns @ found - lightness)
        trust = 1.0 / (1.0 + (off / (_CUT * np.median(off) + 1e-9)) ** 2)
    aside, up = (float(np.exp((basis(way) - basis(way * [-1, -1, 1])) @ found)) for way in (ASIDE, UP))
    return Evenness(float((columns @ found).std()), aside, up)
