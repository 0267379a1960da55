"""From the session's buffers to the values of Blender's passes. Plain numpy; knows no Blender.

Rows run from the top in the core and from the bottom in Blender; `blender_rows` turns them at the very end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ...grmm_core.camera import Camera
from ...grmm_core.color import scene_linear_premultiplied
from ...grmm_core.session import EMPTY_DEPTH
from ...grmm_core.zbuffer import EMPTY, mean_of_samples, triangle_depth, visible_fraction
from .passes import FEATURES_IN_A_PASS, RenderPass
from .snapshot import Occluders


@dataclass(frozen=True)
class Visibility:
    """What scene meshes leave of avatars and background.

    Attributes:
        avatars: Visible part of the avatars in each pixel, 0..1, [H, W, 1]; None where nothing hides them.
        background: Part of the background that no holdout object covers, 0..1, [H, W, 1]; None for all of it.
    """

    avatars: np.ndarray | None = None
    background: np.ndarray | None = None


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
    cut_background = film and len(occluders.holdouts) > 0
    if not len(occluders.triangles) + len(occluders.holdouts):
        return Visibility()
    covered = depth < EMPTY_DEPTH
    if not cut_background and not covered.any():
        return Visibility()
    # Without holdouts only the part of the picture that avatars cover is of interest.
    rows, columns = np.nonzero(covered) if covered.any() else (np.array([0]), np.array([0]))
    y0, y1, x0, x1 = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    far = min(clip[1], float(depth[covered].max())) if covered.any() else clip[1]
    if cut_background:
        y0, y1, x0, x1, far = 0, depth.shape[0], 0, depth.shape[1], clip[1]
    part = camera.crop(int(x0), int(y0), int(x1 - x0), int(y1 - y0))
    plain = triangle_depth(occluders.triangles, part, samples, clip[0], far)
    nearest = plain
    if len(occluders.holdouts):
        holdouts = triangle_depth(occluders.holdouts, part, samples, clip[0], far)
        nearest = np.minimum(plain, holdouts)
    avatars = np.ones((*depth.shape, 1), np.float32)
    avatars[y0:y1, x0:x1, 0] = visible_fraction(depth[y0:y1, x0:x1], nearest, samples)
    background = None
    if cut_background:
        cut = (holdouts < EMPTY) & (holdouts <= plain)
        grid = cut.reshape(depth.shape[0], samples, depth.shape[1], samples)
        background = 1.0 - mean_of_samples(lambda row, column: grid[:, row, :, column], samples)[..., None]
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
    shown = visible.avatars
    if item.kind == "combined":
        return _over_world(buffers["linear"], shown, visible.background, world)
    if item.kind == "raw":
        front = scene_linear_premultiplied(buffers["raw"], buffers["alpha"])
        return _over_world(front, shown, visible.background, world)
    if item.kind == "features":
        values = np.zeros((*buffers["alpha"].shape[:2], FEATURES_IN_A_PASS), np.float32)
        group = buffers["features"][..., item.group * FEATURES_IN_A_PASS : (item.group + 1) * FEATURES_IN_A_PASS]
        values[..., : group.shape[-1]] = group
    elif item.kind == "depth":
        there = buffers["alpha"] > 0 if shown is None else (buffers["alpha"] > 0) & (shown > 0)
        return np.where(there, buffers["depth"], np.float32(EMPTY_DEPTH))
    elif item.kind == "normal":
        return buffers["normal"] if shown is None else np.where(shown > 0, buffers["normal"], np.float32(0))
    elif item.kind == "mask":
        values = np.clip(buffers["alpha"], 0, 1)
    else:
        # Several instances of an avatar share its mask; one that this view layer hides has none.
        own = [index for index, name in enumerate(avatar_names) if name == item.avatar]
        values = np.clip(buffers["mask"][..., own].sum(axis=-1, keepdims=True), 0, 1).astype(np.float32)
    return values if shown is None else values * shown


def _over_world(
    front: np.ndarray, shown: np.ndarray | None, uncut: np.ndarray | None, world: np.ndarray | None
) -> np.ndarray:
    """Put avatars over the world, [H, W, 4].

    Args:
        front: Scene-linear premultiplied colour of the avatars, [H, W, 4].
        shown: Part of the avatars that no mesh hides, [H, W, 1], or None.
        uncut: Part of the background that no holdout cuts, [H, W, 1], or None.
        world: Scene-linear colour, [3], or None for nothing.
    """
    if shown is None and world is None:
        return front
    # One channel at a time: numpy is slow at spreading a value over neighbouring ones.
    result = np.empty(front.shape, np.float32)
    for channel in range(4):
        if shown is None:
            result[..., channel] = front[..., channel]
        else:
            np.multiply(front[..., channel], shown[..., 0], out=result[..., channel])
    if world is not None:
        rest = 1.0 - result[..., 3] if uncut is None else (1.0 - result[..., 3]) * uncut[..., 0]
        for channel, value in enumerate((*world, 1.0)):
            result[..., channel] += rest * np.float32(value)
    return result


def blender_rows(values: np.ndarray) -> np.ndarray:
    """Return [H, W, C] as the flat float32 row that `RenderPass.rect.foreach_set` takes, bottom row first."""
    return np.ascontiguousarray(values[::-1], np.float32).reshape(-1)
