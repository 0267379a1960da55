"""Camera, shape, expression and pose from the landmarks of one or several photos of a person.

The neck stays at rest: where the head is turned to is in the camera. Used by `track`. Needs numpy only.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..errors import ShapeError
from ..geometry.camera import Camera
from ..head.head_model import JOINT_COUNT
from ..head.usual_face import usual_shape
from ..photo.landmarks import EYE_CORNERS, HeadLandmarks
from .landmark_priors import (
    PLACED_SHARE,
    VIEW_NOISE,
    View,
    landmark_modes,
    landmark_sigmas,
    make_priors,
    photo_priors,
    shape_priors,
)
from .point_rig import LandmarkRig
from .solver import PhotoProblem, Problem, Solution, Term, camera_of, project, solve
from .types import LANDMARK_COUNT, PhotoTrack

logger = logging.getLogger(__name__)

CAMERA_ITERATIONS, ITERATIONS = 8, 30
SEEN_SHARE = 0.5  # of MediaPipe's landmarks in what tells the shape
_SLANTED, _FRONTAL = 0.2, 0.7  # cosines between skin and view, from which on they count, and wholly


@dataclass(frozen=True)
class Observation:
    """What was found in one photo.

    Attributes:
        landmarks: MediaPipe's: x, y in pixels of the photo and relative depth in the same unit (smaller is nearer), [478, 3].
        arkit: Reported coefficients of the 52 ARKit shapes, [52].
        width, height: Size of the photo in pixels.
        focal: Focal length in pixels that the file states, or None.
        placed: The head model's as `photo.head_landmarks` found them, by which the shape is looked for; None: by MediaPipe's.
    """

    landmarks: np.ndarray
    arkit: np.ndarray
    width: int
    height: int
    focal: float | None = None
    placed: HeadLandmarks | None = None


@dataclass(frozen=True)
class LandmarkFit:
    """Result of a stage.

    Attributes:
        problem: What was solved; the photometric stage adds to it.
        solution: The unknowns.
        units: Eye distance of each photo in pixels, were it seen from the front.
        cameras: Camera of each whole photo in head space.
        landmarks: The head's landmarks in each photo, pixels, [478, 2] each.
    """

    problem: Problem
    solution: Solution
    units: tuple[float, ...]
    cameras: tuple[Camera, ...]
    landmarks: tuple[np.ndarray, ...]

    @property
    def shape(self) -> np.ndarray:
        """Shape coefficients that all photos share, [S]."""
        return self.solution.shape

    @property
    def views(self) -> tuple[View, ...]:
        """Each photo's expression, pose and camera, in the order of the photos."""
        return self.solution.views


def fit_landmarks(
    observations: Sequence[Observation],
    rig: LandmarkRig,
    *,
    progress: Callable[[float], None] | None = None,
) -> LandmarkFit:
    """Fit the head model to landmarks.

    Args:
        observations: One for each photo of the same person.
        rig: Landmarks of the head model.
        progress: Called with 0..1; may raise to cancel.

    Raises:
        ShapeError: No photo, or landmarks of another shape or not finite.
    """
    if not observations:
        raise ShapeError("No photo was given to fit; choose at least one.")
    for item in observations:
        if item.landmarks.shape != (LANDMARK_COUNT, 3) or not np.isfinite(item.landmarks).all():
            raise ShapeError(f"The landmarks must be finite and of shape ({LANDMARK_COUNT}, 3).")
    problem, start, units = _start(observations, rig)
    # cameras alone first: far from the solution the shape would bend to a wrong rotation
    start = solve(problem, start, CAMERA_ITERATIONS, cameras_only=True)
    problem = _weighed(problem, start, units, rig, [item.placed for item in observations])
    solution = solve(problem, start, ITERATIONS, progress=progress)
    logger.debug("landmarks: %d steps, objective %.1f", solution.iterations, solution.objective)
    return finished(problem, with_shape(problem, solution, ITERATIONS), units, rig)


