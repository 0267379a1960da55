"""From the session's buffers to the values of Blender's passes. Plain numpy; knows no Blender.

Rows run from the top in the core and from the bottom in Blender; `blender_rows` turns them at the very end. What a worker has
drawn lies in memory as Blender wants it already and belongs to nobody else: passes are made in its place.
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
        [H, W, channels] float32, top row first; may take the place of the buffer that it is made from.
    """
    if item.kind == "combined":
        return _over_world(buffers["linear"], visible, world)
    if item.kind == "raw":
        return _over_world(buffers["raw_linear"], visible, world)
    if item.kind == "features":
        values = np.zeros((*buffers["alpha"].shape[:2], FEATURES_IN_A_PASS), np.float32)
        group = buffers["features"][..., item.group * FEATURES_IN_A_PASS : (item.group + 1) * FEATURES_IN_A_PASS]
        values[..., : group.shape[-1]] = group
    elif item.kind == "depth":
        values = _own(buffers["depth"])
        np.copyto(values, np.float32(EMPTY_DEPTH), where=buffers["alpha"] <= 0)
        return _without_hidden(values, visible, EMPTY_DEPTH)
    elif item.kind == "normal":
        return buffers["normal"] if visible.avatars is None else _without_hidden(_own(buffers["normal"]), visible, 0.0)
    elif item.kind in ("diffuse", "specular", "shadow"):
        values = buffers[item.kind] if visible.avatars is None else _own(buffers[item.kind])
    elif item.kind in ("mask", "hair"):
        values = np.clip(buffers["alpha" if item.kind == "mask" else "hair"][::-1], 0, 1)[::-1]  # a copy, from the bottom
    else:
        # Several instances of an avatar share its mask; one that this view layer hides has none.
        own = [index for index, name in enumerate(avatar_names) if name == item.avatar]
        mask = buffers["mask"][::-1]
        total = mask[..., own[0], None] if len(own) == 1 else mask[..., own].sum(axis=-1, keepdims=True)
        values = np.clip(total, 0, 1).astype(np.float32, copy=False)[::-1]
    return _dimmed(values, visible)


def _over_world(front: np.ndarray, visible: Visibility, world: np.ndarray | None) -> np.ndarray:
    """Put avatars over the world, [H, W, 4].

    Args:
        front: Scene-linear premultiplied color of the avatars, [H, W, 4].
        visible: What meshes leave of avatars and background.
        world: Scene-linear color, [3], or None for nothing.
    """
    if visible.avatars is None and world is None:
        return front
    result = _dimmed(_own(front), visible)
    # One channel at a time: numpy is slow at spreading a value over neighbouring ones.
    if world is not None:
        rest = 1.0 - result[..., 3] if visible.background is None else (1.0 - result[..., 3]) * visible.background[..., 0]
        for channel, value in enumerate((*world, 1.0)):
            result[..., channel] += rest * np.float32(value)
    return result


def _dimmed(values: np.ndarray, visible: Visibility) -> np.ndarray:
    """Values [H, W, C] that are ours, with each pixel's visible part left of them."""
    if visible.avatars is not None:
        hidden, shown = values[visible.part], visible.avatars[visible.part]
        for channel in range(values.shape[-1]):
            hidden[..., channel] *= shown[..., 0]
    return values


def _without_hidden(values: np.ndarray, visible: Visibility, empty: float) -> np.ndarray:
    """Values [H, W, C] that are ours, with `empty` where nothing of a pixel is seen: places and directions have no half."""
    if visible.avatars is not None:
        values[visible.part][visible.avatars[visible.part][..., 0] <= 0] = empty
    return values


def _own(values: np.ndarray) -> np.ndarray:
    """Values that may be written to, whose rows lie in memory from the bottom, so that `blender_rows` has nothing to copy.

    Those of a worker are both; those of a session in this process may be kept there, and are copied.
    """
    below = values[::-1]
    if values.strides[0] < 0 and below.flags.c_contiguous and values.flags.writeable:
        return values
    return np.array(below, np.float32)[::-1]


def stretched(values: np.ndarray, width: int, height: int) -> np.ndarray | None:
    """Return a picture [H, W, C] at another size by its nearest pixels, or None where that has another shape."""
    rows, columns = values.shape[:2]
    if (rows, columns) == (height, width):
        return values
    if abs(columns * height - rows * width) > max(rows, columns):  # by more than rounding to whole pixels
        return None
    return values[np.arange(height)[:, None] * rows // height, np.arange(width) * columns // width]


def blender_rows(values: np.ndarray) -> np.ndarray:
    """Return [H, W, C] as the flat float32 row that `RenderPass.rect.foreach_set` takes, bottom row first."""
    return np.ascontiguousarray(values[::-1], np.float32).reshape(-1)
