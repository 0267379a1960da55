"""Strands cut where a photo shows skin or what is behind the person: the groom is one of the package's, and the photo's is not.

What a strand is seen to cover tells where it is wrong; what hides behind other strands would show once these are cut, and is
asked where it lies. Imports torch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
import torch

from ..avatar import Avatar
from ..geometry.triangles import vertex_normals
from ..geometry.zbuffer import triangle_depth
from ..hair.body import cut
from ..hair.coloring import hiding_faces
from ..hair.grids import nearest
from ..hair.groom import TINTS, Groom
from ..hair.roots import SCALP
from ..head import HeadModel
from ..model.grmm import GRMM
from ..photo.parser import PhotoParts
from ..photo.widening import widened
from .hair_shape import BEHIND
from .hair_texture import Onto, Photo, joined, photos_of
from .invert import photo_model_inputs
from .types import PhotoTrack

# pixels that a place must show in, hair in these below which it is wrong and above which right, and the part of all hair from
# which on the photo is not believed
SEEN, WRONG, RIGHT, MOST_CUT = 0.06, 0.3, 0.6, 0.5
# metres that are left of a strand, and the part of it below which it is taken away where the scalp that is seen nearest to its
# root is bare: a scalp behind the horizon is what it is before it
STUBBLE, SHORTEST = 0.008, 0.2
AROUND, MOSTLY_BARE = 40, 0.6  # vertices of the scalp that are asked for that, and the share of them: hair's rim is blurred
LIKELY = 0.5  # of a pixel, from where on it is hat, or hair, or tells something
ROOT = 3  # places of a strand of which the first that is seen tells what it stands on
FACING = 0.15  # cosine between the skin's normal and the view, below which that is not believed: at the head's sides
RIM = 2  # pixels around hair in which hidden strands may lie


def trimmed(model: GRMM, avatar: Avatar, tracks: Sequence[PhotoTrack], parts: Sequence[PhotoParts]) -> Avatar:
    """Return an avatar without the ends of strands that hang where a photo shows skin or what is behind the person.

    Under a hat hair is plain, and nothing of where it begins is seen.
    """
    hair = avatar.hair
    if any((seen.hat > LIKELY).sum() > (seen.hair > LIKELY).sum() for seen in parts):
        return avatar
    if hair is None or hair.groom is None or not (hair.groom.groups == SCALP).any():
        return avatar
    scalp = hair.groom.groups == SCALP
    groom = hair.groom.select(scalp)
    left, rootless = np.ones(len(groom)), np.zeros(len(groom), bool)
    photos = photos_of(model, avatar, hair, groom, tracks, parts)
    for index, (photo, track) in enumerate(zip(photos, tracks, strict=True)):
        every, hairy = Onto(photo, len(groom)).shares()
        seen = every > SEEN
        with torch.no_grad():
            vertices = model.mesh(photo_model_inputs(model, avatar, track, index)[0]).vertices.cpu().numpy()
        beside, within = _hidden(groom, model.head_model, vertices, photo)
        wrong, right = np.where(seen, hairy < WRONG, beside), np.where(seen, hairy > RIGHT, within)
        last = TINTS - 1 - right[:, ::-1].argmax(1)  # the last place that is right; short hair may have none, and stays
        beyond = wrong & (np.arange(TINTS) > last[:, None]) & right.any(1)[:, None]
        first = np.where(beyond.any(1), beyond.argmax(1), TINTS)
        behind = wrong.any(1) & ~right.any(1) & ~wrong[:, 0]  # what is seen of it hangs out from behind the head
        first = np.where(behind, wrong.argmax(1), first)
        first_seen = seen.argmax(1)
        bare = (seen & wrong)[np.arange(len(groom)), first_seen] & (photo.facing > FACING) & (first_seen < ROOT)
        rootless |= seen.any(1) & bare
        mine = (first - 0.5) / (TINTS - 1)
        rootless |= (mine <= SHORTEST) & _beside_bare_scalp(groom, model.head_model, vertices, photo)
        left = np.minimum(left, mine)
    if np.where(rootless, 1.0, 1.0 - left.clip(0.0)).mean() > MOST_CUT:
        return avatar
    even = groom.resampled(int(groom.counts.max()))
    left = np.maximum(left, np.minimum(STUBBLE / even.lengths.clip(1e-6), 1.0))
    points = cut(even.points.reshape(len(even), -1, 3), left).reshape(-1, 3)
    kept = dataclasses.replace(even, points=points).select(~rootless)
    return joined(avatar, hair, kept, hair.groom.select(~scalp))


def _beside_bare_scalp(groom: Groom, head: HeadModel, vertices: np.ndarray, photo: Photo) -> np.ndarray:
    """Strands whose roots lie nearest to scalp that a photo shows bare, of all that it shows, [N] bool."""
    template, posed = np.asarray(head.v_template, float), np.asarray(vertices, float)
    way = photo.camera.position - posed
    facing = (vertex_normals(posed, np.asarray(head.faces)) * way).sum(1) / np.linalg.norm(way, axis=1)
    told, row, column = _told(posed, head, vertices, photo, BEHIND)
    seen = told & head.marked("scalp") & (facing > FACING)
    if not seen.any():
        return np.zeros(len(groom), bool)
    bare = photo.hair.numpy()[row, column][seen] < WRONG
    roots = groom.frames(template, head.faces).at(template)[0]
    found: np.ndarray = bare[nearest(template[seen], roots, AROUND)[0]].mean(1) > MOSTLY_BARE
    return found


def _hidden(groom: Groom, head: HeadModel, vertices: np.ndarray, photo: Photo) -> tuple[np.ndarray, np.ndarray]:
    """Places of strands before or beside the head that lie beside a photo's hair, and in it, [N, TINTS] bool each."""
    even = groom.resampled(TINTS)
    places = even.posed(even.frames(np.asarray(head.v_template, float), head.faces), vertices)
    told, row, column = _told(places, head, vertices, photo)
    around = widened(photo.hair[None], RIM)[0].numpy()
    beside, within = told & (around < WRONG)[row, column], told & (photo.hair.numpy() > RIGHT)[row, column]
    return beside.reshape(len(groom), TINTS), within.reshape(len(groom), TINTS)


def _told(
    places: np.ndarray, head: HeadModel, vertices: np.ndarray, photo: Photo, behind: float = 0.0
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:  # fmt: skip
    """Whether a photo tells what is at places [P, 3], at most so many metres `behind` the skin; their rows and columns, [P]."""
    local, pixels = photo.camera.project(places)
    depth = triangle_depth(np.asarray(vertices, float)[hiding_faces(head)], photo.camera)
    column, row = (pixels[:, k].astype(int).clip(0, size - 1) for k, size in ((0, depth.shape[1]), (1, depth.shape[0])))
    inside = (pixels >= 0.0).all(1) & (pixels < depth.shape[::-1]).all(1)
    told = inside & (local[:, 2] < depth[row, column] + behind) & (photo.counts.numpy() > LIKELY)[row, column]
    return told, row, column
