"""From the session's buffers to the values of Blender's passes. Plain numpy; knows no Blender.

Rows run from the top in the core and from the bottom in Blender; `blender_rows` turns them at the very end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grmm_core.camera import Camera
from ...grmm_core.color import scene_linear_premultiplied
from ...grmm_core.session import EMPTY_DEPTH
from ...grmm_core.zbuffer import EMPTY, triangle_depth, visible_fraction
from .passes import FEATURES_IN_A_PASS, RenderPass
from .snapshot import Occluders


@dataclass(frozen=True)
class Visibility:
    """What scene meshes leave of avatars and background.

    Attributes:
        avatars: Visible part of the avatars in each pixel, 0..1, [H, W].
        background: Part of the background that no holdout object covers, 0..1, [H, W].
    """

    avatars: np.ndarray
    background: np.ndarray


def visibility(
    occluders: Occluders, depth: np.ndarray, camera: Camera, samples: int, clip: tuple[float, float], film: bool
) -> Visibility:
    """Compare the avatars' depth with that of the meshes.

    Args:
        occluders: World triangles.
        depth: The avatars' depth, `EMPTY_DEPTH` where none is, [H, W].
        camera: Camera of the picture.
        samples: Samples per pixel and direction.
        clip: Nearest and farthest distance that the camera sees.
        film: The background is drawn, so that holdouts matter beside the avatars too.
    """
    one = np.ones(depth.shape, np.float32)
    covered = depth < EMPTY_DEPTH
    cut_background = film and len(occluders.holdouts) > 0
    if not cut_background and not covered.any():
        return Visibility(one, one)
    # Without holdouts only the part of the picture that avatars cover is of interest.
    rows, columns = np.nonzero(covered) if covered.any() else (np.array([0]), np.array([0]))
    y0, y1, x0, x1 = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    far = min(clip[1], float(depth[covered].max())) if covered.any() else clip[1]
    if cut_background:
        y0, y1, x0, x1, far = 0, depth.shape[0], 0, depth.shape[1], clip[1]
    part = camera.crop(int(x0), int(y0), int(x1 - x0), int(y1 - y0))
    plain = triangle_depth(occluders.triangles, part, samples, clip[0], far)
    holdouts = triangle_depth(occluders.holdouts, part, samples, clip[0], far)
    avatars, background = one.copy(), one.copy()
    avatars[y0:y1, x0:x1] = visible_fraction(depth[y0:y1, x0:x1], np.minimum(plain, holdouts), samples)
    if cut_background:
        cut = (holdouts < EMPTY) & (holdouts <= plain)
        grid = cut.reshape(y1 - y0, samples, x1 - x0, samples)
        background[y0:y1, x0:x1] = 1.0 - grid.mean(axis=(1, 3), dtype=np.float32)
    return Visibility(avatars, background)


def pass_values(
    item: RenderPass,
    buffers: dict[str, np.ndarray],
    visible: Visibility,
    world: np.ndarray | None,
    avatar_names: list[str],
) -> np.ndarray:
    """Return the values of one pass.

    Args:
        item: The pass.
        buffers: Result of `Session.render`.
        visible: Result of `visibility`.
        world: Scene-linear colour of the background, [3], or None for a transparent film.
        avatar_names: Names of the drawn avatars, in the order of the buffer "mask".

    Returns:
        [H, W, channels] float32, top row first.
    """
    shown = visible.avatars[..., None]
    if item.kind in ("combined", "raw"):
        rgba = scene_linear_premultiplied(buffers["rgb" if item.kind == "combined" else "raw"], buffers["alpha"]) * shown
        return over_world(rgba, world, visible.background[..., None])
    if item.kind == "depth":
        there = (np.clip(buffers["alpha"], 0, 1) * shown) > 0
        return np.where(there, buffers["depth"], np.float32(EMPTY_DEPTH))
    if item.kind == "mask":
        return np.clip(buffers["alpha"], 0, 1) * shown
    if item.kind == "avatar_mask":
        # Several instances of an avatar share its mask; one that this view layer hides has none.
        own = [index for index, name in enumerate(avatar_names) if name == item.avatar]
        return np.clip(buffers["mask"][..., own].sum(axis=-1, keepdims=True), 0, 1).astype(np.float32) * shown
    if item.kind == "normal":
        return np.where(shown > 0, buffers["normal"], np.float32(0))
    features = buffers["features"] * shown
    start = item.group * FEATURES_IN_A_PASS
    result = np.zeros((*shown.shape[:2], FEATURES_IN_A_PASS), np.float32)
    group = features[..., start : start + FEATURES_IN_A_PASS]
    result[..., : group.shape[-1]] = group
    return result


def over_world(rgba: np.ndarray, world: np.ndarray | None, uncut: np.ndarray) -> np.ndarray:
    """Put premultiplied linear `rgba` [H, W, 4] over the world's colour where no holdout cuts it, `uncut` [H, W, 1]."""
    if world is None:
        return rgba.astype(np.float32)
    behind = (1.0 - rgba[..., 3:]) * uncut
    return np.concatenate([rgba[..., :3] + behind * world, rgba[..., 3:] + behind], axis=-1).astype(np.float32)


def blender_rows(values: np.ndarray) -> np.ndarray:
    """Return [H, W, C] as the flat float32 row that `RenderPass.rect.foreach_set` takes, bottom row first."""
    return np.ascontiguousarray(values[::-1], np.float32).reshape(-1)
