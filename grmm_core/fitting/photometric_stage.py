"""Refinement by what the pixels show beside landmarks: the outline of ears and cheeks, and the light.

After the landmark stage the outline of the mesh is matched with the end of the skin (`outline`), the matches are added to the
landmarks as terms of the same least squares, and both are solved again, a few times. The refinement is kept only where the
landmarks stay as near as they were and the shape changes little. Used by `track`; `pixel_stage` takes the same terms. Needs
numpy only.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..geometry.camera import Camera
from ..head.head_model import HeadModel
from .landmark_stage import LandmarkFit, finished, similarity, with_shape
from .outline import REGIONS, find_outline
from .point_rig import LandmarkRig, PointRig
from .solver import Term, solve

logger = logging.getLogger(__name__)

ROUNDS = 3
ROUND_ITERATIONS = 4
OUTLINE_SIGMA = 0.05  # eye distances
MIN_POINTS = 8
MAX_LANDMARK_LOSS = 0.004  # eye distances by which the mean landmark error may grow
MAX_SHAPE_CHANGE = 0.0015  # metres, mean over face and ears; outlines change a shape by half a millimetre, wrong ones by three


@dataclass(frozen=True)
class Appearance:
    """A photo's working picture.

    Attributes:
        image: Display sRGB 0..1, [H, W, 3].
        mask: The person, 0..1, [H, W].
        valid: 1 where the photo has pixels, [H, W].
        left, top: Its upper left corner in the photo, pixels.
        scale: Its pixels per photo pixel.
        others: What the photo shows beside skin of face and ears, 0..1, [H, W], or None.
    """

    image: np.ndarray
    mask: np.ndarray
    valid: np.ndarray
    left: float
    top: float
    scale: float
    others: np.ndarray | None = None

    def camera(self, camera: Camera) -> Camera:
        """The whole photo's camera for this picture."""
        return replace(
            camera, fx=camera.fx * self.scale, fy=camera.fy * self.scale, cx=(camera.cx - self.left) * self.scale,
            cy=(camera.cy - self.top) * self.scale, width=self.image.shape[1], height=self.image.shape[0],
        )  # fmt: skip


def refine(
    fit: LandmarkFit,
    pictures: Sequence[Appearance],
    rig: LandmarkRig,
    *,
    progress: Callable[[float], None] | None = None,
) -> LandmarkFit:
    """Refine a landmark fit by outlines.

    Args:
        fit: Result of the landmark stage.
        pictures: Working picture of each photo.
        rig: Landmarks of the head model.
        progress: Called with 0..1; may raise to cancel.

    Returns:
        The refined fit, or `fit` itself where the outlines contradict the landmarks, would change the shape beyond belief
        (hair of the skin's color), or none is seen.
    """
    result = fit
    for number in range(ROUNDS):
        if progress is not None:
            progress(number / ROUNDS)
        photos, count = [], 0
        for index, (photo, picture) in enumerate(zip(fit.problem.photos, pictures, strict=True)):
            found = outline_terms(result, index, picture, rig)
            count += sum(len(term.target) for term in found)
            photos.append(replace(photo, terms=(*fit.problem.photos[index].terms, *found)))
        if not count:
            return fit
        problem = replace(fit.problem, photos=tuple(photos))
        solution = solve(problem, result.solution, ROUND_ITERATIONS)
        result = finished(fit.problem, with_shape(problem, solution, ROUND_ITERATIONS), fit.units, rig)
    worse = max(after - before for before, after in zip(_errors(fit), _errors(result), strict=True))
    change = shape_change(rig.head, fit.shape, result.shape)
    logger.debug("outline: %d points, landmark error grows by %.4f eye distances, shape by %.4f m", count, worse, change)
    return result if worse <= MAX_LANDMARK_LOSS and change <= MAX_SHAPE_CHANGE else fit


def shape_change(head: HeadModel, before: np.ndarray, after: np.ndarray) -> float:
    """Mean distance in metres of face and ears of two shapes [S], but for rotation, shift and scale."""
    chosen = np.unique(np.concatenate([head.regions[name] for name in REGIONS]))
    first, second = (head.shaped(shape)[chosen].astype(np.float64) for shape in (before, after))
    rotation, scale, shift = similarity(second, first)
    return float(np.linalg.norm(scale * second @ rotation.T + shift - first, axis=1).mean())


def posed(fit: LandmarkFit, index: int, rig: LandmarkRig) -> np.ndarray:
    """Vertices of a photo's head in head space, metres, [V, 3]."""
    view, head = fit.views[index], rig.head
    return head.vertices(fit.shape, view.expression, head.pose_of(view.expression, view.pose))


def outline_terms(fit: LandmarkFit, index: int, picture: Appearance, rig: LandmarkRig) -> tuple[Term, ...]:
    """Where a photo shows the outline of the head as it is fitted, in pixels of the photo: a term, or none of too few points.

    Args:
        fit: The head.
        index: Of the photo.
        picture: Of the photo.
        rig: Landmarks of the head model.
    """
    unit, camera, vertices = fit.units[index], picture.camera(fit.cameras[index]), posed(fit, index, rig)
    shown = picture.image, picture.mask, picture.valid
    points = find_outline(rig.head, vertices, camera, *shown, unit * picture.scale, picture.others)
    if len(points.distance) < MIN_POINTS:
        return ()
    target = points.target / picture.scale + np.array([picture.left, picture.top])
    # hair over ears errs alike in all photos of a person: together they weigh as one
    sigma = np.full(len(target), OUTLINE_SIGMA * unit * len(fit.units) ** 0.5)
    return (Term(PointRig(rig.head, points.triangles, points.barycentric), target, sigma, points.normals),)


def _errors(fit: LandmarkFit) -> list[float]:
    """Mean landmark error of each photo in eye distances."""
    return [
        float(np.linalg.norm(landmarks - photo.terms[0].target, axis=1).mean() / unit)
        for landmarks, photo, unit in zip(fit.landmarks, fit.problem.photos, fit.units, strict=True)
    ]
