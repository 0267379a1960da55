"""A face for a head that nobody has painted: skin, lips, brows, hair and eyes by the head's regions.

For heads that no network draws (a user's FLAME file), and for people where nothing here can run the model. Needs numpy only.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..compute.recent import Recent
from ..controls.names import JOINT_NAMES
from ..head import HeadModel
from ..light.resting import Texels, rig_at_vertices
from ..pictures.color import linear_to_srgb, srgb_to_linear
from ..pictures.images import quantize
from .layout import texel_layout
from .painting import fill_unknown

PIXELS = 512
"""Side of the picture: irises are 20 pixels wide."""
IRIS_DEGREES, PUPIL_DEGREES = 23.0, 9.0
"""Half angles on the eyeball."""
_SKIN, _HAIR, _WHITE = (0.78, 0.60, 0.52), (0.20, 0.14, 0.11), (0.87, 0.86, 0.84)
_IRIS, _RIM, _PUPIL = (0.37, 0.27, 0.19), (0.12, 0.09, 0.07), (0.03, 0.03, 0.03)
# regions, display color, rounds of smoothing, marks between which it begins and is full, share: each lies on those before it
_LAYERS = (
    (("ears",), (0.77, 0.50, 0.44), 2, (0.0, 1.0), 0.5),
    (("lids",), (0.66, 0.45, 0.39), 2, (0.0, 1.0), 0.5),
    (("lips",), (0.68, 0.37, 0.35), 1, (0.0, 0.9), 0.8),
    (("scalp",), _HAIR, 2, (0.1, 0.6), 1.0),
    (("brows",), _HAIR, 0, (0.4, 0.9), 0.75),
    (("mouth_interior",), (0.42, 0.17, 0.16), 0, (0.0, 1.0), 1.0),
    (("tongue",), (0.66, 0.34, 0.33), 0, (0.0, 1.0), 1.0),
    (("upper_teeth", "lower_teeth"), (0.87, 0.84, 0.77), 0, (0.0, 1.0), 1.0),
    (("lashes",), (0.10, 0.08, 0.07), 0, (0.0, 1.0), 1.0),
)  # fmt: skip
UNLIKE = 0.12  # display color between hair and skin from which on they are told apart
_BROW, _DARKER = 16, 1.5  # brows in the side of a painting; how much darker than around them they become
_SHADED, _HAIRY = 0.12, 0.35  # share of hair in a color up to which it is shade on skin, and from which on nothing of it stays
_HUNG = 2.0  # how quickly a neck begins to count as one that hair hangs over
_APART = "mouth_interior", "lashes", "left_eyeball", "right_eyeball"
_CHIN_WIDE, _BEARDED = 0.02, 0.5  # metres from the middle; share of hair in the color of a chin that has a beard
_CHEEK = 0.025  # metres, down from the eyes and out from so far beside the middle, over which hair may begin to hang
_MOST_OVER = 2.5  # below jaws little light arrives, and what does is not known so well
_GRAIN = 0.05  # of hair and brows, in display values: strands' worth of unevenness


def plain_face(head: HeadModel, pixels: int = PIXELS) -> np.ndarray:
    """Paint a plain human face for a head model.

    Args:
        head: The mesh, its UV map and regions; what it lacks stays skin.
        pixels: Side of the picture.

    Returns:
        As `painting.paint`: display sRGB, uint8, [pixels, pixels, 3], the row of v = 0 first.
    """
    return _KNOWN.get((head, pixels), lambda: _plain(head, pixels))


_KNOWN: Recent[np.ndarray] = Recent(2)


def _plain(head: HeadModel, pixels: int) -> np.ndarray:
    layout = texel_layout(head.uv, head.uv_faces, pixels)
    corners = head.faces[layout.face]  # [N, 3]
    colors = np.tile(np.array(_SKIN, np.float32), (len(layout), 1))
    for regions, color, rounds, (low, high), share in _LAYERS:
        mark = _smoothed(head.marked(*regions), head.faces, rounds)
        inside = (mark[corners] * layout.barycentric).sum(1, keepdims=True)
        weight = share * np.clip((inside - low) / (high - low), 0.0, 1.0)
        grain = np.random.default_rng(0).normal(0.0, _GRAIN if color is _HAIR else 0.0, (len(layout), 1))
        colors += weight * (np.array(color, np.float32) + grain.astype(np.float32) - colors)
    points = (head.v_template[corners] * layout.barycentric[..., None]).sum(1)
    for ball, angles in _eyes(head, corners, points):
        rings = (0.0, PUPIL_DEGREES, PUPIL_DEGREES + 2.0, IRIS_DEGREES - 4.0, IRIS_DEGREES - 1.0, IRIS_DEGREES + 1.0)
        shades = np.array([_PUPIL, _PUPIL, _IRIS, _IRIS, _RIM, _WHITE], np.float32)
        colors[ball] = np.stack([np.interp(angles, rings, shades[:, k]) for k in range(3)], -1)
    picture, known = np.zeros((pixels * pixels, 3), np.float32), np.zeros(pixels * pixels, bool)
    picture[layout.texel], known[layout.texel] = colors, True
    return quantize(fill_unknown(picture.reshape(pixels, pixels, 3), known.reshape(pixels, pixels)))


def accented(head: HeadModel, painting: np.ndarray) -> np.ndarray:
    """Return a painting of a person with what a bare mesh wants plainer than strands and lenses have left it.

    Pupils are black, brows darker than what is around them, and what hair has colored where it hangs is skin: ears, neck and
    shoulders, and the sides of a face without a beard.

    Args:
        head: The mesh, its UV map and regions.
        painting: As `plain_face` returns one.
    """
    layout = texel_layout(head.uv, head.uv_faces, len(painting))
    corners = head.faces[layout.face]
    flat = painting.reshape(-1, 3).astype(np.float32) / 255.0
    colors = flat[layout.texel]

    def inside(*regions: str) -> np.ndarray:
        weights: np.ndarray = (head.marked(*regions)[corners] * layout.barycentric).sum(1)
        return weights

    def smooth(region: str, rounds: int) -> np.ndarray:
        marks = _smoothed(head.marked(region), head.faces, rounds)[corners] * layout.barycentric
        return np.clip(_HUNG * marks.sum(1), 0.0, 1.0)

    scalp = inside("scalp") > 0.5
    plain = (inside("face") > 0.5) & (inside("lips", "left_lids", "right_lids", "brows") == 0.0)
    if plain.any() and scalp.any():
        tone = np.median(colors[plain], 0)
        hair = np.median(colors[scalp], 0) - tone
        share = np.clip((colors - tone) @ hair / max(float(hair @ hair), 1e-6), 0.0, 1.0)
        if np.linalg.norm(hair) > UNLIKE:
            points = (head.v_template[corners] * layout.barycentric[..., None]).sum(1)
            aside = np.clip((np.where(points[:, 2] < 0.0, np.inf, np.abs(points[:, 0])) - _CHEEK) / _CHEEK, 0.0, 1.0)
            covered = np.maximum(inside("ears") > 0.0, aside * smooth("neck", 2))  # a throat is in the shade, or has a beard
            heights = {name: head.v_template[head.marked(name)][:, 1] for name in ("lids", "lips")}
            chin = plain & (np.abs(points[:, 0]) < _CHIN_WIDE) & (points[:, 1] < heights["lips"].min())
            if not chin.any() or np.median(share[chin]) < _BEARDED:
                low = np.clip((heights["lids"].min() - points[:, 1]) / _CHEEK, 0.0, 1.0)
                cheek = low * (inside("lips", *_APART) == 0.0)
                covered = np.maximum(covered, aside * np.maximum(smooth("neck", 8), cheek))
            covered *= inside("scalp") == 0.0
            hung = covered * np.clip((share - _SHADED) / (_HAIRY - _SHADED), 0.0, 1.0)
            known = np.zeros(len(flat), bool)
            known[layout.texel] = (hung == 0.0) & (share < _HAIRY) & (plain | (inside("neck") > 0.5))
            skin = fill_unknown(flat.reshape(painting.shape), known.reshape(painting.shape[:2])).reshape(-1, 3)
            colors += hung[:, None] * (skin[layout.texel] - colors)
        around = _averaged(flat.reshape(painting.shape), len(painting) // _BROW).reshape(-1, 3)[layout.texel]
        colors += _DARKER * inside("brows")[:, None] * np.minimum(colors - around, 0.0)
    points = (head.v_template[corners] * layout.barycentric[..., None]).sum(1)
    for ball, angles in _eyes(head, corners, points):
        weight = np.interp(angles, (PUPIL_DEGREES - 1.0, PUPIL_DEGREES + 2.0), (0.9, 0.0))[:, None].astype(np.float32)
        colors[ball] += weight * (np.array(_PUPIL, np.float32) - colors[ball])
    flat[layout.texel] = colors
    return quantize(flat.reshape(painting.shape))


def unlit(head: HeadModel, vertices: np.ndarray, painting: np.ndarray) -> np.ndarray:
    """Return a painting of a person without the studio's light, as a material in a scene's light wants it.

    What is taken off is the light that lies on the person, what nose and jaw shade included: a scene shades that again.

    Args:
        head: The mesh and its UV map.
        vertices: Of the person at rest, [V, 3] metres.
        painting: As `plain_face` returns one.
    """
    side = len(painting)
    layout = texel_layout(head.uv, head.uv_faces, side)
    linear, known = srgb_to_linear(painting.astype(np.float32) / 255.0), np.zeros(side * side, bool)
    face = head.marked("face")[head.faces[layout.face]].all(1) if "face" in head.regions else np.ones(len(layout), bool)
    rig = rig_at_vertices(head, vertices, painting.reshape(-1, 3)[layout.texel][face] / 255.0).mean(1, keepdims=True)
    light = Texels.of(head, layout.face, layout.barycentric).at(rig)
    over = np.ones((side * side, 1), np.float32)
    over[layout.texel] = np.clip(np.pi / np.maximum(light, 1e-3), 0.0, _MOST_OVER)
    known[layout.texel] = True
    return quantize(linear_to_srgb(fill_unknown(over.reshape(side, side, 1), known.reshape(side, side)) * linear))


def _averaged(picture: np.ndarray, size: int) -> np.ndarray:
    """Averages over squares of `size` pixels around each one, [H, W, C]."""
    for axis in (0, 1):
        ends = [(size // 2, size - size // 2) if k == axis else (0, 0) for k in range(3)]
        total = np.cumsum(np.pad(picture, ends, mode="edge"), axis)
        low, high = (np.take(total, range(first, first + picture.shape[axis]), axis) for first in (0, size))
        picture = (high - low) / np.float32(size)
    return picture


def _eyes(head: HeadModel, corners: np.ndarray, points: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Which texels of corners [N, 3] and points [N, 3] lie on an eyeball, and degrees from where each looks, along +z."""
    joints = head.joints(np.zeros(head.shape_count, np.float32))
    for side in ("left", "right"):
        ball = head.marked(f"{side}_eyeball")[corners].all(1)
        ways = points[ball] - joints[JOINT_NAMES.index(f"{side}_eye")]
        yield ball, np.degrees(np.arccos(np.clip(ways[:, 2] / np.linalg.norm(ways, axis=1), -1.0, 1.0)))


def _smoothed(mark: np.ndarray, faces: np.ndarray, rounds: int) -> np.ndarray:
    """1 where marked [V] and 0 elsewhere, then means over the faces around each vertex, as often as asked."""
    mark = mark.astype(np.float32)
    around = np.maximum(np.bincount(faces.ravel(), minlength=len(mark)), 1)
    for _ in range(rounds):
        mark = np.bincount(faces.ravel(), np.repeat(mark[faces].mean(1), 3), len(mark)) / around
    return mark
