"""Which of the skin strands lie over where they begin, finer than the head's triangles are. For `session.scalp`.

What roots cover is known by vertex: its color alone would make partings, and skin before a hairline, a centimetre wide.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.triangles import vertex_normals
from ..head import HeadModel
from .grids import sample, smooth_grid
from .roots import SCALP
from .strands import CROPPED, StrandBlock, lengths_of

CELL, LAYERS = 0.003, 20  # metres of a cell in which strands are counted, and of how many over the skin
FIRST, STEP = 0.06, 0.002  # metres of each strand from its root that count, in steps; curls cover by what is farther out
DENSE = 1.0  # cover by strands, laid beside each other, from where on skin counts as lying under hair
# how soon shorn hair, which has no partings, covers skin: without an edge, at which roots that lie a little unevenly would make
# patches of bare skin
SHORN_DENSE = 2.6


def beneath(
    head: HeadModel, points: np.ndarray, corners: np.ndarray, weights: np.ndarray, blocks: Sequence[StrandBlock],
    group: int = SCALP, layers: int = LAYERS,
) -> np.ndarray:  # fmt: skip
    """Whether strands of the scalp, or of another part, lie over places of the skin on the first part of their way.

    Args:
        head: The head model.
        points: Places on its mean, metres, [N, 3].
        corners: Vertices of the triangle under each, [N, 3].
        weights: Barycentric coordinates, [N, 3].
        blocks: The strands.
        group: Number of the part in `roots.GROUPS`.
        layers: How many over the skin count.

    Returns:
        0..1, [N].
    """
    blocks = [block for block in blocks if block.group == group]
    if not blocks:
        return np.zeros(len(points))
    template = np.asarray(head.v_template, float)
    up = (vertex_normals(template, np.asarray(head.faces))[corners] * weights[..., None]).sum(1)
    low = points.min(0) - 3 * CELL
    size = np.ceil((points.max(0) + 3 * CELL - low) / CELL).astype(int) + 1
    filled = np.zeros((2, int(size.prod())))  # by longer hair, and by shorn hair
    for block in blocks:
        origin, axes = block.frames.at(template)
        begun, real = _begun(np.matmul(block.points, axes) + origin[:, None])
        areas = np.broadcast_to((block.widths[:, :1] * (STEP * len(block) / len(begun))), real.shape)[real]
        cells = np.floor((begun[real] - low) / CELL).astype(int)
        near = ((cells >= 0) & (cells < size)).all(1)  # not a bun behind the head
        number = np.ravel_multi_index(tuple(cells[near].T), tuple(size))
        filled[int(block.length < CROPPED)] += np.bincount(number, areas[near], filled.shape[1])
    some = np.flatnonzero(filled.any(1))
    dense = np.stack([smooth_grid(smooth_grid((filled[kind] / CELL**2).astype(np.float32).reshape(size))) for kind in some], -1)
    passed, at = np.zeros((len(points), 2)), ((points - low) / CELL - 0.5).astype(np.float32)
    up = up.astype(np.float32)
    for k in range(-1, layers) if len(some) else ():
        passed[:, some] += sample(dense, at + np.float32(k + 0.5) * up)
    if group != SCALP:
        return np.minimum(passed.sum(1) / DENSE, 1.0)
    covered: np.ndarray = 1.0 - (1.0 - np.minimum(passed[:, 0] / DENSE, 1.0)) * np.exp(-SHORN_DENSE * passed[:, 1].clip(0.0))
    return covered


def _begun(strands: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Places [M, S, 3] on strands [M, K, 3] every `STEP` from the root, and which of these strands reach, [M, S]."""
    along = np.cumsum(np.linalg.norm(np.diff(strands, axis=1, prepend=strands[:, :1]), axis=2), 1)
    wanted = np.arange(STEP / 2, FIRST, STEP)
    number = np.clip((along[:, :, None] < wanted).sum(1) - 1, 0, strands.shape[1] - 2)  # of the point before each
    row = np.arange(len(strands))[:, None]
    before, after = along[row, number], along[row, number + 1]
    part = np.clip((wanted - before) / np.maximum(after - before, 1e-9), 0.0, 1.0)[..., None]
    places = strands[row, number] * (1.0 - part) + strands[row, number + 1] * part
    return places, wanted <= lengths_of(strands)[:, None]
