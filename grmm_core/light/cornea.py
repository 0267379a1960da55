"""The bulge of the cornea, which the eyeballs of head models, plain balls, do not have: glints of lamps stand on it.

Lamps of a scene have theirs by `shading`. The studio's are too wide to be seen in its pictures, and eyes without any glint look
dead: in pictures each eye gets one, about where its key lamp stands. Needs numpy only.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ..head import HeadModel

_KEY = np.array([0.45, 0.32, 0.834])  # towards the catchlight's lamp, unit: ten degrees below the rig's first, under no lid
_CATCH, _CATCH_WIDTH = 1.8, 0.06  # linear brightness of its glint in the middle, and how far normals turn within it, radians
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


def catchlight(
    head: HeadModel, vertices: np.ndarray, corners: np.ndarray, weights: np.ndarray, view: np.ndarray
) -> np.ndarray:  # fmt: skip
    """What the catchlight adds to the linear brightness of points on eyeballs, [N].

    Args:
        head: Head model.
        vertices: Posed, [V, 3] metres.
        corners: Vertices around each point, [N, 3].
        weights: Barycentric, [N, 3].
        view: Unit direction towards the viewer, head space, [3].
    """
    places = np.einsum("nk,nkx->nx", weights, vertices[corners])
    round_ = np.zeros_like(places)
    for name in EYEBALLS:
        own = head.marked(name)[corners[:, 0]]
        round_[own] = places[own] - vertices[head.regions[name]].mean(0)
    round_ /= np.maximum(np.linalg.norm(round_, axis=1, keepdims=True), 1e-9)
    normals = bulged(head, vertices, corners, round_)
    half = _KEY + view
    half = half / max(float(np.linalg.norm(half)), 1e-9)
    apart = np.arccos((normals @ half).clip(-1.0, 1.0)) / _CATCH_WIDTH
    result: np.ndarray = _CATCH * np.exp(-0.5 * apart * apart) * (normals @ view > 0.0)
    return result
