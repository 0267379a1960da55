"""Teeth for FLAME, which has none: 120 vertices and 168 triangles behind the lips of the user's own mesh.

Counts and order are those that VHAP and GaussianAvatars use, so that their bindings (triangle numbers below 10144) and their
offsets (5143 vertices) fit: eight rows of 15 vertices from the subject's left to the right, then front, back and biting edge of
the upper and of the lower teeth as strips of 28 triangles. Positions are our own: a dental arch whose size and place follow
the mouth opening of the mesh. Called by `flame`; needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ROW = 15
ROWS = 8
TEETH_VERTICES = ROW * ROWS
TEETH_FACES = 6 * 2 * (ROW - 1)
# rows in the order of the layout
UPPER_ROOT, LOWER_ROOT, UPPER_EDGE, LOWER_EDGE, UPPER_ROOT_BACK, UPPER_EDGE_BACK, LOWER_ROOT_BACK, LOWER_EDGE_BACK = range(ROWS)
UPPER_ROWS = (UPPER_ROOT, UPPER_EDGE, UPPER_EDGE_BACK, UPPER_ROOT_BACK)  # around the tooth, from the front's root
LOWER_ROWS = (LOWER_ROOT, LOWER_EDGE, LOWER_EDGE_BACK, LOWER_ROOT_BACK)
# strips in the order of the layout: front, back and biting edge of the upper, then of the lower teeth
_STRIPS = (
    (UPPER_ROOT, UPPER_EDGE), (UPPER_ROOT_BACK, UPPER_EDGE_BACK), (UPPER_EDGE_BACK, UPPER_EDGE),
    (LOWER_EDGE, LOWER_ROOT), (LOWER_EDGE_BACK, LOWER_ROOT_BACK), (LOWER_EDGE_BACK, LOWER_EDGE),
)  # fmt: skip
# The first corner of a triangle is part of the layout too: bindings measure along the edge from it to the second.
# Two triangles of a quad (a_i, a_i+1, b_i, b_i+1 = 0..3) per strip: left of the middle, then right of it.
_CORNERS = (
    (((0, 3, 2), (0, 1, 3)), ((0, 1, 2), (1, 3, 2))),
    (((0, 2, 3), (0, 3, 1)), ((0, 2, 1), (1, 2, 3))),
    (((0, 2, 1), (1, 2, 3)), ((0, 2, 3), (0, 3, 1))),
    (((0, 1, 2), (1, 3, 2)), ((0, 3, 2), (0, 1, 3))),
    (((2, 1, 0), (2, 3, 1)), ((2, 3, 0), (3, 1, 0))),
    (((0, 1, 2), (1, 3, 2)), ((0, 3, 2), (0, 1, 3))),
)
# sizes in widths of the mouth opening (about 5 cm)
_REACH = 0.95  # half the arch's width over half the mouth's
_DEPTH = 0.42  # how far the arch goes back
_GAP = 0.06  # between lips and teeth
_THICKNESS = 0.07
_UPPER_HEIGHT, _LOWER_HEIGHT = 0.19, 0.17
_BITE = 0.012  # the upper edge reaches this far below the lips' line, the lower edge starts here
_OVERJET = 0.03  # the lower teeth stand this far behind the upper ones
_ARCH = np.radians(75.0)
_RIDGE = 1e-6


@dataclass(frozen=True)
class Teeth:
    """What is appended to FLAME's arrays.

    Attributes:
        vertices: Metres, [120, 3].
        faces: Numbers of the teeth's own vertices, 0..119, [168, 3].
        shape_dirs: [120, 3, S].
        weights: Upper teeth follow the neck, lower ones the jaw, [120, 5].
    """

    vertices: np.ndarray
    faces: np.ndarray
    shape_dirs: np.ndarray
    weights: np.ndarray


def build_teeth(mouth: np.ndarray, mouth_dirs: np.ndarray) -> Teeth:
    """Teeth behind a mouth opening.

    Args:
        mouth: Positions along the opening's rim in any order, metres, [n, 3].
        mouth_dirs: Shape directions of these vertices, [n, 3, S].
    """
    vertices = _arches(mouth)
    weights = np.zeros((TEETH_VERTICES, 5))
    for rows, joint in ((UPPER_ROWS, 1), (LOWER_ROWS, 2)):
        for row in rows:
            weights[row * ROW : (row + 1) * ROW, joint] = 1.0
    return Teeth(vertices, teeth_faces(), _follow(mouth, mouth_dirs, vertices), weights)


def teeth_faces() -> np.ndarray:
    """Triangles of the layout, counter-clockwise from outside, [168, 3]."""
    faces = []
    for (first, second), (left, right) in zip(_STRIPS, _CORNERS, strict=True):
        for i in range(ROW - 1):
            quad = (first * ROW + i, first * ROW + i + 1, second * ROW + i, second * ROW + i + 1)
            faces += [[quad[corner] for corner in triangle] for triangle in (left if i < ROW // 2 else right)]
    return np.array(faces, np.int32)


def _arches(mouth: np.ndarray) -> np.ndarray:
    left, right = mouth[np.argmax(mouth[:, 0])], mouth[np.argmin(mouth[:, 0])]
    width = float(left[0] - right[0])
    middle = 0.5 * (left[0] + right[0])
    line = float(mouth[:, 1].mean())
    angle = np.linspace(1.0, -1.0, ROW) * _ARCH  # the subject's left first
    x = middle + 0.5 * width * _REACH * np.sin(angle) / np.sin(_ARCH)  # [15]
    arch = _DEPTH * width * (1 - np.cos(angle)) / (1 - np.cos(_ARCH))  # [15]
    # behind the rim everywhere: its rearmost depth near each x
    near = np.exp(-(((x[:, None] - mouth[None, :, 0]) / (0.08 * width)) ** 2)) + 1e-12  # [15, n]
    rim = (near * mouth[None, :, 2]).sum(1) / near.sum(1)
    front = np.minimum(rim[ROW // 2] - arch, rim) - _GAP * width
    rows = np.zeros((ROWS, ROW, 3))
    rows[..., 0] = x
    edge_upper, edge_lower = line - _BITE * width, line - 2 * _BITE * width
    for row, height, back in (
        (UPPER_ROOT, edge_upper + _UPPER_HEIGHT * width, 0.0), (UPPER_EDGE, edge_upper, 0.0),
        (UPPER_ROOT_BACK, edge_upper + _UPPER_HEIGHT * width, _THICKNESS), (UPPER_EDGE_BACK, edge_upper, _THICKNESS),
        (LOWER_ROOT, edge_lower - _LOWER_HEIGHT * width, _OVERJET), (LOWER_EDGE, edge_lower, _OVERJET),
        (LOWER_ROOT_BACK, edge_lower - _LOWER_HEIGHT * width, _OVERJET + _THICKNESS),
        (LOWER_EDGE_BACK, edge_lower, _OVERJET + _THICKNESS),
    ):  # fmt: skip
        rows[row, :, 1] = height
        rows[row, :, 2] = front - back * width
    return rows.reshape(-1, 3)


def _follow(mouth: np.ndarray, mouth_dirs: np.ndarray, vertices: np.ndarray) -> np.ndarray:
    """Move as a rigid, evenly scaled body as well as possible like the mouth's rim, [120, 3, S].

    Shift t, turn w and growth g by least squares over the rim: d(p) = t + w x (p - c) + g (p - c).
    """
    centre = mouth.mean(0)
    system = _similarity_system(mouth - centre)  # [3 n, 7]
    normal = system.T @ system
    normal += np.eye(7) * _RIDGE * np.trace(normal) / 7
    motion = np.linalg.solve(normal, system.T @ mouth_dirs.reshape(len(mouth) * 3, -1))  # [7, S]
    return (_similarity_system(vertices - centre) @ motion).reshape(TEETH_VERTICES, 3, -1)


def _similarity_system(arms: np.ndarray) -> np.ndarray:
    system = np.zeros((len(arms), 3, 7))
    system[:, :, :3] = np.eye(3)
    x, y, z = arms.T
    system[:, 1, 3], system[:, 2, 3] = -z, y
    system[:, 0, 4], system[:, 2, 4] = z, -x
    system[:, 0, 5], system[:, 1, 5] = -y, x
    system[:, :, 6] = arms
    return system.reshape(-1, 7)
