"""Robust least squares over the cameras, shape, expressions and joint angles of several photos of one person.

Levenberg-Marquardt on all unknowns together (arrow-shaped normal equations, built densely: a few hundred to a thousand
unknowns), with exact derivatives of `point_rig`, a Geman-McClure loss, Gaussian priors on every unknown and bounds on the
expression. The photos share the shape; camera, expression, jaw and eyes are each photo's own. Used by `landmark_stage` and
`photometric_stage`. Needs numpy only, float64.

The objective, with points l of the terms of photo n, projection pi, targets q and expected errors sigma in pixels:

    w |shape - m|^2 + sum_n [ sum_l rho(|pi_n(P_l(shape, e_n, pose_n)) + M_nl b_n - q_nl| / sigma_nl) + |b_n|^2
                        + priors of e_n, pose_n, focal length, distance ]

where w is 1 for photos that err independently, m is people's mean, and b are the strengths of the error modes M of the landmark
network: what it gets wrong, it gets wrong for many landmarks at once, and without them it would be taken for shape.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.camera import Camera
from ..head.head_model import JOINT_COUNT
from .landmark_priors import Priors, View
from .point_rig import PointRig

CAMERA_SIZE = 7  # rotation 3, offset 2, log magnification, log focal length
ROBUST_CUT = 3.0  # sigmas at which a point begins to count as wrong
TOLERANCE = 1e-4  # relative decrease of the objective that ends the iterations
FIRST_DAMPING, DAMPING_FACTOR, MIN_DAMPING, MAX_DAMPING = 1e-4, 8.0, 1e-9, 1e6
_MAX_FOCAL_STEP = 0.5  # of the logarithm
_MIN_DEPTH = 1e-3  # metres


@dataclass(frozen=True)
class Term:
    """Points of the head that should project somewhere.

    Attributes:
        rig: N points.
        target: Where to, pixels, [N, 2].
        sigma: Expected error, pixels, [N].
        normals: Unit directions [N, 2] along which alone the distance counts (outlines slide), or None for both axes.
        modes: Pixels that a unit of each error mode moves the projections by before they are compared, [N, 2, K], or None.
    """

    rig: PointRig
    target: np.ndarray
    sigma: np.ndarray
    normals: np.ndarray | None = None
    modes: np.ndarray | None = None


@dataclass(frozen=True)
class PhotoProblem:
    """What is known of one photo.

    Attributes:
        width, height: Pixels.
        priors: Of its unknowns.
        terms: What its unknowns are to explain, landmarks first.
        seen: Landmarks that camera, pose and expression are to explain in place of the first term once the shape is known;
            None where it is known from the start.
        seen_priors: Likewise in place of `priors`.
    """

    width: int
    height: int
    priors: Priors
    terms: tuple[Term, ...]
    seen: Term | None = None
    seen_priors: Priors | None = None


@dataclass(frozen=True)
class Problem:
    """All photos of a person.

    Attributes:
        photos: At least one.
        center: The point of head space that `View.offset` projects, metres, [3].
        shape_count, expression_count, noise_count: S, E and K.
        shape_weight: Of the shape's prior, w of the module: photos that err alike count as fewer than they are.
        shape_mean: People's mean, m of the module, [S], or 0.
    """

    photos: tuple[PhotoProblem, ...]
    center: np.ndarray
    shape_count: int
    expression_count: int
    noise_count: int
    shape_weight: float = 1.0
    shape_mean: np.ndarray | float = 0.0


@dataclass(frozen=True)
class Solution:
    """Values of all unknowns.

    Attributes:
        shape: Shared shape coefficients, [S].
        views: One for each photo.
        objective: See the module.
        iterations: Steps taken.
    """

    shape: np.ndarray
    views: tuple[View, ...]
    objective: float = float("inf")
    iterations: int = 0


def solve(
    problem: Problem,
    start: Solution,
    limit: int,
    *,
    cameras_only: bool = False,
    shape_held: bool = False,
    progress: Callable[[float], None] | None = None,
) -> Solution:
    """Minimise the objective from `start`, in at most `limit` steps.

    Bounds are kept by freezing: unknowns that press against one are left out of a step.

    Args:
        problem: What is to be explained.
        start: Where to begin.
        limit: Largest number of steps.
        cameras_only: Leave shape, expression and angles as they are.
        shape_held: Leave the shape as it is.
        progress: Called with 0..1; may raise to cancel.
    """
    damping = FIRST_DAMPING
    shape, views = start.shape, start.views
    objective = evaluate(problem, shape, views)
    iteration = 0
    for iteration in range(1, limit + 1):
        if progress is not None:
            progress((iteration - 1) / limit)
        matrix, gradient = _normal_equations(problem, shape, views, cameras_only)
        blocked = np.zeros(len(gradient), bool) if cameras_only else _blocked(problem, views, gradient)
        if shape_held and not cameras_only:
            blocked[: problem.shape_count] = True
        free = np.flatnonzero(~blocked)
        gain = 0.0
        while damping < MAX_DAMPING:
            damped = matrix[np.ix_(free, free)]
            damped[np.diag_indices(len(free))] *= 1.0 + damping
            step = np.zeros(len(gradient))
            step[free] = -np.linalg.solve(damped, gradient[free])
            new_shape, new_views = _moved(problem, shape, views, step, cameras_only)
            value = evaluate(problem, new_shape, new_views)
            if value < objective:
                gain = objective - value
                shape, views, objective = new_shape, new_views, value
                break
            damping *= DAMPING_FACTOR
        damping = max(damping / DAMPING_FACTOR, MIN_DAMPING)
        if gain <= TOLERANCE * objective:
            break
    return Solution(shape, views, objective, iteration)


def evaluate(problem: Problem, shape: np.ndarray, views: tuple[View, ...]) -> float:
    """The objective; twice the gradient of `_normal_equations` is its gradient."""
    total = problem.shape_weight * float(((shape - problem.shape_mean) ** 2).sum())
    for photo, view in zip(problem.photos, views, strict=True):
        total += photo.priors.value(view) + float((view.noise**2).sum())
        for term in photo.terms:
            points = term.rig.positions(shape, view.expression, view.pose)
            delta = project(problem, photo, view, points) - term.target
            if term.modes is not None:
                delta = delta + term.modes @ view.noise
            squared = (delta**2).sum(1) if term.normals is None else (delta * term.normals).sum(1) ** 2
            squared = squared / term.sigma**2
            total += float((squared / (1.0 + squared / ROBUST_CUT**2)).sum())
    return total


def project(problem: Problem, photo: PhotoProblem, view: View, points: np.ndarray) -> np.ndarray:
    """Pixels of points in head space [N, 3]: [N, 2]; what lies behind the camera goes far away."""
    local = (points - problem.center) @ view.rotation.T + _shift(view)
    return np.exp(view.focal) * local[:, :2] / np.maximum(local[:, 2:], _MIN_DEPTH) + _middle(photo)


def camera_of(problem: Problem, photo: PhotoProblem, view: View) -> Camera:
    """Camera of the whole photo in head space."""
    matrix = np.eye(4)
    matrix[:3, :3] = view.rotation
    matrix[:3, 3] = _shift(view) - view.rotation @ problem.center
    focal = float(np.exp(view.focal))
    return Camera(matrix, focal, focal, photo.width / 2.0, photo.height / 2.0, photo.width, photo.height)


def _shift(view: View) -> np.ndarray:
    """Camera coordinates of the face's centre, metres, [3]."""
    metres_per_pixel = np.exp(view.magnification)
    return np.array([*(view.offset * metres_per_pixel), metres_per_pixel * np.exp(view.focal)])


