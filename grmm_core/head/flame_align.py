"""Correspondence between a user's FLAME mesh and the open head, from geometry alone.

Eyes, mouth corners and points of the profile are found on both heads by the same rules; a similarity and a smooth warp take the
open head onto FLAME, and each skin vertex of FLAME gets the open head's vertices that lie nearest in place, direction and
jaw weight. Regions, landmarks, texture density and the ARKit map come from it. Called by `flame`; needs numpy only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..errors import FileFormatError
from ..geometry.triangles import vertex_normals
from .flame_regions import FlameSurface
from .head_model import HeadModel

_BAND = 0.1  # half width of the midline's band, in distances from mouth to eyes
_NORMAL_WEIGHT = 0.012  # metres for opposite directions: half of this apart
_JAW_WEIGHT = 0.02  # metres between what the jaw carries and what it does not: upper and lower lip
_NEIGHBOURS = 4
_SMOOTH = 1e-3
_CHUNK = 256
_OUTER = ("face", "scalp", "neck", "ears")


@dataclass(frozen=True)
class Correspondence:
    """FLAME's skin in terms of the open head.

    Attributes:
        scale: Size of FLAME's head over the open head's.
        shift: Metres: FLAME = scale * open + shift.
        nearest: Vertices of the open head for each vertex of FLAME's skin, [M, 4].
        mix: Their shares, rows sum to 1, [M, 4].
        distance: Metres to the nearest one after the warp, [M].
        warped: The open head's vertices on FLAME, metres, [V_open, 3].
    """

    scale: float
    shift: np.ndarray
    nearest: np.ndarray
    mix: np.ndarray
    distance: np.ndarray
    warped: np.ndarray

    def carry(self, values: np.ndarray) -> np.ndarray:
        """Values at the open head's vertices [V_open, ...] at FLAME's skin vertices, [M, ...]."""
        return np.einsum("mk,mk...->m...", self.mix, values[self.nearest])

    def to_open(self, points: np.ndarray) -> np.ndarray:
        """Points on FLAME in the open head's coordinates, by the similarity only, [n, 3]."""
        return (points - self.shift) / self.scale


def correspond(surface: FlameSurface, jaw_weights: np.ndarray, head: HeadModel, label: str) -> Correspondence:
    """Find the correspondence.

    Args:
        surface: Parts of the FLAME mesh.
        jaw_weights: Skinning weights of FLAME's jaw, [V].
        head: The open head.
        label: The file's name, for messages.

    Raises:
        FileFormatError: The mesh has no profile like a face's.
    """
    vertices = head.v_template.astype(np.float64)
    normals = vertex_normals(vertices, head.faces)
    outer = np.unique(np.concatenate([head.regions[name] for name in _OUTER]))
    eyes = np.stack([vertices[head.regions[f"{side}_eyeball"]].mean(0) for side in ("left", "right")])
    inner_lips = head.landmark_positions(vertices)[60:68]
    corners = inner_lips[[4, 0]]  # iBUG's 64 is the subject's left corner
    source = _anchors(vertices[outer], normals[outer], eyes, corners)
    skin = surface.skin
    target = _anchors(surface.vertices[skin], surface.normals[skin], surface.eye_centres, surface.mouth_corners)
    if source is None or target is None:
        raise FileFormatError(
            f"The mesh in {label} has no face between its eyes and its neck; choose an unchanged FLAME model."
        )
    scale = float(np.linalg.norm(target - target.mean(0)) / np.linalg.norm(source - source.mean(0)))
    shift = target.mean(0) - scale * source.mean(0)
    warped = _warp(scale * source + shift, target, scale * vertices + shift)
    warped_normals = vertex_normals(warped, head.faces)
    open_features = np.concatenate(
        [warped[outer], _NORMAL_WEIGHT * warped_normals[outer], _JAW_WEIGHT * head.weights[outer, 2:3]], 1
    )
    own = np.concatenate(
        [surface.vertices[skin], _NORMAL_WEIGHT * surface.normals[skin], _JAW_WEIGHT * jaw_weights[skin, None]], 1
    )
    nearest, squares = _nearest(open_features, own)
    mix = 1.0 / (squares + 1e-6)
    nearest = outer[nearest]
    distance = np.linalg.norm(warped[nearest[:, 0]] - surface.vertices[skin], axis=1)
    return Correspondence(scale, shift, nearest, mix / mix.sum(1, keepdims=True), distance, warped)


