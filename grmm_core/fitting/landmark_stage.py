"""Robust fit of camera, shape, expression and pose to the landmarks of one or several photos of a person.

Levenberg-Marquardt on all unknowns together (arrow-shaped normal equations, built densely: a few hundred to a thousand
unknowns), with exact derivatives of `landmark_rig`, a Geman-McClure loss on each landmark's distance, Gaussian priors on every
unknown and bounds on the expression. The photos share the shape; camera, expression, jaw and eyes are each photo's own. The
neck stays at rest: where the head is turned to is in the camera. Used by `track`. Needs numpy only, float64.

The maximum a posteriori problem, with landmarks l of photo n, projection pi and distances in units of the eye distance:

    sum_n sum_l rho(|pi_n(L_l(shape, e_n, pose_n)) - found_nl| / sigma_l) + |shape|^2
        + priors of e_n, pose_n, focal length and distance
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..camera import Camera
from ..errors import ShapeError
from ..head.model import JOINT_COUNT
from .landmark_priors import Priors, landmark_sigmas, make_priors
from .landmark_rig import LandmarkRig
from .types import LANDMARK_COUNT

logger = logging.getLogger(__name__)

CAMERA_SIZE = 7  # rotation 3, offset 2, log magnification, log focal length
ROBUST_CUT = 3.0  # sigmas at which a landmark begins to count as wrong
MAX_ITERATIONS = 30
TOLERANCE = 1e-5  # relative decrease of the objective that ends the iterations
FIRST_DAMPING, DAMPING_FACTOR, MAX_DAMPING = 1e-4, 8.0, 1e6
_EYE_CORNERS = (33, 263)


@dataclass(frozen=True)
class Observation:
    """What was found in one photo.

    Attributes:
        landmarks: x, y in pixels of the photo and relative depth in the same unit (smaller is nearer), [478, 3].
        arkit: Reported coefficients of the 52 ARKit shapes, [52].
        width, height: Size of the photo in pixels.
        focal: Focal length in pixels that the file states, or None.
    """

    landmarks: np.ndarray
    arkit: np.ndarray
    width: int
    height: int
    focal: float | None = None


@dataclass
class View:
    """The unknowns of one photo.

    Attributes:
        rotation: Head to camera, [3, 3].
        offset: Projection of the face's centre from the picture's centre, pixels, [2].
        magnification: Logarithm of depth over focal length (metres per pixel).
        focal: Logarithm of the focal length in pixels.
        expression: [E].
        pose: Control angles in radians, [5, 3].
    """

    rotation: np.ndarray
    offset: np.ndarray
    magnification: float
    focal: float
    expression: np.ndarray
    pose: np.ndarray


@dataclass(frozen=True)
class LandmarkFit:
    """Result of the stage.

    Attributes:
        shape: Shared shape coefficients, [S].
        views: One for each photo.
        cameras: Camera of each whole photo in head space.
        landmarks: The head's landmarks in each photo, pixels, [478, 2] each.
        objective: Final value.
        iterations: Steps taken.
    """

    shape: np.ndarray
    views: tuple[View, ...]
    cameras: tuple[Camera, ...]
    landmarks: tuple[np.ndarray, ...]
    objective: float
    iterations: int


@dataclass
class _Problem:
    """Everything that does not change while solving."""

    rig: LandmarkRig
    observations: tuple[Observation, ...]
    priors: tuple[Priors, ...]
    units: tuple[float, ...]  # eye distance of each photo in pixels, were it seen from the front
    center: np.ndarray  # [3] head space: the point that `View.offset` projects
    shape_sigma: np.ndarray  # [S]
    sigmas: list[np.ndarray] = field(default_factory=list)  # [478] each, in eye distances


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
    problem, views = _start(tuple(observations), rig)
    shape = np.zeros(rig.shape_count)
    # cameras alone first: far from the solution the shape would bend to a wrong rotation
    shape, views, _, _ = _solve(problem, shape, views, None, 8, cameras_only=True)
    problem.sigmas = [landmark_sigmas(rig, view.rotation) for view in views]
    shape, views, objective, iterations = _solve(problem, shape, views, progress, MAX_ITERATIONS, cameras_only=False)
    cameras = tuple(_camera(problem, i, view) for i, view in enumerate(views))
    landmarks = tuple(
        _projected(problem, i, view, rig.positions(shape, view.expression, view.pose)) for i, view in enumerate(views)
    )
    logger.debug("landmark stage: %d iterations, objective %.1f", iterations, objective)
    return LandmarkFit(shape, tuple(views), cameras, landmarks, objective, iterations)


def _start(observations: tuple[Observation, ...], rig: LandmarkRig) -> tuple[_Problem, list[View]]:
    """Cameras from the similarity between found landmarks (with their relative depth) and the mean head's."""
    mean = rig.positions(np.zeros(rig.shape_count), np.zeros(rig.expression_count), np.zeros((JOINT_COUNT, 3)))
    center = mean.mean(0)
    eye_distance = float(np.linalg.norm(mean[_EYE_CORNERS[1]] - mean[_EYE_CORNERS[0]]))
    priors, units, views = [], [], []
    for item in observations:
        prior = make_priors(rig.head, item.arkit, item.focal, item.width, item.height)
        model = rig.positions(np.zeros(rig.shape_count), prior.expression_mean, prior.pose_mean)
        rotation, scale, shift = _similarity(model - center, item.landmarks.astype(np.float64))
        # depth over focal length is 1 / scale; the prior of distance and focal length splits the product
        focal = prior.log_focal(-np.log(scale))
        offset = shift[:2] - np.array([item.width, item.height]) / 2.0
        views.append(View(rotation, offset, -float(np.log(scale)), focal, prior.expression_mean.copy(), prior.pose_mean.copy()))
        priors.append(prior)
        units.append(scale * eye_distance)
    sigmas = [landmark_sigmas(rig, view.rotation) for view in views]
    problem = _Problem(rig, observations, tuple(priors), tuple(units), center, np.ones(rig.shape_count), sigmas)
    return problem, views


