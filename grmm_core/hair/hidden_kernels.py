"""What hides strands on a picture: the head, and other strands. Compiled; importing this module loads numba.

Arrays are float32 and contiguous; for the columns of an eye see `strand_kernels`.
"""

from __future__ import annotations

import math

import numpy as np

from ..compute.kernels import compiled
from .ribbons import LONG, WIDE

_OPTIONS = {"fastmath": True, "boundscheck": False, "error_model": "numpy", "nogil": True}
F = np.float32
_LONG, _WIDE = F(LONG), F(WIDE)
_HALF, _ZERO = F(0.5), F(0.0)
_EDGE = 1e-9  # rounding, of a triangle's sides
MOST_PARTS = 16  # of a segment, each in a cell
BORDER = 0.3  # of what hides in a cell, how much must be in those around it
LAYER = 0.003  # metres: of the layers in which is counted what lies before a strand


@compiled(**_OPTIONS)
def place(points: np.ndarray, eye: np.ndarray, shown: np.ndarray) -> None:
    """Write where points [N, 3] are on the picture, once for all below.

    Args:
        points: Head space, metres.
        eye: See `strand_kernels`.
        shown: Written, column and row in pixels from the optical axis, depth in metres, pixels a metre there, [N, 4].
    """
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        depth = eye[6] * x + eye[7] * y + eye[8] * z + eye[11]
        scale = eye[12] if eye[13] > _HALF else eye[12] / max(depth, F(1e-4))
        shown[n, 0] = (eye[0] * x + eye[1] * y + eye[2] * z + eye[9]) * scale
        shown[n, 1] = (eye[3] * x + eye[4] * y + eye[5] * z + eye[10]) * scale
        shown[n, 2], shown[n, 3] = depth, scale


@compiled(**_OPTIONS)
def hide(shown: np.ndarray, depth: np.ndarray, cell: float, left: float, top: float, slack: float, seen: np.ndarray) -> None:
    """Set to 0 what is seen of places that a head hides.

    Args:
        shown: Of `place`, [N, 4].
        depth: Farthest depth of the head around each cell of the picture, far away where it may be seen past, [H, W] metres.
        cell: Pixels of a cell.
        left: What is taken from column pixels (relative to the optical axis) before they are divided by `cell`.
        top: Likewise from rows.
        slack: Metres behind the head that still count as seen.
        seen: Changed, [N].
    """
    for n in range(len(shown)):
        column, row = math.floor((shown[n, 0] - left) / cell), math.floor((shown[n, 1] - top) / cell)
        inside = 0 <= column < depth.shape[1] and 0 <= row < depth.shape[0]
        if inside and shown[n, 2] > depth[row, column] + slack:
            seen[n] = _ZERO


@compiled(**_OPTIONS)
def thicken(
    shown: np.ndarray, radii: np.ndarray, opacity: np.ndarray, seen: np.ndarray, many: float, cell: float,
    left: float, top: float, near: float, thick: np.ndarray,
) -> None:  # fmt: skip
    """Sum up how much strands cover, from the eye inwards.

    Args:
        shown: Of `place`, [N, K, 4].
        radii: At root and tip, metres, [N, 2].
        opacity: Of the strands, [N].
        seen: Of the segments; those at 0 are left out, [N, K - 1].
        many: So many strands each of these stands for.
        cell: Pixels of a cell, as for `hide`, and so `left`, `top`.
        left: See `hide`.
        top: See `hide`.
        near: Depth of the first layer, metres; each is `LAYER` deep.
        thick: Written, mean opacity that lies before a layer of a cell, summed up, [H, W, layers]; zeros are given.
    """
    count = shown.shape[1] - 1
    height, width, layers = thick.shape
    each = F(2.0 * math.pi) * _LONG * _WIDE * F(many) / (F(cell) * F(cell))  # of a Gaussian as long and as wide as 1
    for i in range(len(shown)):
        for k in range(count):
            if seen[i, k] <= _ZERO:
                continue
            au, av, ad = shown[i, k, 0], shown[i, k, 1], shown[i, k, 2]
            bu, bv, bd = shown[i, k + 1, 0], shown[i, k + 1, 1], shown[i, k + 1, 2]
            along = (F(k) + _HALF) / F(count)
            radius = radii[i, 0] + (radii[i, 1] - radii[i, 0]) * along * along
            long = math.sqrt((bu - au) * (bu - au) + (bv - av) * (bv - av))
            parts = min(int(long / cell) + 1, MOST_PARTS)
            covered = each * opacity[i] * radius * shown[i, k, 3] * long / F(parts)
            for part in range(parts):
                t = (F(part) + _HALF) / F(parts)
                column = math.floor((au + t * (bu - au) - left) / cell)
                row = math.floor((av + t * (bv - av) - top) / cell)
                layer = math.floor((ad + t * (bd - ad) - near) / F(LAYER)) + 1
                if 0 <= column < width and 0 <= row < height and layer < layers:
                    thick[row, column, max(layer, 0)] += covered
    for row in range(height):
        for column in range(width):
            before = _ZERO
            for layer in range(layers):
                before += thick[row, column, layer]
                thick[row, column, layer] = before


