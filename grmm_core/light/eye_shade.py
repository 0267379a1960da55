"""Eyes between their lids: how bright whites are, and what lids, lashes and brows keep from them. Needs numpy only.

Whites of eyes are not white. On photos they are six tenths as bright as the cheek in the middle of the eye, a quarter close to
the upper lid (docs/rendering.md, "Eyes"). The capture studio's, in a light from all around, are brighter than any skin, and so
are the colors that are learned from it: eyes that stare. Here they get their tone, and the shade of lids wherever these are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from ..compute.recent import Recent
from ..head.lash_cards import lash_edges
from .cornea import EYEBALLS, catchlight

if TYPE_CHECKING:
    from ..head import HeadModel
    from .resting import Texels

WHITE, IRIS = np.array([0.65, 0.55, 0.54]), np.array([0.8, 0.8, 0.8])  # of the light that learned colors of them send
LIMBUS = 22.0, 25.5  # degrees from the pole of an eyeball: up to the first all is iris, from the second on white
UPPER, LOWER = (0.50, 0.0030), (0.30, 0.0012)  # of light, what a lid keeps off at its edge, and how far that reaches in metres
_SEEN = 85.0  # degrees from the pole beyond which no gaze brings an eyeball between the lids
_GAMMA = 2.2  # of display values, nearly


class _Edge(NamedTuple):
    """Of a lid.

    Attributes:
        vertices: Along it, from the person's right to the left.
        ball: Those of its eyeball.
        rows: Of the points, those on its eye.
        above: 1 for an upper lid, -1 for a lower one.
        most, reach: See `UPPER`.
    """

    vertices: np.ndarray
    ball: np.ndarray
    rows: np.ndarray
    above: float
    most: float
    reach: float


class Eyes(NamedTuple):
    """What is the same in every pose.

    Attributes:
        total: Number of all texels, N.
        texels: That can be seen between lids, [M].
        corners, weights: Of them, [M, 3] each.
        tone: Of them, [M, 3].
        edges: Of the lids.
    """

    total: int
    texels: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    tone: np.ndarray
    edges: tuple[_Edge, ...]

    def glinting(self, colors: np.ndarray, head: HeadModel, vertices: np.ndarray, view: np.ndarray) -> np.ndarray:
        """Display colors of the M texels with the studio's catchlight.

        Args:
            colors: [M, 3].
            head: Head model.
            vertices: Posed, [V, 3] metres.
            view: Unit direction towards the viewer, head space, [3].
        """
        glint = catchlight(head, vertices, self.corners, self.weights, view)
        found: np.ndarray = (colors.clip(0.0, None) ** _GAMMA + glint[:, None]) ** (1.0 / _GAMMA)
        return found.astype(np.float32)

    def shade(self, vertices: np.ndarray) -> np.ndarray:
        """What display colors of the texels are multiplied by, [N, 3] float32, on posed vertices [V, 3], metres."""
        vertices = np.asarray(vertices, np.float32)
        places = np.einsum("nk,nkx->nx", self.weights, vertices[self.corners])
        shade = np.ones((self.total, 3), np.float32)
        shade[self.texels] = (self.tone * lids_leave(places, vertices, self.edges)[:, None]) ** np.float32(1.0 / _GAMMA)
        return shade


def eyes_of(head: HeadModel, texels: Texels) -> Eyes | None:
    """The eyes of a head on its texels; None on heads without lashes on their lids."""
    return _KNOWN.get((head, texels.face, texels.barycentric), lambda: (_found(head, texels),))[0]


_KNOWN: Recent[tuple[Eyes | None]] = Recent(2)


def lids_leave(points: np.ndarray, vertices: np.ndarray, edges: tuple[_Edge, ...]) -> np.ndarray:
    """Share of the light that lids leave to points on eyeballs.

    Args:
        points: [M, 3] metres.
        vertices: Of the head, [V, 3].
        edges: Of `lid_edges`.

    Returns:
        [M] float32.
    """
    light = np.ones(len(points), np.float32)
    for edge in edges:
        apart = _squares(points[edge.rows], vertices, edge)
        light[edge.rows] *= 1.0 - edge.most * np.exp(apart / (-2.0 * edge.reach**2))
    return light


def lid_edges(head: HeadModel, sides: np.ndarray) -> tuple[_Edge, ...]:
    """Edges of the lids; none on heads without lashes.

    Args:
        head: Head model.
        sides: Signs of x of the eyes of points, [M].
    """
    found = []
    for card in lash_edges(head) if "lashes" in head.regions else ():
        across = head.v_template[card.root, 0]
        side = np.sign(across.mean())
        ball = next(
            np.asarray(head.regions[name]) for name in EYEBALLS if head.v_template[head.regions[name], 0].mean() * side > 0
        )
        rows = np.flatnonzero(sides == side)
        above, shade = (1.0, UPPER) if card.upper else (-1.0, LOWER)
        found.append(_Edge(card.root[across.argsort()], ball, rows, above, *shade))
    return tuple(found)


def polar_angles(head: HeadModel, texels: Texels) -> np.ndarray:
    """Degrees of texels from the pole of their eyeball, which looks ahead at rest, [N]; infinite beside eyeballs."""
    angles = np.full(len(texels.face), np.inf)
    for name in EYEBALLS:
        marked = head.marked(name)
        rows = np.flatnonzero(marked[texels.corners].all(1))
        if not len(rows):
            continue
        ball = head.v_template[marked]
        places = np.einsum("nk,nkx->nx", texels.barycentric[rows], head.v_template[texels.corners[rows]])
        places = places - (ball.max(0) + ball.min(0)) / 2
        angles[rows] = np.degrees(np.arctan2(np.linalg.norm(places[:, :2], axis=1), places[:, 2]))
    return angles


def _found(head: HeadModel, texels: Texels) -> Eyes | None:
    angles = polar_angles(head, texels)
    seen = np.flatnonzero(angles < _SEEN)
    edges = lid_edges(head, np.sign(head.v_template[texels.corners[seen, 0], 0]))
    if not edges:
        return None
    share = ((angles[seen] - LIMBUS[0]) / (LIMBUS[1] - LIMBUS[0])).clip(0.0, 1.0)[:, None]
    tone = (IRIS + (WHITE - IRIS) * share).astype(np.float32)
    return Eyes(len(texels.face), seen, texels.corners[seen], texels.barycentric[seen].astype(np.float32), tone, edges)


def _squares(points: np.ndarray, vertices: np.ndarray, edge: _Edge) -> np.ndarray:
    """Squared distance of points [M, 3] in the opening of the eye from the edge of a lid, [M]; 0 of those behind the lid."""
    line = vertices[edge.vertices]
    line = np.concatenate([line, 0.5 * (line[1:] + line[:-1])])  # the vertices, some millimetres apart, and the middles between
    middle = line.mean(0)
    up = np.cross(middle - vertices[edge.ball].mean(0), vertices[edge.vertices[-1]] - vertices[edge.vertices[0]])
    up *= edge.above / np.linalg.norm(up)
    points, line = points - middle, line - middle
    apart = (line * line).sum(1) - 2.0 * (points @ line.T)
    nearest = apart.argmin(1)
    squares = (apart[np.arange(len(points)), nearest] + (points * points).sum(1)).clip(0.0, None)
    found: np.ndarray = squares * ((line @ up)[nearest] > points @ up)
    return found
