"""View-dependent color as spherical harmonics, for splat files.

The model's appearance decoder gives every Gaussian a color for each view direction of the whole head (eq. 4); splat files
hold spherical harmonics of the direction in which a Gaussian is seen. This fits the second to the first by weighted least
squares over directions around the head, for each Gaussian mostly over those from which it can be seen at all.

Called by the command line's and Blender's exporters. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

from ..controls.frame import Controls
from ..errors import ShapeError
from .api import Session
from .wearing import HairUse

MAX_DEGREE = 3
DEFAULT_DEGREE = 2  # degree 1 is 5 dB further from the render, degree 3 gains nothing more
DIRECTIONS_PER_TERM = 3
LATITUDE_LIMIT = 0.7  # sine of the steepest view; models see few cameras above or below
HIDDEN_WEIGHT = 0.03  # of views from behind, which keeps the fit tame where a Gaussian is hardly ever seen
RIDGE = 1e-3
_OWN = HairUse()
_CHUNK = 16384  # Gaussians solved at once: bounds memory

# Real spherical harmonics in the order and with the signs of 3D Gaussian splatting (Kerbl et al. 2023).
_C0 = 0.28209479177387814
_C1 = 0.4886025119029199
_C2 = (1.0925484305920792, -1.0925484305920792, 0.31539156525252005, -1.0925484305920792, 0.5462742152960396)
_C3 = (
    -0.5900435899266435, 2.890611442640554, -0.4570457994644658, 0.3731763325901154,
    -0.4570457994644658, 1.445305721320277, -0.5900435899266435,
)  # fmt: skip


def harmonic_basis(directions: np.ndarray, degree: int) -> np.ndarray:
    """Evaluate the harmonics up to a degree.

    Args:
        directions: Unit vectors from the camera to the Gaussian, [K, 3].
        degree: 0 to 3.

    Returns:
        [K, (degree + 1)^2].
    """
    x, y, z = np.asarray(directions, np.float64).T
    terms = [np.full_like(x, _C0)]
    if degree >= 1:
        terms += [-_C1 * y, _C1 * z, -_C1 * x]
    if degree >= 2:
        terms += [
            _C2[0] * x * y, _C2[1] * y * z, _C2[2] * (2 * z * z - x * x - y * y), _C2[3] * x * z, _C2[4] * (x * x - y * y),
        ]  # fmt: skip
    if degree >= 3:
        terms += [
            _C3[0] * y * (3 * x * x - y * y), _C3[1] * x * y * z, _C3[2] * y * (4 * z * z - x * x - y * y),
            _C3[3] * z * (2 * z * z - 3 * x * x - 3 * y * y), _C3[4] * x * (4 * z * z - x * x - y * y),
            _C3[5] * z * (x * x - y * y), _C3[6] * x * (x * x - 3 * y * y),
        ]  # fmt: skip
    return np.stack(terms, -1)


def fit_harmonics(
    session: Session, avatar_id: int, controls: Controls, degree: int, lod: int = 0, hair: HairUse = _OWN
) -> np.ndarray:
    """Return the coefficients of an avatar's Gaussians.

    Args:
        session: Where the avatar is open.
        avatar_id: The avatar.
        controls: Expression and pose.
        degree: 0 to 3; 0 gives the mean color over the views of each Gaussian.
        lod: As `Session.gaussians`.
        hair: Likewise.

    Returns:
        [N, (degree + 1)^2, 3] float32, with color = 0.5 + sum_k basis_k(direction) coefficient_k.

    Raises:
        ShapeError: Another degree.
        GrmmError: As `Session.gaussians`.
    """
    if not 0 <= degree <= MAX_DEGREE:
        raise ShapeError(f"The degree of the harmonics is {degree}; it must be 0 to {MAX_DEGREE}.")
    views = view_directions(DIRECTIONS_PER_TERM * (degree + 1) ** 2 + 5)
    clouds = [session.gaussians(avatar_id, controls, view, lod, hair=hair) for view in views]
    means = clouds[0].means.astype(np.float64)
    # The head is round enough for the direction from its middle to stand for the normal.
    outward = means - means.mean(0)
    outward /= np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-9)
    weights = np.maximum(outward @ views.T, 0.0) + HIDDEN_WEIGHT  # [N, K]
    basis = harmonic_basis(-views, degree)  # [K, C]
    colors = np.stack([cloud.colors for cloud in clouds], 1) - 0.5  # [N, K, 3]
    ridge = RIDGE * np.eye(basis.shape[1])
    ridge[0, 0] = 0.0  # the mean color is not pulled towards grey
    result = np.empty((len(means), basis.shape[1], 3), np.float32)
    for start in range(0, len(means), _CHUNK):
        part = slice(start, start + _CHUNK)
        left = np.einsum("nk,kc,kd->ncd", weights[part], basis, basis, optimize=True)
        right = np.einsum("nk,kc,nkx->ncx", weights[part], basis, colors[part], optimize=True)
        result[part] = np.linalg.solve(left + ridge * weights[part].sum(1)[:, None, None], right)
    return result


def view_directions(count: int) -> np.ndarray:
    """Return unit vectors spread evenly around the head, from the head towards cameras, [count, 3]."""
    index = np.arange(count) + 0.5
    height = LATITUDE_LIMIT * (2.0 * index / count - 1.0)
    angle = index * np.pi * (3.0 - np.sqrt(5.0))  # the golden angle
    radius = np.sqrt(1.0 - height**2)
    return np.stack([radius * np.sin(angle), height, radius * np.cos(angle)], -1)
