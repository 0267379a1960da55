"""Channels that ride along with Gaussians: features and, in a scene's light, light. Called by `compose`."""

from __future__ import annotations

import numpy as np

from ..compute.buffers import empty
from ..geometry.libraries import Array, as_like, to_numpy, zeros
from ..light.shadows import compiled_kernels

_SPARE_ROWS = 4096  # by which the memory grows, that strands of another frame find it again


def with_light(
    features: Array, own: slice | None, skin: int | None, light: list[np.ndarray], at: slice, count: int
) -> Array:  # fmt: skip
    """Stack features and light.

    Args:
        features: Of the skin's Gaussians, [N, F].
        own: Their channels, or None where nobody asks.
        skin: Channel that is 1 on the skin's, or None.
        light: Of the skin's and then of strands' Gaussians, as of `LitAvatar.channels`.
        at: Channels of light: all, or the first ones.
        count: Of all channels.

    Returns:
        [R, count], zeros elsewhere.
    """
    rows = sum(map(len, light))
    wanted = at.stop - at.start
    if compiled_kernels() is None or (not isinstance(features, np.ndarray) and features.device.type != "cpu"):
        stacked = zeros((rows, count), features)
        if own is not None:
            stacked[: len(features), own] = features
        if skin is not None:
            stacked[: len(features), skin] = 1.0
        stacked[:, at] = as_like(np.concatenate(light)[:, :wanted], features)
        return stacked
    from ..compute.threads import for_rows
    from .cover_kernels import channels

    out = empty((-(-rows // _SPARE_ROWS) * _SPARE_ROWS, count))[:rows]
    more = light[1] if len(light) > 1 else light[0][:0]
    places = -1 if own is None else own.start, -1 if skin is None else skin, light[0], more, at.start, wanted
    for_rows(channels, rows, out, to_numpy(features), *places)
    return as_like(out, features)
