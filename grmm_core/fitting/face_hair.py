"""Brows, beard and lashes of the person in a photo, as strands over the skin, which has their colors as well.

Where the photo shows brows or a beard, the package's fullest groom of the part keeps its strands; elsewhere it loses them. So
they have the person's outline and thickness, and their pigments are sought as those of scalp hair. Imports torch.
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np
import torch

from ..geometry.zbuffer import EMPTY, triangle_depth
from ..hair.brows import FULLEST_BROWS, lowered
from ..hair.coloring import HairView, hiding_faces, with_colors
from ..hair.groom import Groom
from ..hair.packaged import library_groom
from ..hair.roots import BEARD, BROWS
from ..hair.settings import HairSettings
from ..photo.glasses import worn_glasses
from ..photo.lenses import BROWS as OUTLINES
from ..photo.parser import MESH_PARTS, PhotoParts, part_map
from ..photo.person import box_sum
from ..photo.widening import widened
from ..pictures.polygons import polygon
from .long_beard import hanging

if TYPE_CHECKING:
    from ..head import HeadModel
    from .types import PhotoTrack

FULLEST = {"brows": FULLEST_BROWS, "beard": "full"}
SHORT_BEARD = "short"
LIKELY = 0.5  # of a pixel
HANGING, BELOW = 0.08, 0.5  # of a beard's pixels outside the bald head, or on the throat as well: from here on it is long
REACH, AROUND = 0.006, 0.05  # of the head's height: beside the mesh's brows, and from how far skin they are told
# how much darker than that skin a pixel is that is wholly brow, and from which share of it on it is brow: the darkest tenth of
# where brows are tells it, so that thin and fair ones are seen, too
DARK, BROWN, DARKEST = (0.15, 0.3), 1 / 3, 0.9
SHADE = 0.015  # of the head's height: around hair, which is dark there, too
LOWER = (-0.009, 0.006)  # metres by which brows may be moved down
BRIDGE = 168  # landmark between the brows
ARCH = 0.005  # of the head's height: how far beside the landmarks' brows a brow may be
KEPT = (0.15, 0.65)  # of a strand's cover by what the photo shows, from one strand to the next
FEWEST = 0.05  # of the strands; fewer are no beard, and were no brows, whose place the plainest groom takes
SIDES = 0.006  # metres between a hidden strand's mirror image and what stands there
# metres from a strand under frames of glasses to those that tell what it is; share from which none do
FRAMES, MOSTLY = 0.012, 0.55
BROW_THICKNESS = 0.7  # finer strands than the package's: what the photo shows of brows is painted on the skin below as well
BEHIND = 0.004  # metres below the skin that are still seen


def face_hair(
    track: PhotoTrack, parts: PhotoParts, view: HairView, head: HeadModel, scalp: HairSettings
) -> tuple[list[Groom], dict[str, HairSettings]]:
    """Grooms of brows, lashes and, where there is one, beard, and the settings of brows and beard by name.

    Args:
        track: The photo.
        parts: What its pixels show.
        view: The same with the tracked head.
        head: Whose mesh the strands stand on.
        scalp: Of the person's hair: what colors begin from.
    """
    depth = triangle_depth(np.asarray(view.vertices)[hiding_faces(head)], track.camera)
    covers = {"brows": brow_cover(track, parts, view, head)}
    beard = parts.beard * view.counts
    on_throat = part_map(head, view.vertices, track.camera)[0] == tuple(MESH_PARTS).index("neck")
    if (beard > LIKELY).any():
        covers["beard"] = beard
    outside, throat = (float((beard * where).sum()) for where in (depth == EMPTY, on_throat))
    long = outside > HANGING * float(beard.sum()) or outside + throat > BELOW * float(beard.sum())
    grooms, own = [library_groom("natural", head.name, "lashes")], {}
    for (name, cover), group in zip(covers.items(), (BROWS, BEARD), strict=False):
        groom = library_groom(SHORT_BEARD if name == "beard" and not long else FULLEST[name], head.name, name)
        groom = _at_height(groom, track, view, head) if name == "brows" else groom
        shaded = _beside_hair(track, parts, view) > LIKELY if name == "brows" else np.zeros(depth.shape, bool)
        kept, hidden = _kept(groom, cover, depth, view, head, worn_glasses(track, parts).covered, shaded)
        if name == "brows" and hidden > MOSTLY:
            groom = _at_height(library_groom("natural", head.name, "brows"), track, view, head)
        elif kept.mean() > FEWEST:
            groom = groom.select(kept)
        elif name == "beard":
            continue
        else:
            groom = _at_height(library_groom("thin", head.name, "brows"), track, view, head)
        if name == "beard" and long:
            groom = hanging(groom, cover, track.head_down, pixels_per_metre(track, view), view, head)
        grooms.append(groom)
        shown = dataclasses.replace(view, hair=cover)
        colored = with_colors(scalp.for_part(group), groom, [shown], head)
        own[name] = colored.changed(thickness=BROW_THICKNESS * colored.thickness) if name == "brows" else colored
    return grooms, own


def brow_cover(track: PhotoTrack, parts: PhotoParts, view: HairView, head: HeadModel) -> np.ndarray:
    """How much of each pixel is brow, [H, W] 0..1: what at the mesh's brows is darker than the skin around."""
    height = float(np.ptp(track.camera.project(view.vertices)[1][:, 1]))
    at_brows = part_map(head, view.vertices, track.camera)[0] == tuple(MESH_PARTS).index("brows")
    region = _near(at_brows, REACH * height)
    skin = (parts.skin > 0.5) * (1.0 - region)
    light = np.asarray(track.image, np.float32).mean(2)
    planes = torch.from_numpy(np.stack([light * skin, skin]).astype(np.float32))[None]
    reach = max(1, round(AROUND * height))
    lit, count = box_sum(planes.double(), reach)[0].float().numpy()
    darker = 1.0 - light * count / np.maximum(lit, 1e-4 * (2 * reach + 1) ** 2)
    there = region * (count > 0.5) * _at_landmarks(track, max(1.0, ARCH * height)) * (1.0 - parts.eyes) * view.counts
    there = there * (1.0 - _beside_hair(track, parts, view)) * ~worn_glasses(track, parts).covered
    if not (there > LIKELY).any():
        return there
    whole = float(np.clip(np.quantile(darker[there > LIKELY], DARKEST), *DARK))
    cover: np.ndarray = np.clip((darker / whole - BROWN) / (1.0 - BROWN), 0.0, 1.0) * there
    return cover


