"""What becomes of the studio's light when a head turns on its neck: the rig stays with the shoulders.

Learned colors are skin times the rig (`lamps.STUDIO`) on a head that looks ahead; what a turned one gets is found from its
normals alone, without shadows, and what expressions change is learned. On pictures of the studio that no training has seen it
is worth 1.6 dB in the face, and nothing in hair, which stays as it is. Needs numpy; numba makes it faster.
"""

from __future__ import annotations

import functools

import numpy as np

from ..controls.names import JOINT_NAMES
from ..geometry.rotations import euler_to_axis_angle, euler_to_matrix
from ..head.head_model import HeadModel
from .lamps import STUDIO, arriving
from .materials import RELIEF
from .resting import MOUTH, Texels
from .shading import uneven
from .surroundings import mean_irradiance
from .transfer import vertex_normals

_ROOT, _NECK = JOINT_NAMES.index("root"), JOINT_NAMES.index("neck")
_GAMMA = 2.2  # of display values, nearly


def turned_light(head: HeadModel, texels: Texels, vertices: np.ndarray, pose: np.ndarray) -> np.ndarray | None:
    """Irradiance of the rig on N texels over that on them before the neck turned, [N, 1] float32; None where it does not.

    The inside of the mouth, which the rig hardly reaches, stays as it is, and so does a head that is turned by its root.

    Args:
        head: Head model.
        texels: Of it.
        vertices: Posed, [V, 3] metres.
        pose: XYZ Euler angles of the five joints, [5, 3] radians.
    """
    if not np.any(pose[_NECK]):
        return None
    light = _over_before(vertex_normals(vertices, head.faces), pose, head.weights[:, _NECK:].sum(1))
    light[head.marked(*MOUTH) & ~head.marked("lips")] = 1.0
    return texels.at(light[:, None])


def turned_shade(head: HeadModel, texels: Texels, vertices: np.ndarray, pose: np.ndarray) -> np.ndarray | None:
    """What `turned_light` is of display colors: what these are multiplied by, [N, 1] float32."""
    light = turned_light(head, texels, vertices, pose)
    return None if light is None else light ** np.float32(1.0 / _GAMMA)


def _over_before(normals: np.ndarray, pose: np.ndarray, share: np.ndarray) -> np.ndarray:
    """The rig on posed normals [N, 3] that took a share [N] of the neck's turn, over that on them before, [N]."""
    normals = normals @ euler_to_matrix(np.asarray(pose[_ROOT], np.float64))
    turn = euler_to_axis_angle(np.asarray(pose[_NECK], np.float64))
    return rig_irradiance(normals) / rig_irradiance(_turned(normals, -turn, share))


def rig_irradiance(normals: np.ndarray) -> np.ndarray:
    """Irradiance of the rig, W/m2, on surfaces with unit normals [N, 3] where a head is, in the mean of colors, [N]."""
    towards, strengths, even = _rig()
    found: np.ndarray = uneven(normals @ towards.T, np.float64(RELIEF)) @ strengths + even
    return found


@functools.cache
def _rig() -> tuple[np.ndarray, np.ndarray, float]:
    """Directions of the rig's lamps [L, 3] and what arrives of each [L], and of its surroundings."""
    centre = np.zeros((1, 3))
    lamps = [(*arriving(lamp, centre), np.mean(lamp.color)) for lamp in STUDIO.lamps]
    towards, strengths = np.concatenate([lamp[0] for lamp in lamps]), np.array([lamp[1][0] * lamp[2] for lamp in lamps])
    return towards, strengths, float(np.mean(mean_irradiance(STUDIO.surroundings)))


def _turned(vectors: np.ndarray, turn: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Vectors [N, 3] turned by a share [N] of an axis-angle vector [3] (Rodrigues' formula)."""
    angle = float(np.linalg.norm(turn))
    axis = turn / max(angle, 1e-12)
    sine, cosine = np.sin(angle * share)[:, None], np.cos(angle * share)[:, None]
    along = (vectors @ axis)[:, None] * axis
    return vectors * cosine + np.cross(axis, vectors) * sine + along * (1.0 - cosine)