def restarted(tracks: Sequence[PhotoTrack], rig: LandmarkRig) -> LandmarkFit:
    """The landmark stage's problem again, with what was tracked as its solution.

    Args:
        tracks: Photos of a person.
        rig: Landmarks of the head model.
    """
    rest = rig.positions(np.zeros(rig.shape_count), np.zeros(rig.expression_count), np.zeros((JOINT_COUNT, 3)))
    center = rest.mean(0)
    photos, views, units = [], [], []
    for track in tracks:
        camera = track.photo_camera
        scale = track.camera.fx / camera.fx
        origin = np.array([camera.cx - track.camera.cx / scale, camera.cy - track.camera.cy / scale])
        rotation = camera.world_to_camera[:3, :3]
        middle = rotation @ center + camera.world_to_camera[:3, 3]
        magnification, focal = float(np.log(middle[2] / camera.fx)), float(np.log(camera.fx))
        noise = np.zeros(landmark_modes(rotation).shape[2])
        views.append(
            View(
                rotation, camera.fx * middle[:2] / middle[2], magnification, focal, track.expression.astype(np.float64),
                track.pose.astype(np.float64), noise,
            )
        )  # fmt: skip
        units.append(_eye_distance(rest) / np.exp(magnification))
        prior = photo_priors(rig.head, make_priors(rig.head, track.arkit, camera.fx, camera.width, camera.height))
        term = Term(rig, track.landmarks / scale + origin, np.ones(LANDMARK_COUNT))
        shape_prior = shape_priors(rig.head, prior, track.arkit)
        photos.append(PhotoProblem(camera.width, camera.height, shape_prior, (term,), term, prior))
    problem = _problem(photos, center, rig, views)
    solution = Solution(tracks[0].shape.astype(np.float64), tuple(views))
    placed = [track.placed_in_photo for track in tracks]
    return finished(_weighed(problem, solution, tuple(units), rig, placed), solution, tuple(units), rig)


def _problem(photos: list[PhotoProblem], center: np.ndarray, rig: LandmarkRig, views: list[View]) -> Problem:
    counts = (rig.shape_count, rig.expression_count, len(views[0].noise))
    usual = usual_shape(rig.head)[: rig.shape_count]  # a rig of one person has no shape to look for
    return Problem(tuple(photos), center, *counts, shape_mean=usual)


def _weighed(
    problem: Problem, start: Solution, units: tuple[float, ...], rig: LandmarkRig, placed: Sequence[HeadLandmarks | None]
) -> Problem:
    """The problem with the landmarks' expected errors and modes for how the heads are turned; `placed` as in `Observation`."""
    photos = []
    for photo, view, unit, own in zip(problem.photos, start.views, units, placed, strict=True):
        sigma, modes = landmark_sigmas(rig, view.rotation) * unit, landmark_modes(view.rotation) * unit
        assert photo.seen is not None
        seen = replace(photo.seen, sigma=sigma, modes=modes)
        term = seen
        if own is not None:
            modes = landmark_modes(view.rotation, placed=True) * unit
            target = _of_both(own.points, seen.target, rig.facing(view.rotation))
            term = replace(seen, target=target, sigma=PLACED_SHARE * own.sigma, modes=modes)
            if len(problem.photos) > 1:  # MediaPipe's err by how a head is turned, and photos must agree with each other
                seen = replace(seen, target=0.5 * (seen.target + own.points))
        photos.append(replace(photo, terms=(term,), seen=seen))
    # the network errs on a face in much the same way in all its photos: together they tell of the shape what one tells
    return replace(problem, photos=tuple(photos), shape_weight=float(len(photos)))


def _of_both(placed: np.ndarray, seen: np.ndarray, facing: np.ndarray) -> np.ndarray:
    """Landmarks that tell the shape, [478, 2]: the head model's, halfway to MediaPipe's where a face is seen from the front.

    The head model's lean to the synthetic people that taught their network, whose lips are thick and chins short. MediaPipe's
    slide along the outline of a turned head. Where both of them are off by the same is a matter of the camera.
    """
    share = SEEN_SHARE * np.clip((facing - _SLANTED) / (_FRONTAL - _SLANTED), 0.0, 1.0)
    apart = seen - placed
    return placed + share[:, None] * (apart - np.median(apart, axis=0))