def _beside_hair(track: PhotoTrack, parts: PhotoParts, view: HairView) -> np.ndarray:
    """Pixels [H, W] 0..1 that hair covers or shades, so that it is not told whether dark skin is brow."""
    height = float(np.ptp(track.camera.project(view.vertices)[1][:, 1]))
    return _near(parts.hair, SHADE * height)


def _at_landmarks(track: PhotoTrack, reach: float) -> np.ndarray:
    """Pixels not farther than `reach` from the brows that the landmarks outline in the photo, [H, W] bool."""
    found = np.zeros(track.image.shape[:2], bool)
    for outline in OUTLINES:
        found ^= polygon(found.shape, track.landmarks[list(outline), :2])
    return _near(found, reach) > 0.5


def _at_height(groom: Groom, track: PhotoTrack, view: HairView, head: HeadModel) -> Groom:
    """Brows as high above the eyes as the photo's landmarks have them, each for itself; the mesh's move less than people's."""
    template, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    frames = groom.frames(template, faces)
    pixels = view.camera.project(groom.posed(frames, view.vertices))[1]
    strand = groom.strand_of_point
    down = track.head_down
    scale, lower = pixels_per_metre(track, view), np.zeros(len(groom))
    sides = {np.sign(track.landmarks[outline[0], 0] - track.landmarks[BRIDGE, 0]): outline for outline in OUTLINES}
    for side, outline in sides.items():
        own = np.sign(pixels[groom.offsets[:-1], 0] - track.landmarks[BRIDGE, 0]) == side
        if own.any():
            off = (track.landmarks[list(outline), :2].mean(0) - pixels[own[strand]].mean(0)) @ down / scale
            lower[own] = np.clip(off, *LOWER)
    return lowered(groom, head, lower)


def pixels_per_metre(track: PhotoTrack, view: HairView) -> float:
    """How long a metre down the head is in a photo."""
    down = track.head_down
    high, seen = (np.ptp(part) for part in (view.vertices @ track.turn[:, 1], view.camera.project(view.vertices)[1] @ down))
    return max(float(seen / high / max(down @ down, 0.1)), 1e-6)


def _near(plane: np.ndarray, reach: float) -> np.ndarray:
    """A plane [H, W] widened by so many pixels, at least one."""
    result: np.ndarray = widened(torch.from_numpy(np.array(plane, np.float32))[None], max(1, round(reach)))[0].numpy()
    return result


def _kept(
    groom: Groom, cover: np.ndarray, depth: np.ndarray, view: HairView, head: HeadModel, glasses: np.ndarray, shaded: np.ndarray
) -> tuple[np.ndarray, float]:
    """Which strands of a groom stand where a photo shows their part, [N] bool, and the share of which pixels tell nothing.

    Those that the head, a hat, a thing or hair hides are as those on the other side; those under frames as what is seen next
    to them. `glasses`, `shaded`: pixels of frames, and those at hair, [H, W] bool.
    """
    frames = groom.frames(np.asarray(head.v_template, np.float64), head.faces)
    posed = groom.posed(frames, view.vertices)
    local, pixels = view.camera.project(posed)
    column, row = (np.clip(pixels[:, k].astype(int), 0, size - 1) for k, size in ((0, cover.shape[1]), (1, cover.shape[0])))
    strand, free = groom.strand_of_point, ~(glasses | shaded)[row, column]
    told = np.bincount(strand, free, len(groom))
    mean = np.bincount(strand, cover[row, column] * free, len(groom)) / np.maximum(told, 1.0)
    seen = np.bincount(strand, (local[:, 2] < depth[row, column] + BEHIND) * view.counts[row, column] * free, len(groom))
    framed = np.bincount(strand, glasses[row, column], len(groom)) / groom.counts >= 0.5
    chance = (np.arange(len(groom)) * 0.6180339887498949) % 1.0
    shown, untold = seen / groom.counts > 0.5, float((told / groom.counts <= 0.5).mean())
    kept: np.ndarray = shown & (mean > KEPT[0] + (KEPT[1] - KEPT[0]) * chance)
    if shown.all() or not shown.any():
        return kept, untold
    roots = torch.from_numpy(frames.at(np.asarray(head.v_template, np.float64))[0])
    apart, nearest = torch.cdist(roots[~shown] * roots.new_tensor([-1.0, 1.0, 1.0]), roots[shown]).min(1)
    kept[~shown] = kept[shown][nearest.numpy()] & (apart.numpy() < SIDES)
    if framed.any():
        near, nearest = torch.cdist(roots[framed], roots[shown]).min(1)
        kept[framed] = np.where(near.numpy() < FRAMES, kept[shown][nearest.numpy()], kept[framed])
    return kept, untold
