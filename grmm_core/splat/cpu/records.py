"""What stands where in the arrays that the kernels pass on: a camera, a Gaussian's record, a row of gradients.

Needs numpy only. Read by every kernel of this folder; a named tuple of places is a constant to the compiler.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from ..rules import View


class Camera(NamedTuple):
    """Places in a camera, float64.

    Attributes:
        r00, r01, r02, r10, r11, r12, r20, r21, r22: Rotation from the world, by rows.
        tx, ty, tz: Translation from the world, metres.
        fx, fy, cx, cy: Focal lengths and principal point, pixels.
        low_u, high_u, low_v, high_v: Bounds of x / z and y / z at which the perspective is expanded.
        width, height: Pixels.
        orthographic, antialiased: Not zero: yes.
    """

    r00: int
    r01: int
    r02: int
    r10: int
    r11: int
    r12: int
    r20: int
    r21: int
    r22: int
    tx: int
    ty: int
    tz: int
    fx: int
    fy: int
    cx: int
    cy: int
    low_u: int
    high_u: int
    low_v: int
    high_v: int
    width: int
    height: int
    orthographic: int
    antialiased: int


class Record(NamedTuple):
    """Places in the record of a projected Gaussian, one cache line of float32.

    Attributes:
        x, y: Centre, pixels.
        l11, l12, l22: The Cholesky factor of its conic, so that -ln(alpha / opacity) = (s^2 + q^2) / 2 with s = l11 dx + l12 dy
            and q = l22 dy, which lose no digits where Gaussians are long and thin.
        opacity: After cap and compensation.
        reach: The largest SQUEEZE^2 (s^2 + q^2) at which alpha still reaches ALPHA_MIN.
        groups: How many groups of channels (`tiling.GROUP`), its values the first, hold all that is not 0.
        red, green, blue, depth: Its values.
        tiles_low, tiles_high: int32: x | y << 16 of the first tile that it may touch, and of one past the last.
        slot: int32: the first of its instances (see `binning.py`).
        touched: int32: how many tiles these are; 0 where it is not seen, and then all else is undefined.
    """

    x: int
    y: int
    l11: int
    l12: int
    l22: int
    opacity: int
    reach: int
    groups: int
    red: int
    green: int
    blue: int
    depth: int
    tiles_low: int
    tiles_high: int
    slot: int
    touched: int


class Row(NamedTuple):
    """Places in a row of gradients, float32; the features' follow.

    Attributes:
        g, gs, gq, gss, gsq, gqq: Sums over pixels of g, g s, g q, g s^2, g s q, g q^2 with g = alpha dL/dalpha.
        spare, spare_too: Nothing.
        red, green, blue, depth: Gradients of the values.
    """

    g: int
    gs: int
    gq: int
    gss: int
    gsq: int
    gqq: int
    spare: int
    spare_too: int
    red: int
    green: int
    blue: int
    depth: int


CAMERA = Camera(*range(len(Camera._fields)))
RECORD = Record(*range(len(Record._fields)))
ROW = Row(*range(len(Row._fields)))
RECORD_LENGTH = len(RECORD)
SHAPE = RECORD.red  # leading numbers of a record: where and how large it is
VALUES = 4  # red, green, blue and depth, in front of the features
SQUEEZE = 0.25  # the tile kernels work with SQUEEZE s and SQUEEZE q, and so do the sums


def camera_array(view: View, antialiased: bool) -> np.ndarray:
    """Return a view as the kernels read it; `antialiased` has opacities compensated."""
    numbers = (view.fx, view.fy, view.cx, view.cy, *view.clamp, view.width, view.height, view.orthographic, antialiased)
    return np.concatenate([view.rotation.reshape(9), view.translation, np.array(numbers, np.float64)])
