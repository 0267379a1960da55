"""Who acts, and the camera: the shape of the person in a video and the focal length.

The landmark network errs alike in all frames of a person, so that a few of them tell as much as all: six calm ones, turned as
differently as they come, are fitted together like photos of one person. Where that person's brows and lids lie no shape says
well: what the calm frames show otherwise than the head model with the reported expression is the person's, and is no raised
brow. (Of the mouth the reported coefficients are not good enough for that.) Needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..fitting.landmark_priors import EYES
from ..fitting.landmark_stage import LandmarkFit, Observation, fit_landmarks, similarity
from ..fitting.point_rig import LandmarkRig
from ..fitting.solver import project
from ..head.head_model import JOINT_COUNT
from ..jobs.progress import Share
from .following import Followed

KEY_FRAMES = 6
_CALM = 0.5  # share of the frames, those with the least expression, that are looked at
_UPPER = ("brow", "eye")  # shapes that are believed as reported
_LONG_FOCAL = 6.0  # of the picture's longer side; a camera further away says nothing about perspective


@dataclass(frozen=True)
class Actor:
    """The person in a video.

    Attributes:
        shape: Coefficients of the head model, [S].
        focal: Focal length in pixels of the frames.
        offsets: How far landmarks of brows and eyes lie from the head model's in the picture of an upright head, in distances
            of the outer eye corners, [478, 2]; zeros below the eyes.
    """

    shape: np.ndarray
    focal: float
    offsets: np.ndarray


def find_actor(followed: Followed, rig: LandmarkRig, shape: np.ndarray | None = None, progress: Share | None = None) -> Actor:
    """Find the shape of the person and the focal length.

    Args:
        followed: The face.
        rig: Landmarks of the head model.
        shape: The shape, where it is known, [S]: then the focal length alone is looked for.
        progress: Called with the share done; may raise to cancel.
    """
    seen = [observation(followed, index) for index in _key_frames(followed, rig)]
    known = rig if shape is None else rig.of_person(shape, np.ones(rig.expression_count))
    fit = fit_landmarks(seen, known, progress=progress)
    longest = max(followed.width, followed.height)
    focal = float(np.exp(np.median([view.focal for view in fit.views])))
    return Actor(fit.shape if shape is None else shape, min(focal, _LONG_FOCAL * longest), _offsets(fit, known, seen))


def roll_of(rotation: np.ndarray) -> np.ndarray:
    """Roll of a head in the picture, [2, 2]: rows of an upright head's offsets times it are those of a head turned so.

    Args:
        rotation: Head to camera, [3, 3].
    """
    angle = np.arctan2(rotation[1, 0], rotation[0, 0])
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, s], [-s, c]])


def _offsets(fit: LandmarkFit, rig: LandmarkRig, seen: list[Observation]) -> np.ndarray:
    """`Actor.offsets`, the mean over the calm frames."""
    names = rig.head.expression_names
    upper = np.array([name.startswith(_UPPER) for name in names])
    rest = rig.positions(np.zeros(rig.shape_count), np.zeros(rig.expression_count), np.zeros((JOINT_COUNT, 3)))
    above = rest[:, 1] > rest[list(EYES), 1].min()
    found = []
    for item, photo, view, unit in zip(seen, fit.problem.photos, fit.views, fit.units, strict=True):
        expression = np.where(upper, photo.priors.expression_mean, view.expression)
        points = project(fit.problem, photo, view, rig.positions(fit.shape, expression, view.pose))
        found.append((item.landmarks[:, :2] - points) / unit @ roll_of(view.rotation).T)
    return np.mean(found, axis=0) * above[:, None]


def observation(followed: Followed, index: int) -> Observation:
    """A frame as the landmark stage takes photos."""
    return Observation(followed.landmarks[index], followed.arkit[index], followed.width, followed.height)


def _key_frames(followed: Followed, rig: LandmarkRig) -> list[int]:
    """Of the calmest frames those that are turned most differently, one after the other."""
    seen = np.flatnonzero(followed.seen)
    moved = followed.arkit[seen].sum(1)
    calm = seen[np.argsort(moved, kind="stable")[: max(KEY_FRAMES, round(len(seen) * _CALM))]]
    mean = rig.positions(np.zeros(rig.shape_count), np.zeros(rig.expression_count), np.zeros((JOINT_COUNT, 3)))
    ahead = np.array([similarity(mean, followed.landmarks[index].astype(np.float64))[0][2] for index in calm])
    chosen = [int(np.argmax(ahead @ ahead.mean(0)))]  # the usual way of looking first
    while len(chosen) < min(KEY_FRAMES, len(calm)):
        nearest = (ahead @ ahead[chosen].T).max(1)  # cosine of the angle to the nearest chosen one
        nearest[chosen] = np.inf
        chosen.append(int(np.argmin(nearest)))
    return [int(calm[index]) for index in chosen]
