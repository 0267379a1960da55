"""Hair longer than the package's grooms: down to the chest, wide, wavy, before the shoulders or behind. Numpy only.

Strands hang on from where those of a falling groom end. What they hang through is left to the picture: hair that lies before
the shoulders is drawn over the clothes.
"""

from __future__ import annotations

import numpy as np

from grmm_core.hair import library_groom
from grmm_core.hair.groom import Groom, bind
from grmm_core.head import HeadModel

from .drawn import Generator, smooth, unit

FALLING = ("bob", "braids", "curly", "layered", "locs", "long", "long", "ringlets", "ringlets", "wavy_long", "wavy_long")
POINTS, FINER = 14, 44  # of a strand of the groom, and of one that hangs on
CHIN = -0.06  # metres: strands that end higher do not hang on
LOCKS = 0.022  # metres of the scalp whose strands wave and end together
HANGING = 0.07  # metres on which a strand turns downwards


def long_hair(head: HeadModel, g: Generator, detail: float) -> Groom:
    """A share of the strands of a falling groom, longer, by chance wavy and wide."""
    groom = library_groom(FALLING[int(g.integers(len(FALLING)))]).level(detail).resampled(POINTS)
    template = np.asarray(head.v_template, np.float64)
    frames = groom.frames(template, head.faces)
    points = np.asarray(groom.posed(frames, template), np.float64).reshape(len(groom), POINTS, 3)
    lock = np.unique(np.round(points[:, 0] / LOCKS).astype(int), axis=0, return_inverse=True)[1].ravel()
    own = g.normal(0.0, 1.0, (lock.max() + 1, 6))[lock]
    points = _waving(_wide(_hung_on(points, own, g), g), own, g)
    offsets = np.arange(len(groom) + 1) * FINER
    flat = points.reshape(-1, 3)
    return bind(template, head.faces, template, groom.triangles, groom.weights, flat, offsets, groom.widths, groom.groups)


def _hung_on(points: np.ndarray, own: np.ndarray, g: Generator) -> np.ndarray:
    """Strands [N, K, 3] with so much more at their ends, [N, FINER, 3]; `own` are random numbers of their locks, [N, 6]."""
    more = g.uniform(0.03, 0.36) * np.clip(1.0 + g.uniform(0.02, 0.25) * own[:, 0] + g.normal(0, 0.05, len(own)), 0.3, 1.7)
    if g.random() < 0.3:  # the hair of one side is behind the shoulder
        more = np.where(points[:, -1, 0] * g.choice([-1.0, 1.0]) > 0.0, more, 0.15 * more)
    more = more * (points[:, -1, 1] < CHIN)
    steps = np.linspace(0.0, 1.0, FINER)[None, :, None] * more[:, None, None]
    start = unit(points[:, -1] - points[:, -2])[:, None]
    side = np.sign(points[:, -1, 0]) * g.normal(0.0, 0.22) + 0.06 * own[:, 1]
    down = unit(np.stack([side, -np.ones(len(own)), g.normal(0.0, 0.12) + 0.05 * own[:, 2]], 1))[:, None]
    turned = smooth(0.0, 1.0, steps / HANGING)
    way = unit(start + (down - start) * turned)
    tail = points[:, -1:] + np.cumsum(way * np.diff(steps, axis=1, prepend=steps[:, :1]), 1)
    whole = np.concatenate([points, tail[:, 1:]], 1)
    along = np.cumsum(np.linalg.norm(np.diff(whole, axis=1, prepend=whole[:, :1]), axis=2), 1)
    at = along[:, -1:] * np.linspace(0.0, 1.0, FINER)
    row = np.arange(len(whole))[:, None]
    low = np.clip((along[:, None] <= at[..., None]).sum(2) - 1, 0, whole.shape[1] - 2)
    step = np.maximum(along[row, low + 1] - along[row, low], 1e-9)
    return whole[row, low] + ((at - along[row, low]) / step)[..., None] * (whole[row, low + 1] - whole[row, low])


def _wide(points: np.ndarray, g: Generator) -> np.ndarray:
    """Strands [N, K, 3] that stand out more the farther down they are, or as they were."""
    volume = g.uniform(0.0, 0.9) if g.random() < 0.45 else g.uniform(-0.1, 0.1)
    low = g.uniform(-0.16, -0.04)
    wider = 1.0 + volume * smooth(-0.09, -low, -points[..., 1])
    return np.stack([points[..., 0] * wider, points[..., 1], points[..., 2] * (1.0 + 0.4 * (wider - 1.0))], -1)


def _waving(points: np.ndarray, own: np.ndarray, g: Generator) -> np.ndarray:
    """Strands [N, K, 3] in waves that those of a lock have in common."""
    kind = g.random()
    if kind < 0.3:
        return points
    size, length, loose = g.uniform(0.003, 0.018), g.uniform(0.05, 0.16), g.uniform(0.05, 0.5)
    if kind > 0.7:  # curls
        size, length, loose = g.uniform(0.004, 0.012), g.uniform(0.022, 0.05), g.uniform(0.1, 0.8)
    angle = 2.0 * np.pi * points[..., 1] / length + 1.2 * own[:, 3:4] + loose * g.normal(0.0, 1.0, (len(points), 1))
    x = np.sin(angle) * (1.0 + 0.3 * own[:, 4:5])
    return points + size * smooth(-0.05, 0.06, -points[..., 1])[..., None] * np.stack(
        [x, 0.0 * angle, np.cos(angle) * (0.6 + 0.2 * own[:, 5:6])], -1
    )
