"""A groom in few bytes, for `.grmm` files and the package's own grooms. Needs numpy only.

Along a strand, each point is predicted from the two before it, and what is off is kept in one byte a coordinate, in steps that
suit the strand. Rounding feeds back into the prediction, so that errors do not add up: every point is within half a step.
Tints are kept in steps of 1/127.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ..errors import ShapeError
from .groom import TINTS, Groom, join
from .roots import BEARD, BROWS, GROUPS, LASHES, SCALP

MAX_BYTES = 1 << 20  # of a groom in a file
FINEST_STEP = 1e-5  # metres
_MOST_POINTS = 40
_FEWEST = 4
_ROOT = 0.03 / 32767  # metres: a step of a root's place in its own frame


def compact(groom: Groom, max_bytes: int = MAX_BYTES, points: int | None = None) -> dict[str, np.ndarray]:
    """Pack strands of one number of points into arrays of at most `max_bytes`; fewer, wider strands where more do not fit.

    Args:
        groom: The strands.
        max_bytes: Of all arrays.
        points: Of a strand; as many as the longest has, up to 40, when None.
    """
    count = int(np.clip(points or groom.counts.max(initial=_FEWEST), _FEWEST, _MOST_POINTS))
    tinted = groom.tints is not None and bool(groom.tints.any())
    each = 4 + 2 * 2 + 6 + 2 + 4 + 1 + 3 * (count - 1) + 3 * TINTS * tinted
    fitting = max_bytes // each
    if len(groom) > fitting:
        groom = groom.level(fitting / len(groom))
        groom = groom.select(np.arange(min(len(groom), fitting)))
    if (groom.counts != count).any():  # what was packed before keeps its points
        groom = groom.resampled(count)
    path = groom.points.reshape(len(groom), count, 3).astype(np.float64)
    root = np.clip(np.round(path[:, 0] / _ROOT), -32767, 32767).astype(np.int16)
    step = np.maximum(
        np.abs(np.diff(path, 2, axis=1, prepend=path[:, :1])).reshape(len(groom), -1).max(1) * 1.02 / 126, FINEST_STEP
    )
    step = np.maximum(step, np.abs(path[:, 1] - path[:, 0]).max(1) * 1.02 / 126)
    step = (np.ceil(np.minimum(step, 0.06) / 1e-6) * 1e-6).astype(np.float64)
    before, last = root * _ROOT, root * _ROOT
    off = np.zeros((len(groom), count - 1, 3), np.int8)
    for k in range(1, count):
        guess = 2 * last - before if k > 1 else last
        off[:, k - 1] = np.clip(np.round((path[:, k] - guess) / step[:, None]), -127, 127).astype(np.int8)
        before, last = last, guess + off[:, k - 1] * step[:, None]
    own = {} if groom.tints is None or not tinted else {"tints": np.round(np.clip(groom.tints, -1, 1) * 127).astype(np.int8)}
    return own | {
        "triangles": groom.triangles.astype(np.int32), "weights": np.round(groom.weights[:, :2] * 65535).astype(np.uint16),
        "root": root, "step": np.round(step / 1e-6).astype(np.uint16), "off": off, "groups": groom.groups.astype(np.uint8),
        "widths": np.round(np.clip(groom.widths * 1e6, 0, 65535)).astype(np.uint16),
    }  # fmt: skip


def compact_parts(groom: Groom) -> dict[str, np.ndarray]:
    """Pack the parts of a groom one by one, each with as many points as it needs; the scalp's names have no prefix."""
    packed: dict[str, np.ndarray] = {}
    left = MAX_BYTES
    for group in (LASHES, BROWS, BEARD, SCALP):  # the scalp's gets what the others leave
        some = groom.select(groom.groups == group)
        if len(some):
            arrays = compact(some, left if group == SCALP else min(left, MAX_BYTES // 3))
            left -= sum(array.nbytes for array in arrays.values())
            packed |= {(name if group == SCALP else f"{GROUPS[group]}/{name}"): array for name, array in arrays.items()}
    return packed


def restored_parts(arrays: Mapping[str, np.ndarray]) -> Groom | None:
    """The opposite of `compact_parts`; None where there is nothing. Raises `ShapeError`."""
    found = []
    for group, part in enumerate(GROUPS):
        prefix = "" if group == SCALP else f"{part}/"
        own = {name[len(prefix) :]: array for name, array in arrays.items() if name.rpartition("/")[0] == prefix.rstrip("/")}
        found += [restored(own)] if own else []
    return join(found) if found else None


def restored(arrays: Mapping[str, np.ndarray]) -> Groom:
    """The opposite of `compact`. Raises `ShapeError` for arrays that do not fit together."""
    try:
        off = np.asarray(arrays["off"])
        count, points = off.shape[0], off.shape[1] + 1
        step = arrays["step"].astype(np.float64)[:, None] * 1e-6
        path = np.empty((count, points, 3))
        path[:, 0] = arrays["root"] * _ROOT
        for k in range(1, points):
            guess = 2 * path[:, k - 1] - path[:, k - 2] if k > 1 else path[:, 0]
            path[:, k] = guess + off[:, k - 1] * step
        two = arrays["weights"].astype(np.float32) / 65535
        weights = np.concatenate([two, 1 - two.sum(1, keepdims=True)], 1)
        return Groom(
            arrays["triangles"].astype(np.int32), weights, np.arange(count + 1) * points,
            path.reshape(-1, 3).astype(np.float32),
            (arrays["widths"] * 1e-6).astype(np.float32), arrays["groups"].astype(np.uint8),
            arrays["tints"].astype(np.float32) / 127 if "tints" in arrays else None,
        )  # fmt: skip
    except (KeyError, ValueError, IndexError, TypeError) as error:
        raise ShapeError(f"The arrays of a groom do not fit together ({error}); make it again.") from error