@compiled(**_OPTIONS)
def bury(
    shown: np.ndarray, cell: float, left: float, top: float, near: float, thick: np.ndarray, most: float, seen: np.ndarray
) -> None:  # fmt: skip
    """Likewise of places that more than `most` of hair covers, at least a layer before them; see `thicken`."""
    height, width, layers = thick.shape
    for n in range(len(shown)):
        if seen[n] <= _ZERO:
            continue
        column, row = math.floor((shown[n, 0] - left) / cell), math.floor((shown[n, 1] - top) / cell)
        layer = min(math.floor((shown[n, 2] - near) / F(LAYER)), layers) - 1
        if not (0 <= column < width and 0 <= row < height and layer >= 0) or thick[row, column, layer] <= most:
            continue
        least = most
        for step in (-1, 1):  # nor may it be seen past the border of what covers it
            least = min(least, thick[min(max(row + step, 0), height - 1), column, layer])
            least = min(least, thick[row, min(max(column + step, 0), width - 1), layer])
        if least > F(BORDER) * most:
            seen[n] = _ZERO


@compiled(**_OPTIONS)
def nearest_skin(vertices: np.ndarray, faces: np.ndarray, camera: np.ndarray, empty: float, depth: np.ndarray) -> bool:
    """Draw triangles in cells as `geometry.zbuffer.triangle_depth` does, for those that lie before the camera as a whole.

    Args:
        vertices: Head space, [V, 3].
        faces: [F, 3] int32 or int64.
        camera: Rotation by rows (0-8), translation (9-11), focal lengths and optical axis in cells (12-15), parallel
            projection (16), nearest depth (17); float64.
        empty: Depth of cells without skin.
        depth: Written, [H, W].

    Returns:
        Whether all triangles do; if not, nothing is drawn.
    """
    height, width = depth.shape
    x, y, linear = np.empty(len(vertices)), np.empty(len(vertices)), np.empty(len(vertices))
    parallel = camera[16] > 0.5
    for v in range(len(vertices)):
        px, py, pz = float(vertices[v, 0]), float(vertices[v, 1]), float(vertices[v, 2])
        z = camera[6] * px + camera[7] * py + camera[8] * pz + camera[11]
        if not camera[17] <= z < empty:
            return False
        scale = 1.0 if parallel else 1.0 / z
        x[v] = camera[12] * scale * (camera[0] * px + camera[1] * py + camera[2] * pz + camera[9]) + camera[14]
        y[v] = camera[13] * scale * (camera[3] * px + camera[4] * py + camera[5] * pz + camera[10]) + camera[15]
        linear[v] = z if parallel else scale  # on the picture
    depth[:] = empty
    for f in range(len(faces)):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        left, right = min(x[a], x[b], x[c]) - 0.5, max(x[a], x[b], x[c]) - 0.5
        upper, lower = min(y[a], y[b], y[c]) - 0.5, max(y[a], y[b], y[c]) - 0.5
        if not (right > -1.0 and left < width and lower > -1.0 and upper < height):
            continue
        first, last = max(math.ceil(left), 0), min(math.floor(right), width - 1)
        ux, uy, vx, vy = x[b] - x[a], y[b] - y[a], x[c] - x[a], y[c] - y[a]
        area = ux * vy - uy * vx
        if first > last or area == 0.0:
            continue
        inverse = 1.0 / area
        for row in range(max(math.ceil(upper), 0), min(math.floor(lower), height - 1) + 1):
            dy = row + 0.5 - y[a]
            for column in range(first, last + 1):
                dx = column + 0.5 - x[a]
                second, third = (dx * vy - dy * vx) * inverse, (ux * dy - uy * dx) * inverse
                if second >= -_EDGE and third >= -_EDGE and second + third <= 1.0 + _EDGE:
                    value = linear[a] + second * (linear[b] - linear[a]) + third * (linear[c] - linear[a])
                    z = value if parallel else 1.0 / value
                    depth[row, column] = min(depth[row, column], F(z))
    return True


@compiled(**_OPTIONS)
def farthest_around(depth: np.ndarray, empty: float, metres: float, out: np.ndarray) -> None:
    """Write the farthest of each cell of `depth` and those around it, times `metres`, to `out` [H, W].

    Where one of them is `empty`, as everything outside is, so is the result.
    """
    height, width = depth.shape
    for row in range(height):
        for column in range(width):
            most = F(empty) if row in (0, height - 1) or column in (0, width - 1) else depth[row, column]
            for y in range(max(row - 1, 0), min(row + 2, height)):
                for x in range(max(column - 1, 0), min(column + 2, width)):
                    most = max(most, depth[y, x])
            out[row, column] = F(empty) if most >= F(empty) else most * F(metres)
