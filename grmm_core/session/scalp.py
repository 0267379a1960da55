"""The hair that an avatar's Gaussians were trained with, laid flat onto the skin where it wears strands instead.

The model's texels of the scalp stand for hair: they float above the skin in its color, and those of long hair hang beside the
neck. They become a cap: no offset from the skin, closed, in the color of the skin around it, darker where strands take the
light. A beard stays: it belongs to the face. Called by `wardrobe`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ..compute.recent import Recent
from ..geometry.libraries import to_numpy
from ..geometry.points import squared_distances
from ..hair.cover import beneath
from ..hair.hanging import left_by_hair
from ..hair.pigment import albedos
from ..hair.roots import BEARD as BEARDS
from ..hair.roots import BROWS, SCALP
from ..hair.settings import HairSettings
from ..hair.strands import DIM, StrandBlock
from ..head import HeadModel
from ..model.config import METRES_PER_MM
from ..pictures.color import linear_to_srgb, srgb_to_linear
from .evaluator import Evaluator, Inputs, OpenAvatar

LIFTED = (0.003, 0.006)  # metres above the skin: from where on a texel beside the scalp counts as hair, and counts fully
ASIDE = (0.012, 0.02)  # metres: likewise along the skin
DARK = (0.75, 0.5)  # of the brightness of skin: from where on a texel beside the face counts as hair, and counts fully
BESIDE = (0.068, 0.05)  # metres: in front of the first depth is face, behind the second beside it
CHIN, BEARDED = 0.025, 0.6  # metres to either side of the chin's middle; brightness of a bearded chin, of the skin's
TEMPLES = (-0.01, 0.01)  # metres: above these heights hair of a photo is painted beside the scalp
BEHIND = (0.0, -0.015)  # metres: likewise behind these depths, at whatever height
OTHER = (0.08, 0.2)  # of the brightness of skin: from how far off in color on a photo's texel counts as hair, and counts fully
HAIRLINE = 2  # triangles beside the scalp up to which a shaven head's hairline may lie
TINTED = (0.02, 0.08)  # likewise there, of anybody's
FOREHEAD = (0.074, 0.084)  # metres: above the brows, hair is that of the scalp
BEARD = ((0.0, 0.02), (0.03, 0.01))  # metres: below this height, and in front of this depth, hair is beard
RIM = (0.006, 0.015)  # metres from an open edge: nearer than the first one what is dark is the edge, not a photo's hair
NEAR = 0.02  # metres: over what distance the skin's color is smoothed
SAMPLES = 1200  # texels of skin from which it is taken
# of the brightness of skin that is not laid flat: what dense strands over it take
SHADED = {SCALP: 0.3, BROWS: 0.42, BEARDS: 0.5}
SHADING = 5  # layers of `hair.cover` over skin in which strands shade it: curls that stand before a forehead do not
DISPLAYED = 1.0 / 2.2  # power that makes a share of light one of a display color
UNDER = 0.9  # how much of the hair's color the skin under dense hair takes on
ROOTED = 0.75  # of what is left, where that skin is of a place without hair: what roots in it take
GLOSS = 0.05  # linear: white glints on that color where light gets to; without them what shows of it is rust
SKIN = ("face", "neck")  # regions where skin shows; the others in it below
_NOT_SKIN = ("lips", "brows", "lids", "lashes", "mouth_interior", "left_eyeball", "right_eyeball")
_ISLAND = 0


class Places(NamedTuple):
    """Texels on the mean head.

    Attributes:
        points: [N, 3] metres.
        corners: Vertices of the triangle under each, [N, 3].
        weights: Barycentric coordinates, [N, 3].
        scalp: How far it belongs to the scalp, 0..1 [N].
        hairline: How far to the scalp or to what is beside it, as far as `HAIRLINE` triangles, 0..1 [N].
        skin: Whether it is plain skin of face and neck, [N].
        outer: Whether it is on the outer skin, [N].
        beside: How far it is beside, behind and above the face, 0..1 [N].
        painted: How far a photo's hair may be painted there, as at temples, 0..1 [N].
    """

    points: np.ndarray
    corners: np.ndarray
    weights: np.ndarray
    scalp: np.ndarray
    hairline: np.ndarray
    skin: np.ndarray
    outer: np.ndarray
    beside: np.ndarray
    painted: np.ndarray


class Skin(NamedTuple):
    """What lies under hair; float32.

    Attributes:
        share: How flat each texel is to be laid, 0..1 [N].
        color: Of the skin there, linear RGB [N, 3].
        bare: How far that color is of skin on which no hair grows, 0..1 [N].
    """

    share: np.ndarray
    color: np.ndarray
    bare: np.ndarray


def bare_skin(evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, own: bool = False) -> Skin:
    """Find the trained hair of an avatar, and the skin under it, from its inputs at rest.

    With its `own` strands, what a photo painted under these stays.
    """
    places = places_of(target)
    seen = seen_colors(evaluator, target, inputs, 1.0)
    hairless, bare = target.model.config.hairless, np.zeros(len(seen), np.float32)
    if hairless and own:
        return Skin(places.scalp.astype(np.float32), seen, bare)
    far = np.zeros(len(seen), np.float32)
    if not hairless:
        offsets = to_numpy(evaluator.offsets(target, inputs))[:, :3] * target.model.config.position_unit_mm * METRES_PER_MM
        far = np.maximum(ramp(offsets[:, 2], *LIFTED), ramp(np.linalg.norm(offsets[:, :2], axis=1), *ASIDE))
    (y_low, y_high), (z_low, z_high) = BEARD
    beard = ramp(places.points[:, 1], y_high, y_low) * ramp(places.points[:, 2], z_high, z_low)
    bright = seen.mean(1)
    plain = places.skin & (places.scalp < 0.02) & (far < 0.02) & (beard < 0.5)
    middle = float(np.median(bright[plain])) if plain.any() else 0.0
    chin = places.skin & (beard > 0.9) & (np.abs(places.points[:, 0]) < CHIN)
    if not chin.any() or np.median(bright[chin]) > BEARDED * middle:
        beard = np.zeros_like(beard)  # shaven: what is dark beside the jaw is scalp hair that hangs there
    around = (1.0 - beard) * places.outer * (places.painted if hairless else places.beside)
    share = np.maximum(places.scalp, far * around)
    photo = target.avatar.provenance.from_photos
    shaven = places.hairline if hairless and not photo else np.zeros(len(seen))  # its tint ends at the person's own hairline
    clean = np.flatnonzero(plain & (bright > DARK[0] * middle) & (shaven < 0.02))
    if not len(clean):
        return Skin(share.astype(np.float32), seen, bare)
    some = clean[:: max(1, len(clean) // SAMPLES)]
    wanted = np.flatnonzero((around > 0) | (share > 0))
    color = seen.copy()
    for part in np.array_split(wanted, max(1, len(wanted) // 2048)):
        near = 1.0 / (squared_distances(places.points[part], places.points[some]) + NEAR**2) ** 2
        color[part] = (near @ seen[some]) / near.sum(1, keepdims=True)
    # what is as dark as hair beside and behind the face is hair that lies on the skin
    usual = np.maximum(color.mean(1), 1e-4)
    dark = ramp(bright / usual, DARK[0], DARK[1])
    if hairless:  # only a photo paints its hair there, of any color, with soft borders; else the scalp is shaven
        sides = seen, seen_colors(evaluator, target, inputs, -1.0)  # the inner side of an open bust is in the dark, and no hair
        if photo:
            dark = np.minimum(*(ramp(np.abs(side - color).max(1) / usual, *OTHER) for side in sides))
        else:
            dark = np.minimum(*(ramp(side.mean(1) / usual, *DARK) for side in sides))
            tinted = np.minimum(*(ramp(np.abs(side - color).max(1) / usual, *TINTED) for side in sides))
            dark = np.maximum.reduce([dark, tinted * shaven, places.scalp])
        color, bare = seen + dark[:, None] * (color - seen), dark.astype(np.float32)
    return Skin(np.maximum(share, dark * around).astype(np.float32), color, bare)


def seen_colors(evaluator: Evaluator, target: OpenAvatar, inputs: Inputs, ahead: float) -> np.ndarray:
    """Colors [N, 3] of the texels, linear RGB, seen from before the face, or from behind where `ahead` is -1."""
    colors = evaluator.appearance(target, inputs, np.array([0.0, 0.0, ahead], np.float32))[0]
    return srgb_to_linear(to_numpy(colors).clip(0.0, 1.0)).astype(np.float32)


class Covered(NamedTuple):
    """What strands as they are stored do to the skin of each texel.

    Attributes:
        under: Whether it lies under scalp hair, 0..1 [N].
        cover: What roots cover of it, 0..1 [N].
        light: What reaches it, 0..1 [N].
        shaded: Whether strands of each part of `SHADED` lie over it closely, 0..1 [N].
        beside: What hair that stands off leaves of the rig's light, 0..1 [N].
    """

    under: np.ndarray
    cover: np.ndarray
    light: np.ndarray
    shaded: tuple[np.ndarray, ...]
    beside: np.ndarray


def covered(target: OpenAvatar, blocks: Sequence[StrandBlock]) -> Covered:
    """Find what strands cover, whatever their settings."""
    places, head = places_of(target), target.model.head_model
    cover, light = ((part[places.corners] * places.weights).sum(1) for part in _under_hair(head, blocks))
    where = head, places.points, places.corners, places.weights, blocks
    shaded = tuple(beneath(*where, group, SHADING) * places.outer for group in SHADED)
    lost = ((1.0 - left_by_hair(head, blocks))[places.corners] * places.weights).sum(1)
    return Covered(beneath(*where), cover, light, shaded, 1.0 - lost * places.outer)


def cap_color(skin: Skin, there: Covered, settings: HairSettings, rig: bool) -> np.ndarray:
    """Color of the texels where they are laid flat, under strands, display sRGB [N, 3] float32; `rig`: in its shadows, too."""
    cover = (1.0 - (1.0 - there.cover) ** settings.density)[:, None] * there.under[:, None]
    dark = there.under * (1.0 - np.maximum(there.light, DIM) ** settings.shading)
    if rig:  # else a bright rim would be left along the hairline, between both shadows
        dark = np.maximum(dark, (1.0 - there.beside) * settings.shading)
    hair = albedos(settings, np.zeros(1), np.full((1, 2), 0.5))[0, 0] + GLOSS * (there.light**2)[:, None]
    left = (1.0 - UNDER * cover) * (1.0 - ROOTED * skin.bare[:, None] * cover)
    color = skin.color * left + (1.0 - left) * hair
    return linear_to_srgb(color * (1.0 - dark)[:, None])


def shade(there: Covered, settings: Sequence[HairSettings]) -> np.ndarray:
    """What strands that lie over skin leave of its color, as a fringe on a forehead and a beard on a chin, float32 [N, 1]."""
    left = np.ones(len(there.under))
    for (group, most), over in zip(SHADED.items(), there.shaded, strict=True):
        left *= 1.0 - most * settings[group].shading * over
    return left[:, None].astype(np.float32)


def shadow(there: Covered, settings: HairSettings) -> np.ndarray:
    """What scalp hair that stands off, as beside a neck, leaves of the color of skin in the rig's light, float32 [N, 1]."""
    return ((1.0 - (1.0 - there.beside) * settings.shading) ** DISPLAYED)[:, None].astype(np.float32)


