"""What hair that hangs beside the face and the neck takes of the rig's light there. For `session.scalp`; needs numba.

The skin was learned without hair. What lies on it closely is `cover`'s; this is the shadow of strands that stand off.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..geometry.triangles import vertex_normals
from ..head import HeadModel
from .grids import smooth_grid
from .occlusion import CELL, DIRECTIONS, FINE, REACH, directions_over
from .ribbons import AMBIENT, LAMPS
from .roots import SCALP
from .strands import StrandBlock

LIFTED = 0.006  # metres above the skin where light is asked for: nearer, strands' own cells are full
BOUNCED = 0.1  # of the light that is lost, what neighbouring skin and hair give back


def left_by_hair(head: HeadModel, blocks: Sequence[StrandBlock]) -> np.ndarray:
    """Share of the rig's light that strands of the scalp at rest leave at the vertices of the mean head, 0..1 float32 [V]."""
    from ..compute.threads import for_rows
    from .grid_kernels import march

    template, faces = np.asarray(head.v_template, float), np.asarray(head.faces)
    ends, shadows = [], []
    for block in blocks:
        if block.group == SCALP:
            origin, axes = block.frames.at(template)
            points = np.matmul(block.points, axes) + origin[:, None]
            widths = block.widths.mean(1) * (len(block) / len(block.points))
            ends.append((0.5 * (points[:, 1:] + points[:, :-1])).reshape(-1, 3))
            shadows.append((np.linalg.norm(np.diff(points, axis=1), axis=2) * widths[:, None]).ravel())
    if not ends:
        return np.ones(len(template), np.float32)
    middle, shadow = np.concatenate(ends), np.concatenate(shadows)
    up = vertex_normals(template, faces)
    places = template + LIFTED * up
    low = np.minimum(middle.min(0), places.min(0)) - 2 * CELL
    size = np.ceil((np.maximum(middle.max(0), places.max(0)) + 2 * CELL - low) / CELL).astype(int) + 1
    number = np.ravel_multi_index(tuple(((middle - low) / CELL).astype(int).T), tuple(size))
    filled = np.bincount(number, shadow, int(size.prod())).reshape(size) * (FINE * np.pi / 4 / CELL**3)
    seen = np.empty((len(places), 4), np.float32)
    for_rows(
        march, len(places), smooth_grid(filled).astype(np.float32), ((places - low) / CELL).astype(np.float32),
        directions_over(DIRECTIONS), int(REACH / CELL), CELL, seen, smallest=512,
    )  # fmt: skip
    arriving = AMBIENT * np.clip(seen[:, 0] + (2.0 / 3.0) * (seen[:, 1:] * up).sum(1), 0.0, 1.0)
    whole = np.full(len(places), AMBIENT)
    for x, y, z, power in LAMPS.tolist():
        facing = power * np.clip(up @ (x, y, z), 0.0, None)
        whole += facing
        arriving += facing * np.clip(seen[:, 0] + seen[:, 1:] @ np.array((x, y, z)), 0.0, 1.0)
    share = arriving / whole
    return (share + BOUNCED * (1.0 - share)).astype(np.float32)