def _similarity(model: np.ndarray, found: np.ndarray) -> tuple[np.ndarray, float, np.ndarray]:
    """Rotation, scale and shift with found = scale rotation model + shift in least squares (Umeyama 1991), x right, y down."""
    a, b = model - model.mean(0), found - found.mean(0)
    u, values, vt = np.linalg.svd(b.T @ a)
    sign = np.array([1.0, 1.0, np.sign(np.linalg.det(u @ vt))])
    rotation = (u * sign) @ vt
    scale = float((values * sign).sum() / (a * a).sum())
    return rotation, scale, found.mean(0) - scale * rotation @ model.mean(0)


def _solve(
    problem: _Problem,
    shape: np.ndarray,
    views: list[View],
    progress: Callable[[float], None] | None,
    limit: int,
    cameras_only: bool,
) -> tuple[np.ndarray, list[View], float, int]:
    """Levenberg-Marquardt with bounds by freezing: unknowns that press against a bound are left out of a step."""
    damping = FIRST_DAMPING
    objective = _objective(problem, shape, views)
    iteration = 0
    for iteration in range(1, limit + 1):
        if progress is not None:
            progress((iteration - 1) / limit)
        matrix, gradient = _normal_equations(problem, shape, views, cameras_only)
        blocked = np.zeros(len(gradient), bool) if cameras_only else _blocked(problem, views, gradient)
        free = np.flatnonzero(~blocked)
        improved = False
        while damping < MAX_DAMPING:
            damped = matrix[np.ix_(free, free)]
            damped[np.diag_indices(len(free))] *= 1.0 + damping
            step = np.zeros(len(gradient))
            step[free] = -np.linalg.solve(damped, gradient[free])
            new_shape, new_views = _moved(problem, shape, views, step, cameras_only)
            value = _objective(problem, new_shape, new_views)
            if value < objective:
                improved = True
                break
            damping *= DAMPING_FACTOR
        if not improved:
            break
        gain, objective = objective - value, value
        shape, views = new_shape, new_views
        damping = max(damping / DAMPING_FACTOR, 1e-9)
        if gain < TOLERANCE * max(objective, 1e-12):
            break
    return shape, views, objective, iteration