def _under_hair(head: HeadModel, blocks: Sequence[StrandBlock]) -> tuple[np.ndarray, np.ndarray]:
    """How much of the skin at each vertex strands cover, and how much light they leave it, 0..1 [V] each."""
    count = len(head.v_template)
    faces = np.asarray(head.faces)
    template = np.asarray(head.v_template, float)
    shadow, light, roots, area = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    corners = template[faces]
    np.add.at(
        area,
        faces,
        (np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 6)[:, None],
    )
    for block in blocks:
        if block.group != SCALP:
            continue
        first = np.linalg.norm(block.points[:, 1:] - block.points[:, :-1], axis=2).sum(1).clip(max=0.02)
        each = first * block.widths[:, 0] * (len(block) / len(block.points))
        weights = block.frames.weights
        np.add.at(shadow, block.frames.corners, weights * each[:, None])
        np.add.at(light, block.frames.corners, weights * block.light[:, :2, 0].mean(1)[:, None])
        np.add.at(roots, block.frames.corners, weights)
    cover = 1.0 - np.exp(-shadow / np.maximum(area, 1e-9))
    light = np.where(roots > 0, light / np.maximum(roots, 1e-9), 1.0)
    for _ in range(2):
        cover, light = (smoothed(part, faces) for part in (cover, light))
    return cover, np.clip(2.0 * light, 0.0, 1.0)  # openness at the skin is half a sphere's


