"""Heads that are tilted in a photo, tilted on their necks.

Tracking turns head and bust as one. Of a head that leans to a side shoulders and long hair do not lean with it: so the tilt in
the picture goes to the neck, the camera makes up for it, and the bust stands upright in the photo. Imports torch.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.camera import Camera
from ..geometry.rotations import matrix_to_euler
from ..hair.body import Body
from ..hair.groom import bind, join
from ..hair.roots import SCALP
from ..hair.shoulders import unhung
from ..photo.parser import parse

if TYPE_CHECKING:
    from ..avatar import Hair
    from ..head import HeadModel
    from .types import PhotoTrack

NECK = 1  # the joint
_MOVED = 1e-4  # metres
MOST = np.radians(45.0)  # of a tilt: who is tilted more lies, or the photo does


def upright(track: PhotoTrack, head: HeadModel) -> PhotoTrack:
    """A track whose head is as it was, on a bust that stands upright in the picture; what its pixels show is told before."""
    rotation = np.asarray(track.camera.world_to_camera[:3, :3], np.float64)
    right, down = rotation[:2, 1]  # where the head's up goes, in the picture
    tilt = np.arctan2(right, -down)
    if track.pose[:2].any() or abs(tilt) > MOST:
        return track
    cosine, sine = np.cos(tilt), np.sin(tilt)
    standing = np.array([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ rotation
    turn = standing.T @ rotation
    joint = head.joints(track.shape)[NECK]
    back = np.eye(4)
    back[:3, :3], back[:3, 3] = turn.T, joint - turn.T @ joint
    pose = track.pose.copy()
    pose[NECK] = matrix_to_euler(turn)

    def moved(camera: Camera) -> Camera:
        return dataclasses.replace(camera, world_to_camera=camera.world_to_camera @ back)

    labels = np.stack(dataclasses.astuple(parse(track, head)))  # the parser knows heads by what is up and down on them
    cameras = moved(track.camera), moved(track.photo_camera)
    return dataclasses.replace(track, camera=cameras[0], photo_camera=cameras[1], pose=pose, labels=labels)


def hung_free(hair: Hair | None, tracks: Sequence[PhotoTrack], head: HeadModel) -> Hair | None:
    """Hair that lies as the photos show it once it hangs beside the tilted head; it had been fitted as if it went along.

    Args:
        hair: With strands, or nothing to change.
        tracks: The photos.
        head: Whose mesh they stand on.
    """
    groom = None if hair is None else hair.groom
    if hair is None or groom is None or not (groom.groups == SCALP).any():
        return hair
    down = -np.mean([track.turn[1] for track in tracks], axis=0)  # the bust's, in the head's axes
    scalp = np.flatnonzero(groom.groups == SCALP)
    own = groom.select(scalp)
    vertices, faces = np.asarray(head.v_template, np.float64), np.asarray(head.faces)
    even = own.resampled(int(own.counts.max()))
    strands = even.posed(even.frames(vertices, faces), vertices).reshape(len(even), -1, 3)
    hung = unhung(head, vertices, strands, down)
    rows = np.flatnonzero(np.abs(hung - strands).max((1, 2)) > _MOVED)
    if not len(rows):
        return hair
    strands[rows] = Body.of(head, vertices).pushed(hung[rows])
    points = strands.reshape(-1, 3)
    made = bind(vertices, faces, vertices, even.triangles, even.weights, points, even.offsets, even.widths, even.groups)
    made = dataclasses.replace(made, tints=even.tints)
    return dataclasses.replace(hair, groom=join([made, groom.select(np.flatnonzero(groom.groups != SCALP))]))
