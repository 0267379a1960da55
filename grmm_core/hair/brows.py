"""Brows at a person's height above the eyes: the package's stand where the mean head has its own, people's lie lower."""

from __future__ import annotations

import numpy as np

from ..geometry.triangles import closest_on_surface, vertex_normals
from ..head import HeadModel
from .groom import Groom, bind
from .packaged import library_groom
from .roots import BROWS, GROUPS

FULLEST_BROWS = "bushy"  # of the package: they cover all of where brows are
LOWER = (-0.009, 0.009)  # metres by which brows may be moved down
# metres: up to number 8 the capture studio grew brows as much higher than the package has them, and tinted the skin there
PAINTED_HIGHER = 0.006
_EVERY = 4  # of its strands, which tell where that is
_AROUND = 0.008  # metres around brows in which skin is looked for
_SLICES = np.linspace(0.005, 0.06, 12)  # metres from the plane of symmetry: heights are compared in slices between these
_FEW = 3  # strands in a slice that tell one


def lowered(groom: Groom, head: HeadModel, down: np.ndarray) -> Groom:
    """Brows moved down along the skin of the mean head.

    Args:
        groom: On the head.
        head: Whose mesh strands stand on.
        down: Of each strand, metres, [N].
    """
    template, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    frames = groom.frames(template, faces)
    points = groom.posed(frames, template)
    skin = _skin_near(head, points, np.abs(down).max(initial=0.0) + _AROUND)
    surface, normals = faces[skin], vertex_normals(template, faces)

    def on_skin(places: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        triangles, weights, _ = closest_on_surface(places, template, surface)
        corners = surface[triangles]
        up = (normals[corners] * weights[..., None]).sum(1)
        return (
            triangles,
            weights,
            (template[corners] * weights[..., None]).sum(1),
            up / np.linalg.norm(up, axis=1, keepdims=True),
        )

    # each point stays as high above the skin as it was: moved as they are, strands of the brow would dip into its ridge
    _, _, foot, up = on_skin(points)
    height = ((points - foot) * up).sum(1, keepdims=True)
    lower = down[groom.strand_of_point, None] * [0.0, 1.0, 0.0]
    _, _, foot, up = on_skin(points - height * up - lower)
    triangles, weights, _, _ = on_skin(frames.at(template)[0] - down[:, None] * [0.0, 1.0, 0.0])
    points = foot + height * up
    return bind(template, faces, template, skin[triangles], weights, points, groom.offsets, groom.widths, groom.groups)


def painted(head: HeadModel) -> np.ndarray:
    """Where weights of such captures have a tint of brows on their skin: places on the mean head, metres, [N, 3]."""
    template, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    fullest = library_groom(FULLEST_BROWS, head.name, GROUPS[BROWS])
    roots = fullest.frames(template, faces).at(template)[0][::_EVERY] + np.array([0.0, PAINTED_HIGHER, 0.0])
    surface = faces[_skin_near(head, roots, _AROUND)]
    triangles, weights, _ = closest_on_surface(roots, template, surface)
    places: np.ndarray = (template[surface[triangles]] * weights[..., None]).sum(1)
    return places


def _skin_near(head: HeadModel, points: np.ndarray, reach: float) -> np.ndarray:
    """Numbers of the skin's triangles in the box around points [N, 3], widened by so many metres."""
    template, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    skin = np.flatnonzero(~head.marked("lashes", "left_eyeball", "right_eyeball")[faces].any(1))
    middles = template[faces[skin]].mean(1)
    near: np.ndarray = skin[((middles > points.min(0) - reach) & (middles < points.max(0) + reach)).all(1)]
    return near


def at_height_of(groom: Groom, usual: Groom, own: Groom, head: HeadModel) -> Groom:
    """Brows moved as far as a person's own lie lower than the usual ones, each side for itself.

    Args:
        groom: Brows of the package.
        usual: Brows at the same height that cover all of where brows are.
        own: The person's; of a photo some of the strands may be missing, so that heights are compared slice by slice.
        head: Whose mesh strands stand on.
    """
    template, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    roots, theirs, wanted = (one.frames(template, faces).at(template)[0] for one in (groom, usual, own))
    down = np.zeros(len(groom))
    for side in (-1.0, 1.0):
        down[side * roots[:, 0] > 0.0] = np.clip(_lower(theirs * [side, 1.0, 1.0], wanted * [side, 1.0, 1.0]), *LOWER)
    return lowered(groom, head, down)


def _lower(usual: np.ndarray, own: np.ndarray) -> float:
    """How much lower the second roots [N, 3] lie than the first at the same distances from the middle, metres."""
    apart, slices = [], [np.digitize(roots[:, 0], _SLICES) for roots in (usual, own)]
    for number in range(1, len(_SLICES)):
        there = [roots[at == number, 1] for roots, at in zip((usual, own), slices, strict=True)]
        if min(map(len, there)) >= _FEW:
            apart.append(there[0].mean() - there[1].mean())
    return float(np.median(apart)) if apart else 0.0
