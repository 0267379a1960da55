"""Small pictures of an avatar made by the session: thumbnails of poses, tiles of contact sheets.

What `portrait` returns touches no Blender data and may run on any thread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ..grmm_core.controls.frame import Controls
from ..grmm_core.geometry.camera import Camera
from ..grmm_core.session import Instance, RenderOptions
from . import session_host

OVERSAMPLING = 2  # small pictures of the model are rough; larger ones made smaller are not


def with_expression(controls: Controls, values: dict[str, float]) -> Controls:
    """Return controls whose named expressions are exactly `values`; everything else stays."""
    return replace(controls, aligned=Controls().set_named(values).aligned)


def portrait(
    source: str,
    controls: Controls,
    camera_of: Callable[[int], Camera],
    size: int,
    background: tuple[float, float, float] | None,
) -> Callable[[Callable[[], bool]], np.ndarray]:
    """Return the work that draws one avatar.

    Args:
        source: The avatar's source.
        controls: Its controls.
        camera_of: Camera for a picture of a given size.
        size: Pixels of the square picture.
        background: Display sRGB, or None for transparent.

    Returns:
        A function of a cancel check that returns display sRGB with straight alpha, [size, size, 4] float32, top row first. It
        raises `GrmmError`.
    """

    def draw(should_cancel: Callable[[], bool]) -> np.ndarray:
        from ..grmm_core.pictures.color import straight_rgba

        info = session_host.open_avatar(source)
        options = RenderOptions(passes=("rgb", "alpha"), background=background)
        camera = camera_of(size * OVERSAMPLING)
        buffers = session_host.get_session().render([Instance(info.id, controls)], camera, options, should_cancel)
        small = {name: _smaller(values) for name, values in buffers.items()}
        if background is not None:
            return np.concatenate([small["rgb"], np.ones_like(small["alpha"])], -1)
        return straight_rgba(small["rgb"], small["alpha"])

    return draw


def _smaller(values: np.ndarray) -> np.ndarray:
    """Average blocks of `OVERSAMPLING` pixels, [2H, 2W, C] -> [H, W, C]."""
    height, width, channels = values.shape
    blocks = values.reshape(height // OVERSAMPLING, OVERSAMPLING, width // OVERSAMPLING, OVERSAMPLING, channels)
    return blocks.mean(axis=(1, 3))
