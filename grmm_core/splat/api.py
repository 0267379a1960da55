"""The rasteriser's front door: checks the input, finds the backend (`backends.py`), and calls it.

Torch, numba and gsplat are imported on first use, so that this module can be imported where they are missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..errors import BackendError, RuntimeMissingError, ShapeError
from .backends import choose_backend, find_backend, installed
from .rules import View
from .types import GaussianArrays, Gaussians, PictureArrays, RasterOutput

if TYPE_CHECKING:
    from torch import Tensor

    from ..geometry.camera import Camera


def _check_background(shape: Sequence[int], camera: Camera) -> None:
    if tuple(shape) not in ((3,), (camera.height, camera.width, 3)):
        raise ShapeError(f"The background has the shape {list(shape)}; [3] or [{camera.height}, {camera.width}, 3] is needed.")


def _background(background: Any, gaussians: Gaussians, camera: Camera) -> Tensor | None:
    """Return the background as a tensor [3] or [H, W, 3] like the means; None stays None."""
    if background is None:
        return None
    import torch

    ground = torch.as_tensor(background, device=gaussians.means.device, dtype=gaussians.means.dtype)
    _check_background(ground.shape, camera)
    return ground


def rasterize(
    gaussians: Gaussians,
    camera: Camera,
    background: Tensor | Sequence[float] | None = None,
    backend: str = "auto",
    antialiased: bool = False,
    frame: Camera | None = None,
    motion: Tensor | None = None,
) -> RasterOutput[Tensor]:
    """Draw Gaussians: color, cover, expected depth and features in one pass, differentiable in all of their parameters.

    The rules of 3DGS but for a pixel's end (`rules.py`): perspective expanded within 1.3 times the field of view, 0.3 px^2
    dilation, Gaussians skipped where they cover less than 1 / 255, the one that would take a pixel's transmittance below
    1 / 255 covers what is left of it, nothing nearer than 0.01 m; equal depths (as float32) keep the order of their index.
    Gaussians with non-finite numbers are dropped. The backends "cpu" and "cuda" compute in float32.

    Args:
        gaussians: The scene.
        camera: Perspective or orthographic; crops and lens shift are a moved principal point.
        background: [3] or [H, W, 3] colors behind the scene; black when None.
        backend: "torch", "cpu", "cuda", another one of the table, or "auto": the fastest for the tensors' device.
        antialiased: Compensate opacities for the dilation (Mip-Splatting), which keeps small Gaussians from swelling.
        frame: The camera of the whole picture where `camera` is a crop of it; see `rules.View.of`.
        motion: [6] rotation vector (radians) and translation (metres) in the camera's axes, applied to the scene in front of
            it; zeros change nothing. This is how a camera's pose gets gradients.

    Raises:
        ShapeError: A tensor's shape, type or device does not fit.
        BackendError: The backend is not available here, or the scene is too large for it.
    """
    if not installed("torch"):
        raise RuntimeMissingError("Drawing Gaussians needs torch, which is not installed here.")
    gaussians.validate()
    ground = _background(background, gaussians, camera)
    if motion is not None:
        from .motion import moved

        gaussians, camera = moved(gaussians, camera, motion)
    view = View.of(camera, frame)
    draw = find_backend(choose_backend(gaussians.means.device.type) if backend == "auto" else backend).load()
    return draw(gaussians, view, ground, antialiased)


def rasterize_arrays(
    gaussians: GaussianArrays,
    camera: Camera,
    background: np.ndarray | Sequence[float] = (0.0, 0.0, 0.0),
    antialiased: bool = False,
    frame: Camera | None = None,
    halved: int = 0,
) -> PictureArrays:
    """Draw Gaussians given as arrays with the compiled kernels, as `rasterize` does with tensors; needs numba, not torch.

    Args:
        gaussians: The scene.
        camera: As in `rasterize`.
        background: [3] or [H, W, 3] colors behind the scene.
        antialiased: As in `rasterize`.
        frame: As in `rasterize`.
        halved: So many of the last features come as means over 2 x 2 pixels, `halves`, which takes less time.

    Raises:
        ShapeError: An array's shape does not fit.
        BackendError: Numba is not installed, or the scene is too large.
    """
    if not installed("numba"):
        raise BackendError("The CPU rasteriser needs numba, which is not installed here.")
    from .cpu.drawing import draw

    ground = np.ascontiguousarray(background, np.float32)
    _check_background(ground.shape, camera)
    ground = ground.reshape(1, 1, 3) if ground.ndim == 1 else ground
    return draw(gaussians.prepared(), ground, View.of(camera, frame), antialiased, halved)[0]
