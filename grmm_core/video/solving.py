"""Expression and head pose of each frame: the landmark stage's least squares, one frame after the other.

Of a person whose shape is known, only the weights of the ARKit shapes and the pose are unknown, and each frame begins where the
last one ended, so that two steps are enough. Different from photos: the network's errors are the person's and stay, so that no
error modes are free in each frame (they took away a tenth of the movement of the mouth); blinks are believed as they are
reported, since lids move less in landmarks than they do (they closed by two thirds); jaw and eyes move by their shapes, which
animators have sliders for. Needs numpy only, float64.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..controls.names import ARKIT_NAMES
from ..fitting.landmark_priors import Priors, View, landmark_sigmas, make_priors
from ..fitting.landmark_stage import Observation, seen_pose
from ..fitting.point_rig import LandmarkRig
from ..fitting.solver import PhotoProblem, Problem, Solution, Term, project, solve
from ..head import arkit_gain
from ..head.head_model import JOINT_COUNT
from ..jobs.progress import Share
from ..photo.landmarks import EYE_CORNERS
from .actor import Actor, observation, roll_of
from .following import Followed

STEPS = 2
FIRST_STEPS = 10  # where no frame before says where to begin
_FOCAL_SIGMA = 1e-4  # of the logarithm: it is the camera's
_BLINK, _BLINK_SIGMA = 1.0, 0.04  # share of what is reported, and how far it is believed
_BROW_SIGMA = 0.4  # reported brows move by less than two thirds of what landmarks do
_TO_HEAD = np.diag([1.0, -1.0, -1.0])  # a camera's axes (y down, z forward) to the axes of a head that looks into it


@dataclass(frozen=True)
class Motion:
    """What a face does.

    Attributes:
        weights: Of the ARKit shapes, 0..1, [T, 52]; zeros where the face is not seen.
        rotation: Of the head against one that looks into the camera, upright, [T, 3, 3]; ones on the diagonal likewise.
        error: Distance of landmarks from the head's, mean of each frame in distances of the outer eye corners, [T]; NaN where
            the face is not seen.
    """

    weights: np.ndarray
    rotation: np.ndarray
    error: np.ndarray


def solve_frames(followed: Followed, actor: Actor, rig: LandmarkRig, progress: Share | None = None) -> Motion:
    """Solve for the weights and the pose of each frame.

    Args:
        followed: The face.
        actor: The person.
        rig: Landmarks of the head model, whose first components of expression are the ARKit shapes.
        progress: Called with the share done; may raise to cancel.
    """
    person = rig.of_person(actor.shape, arkit_gain(rig.head, actor.shape))
    rest = person.positions(np.zeros(0), np.zeros(len(ARKIT_NAMES)), np.zeros((JOINT_COUNT, 3)))
    center, eyes = rest.mean(0), float(np.linalg.norm(np.subtract(*rest[list(EYE_CORNERS)])))
    count = len(followed.times)
    weights, rotation = np.zeros((count, len(ARKIT_NAMES))), np.tile(np.eye(3), (count, 1, 1))
    error = np.full(count, np.nan)
    view: View | None = None
    for index in range(count):
        if progress is not None:
            progress(index / count)
        if not followed.seen[index]:
            view = None
            continue
        item = observation(followed, index)
        priors = _priors(person, item, actor.focal)
        begin = view is None
        if view is None:
            turned, offset, magnification = seen_pose(rest - center, item)
            expression = priors.expression_mean.clip(0.0, 1.0)
            view = View(turned, offset, magnification, float(np.log(actor.focal)), expression, priors.pose_mean, np.zeros(0))
        unit = eyes * np.exp(-view.magnification)  # pixels
        target = item.landmarks[:, :2] - actor.offsets @ roll_of(view.rotation) * unit
        sigma = landmark_sigmas(person, view.rotation) * unit
        photo = PhotoProblem(item.width, item.height, priors, (Term(person, target, sigma),))
        problem = Problem((photo,), center, 0, person.expression_count, 0)
        solution = Solution(np.zeros(0), (view,))
        if begin:
            solution = solve(problem, solution, FIRST_STEPS, cameras_only=True)
        view = solve(problem, solution, FIRST_STEPS if begin else STEPS).views[0]
        weights[index], rotation[index] = view.expression, _TO_HEAD @ view.rotation
        found = project(problem, photo, view, person.positions(np.zeros(0), view.expression, view.pose))
        error[index] = np.linalg.norm(found - target, axis=1).mean() / unit
    return Motion(weights, rotation, error)


def _priors(person: LandmarkRig, item: Observation, focal: float) -> Priors:
    """What is likely in a frame: the photos' priors, with jaw and eyes at rest and lids and brows as the module says."""
    priors = make_priors(person.head, item.arkit, focal, item.width, item.height)
    known = slice(len(ARKIT_NAMES))
    mean, sigma = priors.expression_mean[known].copy(), priors.expression_sigma[known].copy()
    blink = np.array([name.startswith("eyeBlink") for name in ARKIT_NAMES])
    mean[blink], sigma[blink] = _BLINK * np.clip(item.arkit[blink], 0.0, 1.0), _BLINK_SIGMA
    sigma[[name.startswith("brow") for name in ARKIT_NAMES]] = _BROW_SIGMA
    still = np.zeros((JOINT_COUNT, 3))
    return replace(
        priors, expression_mean=mean, expression_sigma=sigma, expression_low=np.zeros(len(mean)),
        expression_high=np.ones(len(mean)), pose_mean=still, pose_sigma=still, focal_sigma=_FOCAL_SIGMA,
    )  # fmt: skip