def _middle(photo: PhotoProblem) -> np.ndarray:
    return np.array([photo.width, photo.height]) / 2.0


def _view_size(problem: Problem, cameras_only: bool) -> int:
    return CAMERA_SIZE if cameras_only else CAMERA_SIZE + problem.expression_count + JOINT_COUNT * 3 + problem.noise_count


def _normal_equations(
    problem: Problem, shape: np.ndarray, views: tuple[View, ...], cameras_only: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Gauss-Newton matrix and half gradient of [shape, view, view ...]."""
    shared = 0 if cameras_only else problem.shape_count
    size = _view_size(problem, cameras_only)
    matrix = np.zeros((shared + size * len(views), shared + size * len(views)))
    gradient = np.zeros(len(matrix))
    matrix[np.arange(shared), np.arange(shared)] = problem.shape_weight
    if shared:
        gradient[:shared] = problem.shape_weight * (shape - problem.shape_mean)
    for index, (photo, view) in enumerate(zip(problem.photos, views, strict=True)):
        own = slice(shared + index * size, shared + (index + 1) * size)
        for term in photo.terms:
            residuals, derivative = _residuals(problem, photo, term, shape, view, cameras_only)
            product, moment = derivative.T @ derivative, derivative.T @ residuals
            matrix[:shared, :shared] += product[:shared, :shared]
            matrix[:shared, own] += product[:shared, shared:]
            matrix[own, :shared] += product[shared:, :shared]
            matrix[own, own] += product[shared:, shared:]
            gradient[:shared] += moment[:shared]
            gradient[own] += moment[shared:]
        prior_matrix, prior_gradient = photo.priors.quadratic(view)
        known = min(size, len(prior_gradient))
        before = slice(own.start, own.start + known)
        matrix[before, before] += prior_matrix[:known, :known]
        gradient[before] += prior_gradient[:known]
        noise = np.arange(before.stop, own.stop)  # none where only cameras are solved for
        matrix[noise, noise] += 1.0
        gradient[noise] += view.noise[: len(noise)]
    return matrix, gradient


def _residuals(
    problem: Problem, photo: PhotoProblem, term: Term, shape: np.ndarray, view: View, cameras_only: bool
) -> tuple[np.ndarray, np.ndarray]:
    """Weighted residuals [R] of a term and their derivatives by [shape, camera, expression, angles, noise] or the camera."""
    if cameras_only:
        points = term.rig.positions(shape, view.expression, view.pose)
        parts: list[np.ndarray] = []
    else:
        points, *parts = term.rig.linearise(shape, view.expression, view.pose)
        parts[2] = parts[2].reshape(len(points), 3, -1)
    metres_per_pixel, focal, shift = np.exp(view.magnification), np.exp(view.focal), _shift(view)
    turned = (points - problem.center) @ view.rotation.T  # [N, 3]
    local = turned + shift
    z = np.maximum(local[:, 2], _MIN_DEPTH)
    ray = local[:, :2] / z[:, None]
    delta = focal * ray + _middle(photo) - term.target  # [N, 2]
    modes = np.zeros((len(points), 2, problem.noise_count)) if term.modes is None else term.modes
    delta = delta + modes @ view.noise
    pixel = np.zeros((len(points), 2, 3))  # pixels by camera coordinates
    pixel[:, 0, 0] = pixel[:, 1, 1] = focal / z
    pixel[:, :, 2] = -focal * ray / z[:, None]
    by_camera = np.zeros((len(points), 2, CAMERA_SIZE))
    for axis in range(3):
        by_camera[:, :, axis] = np.einsum("nij,nj->ni", pixel, np.cross(np.eye(3)[axis], turned))
    by_camera[:, :, 3:5] = pixel[:, :, :2] * metres_per_pixel
    by_camera[:, :, 5] = pixel @ shift
    by_camera[:, :, 6] = focal * ray + pixel[:, :, 2] * shift[2]
    if term.normals is not None:  # along the normals only: one residual for each point
        pixel, by_camera, modes = (np.einsum("ni,nij->nj", term.normals, a)[:, None] for a in (pixel, by_camera, modes))
        delta = (delta * term.normals).sum(1, keepdims=True)
    distance = np.linalg.norm(delta, axis=1) / term.sigma
    weight = 1.0 / (term.sigma * (1.0 + (distance / ROBUST_CUT) ** 2))  # square root of Geman-McClure's weight
    columns = [by_camera]
    if not cameras_only:
        turned_pixel = pixel @ view.rotation
        columns = [turned_pixel @ parts[0], by_camera, turned_pixel @ parts[1], turned_pixel @ parts[2], modes]
    derivative = np.concatenate(columns, axis=2) * weight[:, None, None]
    return (delta * weight[:, None]).reshape(-1), derivative.reshape(delta.size, -1)


def _moved(
    problem: Problem, shape: np.ndarray, views: tuple[View, ...], step: np.ndarray, cameras_only: bool
) -> tuple[np.ndarray, tuple[View, ...]]:
    """Apply a step; expressions are kept inside their bounds."""
    shared = 0 if cameras_only else problem.shape_count
    size = _view_size(problem, cameras_only)
    result = []
    for index, (photo, view) in enumerate(zip(problem.photos, views, strict=True)):
        own = step[shared + index * size : shared + (index + 1) * size]
        moved = replace(
            view,
            rotation=rotation_of(own[:3]) @ view.rotation,
            offset=view.offset + own[3:5],
            magnification=view.magnification + float(own[5]),
            focal=view.focal + float(np.clip(own[6], -_MAX_FOCAL_STEP, _MAX_FOCAL_STEP)),
        )
        if not cameras_only:
            angles = CAMERA_SIZE + problem.expression_count
            expression = view.expression + own[CAMERA_SIZE:angles]
            moved.expression = np.clip(expression, photo.priors.expression_low, photo.priors.expression_high)
            moved.pose = view.pose + own[angles : angles + JOINT_COUNT * 3].reshape(JOINT_COUNT, 3)
            moved.noise = view.noise + own[angles + JOINT_COUNT * 3 :]
        result.append(moved)
    return (shape + step[:shared] if shared else shape), tuple(result)


def _blocked(problem: Problem, views: tuple[View, ...], gradient: np.ndarray) -> np.ndarray:
    """Which unknowns sit at a bound and would go beyond it, and those that have no freedom at all."""
    size = _view_size(problem, False)
    result = np.zeros(len(gradient), bool)
    for index, (photo, view) in enumerate(zip(problem.photos, views, strict=True)):
        start = problem.shape_count + index * size + CAMERA_SIZE
        own = slice(start, start + problem.expression_count)
        low = (view.expression <= photo.priors.expression_low) & (gradient[own] > 0)
        high = (view.expression >= photo.priors.expression_high) & (gradient[own] < 0)
        result[own] = low | high
        result[own.stop : own.stop + JOINT_COUNT * 3] = photo.priors.pose_sigma.reshape(-1) <= 0.0
    return result


def rotation_of(vector: np.ndarray) -> np.ndarray:
    """Rodrigues' formula: the rotation by |vector| radians about it, [3, 3]."""
    angle = float(np.linalg.norm(vector))
    if angle < 1e-12:
        return np.eye(3)
    x, y, z = vector / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
