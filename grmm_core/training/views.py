"""Training views, and which one is used when.

A `ViewSource` hides how a data set stores its pictures; `capture.CapturedViews` adapts `data.CaptureDataset`. Every random
choice of a step is drawn from a generator seeded by (seed, step, place in the step): nothing needs to be saved to resume a
run, and several processes choose as one would.

Used by `trainer`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from ..geometry.camera import Camera
from .config import TrainConfig

_MULTIPLE = 16


@dataclass(frozen=True)
class View:
    """One picture of one person.

    Attributes:
        subject: Index of the person.
        name: For messages and sheets.
        camera: In head space.
        image: Display sRGB premultiplied over black, [H, W, 3] uint8.
        mask: Coverage, [H, W] uint8.
        depth: Camera z in metres, 0 where empty, [H, W] float32, or None.
        aligned: Weights of the aligned expressions, [60].
        expression: Head-model coefficients, [E].
        pose: XYZ Euler angles of the five joints, radians, all parts included, [5, 3].
        split: What the view is for, in the words of the data set.
        displacement: What was added to the posed vertices of the mesh model, metres, [V, 3], or None where it is not known.
        depths: Smallest and largest depth of the whole picture, metres: what the refinement network's depth is scaled by when
            only a part of the picture is drawn, as it is in use. None where it is not known.
        detail: Coverage by eyes, teeth and inner mouth and a few pixels around, [H, W] uint8, or None where it is not known.
    """

    subject: int
    name: str
    camera: Camera
    image: np.ndarray
    mask: np.ndarray
    depth: np.ndarray | None
    aligned: np.ndarray
    expression: np.ndarray
    pose: np.ndarray
    split: str = ""
    displacement: np.ndarray | None = None
    depths: tuple[float, float] | None = None
    detail: np.ndarray | None = None


class ViewSource(Protocol):
    """Pictures of people with known parameters.

    Attributes:
        people: Names, [P].
        shapes: Shape coefficients, [P, S] float32.
        subjects: Person of each view, index into `people`.
        training, validation: Numbers of the views to train on and to judge by.
    """

    people: tuple[str, ...]
    shapes: np.ndarray
    subjects: np.ndarray
    training: np.ndarray
    validation: np.ndarray

    def load(self, index: int) -> View:
        """Return a view. Raises `FileFormatError` naming a picture that cannot be used."""
        ...


def choose(config: TrainConfig, source: ViewSource, step: int, place: int, progress: float) -> tuple[View, np.ndarray]:
    """Choose view, crop and background of one place in a step.

    Args:
        config: Run.
        source: Data.
        step: Optimiser step, from 0.
        place: 0 .. views_per_step - 1.
        progress: 0..1.

    Returns:
        The view at the size to be rendered, and the background color, [3] float32.
    """
    epoch, position = divmod(step * config.views_per_step + place, len(source.training))
    order = np.random.default_rng((config.seed, 1, epoch)).permutation(len(source.training))  # every view once an epoch
    view = source.load(int(source.training[order[position]]))
    rng = np.random.default_rng((config.seed, 2, step, place))
    size = config.image_size or max(view.image.shape[:2])
    if progress < config.half_until:
        size = (size + 1) // 2
    view = _with_depths(crop_to_person(shrink(view, size), config.margin))
    cropped = config.crop_size > 0 and rng.random() < config.crop_share
    if cropped:
        view = random_crop(view, config.crop_size, rng)
    return view, rng.random(3).astype(np.float32)


def _with_depths(view: View) -> View:
    covered = view.depth[view.depth > 0] if view.depth is not None else np.zeros(0)
    return replace(view, depths=(float(covered.min()), float(covered.max()))) if len(covered) else view


def shrink(view: View, size: int) -> View:
    """Reduce a view to a longer side of about `size` pixels by averaging whole blocks; never enlarges.

    Whole blocks keep camera and pixels exactly in step; the factor is the nearest whole number.
    """
    height, width = view.image.shape[:2]
    factor = max(1, round(max(height, width) / size))
    if factor == 1:
        return view
    rows, columns = height // factor, width // factor

    def blocks(array: np.ndarray) -> np.ndarray:
        array = array[: rows * factor, : columns * factor]
        return array.reshape(rows, factor, columns, factor, *array.shape[2:]).astype(np.float32)

    depth = view.depth
    if depth is not None:
        grid = blocks(depth)
        valid = grid > 0
        # a mean across a silhouette would lie in empty space
        depth = np.where(valid.all((1, 3)), grid.mean((1, 3)), 0.0).astype(np.float32)
    camera = view.camera.crop(0, 0, columns * factor, rows * factor).resized(columns, rows)
    image, mask = ((blocks(a).mean((1, 3)) + 0.5).astype(np.uint8) for a in (view.image, view.mask))
    detail = None if view.detail is None else (blocks(view.detail).mean((1, 3)) + 0.5).astype(np.uint8)
    return replace(view, camera=camera, image=image, mask=mask, depth=depth, detail=detail)


def random_crop(view: View, size: int, rng: np.random.Generator) -> View:
    """Return a square crop whose centre lies on the person; the whole view where it is smaller."""
    height, width = view.image.shape[:2]
    if height <= size or width <= size:
        return view
    covered = np.flatnonzero(view.mask > 127)
    centre = int(covered[rng.integers(len(covered))]) if len(covered) else (height // 2) * width + width // 2
    y = int(np.clip(centre // width - size // 2, 0, height - size))
    x = int(np.clip(centre % width - size // 2, 0, width - size))
    return _window(view, x, y, size, size)


def crop_to_person(view: View, margin: int) -> View:
    """Return the part of a view that shows the person and `margin` pixels around; 0 keeps the whole view.

    Empty background costs time and teaches nothing, except that nothing should be there: the margin sees to that.
    """
    rows, columns = np.flatnonzero(view.mask.any(1)), np.flatnonzero(view.mask.any(0))
    if margin == 0 or not len(rows):
        return view
    height, width = view.mask.shape
    top, left = max(0, rows[0] - margin), max(0, columns[0] - margin)
    bottom, right = min(height, rows[-1] + 1 + margin), min(width, columns[-1] + 1 + margin)
    # the refinement network folds and halves pixels: whole multiples need no padding
    down, across = (int(np.ceil(n / _MULTIPLE)) * _MULTIPLE for n in (bottom - top, right - left))
    if down > height or across > width:
        return view
    return _window(view, int(min(left, width - across)), int(min(top, height - down)), across, down)


def _window(view: View, x: int, y: int, width: int, height: int) -> View:
    window = (slice(y, y + height), slice(x, x + width))
    depth, detail = (None if a is None else a[window] for a in (view.depth, view.detail))
    return replace(
        view, camera=view.camera.crop(x, y, width, height), image=view.image[window], mask=view.mask[window], depth=depth,
        detail=detail,
    )  # fmt: skip
