"""From the session's buffers to the values of Blender's passes. Plain numpy; knows no Blender.

Rows run from the top in the core and from the bottom in Blender; `blender_rows` turns them at the very end.
"""

from __future__ import annotations

import numpy as np

from ...grmm_core.session import EMPTY_DEPTH
from .occlusion import Visibility
from .passes import FEATURES_IN_A_PASS, RenderPass


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
        visible: What meshes leave of avatars and background.
        world: Scene-linear color of the background, [3], or None for a transparent film.
        avatar_names: Names of the drawn avatars, in the order of the buffer "mask".

    Returns:
        [H, W, channels] float32, top row first.
    """
    shown = visible.avatars
    if item.kind == "combined":
        return _over_world(buffers["linear"], visible, world)
    if item.kind == "raw":
        return _over_world(buffers["raw_linear"], visible, world)
    if item.kind == "features":
        values = np.zeros((*buffers["alpha"].shape[:2], FEATURES_IN_A_PASS), np.float32)
        group = buffers["features"][..., item.group * FEATURES_IN_A_PASS : (item.group + 1) * FEATURES_IN_A_PASS]
        values[..., : group.shape[-1]] = group
    elif item.kind == "depth":
        there = buffers["alpha"] > 0 if shown is None else (buffers["alpha"] > 0) & (shown > 0)
        return np.where(there, buffers["depth"], np.float32(EMPTY_DEPTH))
    elif item.kind == "normal":
        if shown is None:
            return buffers["normal"]
        values = _turned(buffers["normal"])
        values[visible.part][shown[visible.part][..., 0] <= 0] = 0.0
        return values
    elif item.kind in ("diffuse", "specular", "shadow"):
        values = buffers[item.kind]
    elif item.kind in ("mask", "hair"):
        values = np.clip(buffers["alpha" if item.kind == "mask" else "hair"], 0, 1)
    else:
        # Several instances of an avatar share its mask; one that this view layer hides has none.
        own = [index for index, name in enumerate(avatar_names) if name == item.avatar]
        values = np.clip(buffers["mask"][..., own].sum(axis=-1, keepdims=True), 0, 1).astype(np.float32)
    return values if shown is None else values * shown


def _over_world(front: np.ndarray, visible: Visibility, world: np.ndarray | None) -> np.ndarray:
    """Put avatars over the world, [H, W, 4].

    Args:
        front: Scene-linear premultiplied color of the avatars, [H, W, 4].
        visible: What meshes leave of avatars and background.
        world: Scene-linear color, [3], or None for nothing.
    """
    if visible.avatars is None and world is None:
        return front
    result = _turned(front)
    # One channel at a time: numpy is slow at spreading a value over neighbouring ones.
    if visible.avatars is not None:
        hidden, shown = result[visible.part], visible.avatars[visible.part]
        for channel in range(4):
            hidden[..., channel] *= shown[..., 0]
    if world is not None:
        rest = 1.0 - result[..., 3] if visible.background is None else (1.0 - result[..., 3]) * visible.background[..., 0]
        for channel, value in enumerate((*world, 1.0)):
            result[..., channel] += rest * np.float32(value)
    return result


def _turned(values: np.ndarray) -> np.ndarray:
    """A copy whose rows lie in memory from the bottom, so that `blender_rows` has nothing to copy."""
    return np.array(values[::-1], np.float32)[::-1]


def blender_rows(values: np.ndarray) -> np.ndarray:
    """Return [H, W, C] as the flat float32 row that `RenderPass.rect.foreach_set` takes, bottom row first."""
    return np.ascontiguousarray(values[::-1], np.float32).reshape(-1)
