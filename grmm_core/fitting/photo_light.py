"""The light of a photo in nine spherical-harmonic coefficients, from the skin's colors.

Ramamoorthi and Hanrahan, "An Efficient Representation for Irradiance Environment Maps", 2001: nine coefficients describe what a
matt surface reflects to better than a few percent. Skin color and light cannot be told apart in one photo, so the coefficients
hold their product. Used by `photometric_stage`. Needs numpy only.
"""

from __future__ import annotations

import numpy as np

from ..geometry.camera import Camera
from ..geometry.triangles import vertex_normals
from ..geometry.zbuffer import triangle_depth
from ..head.head_model import HeadModel
from ..pictures.color import srgb_to_linear
from ..pictures.sampling import bilinear
from .outline import visible_skin_vertices

COEFFICIENTS = 9
_RIDGE = 0.02  # of the mean square: keeps directions that the face does not show near zero
_ROBUST_STEPS, _ROBUST_CUT = 6, 2.5
_MIN_SAMPLES = 60


def harmonics(normals: np.ndarray) -> np.ndarray:
    """Real spherical harmonics up to order 2, unnormalised: 1, x, y, z, xy, xz, yz, x^2 - y^2, 3 z^2 - 1; [N, 3] to [N, 9]."""
    x, y, z = normals[:, 0], normals[:, 1], normals[:, 2]
    return np.stack([np.ones_like(x), x, y, z, x * y, x * z, y * z, x * x - y * y, 3.0 * z * z - 1.0], axis=1)


def estimate_light(
    head: HeadModel, vertices: np.ndarray, camera: Camera, image: np.ndarray, mask: np.ndarray
) -> np.ndarray | None:
    """Light times mean skin color, by robust least squares over the visible skin.

    The color of skin with normal n (head space) is `harmonics(n) @ light` in linear RGB. Highlights, freckles and stubble
    count as outliers.

    Args:
        head: Head model.
        vertices: Its posed vertices, [V, 3], metres.
        camera: The picture's.
        image: The picture, display sRGB 0..1, [H, W, 3].
        mask: Where the person is, 0..1, [H, W].

    Returns:
        [9, 3], or None where too little skin is seen.
    """
    vertices = np.asarray(vertices, np.float64)
    chosen = visible_skin_vertices(head, vertices, camera, triangle_depth(vertices[head.faces], camera))
    pixels = camera.project(vertices[chosen])[1]
    seen = bilinear(mask, pixels) > 0.9
    chosen, pixels = chosen[seen], pixels[seen]
    if len(chosen) < _MIN_SAMPLES:
        return None
    basis = harmonics(vertex_normals(vertices, head.faces)[chosen])  # [N, 9]
    colors = srgb_to_linear(bilinear(image, pixels)).astype(np.float64)  # [N, 3]
    weights = np.ones(len(chosen))
    ridge = np.eye(COEFFICIENTS) * _RIDGE
    ridge[0, 0] = 0.0
    light = np.zeros((COEFFICIENTS, 3))
    for _ in range(_ROBUST_STEPS):
        weighted = basis * weights[:, None]
        light = np.linalg.solve(weighted.T @ basis / weights.sum() + ridge, weighted.T @ colors / weights.sum())
        distance = np.linalg.norm(basis @ light - colors, axis=1)
        scale = max(1.48 * float(np.median(distance)), 1e-4)
        weights = 1.0 / (1.0 + (distance / (_ROBUST_CUT * scale)) ** 2) ** 2
    return light