def with_shape(problem: Problem, start: Solution, limit: int) -> Solution:
    """Camera, expression and pose of each photo for the shape that was found.

    MediaPipe's landmarks are believed, of several photos the mean of them and the head model's, and more than where the
    shape is looked for: an error that bends the shape is seen in every view and expression, one that moves a brow in its
    photo only, where nearness is what counts.

    Args:
        problem: What the shape was found by.
        start: Its solution.
        limit: Largest number of steps.
    """
    photos, views = [], []
    for photo, view in zip(problem.photos, start.views, strict=True):
        assert photo.seen is not None
        assert photo.seen_priors is not None
        assert photo.seen.modes is not None
        seen = replace(photo.seen, modes=photo.seen.modes * VIEW_NOISE)
        photos.append(replace(photo, priors=photo.seen_priors, terms=(seen, *photo.terms[1:])))
        views.append(replace(view, noise=np.zeros_like(view.noise)))
    solution = solve(replace(problem, photos=tuple(photos)), replace(start, views=tuple(views)), limit, shape_held=True)
    kept = zip(solution.views, start.views, strict=True)
    return replace(solution, views=tuple(replace(view, noise=before.noise) for view, before in kept))


def _eye_distance(landmarks: np.ndarray) -> float:
    return float(np.linalg.norm(landmarks[EYE_CORNERS[1]] - landmarks[EYE_CORNERS[0]]))


def finished(problem: Problem, solution: Solution, units: tuple[float, ...], rig: LandmarkRig) -> LandmarkFit:
    """A solution with its cameras and landmarks."""
    pairs = list(zip(problem.photos, solution.views, strict=True))
    landmarks = (
        project(problem, photo, view, rig.positions(solution.shape, view.expression, view.pose)) for photo, view in pairs
    )
    cameras = (camera_of(problem, photo, view) for photo, view in pairs)
    return LandmarkFit(problem, solution, units, tuple(cameras), tuple(landmarks))


def _start(observations: Sequence[Observation], rig: LandmarkRig) -> tuple[Problem, Solution, tuple[float, ...]]:
    """Cameras from the similarity between found landmarks (with their relative depth) and the mean head's."""
    shape = np.zeros(rig.shape_count)
    mean = rig.positions(shape, np.zeros(rig.expression_count), np.zeros((JOINT_COUNT, 3)))
    center = mean.mean(0)
    photos, units, views = [], [], []
    for item in observations:
        prior = photo_priors(rig.head, make_priors(rig.head, item.arkit, item.focal, item.width, item.height))
        model = rig.positions(shape, prior.expression_mean, prior.pose_mean)
        rotation, offset, magnification = seen_pose(model - center, item)
        # depth over focal length is 1 / scale; the priors of distance and focal length split the product
        focal = prior.log_focal(magnification)
        noise = np.zeros(landmark_modes(rotation).shape[2])
        views.append(View(rotation, offset, magnification, focal, prior.expression_mean.copy(), prior.pose_mean.copy(), noise))
        units.append(_eye_distance(mean) / np.exp(magnification))
        term = Term(rig, item.landmarks[:, :2].astype(np.float64), landmark_sigmas(rig, rotation) * units[-1])
        shape_prior = shape_priors(rig.head, prior, item.arkit)
        photos.append(PhotoProblem(item.width, item.height, shape_prior, (term,), term, prior))
    problem = _problem(photos, center, rig, views)
    return problem, Solution(shape, tuple(views)), tuple(units)


def seen_pose(model: np.ndarray, item: Observation) -> tuple[np.ndarray, np.ndarray, float]:
    """How landmarks are seen, by the similarity between these (with their relative depth) and the model's.

    Args:
        model: Landmarks about the point that `View.offset` projects, metres, [478, 3].
        item: What was found.

    Returns:
        `rotation`, `offset` and `magnification` of a `View`.
    """
    rotation, scale, shift = similarity(model, item.landmarks.astype(np.float64))
    return rotation, shift[:2] - np.array([item.width, item.height]) / 2.0, -float(np.log(scale))


def similarity(model: np.ndarray, landmarks: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Rotation, scale and shift with found = scale rotation model + shift in least squares (Umeyama 1991).

    Args:
        model: [N, 3].
        landmarks: [N, 3], x right, y down, z forward.
    """
    a, b = model - model.mean(0), landmarks - landmarks.mean(0)
    u, values, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((values * sign).sum() / max((a * a).sum(), 1e-30))
    return rotation, scale, landmarks.mean(0) - scale * rotation @ model.mean(0)