def _view_size(problem: _Problem, cameras_only: bool) -> int:
    return CAMERA_SIZE if cameras_only else CAMERA_SIZE + problem.rig.expression_count + JOINT_COUNT * 3


def _normal_equations(
    problem: _Problem, shape: np.ndarray, views: list[View], cameras_only: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton matrix and gradient (half of the objective's) of shape and all views."""
    shared = 0 if cameras_only else problem.rig.shape_count
    size = _view_size(problem, cameras_only)
    matrix = np.zeros((shared + size * len(views), shared + size * len(views)))
    gradient = np.zeros(len(matrix))
    if shared:
        matrix[np.arange(shared), np.arange(shared)] = 1.0 / problem.shape_sigma**2
        gradient[:shared] = shape / problem.shape_sigma**2
    for index, view in enumerate(views):
        residuals, derivative = _residuals(problem, index, shape, view, cameras_only)
        own = slice(shared + index * size, shared + (index + 1) * size)
        product = derivative.T @ derivative
        matrix[:shared, :shared] += product[:shared, :shared]
        matrix[:shared, own] = product[:shared, shared:]
        matrix[own, :shared] = product[shared:, :shared]
        matrix[own, own] = product[shared:, shared:]
        moment = derivative.T @ residuals
        gradient[:shared] += moment[:shared]
        gradient[own] = moment[shared:]
        prior_matrix, prior_gradient = problem.priors[index].quadratic(view)
        matrix[own, own] += prior_matrix[:size, :size]
        gradient[own] += prior_gradient[:size]
    return matrix, gradient


def _residuals(
    problem: _Problem, index: int, shape: np.ndarray, view: View, cameras_only: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted residuals [478 * 2] of a photo and their derivatives by [shape, camera, expression, angles] or the camera."""
    rig = problem.rig
    scale = 1.0 / (problem.sigmas[index] * problem.units[index])  # [478] per pixel
    if cameras_only:
        points = rig.positions(shape, view.expression, view.pose)
        parts: list[np.ndarray] = []
    else:
        points, by_shape, by_expression, by_angle = rig.linearise(shape, view.expression, view.pose)
        parts = [by_shape, by_expression, by_angle.reshape(LANDMARK_COUNT, 3, -1)]
    turned = (points - problem.center) @ view.rotation.T  # [478, 3]
    depth_per_pixel, focal = np.exp(view.magnification), np.exp(view.focal)
    local = turned + np.array([*(view.offset * depth_per_pixel), depth_per_pixel * focal])
    z = local[:, 2]
    ray = local[:, :2] / z[:, None]
    delta = focal * ray + _middle(problem, index) - problem.observations[index].landmarks[:, :2]  # [478, 2]
    weight = scale * _robust_weight(np.linalg.norm(delta, axis=1) * scale)  # square roots of the weights
    # pixels by camera coordinates, [478, 2, 3]
    pixel = np.zeros((LANDMARK_COUNT, 2, 3))
    pixel[:, 0, 0] = pixel[:, 1, 1] = focal / z
    pixel[:, :, 2] = -focal * ray / z[:, None]
    by_camera = np.zeros((LANDMARK_COUNT, 2, CAMERA_SIZE))
    for axis in range(3):
        by_camera[:, :, axis] = np.einsum("lij,lj->li", pixel, np.cross(np.eye(3)[axis], turned))
    by_camera[:, :, 3:5] = pixel[:, :, :2] * depth_per_pixel
    by_camera[:, :, 5] = pixel @ np.array([*(view.offset * depth_per_pixel), depth_per_pixel * focal])
    by_camera[:, :, 6] = focal * ray + pixel[:, :, 2] * depth_per_pixel * focal
    turned_pixel = pixel @ view.rotation  # [478, 2, 3]
    columns = [by_camera] if cameras_only else [
        turned_pixel @ parts[0], by_camera, turned_pixel @ parts[1], turned_pixel @ parts[2],
    ]  # fmt: skip
    derivative = np.concatenate(columns, axis=2) * weight[:, None, None]
    return (delta * weight[:, None]).reshape(-1), derivative.reshape(2 * LANDMARK_COUNT, -1)


def _robust_weight(distance: np.ndarray) -> np.ndarray:
    """Square root of the Geman-McClure weight for distances in sigmas."""
    return 1.0 / (1.0 + (distance / ROBUST_CUT) ** 2)


def _objective(problem: _Problem, shape: np.ndarray, views: list[View]) -> float:
    """Robust landmark terms plus priors; its half gradient is `_normal_equations`'."""
    total = float(((shape / problem.shape_sigma) ** 2).sum())
    for index, view in enumerate(views):
        points = problem.rig.positions(shape, view.expression, view.pose)
        delta = _projected(problem, index, view, points) - problem.observations[index].landmarks[:, :2]
        squared = (delta**2).sum(1) / (problem.sigmas[index] * problem.units[index]) ** 2
        total += float((squared / (1.0 + squared / ROBUST_CUT**2)).sum()) + problem.priors[index].value(view)
    return total


def _projected(problem: _Problem, index: int, view: View, points: np.ndarray) -> np.ndarray:
    """Pixels of points in head space, [N, 2]; behind the camera they go far away."""
    depth_per_pixel, focal = np.exp(view.magnification), np.exp(view.focal)
    local = (points - problem.center) @ view.rotation.T
    local = local + np.array([*(view.offset * depth_per_pixel), depth_per_pixel * focal])
    return focal * local[:, :2] / np.maximum(local[:, 2:], 1e-3) + _middle(problem, index)


def _middle(problem: _Problem, index: int) -> np.ndarray:
    item = problem.observations[index]
    return np.array([item.width, item.height]) / 2.0


def _moved(
    problem: _Problem, shape: np.ndarray, views: list[View], step: np.ndarray, cameras_only: bool
) -> tuple[np.ndarray, list[View]]:
    """Apply a step; expressions and angles are kept inside their bounds."""
    shared = 0 if cameras_only else problem.rig.shape_count
    size = _view_size(problem, cameras_only)
    result = []
    for index, view in enumerate(views):
        own = step[shared + index * size : shared + (index + 1) * size]
        prior = problem.priors[index]
        changes = {
            "rotation": _rotation(own[:3]) @ view.rotation,
            "offset": view.offset + own[3:5],
            "magnification": view.magnification + float(own[5]),
            "focal": view.focal + float(np.clip(own[6], -0.5, 0.5)),
        }
        if not cameras_only:
            count = problem.rig.expression_count
            moved = view.expression + own[CAMERA_SIZE : CAMERA_SIZE + count]
            changes["expression"] = np.clip(moved, prior.expression_low, prior.expression_high)
            changes["pose"] = view.pose + own[CAMERA_SIZE + count :].reshape(JOINT_COUNT, 3)
        result.append(replace(view, **changes))
    return shape + step[:shared] if shared else shape, result


def _blocked(problem: _Problem, views: list[View], gradient: np.ndarray) -> np.ndarray:
    """Which unknowns sit at a bound and would go beyond it, and those that have no freedom at all."""
    shared, size = problem.rig.shape_count, _view_size(problem, False)
    result = np.zeros(len(gradient), bool)
    for index, view in enumerate(views):
        prior = problem.priors[index]
        start = shared + index * size + CAMERA_SIZE
        own = slice(start, start + problem.rig.expression_count)
        low = (view.expression <= prior.expression_low) & (gradient[own] > 0)
        high = (view.expression >= prior.expression_high) & (gradient[own] < 0)
        result[own] = low | high
        angles = slice(own.stop, own.stop + JOINT_COUNT * 3)
        result[angles] = prior.pose_sigma.reshape(-1) <= 0.0
    return result


def _rotation(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: rotation by |vector| radians about it, [3, 3]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def _camera(problem: _Problem, index: int, view: View) -> Camera:
    """Camera of the whole photo in head space."""
    item = problem.observations[index]
    depth_per_pixel, focal = float(np.exp(view.magnification)), float(np.exp(view.focal))
    matrix = np.eye(4)
    matrix[:3, :3] = view.rotation
    shift = np.array([*(view.offset * depth_per_pixel), depth_per_pixel * focal])
    matrix[:3, 3] = shift - view.rotation @ problem.center
    return Camera(matrix, focal, focal, item.width / 2.0, item.height / 2.0, item.width, item.height)
