"""What a session computes with: the library behind its arrays, its models, and the two steps that are not one text.

`torch_engine` is the reference and the only one on graphics cards; `plain_engine` is what stock Blender has room for.
Everything else of a session (`local`, `evaluator`, `compose`, `clouds`) is written once for the arrays of both.
"""

from __future__ import annotations

from contextlib import AbstractContextManager
from typing import Any, Protocol

import numpy as np

from ..geometry.camera import Camera
from ..model.store import ModelStore
from ..splat.types import Gaussians, RasterOutput


class Engine(Protocol):
    """Arrays, models and pictures of one library.

    Attributes:
        store: Trained models.
        name: "torch" or "plain".
        torch: Version of torch, or "" for an engine without it.
        device: What computes, for people.
        threads: How many threads it uses.
    """

    store: ModelStore[Any]
    name: str
    torch: str
    device: str
    threads: int

    def calling(self) -> AbstractContextManager[None]:
        """Surrounds each call of a session; an exhausted memory leaves it as `MemoryError`."""
        ...

    def one_thread(self) -> AbstractContextManager[None]:
        """Surrounds work that is too small to be shared among threads."""
        ...

    def array(self, values: np.ndarray) -> Any:
        """Numbers as this library has them, float32, on its device."""
        ...

    def rasterize(self, gaussians: Gaussians, camera: Camera, halved: int = 0) -> RasterOutput[Any]:
        """Draw over black; so many of the last features may come in `halves` alone, if the engine can."""
        ...

    def scene_linear(self, rgb: Any, alpha: Any) -> Any:
        """`color.scene_linear_premultiplied` of arrays rgb [H, W, 3] and alpha [H, W]: [H, W, 4]."""
        ...
