"""The bulge of the cornea, which the eyeballs of head models, plain balls, do not have: glints of lamps stand on it.

Needs numpy only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..head import HeadModel

EYEBALLS = ("left_eyeball", "right_eyeball")
_STEEPER = 0.54  # by how much more its normals turn: radii of 12 and 7.8 mm (Gullstrand's eye)
_EDGE, _END = 0.42, 0.66  # radians from the pole up to which the bulge is whole, and where the ball begins
_POLE = 0.2  # share of an eyeball's depth, from the front, whose vertices at rest tell where it looks


def on_eyes(head: HeadModel, corners: np.ndarray) -> np.ndarray:
    """Numbers of points on eyeballs, whose faces have corners [N, 3]."""
    found: np.ndarray = np.flatnonzero(head.marked(*EYEBALLS)[corners].all(1))
    return found


def bulged(head: HeadModel, vertices: np.ndarray, corners: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Unit normals at points of a head, [N, 3], those on eyeballs turned as on a cornea.

    Args:
        head: Head model.
        vertices: Posed, [V, 3] metres.
        corners: Vertices around each point, [N, 3].
        normals: Of the mesh at the points, [N, 3].
    """
    result = np.array(normals)
    for name in EYEBALLS:
        ball = np.asarray(head.regions.get(name, ()), np.int64)
        if not len(ball):
            continue
        depth = head.v_template[ball, 2]
        front = ball[depth > depth.max() - _POLE * np.ptp(depth)]
        axis = vertices[front].mean(0) - vertices[ball].mean(0)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
        inside = np.zeros(len(vertices), bool)
        inside[ball] = True
        rows = np.flatnonzero(inside[corners[:, 0]])
        along = normals[rows] @ axis
        beside = normals[rows] - along[:, None] * axis
        sine = np.linalg.norm(beside, axis=1)
        angle = np.arctan2(sine, along)
        share = np.clip((_END - angle) / (_END - _EDGE), 0.0, 1.0)
        turned = angle * (1.0 + _STEEPER * share * share * (3.0 - 2.0 * share))
        result[rows] = np.cos(turned)[:, None] * axis + (np.sin(turned) / np.maximum(sine, 1e-9))[:, None] * beside
    return result
