"""The compiled rasteriser: arrays in, arrays out, and the gradients of that; numpy and numba alone.

`autograd.py` makes a PyTorch operation of it, `api.rasterize_arrays` a function for those without torch. Any number of threads
may call it at a time.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...compute import buffers
from ...compute.threads import TASKS, for_each, pieces, thread_count
from ...errors import BackendError
from ..rules import TILE, View
from ..types import GaussianArrays, PictureArrays
from . import backward, binning, blocks, forward, projection, records, tiling

CHUNK_MIN, TILES_MIN = 2048, 4  # smallest task
CHUNKS_MAX = 64  # chunks of Gaussians; each counts every tile
MAX_INSTANCES = 2**28  # pairs of a Gaussian and a tile: 1 GiB of numbers; a head has a million
MAX_GRADIENT_BYTES = 8 << 30  # of the pairs' gradients


@dataclass
class Drawing:
    """What the backward pass needs of a forward pass; arrays as their kernels describe them."""

    camera: np.ndarray
    tiles_x: int
    geometry: np.ndarray
    whole: np.ndarray
    starts: np.ndarray
    ends: np.ndarray
    gaussian: np.ndarray


def draw(
    gaussians: GaussianArrays, background: np.ndarray, view: View, antialiased: bool, halved: int = 0
) -> tuple[PictureArrays, Drawing]:
    """Draw Gaussians.

    Args:
        gaussians: float32, contiguous; features [N, 0] when there are none.
        background: [1, 1, 3] or [H, W, 3] float32.
        view: The camera.
        antialiased: Opacity compensation.
        halved: So many of the last features are wanted in `PictureArrays.halves` instead of `features`; without gradients.

    Returns:
        The pictures, features [H, W, C - halved]; and what the backward pass needs.

    Raises:
        BackendError: The picture is too large, or the Gaussians cover so many tiles that they cannot be counted.
    """
    count = len(gaussians.means)
    height, width = view.height, view.width
    tiles_x, tiles_y = -(-width // TILE), -(-height // TILE)
    if max(tiles_x, tiles_y) > projection.TILES_MAX:
        raise BackendError(f"A picture of {width}x{height} pixels is too large to draw at once; draw it in parts.")
    tiles = tiles_x * tiles_y
    camera = records.camera_array(view, antialiased)
    geometry = np.empty((count, records.RECORD_LENGTH), np.float32)
    whole = geometry.view(np.int32)
    threads = thread_count()

    chunks = pieces(count, CHUNK_MIN, min(TASKS * threads, CHUNKS_MAX))
    histogram = np.zeros((len(chunks), tiles), np.int32)
    touched = np.zeros(len(chunks), np.int64)
    groups = tiling.padded(gaussians.features.shape[1]) // tiling.GROUP  # of channels
    needs = np.zeros((len(chunks), groups + 1), np.int32)
    starts = np.empty(tiles + 1, np.int64)

    def project(k: int) -> None:
        touched[k] = projection.project(*chunks[k], tuple(gaussians), camera, geometry, whole, tiles_x, histogram[k], needs[k])

    for_each(len(chunks), project)
    instances = int(touched.sum())
    if instances > MAX_INSTANCES:
        raise BackendError("The Gaussians are too large and too many to draw: scale them down or make the picture smaller.")
    binning.place(histogram, touched, starts)
    gaussian = np.empty(instances, np.int32)
    for_each(len(chunks), lambda k: binning.fill(*chunks[k], whole, tiles_x, histogram[k], touched[k], gaussian))

    pictures = PictureArrays(
        rgb=buffers.empty((height, width, 3)),
        alpha=buffers.empty((height, width)),
        depth=buffers.empty((height, width)),
        features=buffers.empty((height, width, gaussians.features.shape[1] - halved)),
        halves=buffers.empty((-(-height // 2), -(-width // 2), halved)),
    )
    ends = np.empty(tiles, np.int64)
    few = int(np.argmax(needs.sum(0).cumsum() * np.arange(groups, -1, -1)))  # with what most sums are spared
    parts = pieces(tiles, TILES_MIN, TASKS * threads)
    for_each(
        len(parts),
        lambda k: forward.draw(
            *parts[k], tiles_x, starts, (gaussian, geometry, whole, gaussians.features), background, blocks.CONSTANTS,
            few, tuple(pictures), ends,
        ),
    )  # fmt: skip
    return pictures, Drawing(camera, tiles_x, geometry, whole, starts, ends, gaussian)


def differentiate(
    gaussians: GaussianArrays, pictures: PictureArrays, drawing: Drawing, d_pictures: PictureArrays
) -> GaussianArrays:
    """Return the gradients of Gaussians, given those of what `draw` made of them.

    Args:
        gaussians: As given to `draw`.
        pictures: What it returned.
        drawing: Likewise.
        d_pictures: Gradients of a loss, float32, contiguous.

    Raises:
        BackendError: The gradients of all pairs of a Gaussian and a tile would not fit the memory.
    """
    shape = (len(drawing.gaussian), records.ROW.red + tiling.padded(gaussians.features.shape[1]))
    if 4 * shape[0] * shape[1] > MAX_GRADIENT_BYTES:
        raise BackendError("The Gaussians are too large and too many to differentiate: scale them down.")
    rows = buffers.empty(shape)
    gradients = GaussianArrays(*(np.zeros_like(array) for array in gaussians))
    geometry, whole = drawing.geometry, drawing.whole
    scene = (drawing.gaussian, geometry, whole, gaussians.features)
    groups = pieces(len(drawing.ends), TILES_MIN, TASKS * thread_count())
    for_each(
        len(groups),
        lambda k: backward.replay(
            *groups[k], drawing.tiles_x, drawing.starts, drawing.ends, scene,
            blocks.CONSTANTS, tuple(pictures)[:4], tuple(d_pictures)[:4], rows,
        ),
    )  # fmt: skip
    chunks = pieces(len(gaussians.means), CHUNK_MIN, TASKS * thread_count())
    for_each(
        len(chunks),
        lambda k: backward.collect(*chunks[k], rows, tuple(gaussians), drawing.camera, geometry, whole, tuple(gradients)),
    )
    return gradients