def _anchors(points: np.ndarray, normals: np.ndarray, eyes: np.ndarray, corners: np.ndarray) -> np.ndarray | None:
    """Points that both heads have: eyes, mouth corners, profile from the crown to the chin, temples; [13, 3]."""
    middle = float(eyes[:, 0].mean())
    line, level = float(corners[:, 1].mean()), float(eyes[:, 1].mean())
    unit = level - line
    if unit <= 0:
        return None
    height = (points[:, 1] - line) / unit  # 0 at the mouth, 1 at the eyes
    forward = normals[:, 2] > 0.1
    midline = np.abs(points[:, 0] - middle) < _BAND * unit
    temple = (height > 1.3) & (height < 1.7) & ~midline
    wanted = [
        (midline & forward & (height > 0.25) & (height < 0.95), points[:, 2]),  # nose
        (midline & forward & (height > 0.0) & (height < 0.2), points[:, 2]),  # upper lip
        (midline & forward & (height > -0.25) & (height <= 0.0), points[:, 2]),  # lower lip
        (midline & forward & (height > -1.0) & (height < -0.4), points[:, 2]),  # chin
        (midline & forward & (height > 1.3) & (height < 1.6), points[:, 2]),  # forehead
        (midline & (height > 1.5), points[:, 1]),  # crown
        (midline & (height > 0.5), -points[:, 2]),  # back of the head
        (temple & (points[:, 0] > middle), points[:, 0]),
        (temple & (points[:, 0] < middle), -points[:, 0]),
    ]
    result = [*eyes, *corners]
    for mark, value in wanted:
        if not mark.any():
            return None
        found = points[np.flatnonzero(mark)[np.argmax(value[mark])]].copy()
        if abs(found[0] - middle) < _BAND * unit:
            found[0] = middle
        result.append(found)
    return np.array(result)


def _warp(source: np.ndarray, target: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Move points as the anchors move, smoothly (biharmonic splines with an affine part)."""
    count = len(source)
    kernel = np.linalg.norm(source[:, None] - source[None], axis=2) + _SMOOTH * np.eye(count)
    affine = np.c_[np.ones(count), source]
    system = np.block([[kernel, affine], [affine.T, np.zeros((4, 4))]])
    # the midline's anchors are nearly in one plane: the smallest solution is taken
    solution = np.linalg.lstsq(system, np.r_[target - source, np.zeros((4, 3))], rcond=1e-9)[0]
    distance = np.linalg.norm(points[:, None] - source[None], axis=2)
    return points + distance @ solution[:count] + np.c_[np.ones(len(points)), points] @ solution[count:]


def _nearest(source: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four nearest rows of `source` for each row of `target`, and their squared distances, both [n, 4]."""
    squares = (source**2).sum(1)
    found, values = [], []
    for start in range(0, len(target), _CHUNK):
        part = target[start : start + _CHUNK]
        table = squares - 2 * part @ source.T + (part**2).sum(1, keepdims=True)
        index = np.argpartition(table, _NEIGHBOURS, axis=1)[:, :_NEIGHBOURS]
        value = np.take_along_axis(table, index, 1)
        order = np.argsort(value, axis=1, kind="stable")
        found.append(np.take_along_axis(index, order, 1))
        values.append(np.maximum(np.take_along_axis(value, order, 1), 0.0))
    return np.concatenate(found), np.concatenate(values)
