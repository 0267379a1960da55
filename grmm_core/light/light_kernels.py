"""The compiled twins of light at points. Importing this loads numba.

All arrays are contiguous float32 but for indices. What takes `first` and `last` does these rows (`compute.threads.for_rows`).
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from ..compute.kernels import compiled
from .shadow_kernels import OPTIONS, single

_0, _1, _2, _HALF = single(0.0), single(1.0), single(2.0), single(0.5)
_TINY, _PI = single(1e-9), single(math.pi)
# columns of a lamp's row; `shading.lamp_rows` writes them
(KIND, PLACE, POWER, SPREAD, TOWARDS, INNER, FADE, SIZE, COLOR, LAMP_VALUES) = (0, 1, 4, 5, 6, 9, 10, 11, 12, 15)
SUN, POINT, SPOT, AREA = 0, 1, 2, 3
NEAREST_SQUARE = np.float32(0.02**2)
BLOCK = 64  # points that are lit together: the compiler does eight or sixteen of them at once


@compiled(**OPTIONS)
def interpolate(
    values: np.ndarray, corners: np.ndarray, weights: np.ndarray, unit: bool, out: np.ndarray, first: int, last: int
) -> None:  # fmt: skip
    """Write weighted sums of three rows of `values` [V, C] into `out` [N, C], of length 1 if `unit`; the others [N, 3]."""
    for i in range(first, last):
        a, b, c, square = corners[i, 0], corners[i, 1], corners[i, 2], np.float32(1e-20)
        for k in range(values.shape[1]):
            value = weights[i, 0] * values[a, k] + weights[i, 1] * values[b, k] + weights[i, 2] * values[c, k]
            out[i, k], square = value, square + value * value
        if unit:
            for k in range(values.shape[1]):
                out[i, k] /= math.sqrt(square)


@compiled(**OPTIONS)
def vertex_normals(vertices: np.ndarray, faces: np.ndarray, out: np.ndarray) -> None:
    """Add unit normals of a mesh to zeros, [V, 3] float64; see `transfer.vertex_normals`. Vertices likewise, faces [F, 3]."""
    for t in range(len(faces)):
        a, b, c = faces[t, 0], faces[t, 1], faces[t, 2]
        ux, uy, uz = vertices[b, 0] - vertices[a, 0], vertices[b, 1] - vertices[a, 1], vertices[b, 2] - vertices[a, 2]
        vx, vy, vz = vertices[c, 0] - vertices[a, 0], vertices[c, 1] - vertices[a, 1], vertices[c, 2] - vertices[a, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        for k in range(3):
            i = faces[t, k]
            out[i, 0], out[i, 1], out[i, 2] = out[i, 0] + nx, out[i, 1] + ny, out[i, 2] + nz
    for i in range(len(out)):
        length = math.sqrt(out[i, 0] * out[i, 0] + out[i, 1] * out[i, 1] + out[i, 2] * out[i, 2])
        inverse = 1.0 / max(length, 1e-20)
        out[i, 0], out[i, 1], out[i, 2] = out[i, 0] * inverse, out[i, 1] * inverse, out[i, 2] * inverse


@compiled(**OPTIONS)
def on_surface(
    vertices: np.ndarray, normals: np.ndarray, corners: np.ndarray, weights: np.ndarray, points: np.ndarray, units: np.ndarray,
    first: int, last: int,
) -> None:  # fmt: skip
    """Write points of a mesh and their unit normals, [N, 3] each; see `resting.Texels.receivers`. Vertices, normals [V, 3]."""
    for i in range(first, last):
        px = py = pz = nx = ny = nz = _0
        for k in range(3):
            a, weight = corners[i, k], weights[i, k]
            px, py, pz = px + weight * vertices[a, 0], py + weight * vertices[a, 1], pz + weight * vertices[a, 2]
            nx, ny, nz = nx + weight * normals[a, 0], ny + weight * normals[a, 1], nz + weight * normals[a, 2]
        up_x = up_y = up_z = _0
        for k in range(3):
            a = corners[i, k]
            ax, ay, az = normals[a, 0], normals[a, 1], normals[a, 2]
            below = ax * (vertices[a, 0] - px) + ay * (vertices[a, 1] - py) + az * (vertices[a, 2] - pz)
            lift = _HALF * weights[i, k] * max(below, _0)
            up_x, up_y, up_z = up_x + lift * ax, up_y + lift * ay, up_z + lift * az
        inverse = _1 / math.sqrt(nx * nx + ny * ny + nz * nz + np.float32(1e-20))
        points[i, 0], points[i, 1], points[i, 2] = px + up_x, py + up_y, pz + up_z
        units[i, 0], units[i, 1], units[i, 2] = nx * inverse, ny * inverse, nz * inverse


@compiled(**OPTIONS)
def dim(
    seen: np.ndarray, rows: np.ndarray, corners: np.ndarray, weights: np.ndarray, through: np.ndarray, first: int, last: int
) -> None:  # fmt: skip
    """Multiply `seen` [N] at rows [M] by what comes through to the vertices around, [V]; corners and weights [N, 3]."""
    for j in range(first, last):
        i = rows[j]
        a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
        seen[i] *= weights[i, 0] * through[a] + weights[i, 1] * through[b] + weights[i, 2] * through[c]


@compiled(**OPTIONS)
def facing(
    points: np.ndarray, normals: np.ndarray, eye: np.ndarray, least: float, out: np.ndarray, first: int, last: int
) -> None:
    """Write whether points face an eye [3] by a cosine times metres of more than `least`, [N] bool; the others [N, 3]."""
    for i in range(first, last):
        x, y, z = eye[0] - points[i, 0], eye[1] - points[i, 1], eye[2] - points[i, 2]
        out[i] = normals[i, 0] * x + normals[i, 1] * y + normals[i, 2] * z > least


@compiled(**OPTIONS)
def brightness_around(
    colors: np.ndarray, tint: np.ndarray, corners: np.ndarray, weights: np.ndarray, least: float, sums: np.ndarray
) -> None:  # fmt: skip
    """Add squares of colors [N, 3] with what is added to them, `least` to 1, to the vertices around, [V]; the others [N, 3]."""
    for i in range(len(colors)):
        total = _0
        for k in range(3):
            value = min(max(colors[i, k] + tint[i, k], least), _1)
            total += value * value
        for k in range(3):
            sums[corners[i, k]] += weights[i, k] * total


@compiled(inline="always", **OPTIONS)
def arriving(lamps: np.ndarray, k: int, x: float, y: float, z: float) -> tuple[float, float, float, float]:
    """Direction to a lamp and irradiance, as `lamps.arriving`."""
    if lamps[k, KIND] == SUN:
        return lamps[k, PLACE], lamps[k, PLACE + 1], lamps[k, PLACE + 2], lamps[k, POWER]
    dx, dy, dz = lamps[k, PLACE] - x, lamps[k, PLACE + 1] - y, lamps[k, PLACE + 2] - z
    square = dx * dx + dy * dy + dz * dz
    inverse = _1 / math.sqrt(max(square, np.float32(1e-12)))
    dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
    strength = lamps[k, POWER] / (max(square, NEAREST_SQUARE) + lamps[k, SPREAD])
    if lamps[k, KIND] != POINT:
        along = -(dx * lamps[k, TOWARDS] + dy * lamps[k, TOWARDS + 1] + dz * lamps[k, TOWARDS + 2])
        if lamps[k, KIND] == AREA:
            strength *= max(along, _0)
        else:
            share = min(max((along - lamps[k, INNER]) * lamps[k, FADE], _0), _1)
            strength *= share * share * (np.float32(3.0) - _2 * share)
    return dx, dy, dz, strength


@compiled(**OPTIONS)
def arriving_at_block(w: np.ndarray, lamp: np.ndarray, at: int, towards: int, strength: int) -> None:
    """Write directions to a lamp and irradiance of the points of a block, as `lamps.arriving`.

    Args:
        w: Numbers of the block, a column of `BLOCK` for each quantity.
        lamp: Row of `shading.lamp_rows`.
        at: Where the points begin in `w`, three columns.
        towards: Likewise the directions that are written.
        strength: Likewise the irradiance, one column.
    """
    x, y, z, power, spread = lamp[PLACE], lamp[PLACE + 1], lamp[PLACE + 2], lamp[POWER], lamp[SPREAD]
    if lamp[KIND] == SUN:
        for j in range(BLOCK):
            w[towards + j], w[towards + BLOCK + j], w[towards + 2 * BLOCK + j], w[strength + j] = x, y, z, power
        return
    ax, ay, az, inner, fade = lamp[TOWARDS], lamp[TOWARDS + 1], lamp[TOWARDS + 2], lamp[INNER], lamp[FADE]
    area, spot = np.float32(lamp[KIND] == AREA), np.float32(lamp[KIND] == SPOT)
    ball = _1 - area - spot
    for j in range(BLOCK):
        dx, dy, dz = x - w[at + j], y - w[at + BLOCK + j], z - w[at + 2 * BLOCK + j]
        square = dx * dx + dy * dy + dz * dz
        inverse = _1 / math.sqrt(max(square, np.float32(1e-12)))
        dx, dy, dz = dx * inverse, dy * inverse, dz * inverse
        along = -(dx * ax + dy * ay + dz * az)
        share = min(max((along - inner) * fade, _0), _1)
        cone = ball + area * max(along, _0) + spot * share * share * (np.float32(3.0) - _2 * share)
        w[towards + j], w[towards + BLOCK + j], w[towards + 2 * BLOCK + j] = dx, dy, dz
        w[strength + j] = power * cone / (max(square, NEAREST_SQUARE) + spread)


@compiled(**OPTIONS)
def march(
    extinction: np.ndarray, low: np.ndarray, cell: float, steps: int, lamps: np.ndarray, points: np.ndarray, seen: np.ndarray,
    first: int, last: int,
) -> None:  # fmt: skip
    """Dim what points see of a lamp by a cloud before it; see `hair_shading.through`.

    Args:
        extinction: At the middles of cells, 1/m, [X, Y, Z].
        low: Corner of the grid, [3].
        cell: Side of a cell and length of a step, metres.
        steps: At most.
        lamps: One row of `shading.lamp_rows`, [1, LAMP_VALUES].
        points: [N, 3].
        seen: Changed, [N].
        first: Row of `points`.
        last: The row after the last.
    """
    inverse, length = np.float32(1.0 / cell), np.float32(cell)
    wide, high, deep = extinction.shape
    for i in range(first, last):
        if seen[i] <= _0:
            continue
        lx, ly, lz, _ = arriving(lamps, 0, points[i, 0], points[i, 1], points[i, 2])
        # in cells from the middle of the first one; half a step ahead
        x = (points[i, 0] - low[0]) * inverse - _HALF + _HALF * lx
        y = (points[i, 1] - low[1]) * inverse - _HALF + _HALF * ly
        z = (points[i, 2] - low[2]) * inverse - _HALF + _HALF * lz
        total = _0
        for _step in range(steps):
            if x >= _0 and y >= _0 and z >= _0:
                a, b, c = int(x), int(y), int(z)
                if a < wide - 1 and b < high - 1 and c < deep - 1:
                    u, v, w = x - np.float32(a), y - np.float32(b), z - np.float32(c)
                    near = (_1 - w) * extinction[a, b, c] + w * extinction[a, b, c + 1]
                    beside = (_1 - w) * extinction[a, b + 1, c] + w * extinction[a, b + 1, c + 1]
                    ahead = (_1 - w) * extinction[a + 1, b, c] + w * extinction[a + 1, b, c + 1]
                    across = (_1 - w) * extinction[a + 1, b + 1, c] + w * extinction[a + 1, b + 1, c + 1]
                    total += (_1 - u) * ((_1 - v) * near + v * beside) + u * ((_1 - v) * ahead + v * across)
            x, y, z = x + lx, y + ly, z + lz
        seen[i] *= math.exp(-total * length)


@compiled(**OPTIONS)
def touch(points: np.ndarray, to_grid: np.ndarray, touched: np.ndarray, first: int, last: int) -> None:
    """Mark the places of a grid between which some points lie; see `hair_shading.LightGrid.around_points`.

    Args:
        points: [N, 3].
        to_grid: Coordinates of the grid, [3, 4].
        touched: Written, [X, Y, Z] bool.
        first: Row of `points`.
        last: The row after the last.
    """
    most_x, most_y, most_z = touched.shape[0] - 2, touched.shape[1] - 2, touched.shape[2] - 2
    last_a = last_b = last_c = -1
    flat, up, across = touched.reshape(-1), touched.shape[2], touched.shape[1] * touched.shape[2]
    for i in range(first, last):
        px, py, pz = points[i, 0], points[i, 1], points[i, 2]
        x = to_grid[0, 0] * px + to_grid[0, 1] * py + to_grid[0, 2] * pz + to_grid[0, 3]
        y = to_grid[1, 0] * px + to_grid[1, 1] * py + to_grid[1, 2] * pz + to_grid[1, 3]
        z = to_grid[2, 0] * px + to_grid[2, 1] * py + to_grid[2, 2] * pz + to_grid[2, 3]
        a, b, c = min(max(int(x), 0), most_x), min(max(int(y), 0), most_y), min(max(int(z), 0), most_z)
        if a == last_a and b == last_b and c == last_c:  # as most pieces of a strand and the ones before them
            continue
        last_a, last_b, last_c = a, b, c
        at = (a * touched.shape[1] + b) * touched.shape[2] + c
        for row in (at, at + up, at + across, at + across + up):
            flat[row] = flat[row + 1] = True


# --- light at points ---------------------------------------------------------------------------------------------------------


@compiled(inline="always", **OPTIONS)
def harmonics_of(x: float, y: float, z: float) -> tuple[Any, ...]:
    """`surroundings.basis` of a unit vector."""
    return (
        np.float32(0.282095), np.float32(0.488603) * y, np.float32(0.488603) * z, np.float32(0.488603) * x,
        np.float32(1.092548) * x * y, np.float32(1.092548) * y * z, np.float32(0.315392) * (np.float32(3.0) * z * z - _1),
        np.float32(1.092548) * x * z, np.float32(0.546274) * (x * x - y * y),
    )  # fmt: skip


@compiled(**OPTIONS)
def relative(
    light: np.ndarray, corners: np.ndarray, bounced: np.ndarray, weights: np.ndarray, rig: np.ndarray, learned: np.ndarray,
    inside: np.ndarray, gloss: float, most: float, least: float, first: int, last: int,
) -> None:  # fmt: skip
    """Turn what arrives into what changes colors; see `shading.relative`.

    Args:
        light: Of `shade`; overwritten, [N, 8].
        corners: [N, 3], or [0, 3]: nothing bounces.
        bounced: [V, 3].
        weights: As `corners`.
        rig: [N, 3].
        learned: Highlights, [N, 3].
        inside: Irradiance of what faces away, [3], or [0].
        gloss: Their factor.
        most: Of a ratio.
        least: Cover that counts of what faces away.
        first: Row of `light`.
        last: The row after the last.
    """
    shine, limit, third = np.float32(gloss), np.float32(most), np.float32(1.0 / (3.0 * math.pi))
    for i in range(first, last):
        weight = light[i, 6] * (rig[i, 0] + rig[i, 1] + rig[i, 2]) * third
        for k in range(3):
            more = _0
            if len(corners):
                a, b, c = corners[i, 0], corners[i, 1], corners[i, 2]
                more = weights[i, 0] * bounced[a, k] + weights[i, 1] * bounced[b, k] + weights[i, 2] * bounced[c, k]
            there = light[i, k] + more
            if len(inside) and light[i, 6] <= least:
                there = inside[k]
            ratio = min(max(there / rig[i, k], _0), limit)
            light[i, k] = ratio * weight
            light[i, 3 + k] = (light[i, 3 + k] - shine * learned[i, k] * ratio) * weight
        light[i, 6] = weight
        light[i, 7] *= weight


@compiled(**OPTIONS)
def learned(light: np.ndarray, least: float, rig: np.ndarray, highlights: np.ndarray, first: int, last: int) -> None:
    """Write what `shading.Learned.of` makes of light, [N, 8]: irradiance of `least` at least, and highlights, both [N, 3]."""
    for i in range(first, last):
        for k in range(3):
            rig[i, k], highlights[i, k] = max(light[i, k], least), light[i, 3 + k]


@compiled(**OPTIONS)
def thrown_back(
    patch: np.ndarray, area: np.ndarray, irradiance: np.ndarray, albedo: np.ndarray, sums: np.ndarray
) -> None:  # fmt: skip
    """Add what patches of skin throw back to zeros, [P, 3]; see `bounce.Exchange`."""
    for i in range(len(patch)):
        for c in range(3):
            sums[patch[i], c] += area[i] * irradiance[i, c] * albedo[c]


@compiled(**OPTIONS)
def bounced(givers: np.ndarray, shares: np.ndarray, sums: np.ndarray, out: np.ndarray, first: int, last: int) -> None:
    """Write what comes from patches of skin, of `thrown_back`, to vertices, [V, 3]; see `bounce.Exchange`."""
    for i in range(first, last):
        r = g = b = _0
        for k in range(givers.shape[1]):
            share, p = shares[i, k], givers[i, k]
            r, g, b = r + share * sums[p, 0], g + share * sums[p, 1], b + share * sums[p, 2]
        out[i, 0], out[i, 1], out[i, 2] = r, g, b


@compiled(**OPTIONS)
def strongest(
    vertices: np.ndarray, normals: np.ndarray, middles: np.ndarray, facing: np.ndarray, whole: np.ndarray,
    givers: np.ndarray, factors: np.ndarray, first: int, last: int,
) -> None:  # fmt: skip
    """Write the patches [P] with the greatest form factors and these, [V, K], zeros before; see `bounce.Exchange`.

    Vertices, middles and their normals are float64, [V, 3] and [P, 3], and so are the patches' areas, [P], and the factors.
    """
    most = givers.shape[1]
    for i in range(first, last):
        x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
        for p in range(len(middles)):
            dx, dy, dz = middles[p, 0] - x, middles[p, 1] - y, middles[p, 2] - z
            arriving = normals[i, 0] * dx + normals[i, 1] * dy + normals[i, 2] * dz
            leaving = -(facing[p, 0] * dx + facing[p, 1] * dy + facing[p, 2] * dz)
            if arriving <= 0.0 or leaving <= 0.0:
                continue
            square = dx * dx + dy * dy + dz * dz + whole[p] / math.pi
            factor = arriving * leaving * whole[p] / (square * square)
            if factor <= factors[i, most - 1]:
                continue
            k = most - 1
            while k > 0 and factors[i, k - 1] < factor:
                factors[i, k], givers[i, k] = factors[i, k - 1], givers[i, k - 1]
                k -= 1
            factors[i, k], givers[i, k] = factor, p
