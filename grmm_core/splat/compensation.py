"""Mip-Splatting's filters apart from a backend: for some Gaussians of a scene, before it is drawn as a whole.

The rasterisers' own switch, `antialiased`, holds for everything they draw; a scene may hold avatars trained with it beside
others, splat files and strands (which bring a factor of their own). For numpy's arrays compiled, for tensors with gradients.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..geometry.libraries import Array, as_like, library_of
from ..geometry.rotations import quaternion_to_matrix
from .rules import COMPENSATION_MIN, DILATION, NEAR, View
from .types import Gaussians

if TYPE_CHECKING:
    from ..geometry.camera import Camera

FINEST = 4e-4  # metres of a pixel in the nearest of the pictures that a model learned from


def unresolved(camera: Camera, target: np.ndarray) -> float:
    """What a camera in a model's space lacks of the spread that training pictures gave Gaussians, square metres of the model.

    Every picture spreads Gaussians by a share of a pixel: 0 where pixels are `FINEST` or larger.

    Args:
        camera: From where they are seen, `Camera.transformed` by the model's placement, which may scale it.
        target: Where pixels are measured, [3].
    """
    scale = abs(np.linalg.det(camera.world_to_camera[:3, :3])) ** (1.0 / 3.0)
    depth = 1.0 if camera.orthographic else max(float(camera.project(target[None])[0][0, 2]), NEAR)
    return max(0.0, DILATION * (FINEST**2 - (depth / (camera.fx * scale)) ** 2))


def widened(scales: Array, missing: float) -> tuple[Array, Array | float]:
    """Widen Gaussians in a close-up by what a pixel of the training pictures did: the smoothing filter in 3D.

    Those of an iris learned to be a closed surface with it; nearer than they were seen, the spread shrinks to nothing and gaps
    open.

    Args:
        scales: Standard deviations, the last along the surface's normal, which stays, [N, 3].
        missing: See `unresolved`; nothing is changed where it is 0.

    Returns:
        Scales [N, 3], and what the opacities are to be multiplied by, [N] or 1.
    """
    if missing <= 0.0:
        return scales, 1.0
    flat = (scales[:, :2] ** 2 + missing) ** 0.5
    area: Array = scales[:, :2].prod(-1) / flat.prod(-1)
    return library_of(scales).concatenate([flat, scales[:, 2:]], -1), area


def filtered(gaussians: Gaussians, camera: Camera, target: np.ndarray) -> Gaussians:
    """Gaussians as a camera shall see them: `widened` where it is near, and their opacities with `compensation`."""
    scales, spread = widened(gaussians.scales, unresolved(camera, target))
    kept = compensation(gaussians.means, gaussians.quats, scales, camera)
    return replace(gaussians, scales=scales, opacities=gaussians.opacities * kept * spread)


def compensation(means: Array, quats: Array, scales: Array, camera: Camera) -> Array:
    """Return sqrt(det / det_dilated) of projected Gaussians, [N]: a twin of `reference.project`.

    Args:
        means: World space, [N, 3].
        quats: wxyz, [N, 4], of any length.
        scales: Standard deviations, [N, 3].
        camera: From where they are seen.
    """
    if isinstance(means, np.ndarray):
        return _compiled(means, quats, scales, camera)
    library, view = library_of(means), View.of(camera)
    rotation = as_like(view.rotation, means)
    seen = means @ rotation.T + as_like(view.translation, means)
    axes = rotation @ (quaternion_to_matrix(quats) * scales[:, None])  # [N, 3, 3]
    if view.orthographic:
        first, second = view.fx * axes[:, 0], view.fy * axes[:, 1]
    else:
        z = library.clip(seen[:, 2], NEAR, None)
        low_x, high_x, low_y, high_y = view.clamp.tolist()
        u, v = library.clip(seen[:, 0] / z, low_x, high_x), library.clip(seen[:, 1] / z, low_y, high_y)
        first = (view.fx / z)[:, None] * (axes[:, 0] - u[:, None] * axes[:, 2])
        second = (view.fy / z)[:, None] * (axes[:, 1] - v[:, None] * axes[:, 2])
    after, before = [1, 2, 0], [2, 0, 1]
    normal = first[:, after] * second[:, before] - first[:, before] * second[:, after]  # free of cancellation
    area = (normal * normal).sum(-1)
    dilated = area + DILATION * ((first * first).sum(-1) + (second * second).sum(-1)) + DILATION**2
    result: Array = library.clip(area / dilated, COMPENSATION_MIN, None) ** 0.5
    return result


def _compiled(means: np.ndarray, quats: np.ndarray, scales: np.ndarray, camera: Camera) -> np.ndarray:
    from ..compute.threads import for_rows
    from .cpu.projection import compensate
    from .cpu.records import camera_array

    factors = np.empty(len(means), np.float32)
    parts = (np.ascontiguousarray(part, np.float32) for part in (means, quats, scales))
    for_rows(compensate, len(means), *parts, camera_array(View.of(camera), True), factors)
    return factors
