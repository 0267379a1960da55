"""The 52 ARKit shapes in FLAME's expression space, jaw and eyes: computed from the user's file, not from a table.

FLAME's expression components have no names. What each ARKit shape of the open head does to the skin is carried to FLAME by
correspondence (`flame_align`), and the expression coefficients and jaw rotation that do most nearly the same are solved for.
Where the eyes look is taken from the open head as it is: it is a rotation in both. Called by `flame`; needs numpy only.
"""

from __future__ import annotations

import numpy as np

from ..controls.names import ARKIT_NAMES, JOINT_NAMES
from ..geometry.rotations import euler_to_matrix
from ..geometry.triangles import face_areas, spread_to_corners
from .flame_align import Correspondence
from .flame_regions import FlameSurface
from .head_model import HeadModel
from .skinning import posed_vertices

_JAW = JOINT_NAMES.index("jaw")
_EYES = (JOINT_NAMES.index("left_eye"), JOINT_NAMES.index("right_eye"))
_JAW_SHAPES = {"jawOpen": (0,), "jawLeft": (0, 1, 2), "jawRight": (0, 1, 2), "jawForward": (), "tongueOut": (0,)}  # free axes
_MAX_JAW = 0.6  # radians
_RIDGE = 2e-3  # of the mean diagonal; FLAME's components have unit variance, so this favours probable faces
_STEPS = 4
_DELTA = 1e-3  # radians
_NEAR = 0.006  # metres: correspondences that are further off count less


def arkit_map(
    surface: FlameSurface, correspondence: Correspondence, flame: HeadModel, head: HeadModel
) -> tuple[np.ndarray, np.ndarray]:
    """Solve for all shapes.

    Args:
        surface: Parts of the FLAME mesh.
        correspondence: Between its skin and the open head.
        flame: FLAME; its own map is not read.
        head: The open head.

    Returns:
        Expression coefficients, [52, E], and XYZ Euler angles in radians, [52, 5, 3], per unit of each shape.
    """
    skin = surface.skin
    trust = np.exp(-((correspondence.distance / _NEAR) ** 2))
    trust[np.isin(skin, surface.inner_mouth)] = 0.0  # the open head's outer skin says nothing about it; it follows the lips
    around = spread_to_corners(face_areas(surface.vertices, surface.faces) / 3, surface.faces, len(surface.vertices))  # [V]
    weight = np.sqrt(around[skin] * trust)[:, None]  # [M, 1]
    basis = (flame.expression_dirs[skin].astype(np.float64) * weight[..., None]).reshape(len(skin) * 3, -1)
    normal = basis.T @ basis
    normal += np.eye(len(normal)) * _RIDGE * max(float(np.trace(normal)) / len(normal), 1e-20)
    coefficients = np.zeros((len(ARKIT_NAMES), basis.shape[1]))
    pose = np.zeros((len(ARKIT_NAMES), len(JOINT_NAMES), 3))
    open_map, open_pose = head.arkit_to_expression, head.arkit_pose
    for index, name in enumerate(ARKIT_NAMES):
        row = open_map[index]
        angles = head.pose_of(row) + open_pose[index]
        moved = head.vertices(np.zeros(0), row, angles) - head.v_template  # [V_open, 3]
        wanted = (correspondence.carry(moved.astype(np.float64)) * correspondence.scale * weight).reshape(-1)
        turn = np.zeros(3)
        axes = _JAW_SHAPES.get(name, ())
        if axes:
            turn = _solve_jaw(flame, skin, weight, wanted, axes)
            wanted = wanted - (_jaw_moves(flame, turn)[skin] * weight).reshape(-1)
        coefficients[index] = np.linalg.solve(normal, basis.T @ wanted)
        pose[index, _JAW] = turn
        for eye in _EYES:
            pose[index, eye] = angles[eye]
    return coefficients.astype(np.float32), pose.astype(np.float32)


def _jaw_moves(flame: HeadModel, turn: np.ndarray) -> np.ndarray:
    """What a jaw rotation alone moves, with pose correctives, metres, [V, 3]."""
    euler = np.zeros((len(JOINT_NAMES), 3))
    euler[_JAW] = turn
    template = flame.v_template.astype(np.float64)
    joints, parents = flame.joint_template.astype(np.float64), flame.parents.tolist()
    return posed_vertices(template, euler_to_matrix(euler), joints, flame.weights, parents, flame.posedirs) - template


def _solve_jaw(flame: HeadModel, skin: np.ndarray, weight: np.ndarray, wanted: np.ndarray, axes: tuple[int, ...]) -> np.ndarray:
    """Gauss-Newton for the jaw's angles alone; what they leave goes to the expression, which must not take over their work."""
    turn = np.zeros(3)
    for _ in range(_STEPS):
        at = (_jaw_moves(flame, turn)[skin] * weight).reshape(-1)
        slopes = []
        for axis in axes:
            ahead = turn.copy()
            ahead[axis] += _DELTA
            slopes.append(((_jaw_moves(flame, ahead)[skin] * weight).reshape(-1) - at) / _DELTA)
        step = np.linalg.lstsq(np.stack(slopes, 1), wanted - at, rcond=1e-6)[0]
        turn[list(axes)] = np.clip(turn[list(axes)] + step, -_MAX_JAW, _MAX_JAW)
    return turn