def smoothed(values: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Values of vertices [V], each the mean of the triangles [F, 3] at it."""
    total, number = np.zeros(len(values)), np.zeros(len(values))
    np.add.at(total, faces, values[faces].mean(1)[:, None])
    np.add.at(number, faces, 1.0)
    return np.where(number > 0, total / np.maximum(number, 1), values)


_KNOWN: Recent[Places] = Recent(2)
"""All avatars of the same weights have the same."""


def places_of(target: OpenAvatar) -> Places:
    """Where an avatar's texels are."""
    head, layout = target.model.head_model, target.model.layout

    def make() -> Places:
        corners = np.asarray(head.faces)[layout.face]

        def share(*names: str) -> np.ndarray:
            return (head.marked(*names).astype(float)[corners] * layout.barycentric).sum(1)

        points = (np.asarray(head.v_template, float)[corners] * layout.barycentric[..., None]).sum(1)
        faces, wider = np.asarray(head.faces), head.marked("scalp")
        for _ in range(HAIRLINE):
            wider = np.isin(np.arange(len(wider)), faces[wider[faces].any(1)])
        outer = np.asarray(head.uv_islands)[layout.face] == _ISLAND
        beside = np.maximum(ramp(points[:, 2], *BESIDE), ramp(points[:, 1], *FOREHEAD))
        skin = outer & (share(*SKIN) > 0.99) & (share(*_NOT_SKIN) < 0.01)
        return Places(
            points.astype(np.float32),
            corners,
            layout.barycentric,
            share("scalp") * outer,
            (wider[corners] * layout.barycentric).sum(1) * outer,
            skin,
            outer,
            beside,
            beside
            * (1.0 - share("ears", *_NOT_SKIN))
            * ramp(_from_edges(head, points), *RIM)
            * np.maximum(ramp(points[:, 1], *TEMPLES), ramp(points[:, 2], *BEHIND)),
        )

    return _KNOWN.get((head, layout.face, layout.barycentric), make)


def _from_edges(head: HeadModel, points: np.ndarray) -> np.ndarray:
    """Distance of points [N, 3] on the mean head from the mesh's open edges, such as a bust's, metres [N]."""
    faces = np.asarray(head.faces)
    sides, uses = np.unique(np.sort(faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1), axis=0, return_counts=True)
    open_edges = np.asarray(head.v_template, float)[np.unique(sides[uses == 1])]
    nearest = np.full(len(points), np.inf)
    for part in np.array_split(np.arange(len(points)), max(1, len(points) // 2048)):
        for edge in np.array_split(open_edges, max(1, len(open_edges) // 512)):
            if len(edge):
                nearest[part] = np.minimum(nearest[part], squared_distances(points[part], edge).min(1))
    return np.sqrt(nearest)


def ramp(values: np.ndarray, low: float, high: float) -> np.ndarray:
    """0 at `low`, 1 at `high`, smooth between them, either way round."""
    x = np.clip((values - low) / (high - low), 0.0, 1.0)
    return x * x * (3.0 - 2.0 * x)
