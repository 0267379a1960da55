"""The rasteriser's front door: checks the input, chooses a backend, and calls it.

Torch, numba and gsplat are imported on first use, so that this module can be imported where they are missing.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from ..errors import BackendError, RuntimeMissingError, ShapeError
from .rules import View
from .types import Gaussians, RasterOutput

if TYPE_CHECKING:
    from torch import Tensor

    from ..geometry.camera import Camera

Backend = Literal["auto", "torch", "cpu", "cuda"]
BACKENDS: tuple[str, ...] = ("torch", "cpu", "cuda")
CUDA_TOLERANCE = 2e-3  # relative, float32 against float32: what `available_backends` accepts of a graphics card


@dataclass(frozen=True)
class BackendInfo:
    """One backend, for `grmm info`.

    Attributes:
        name: "torch", "cpu" or "cuda".
        available: Whether it can be used here.
        detail: What it is and how far it was tested, or what is missing.
    """

    name: str
    available: bool
    detail: str


def _installed(module: str) -> bool:
    return importlib.util.find_spec(module) is not None


def available_backends() -> list[BackendInfo]:
    """Return every backend with its state on this machine.

    Imports no heavy module except torch, for its devices; where there is a CUDA device, it draws a small scene there.
    """
    if not _installed("torch"):
        return [BackendInfo(name, False, "torch is not installed") for name in BACKENDS]
    import torch

    backends = [BackendInfo("torch", True, "readable reference in PyTorch, any device; slow")]
    if _installed("numba"):
        backends.append(BackendInfo("cpu", True, "compiled with numba, all cores; tested against the reference"))
    else:
        backends.append(BackendInfo("cpu", False, "numba is not installed"))
    if not torch.cuda.is_available():
        detail = "no CUDA device; gsplat or own kernels, of which only the arithmetic is tested, never the run on a card"
        backends.append(BackendInfo("cuda", False, detail))
    else:
        backends.append(_describe_cuda())
    return backends


def _describe_cuda() -> BackendInfo:
    """Describe the backend "cuda" on a machine with a card: what runs, and whether it is right here."""
    import torch

    from .cuda.adapter import check_device, gsplat_usable

    what = "gsplat" if gsplat_usable() else "own kernels, compiled at run time"
    try:
        error = check_device(torch.device("cuda"))
    except BackendError as problem:
        return BackendInfo("cuda", False, f"{what}: {problem}")
    verdict = "as they should be" if error < CUDA_TOLERANCE else "WRONG: use the device cpu"
    return BackendInfo(
        "cuda", error < CUDA_TOLERANCE,
        f"{what}; our own tests never ran on a graphics card; checked just now on this one: pictures and gradients within "
        f"{error:.0e} of the reference, {verdict}",
    )  # fmt: skip


def choose_backend(device: str) -> str:
    """Return the fastest backend for tensors on a device ("cpu", "cuda", "mps" ...)."""
    if device == "cpu" and _installed("numba"):
        return "cpu"
    return "cuda" if device == "cuda" else "torch"


def _background(background: Any, gaussians: Gaussians, camera: Camera) -> Tensor | None:
    """Return the background as a tensor [3] or [H, W, 3] like the means; None stays None."""
    if background is None:
        return None
    import torch

    ground = torch.as_tensor(background, device=gaussians.means.device, dtype=gaussians.means.dtype)
    if tuple(ground.shape) not in ((3,), (camera.height, camera.width, 3)):
        raise ShapeError(
            f"The background has the shape {list(ground.shape)}; [3] or [{camera.height}, {camera.width}, 3] is needed."
        )
    return ground


def rasterize(
    gaussians: Gaussians,
    camera: Camera,
    background: Tensor | Sequence[float] | None = None,
    backend: Backend = "auto",
    antialiased: bool = False,
    frame: Camera | None = None,
    motion: Tensor | None = None,
) -> RasterOutput:
    """Draw Gaussians: color, cover, expected depth and features in one pass, differentiable in all of their parameters.

    Exact 3DGS rules (`rules.py`): perspective expanded within 1.3 times the field of view, 0.3 px^2 dilation, Gaussians
    skipped where they cover less than 1 / 255, cover capped at 0.999, a pixel ends before the Gaussian that would take its
    transmittance below 1e-4, nothing nearer than 0.01 m; equal depths (as float32) keep the order of their index. Gaussians
    with non-finite numbers are dropped. The backends "cpu" and "cuda" compute in float32.

    Args:
        gaussians: The scene.
        camera: Perspective or orthographic; crops and lens shift are a moved principal point.
        background: [3] or [H, W, 3] colors behind the scene; black when None.
        backend: "torch", "cpu", "cuda", or the fastest that is there for the tensors' device.
        antialiased: Compensate opacities for the dilation (Mip-Splatting), which keeps small Gaussians from swelling.
        frame: The camera of the whole picture where `camera` is a crop of it; see `rules.View.of`.
        motion: [6] rotation vector (radians) and translation (metres) in the camera's axes, applied to the scene in front of
            it; zeros change nothing. This is how a camera's pose gets gradients.

    Raises:
        ShapeError: A tensor's shape, type or device does not fit.
        BackendError: The backend is not available here, or the scene is too large for it.
    """
    if not _installed("torch"):
        raise RuntimeMissingError("Drawing Gaussians needs torch, which is not installed here.")
    gaussians.validate()
    ground = _background(background, gaussians, camera)
    if motion is not None:
        from .motion import moved

        gaussians, camera = moved(gaussians, camera, motion)
    view = View.of(camera, frame)
    name = choose_backend(gaussians.means.device.type) if backend == "auto" else backend
    if name == "torch":
        from .reference import rasterize_reference

        return rasterize_reference(gaussians, view, ground, antialiased)
    if name == "cpu":
        if not _installed("numba"):
            raise BackendError("The CPU rasteriser needs numba: install it, or use the backend 'torch'.")
        if gaussians.means.device.type != "cpu":
            raise BackendError(f"The CPU rasteriser needs tensors on the CPU; these are on {gaussians.means.device}.")
        from .cpu.function import rasterize_cpu

        return rasterize_cpu(gaussians, view, ground, antialiased)
    if name == "cuda":
        from .cuda.adapter import rasterize_cuda

        return rasterize_cuda(gaussians, view, ground, antialiased)
    raise BackendError(f"There is no rasteriser called '{name}'; there are {', '.join(BACKENDS)} and auto.")


def rasterize_batch(
    gaussians: Gaussians | Sequence[Gaussians],
    cameras: Sequence[Camera],
    background: Tensor | Sequence[float] | None = None,
    backend: Backend = "auto",
    antialiased: bool = False,
) -> list[RasterOutput]:
    """Draw several pictures, one per camera; each call uses all cores.

    Args:
        gaussians: One scene seen by all cameras, or one per camera.
        cameras: The cameras; sizes may differ.
        background: As in `rasterize`, the same for all.
        backend: As in `rasterize`.
        antialiased: As in `rasterize`.

    Raises:
        ShapeError: The numbers of scenes and cameras differ, or a scene does not fit.
    """
    scenes = [gaussians] * len(cameras) if isinstance(gaussians, Gaussians) else list(gaussians)
    if len(scenes) != len(cameras):
        raise ShapeError(f"{len(scenes)} sets of Gaussians were given for {len(cameras)} cameras.")
    return [rasterize(scene, camera, background, backend, antialiased) for scene, camera in zip(scenes, cameras, strict=True)]
