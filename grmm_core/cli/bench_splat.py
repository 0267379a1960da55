"""The rasteriser's part of `grmm bench`: a head of the paper's size, threads, sizes, the arithmetic limit, alternatives.

Called by `bench.py`, whose `best_times` it is given. The scene is the open head with one Gaussian at each texel of an N_g x N_g
map, sized as the model places them, with random opacities, colors and features: its work is that of a trained model's frame.
"""

from __future__ import annotations

import dataclasses
import importlib.util
import os
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..geometry.camera import Camera

if TYPE_CHECKING:
    from ..splat import Gaussians

BestTimes = Callable[[Mapping[str, Callable[[], object]], int], dict[str, float]]

FEATURES = 32
GRIDS = (128, 256, 512)  # N_g; the last one is the paper's
PAPER_SIZE, QUICK_SIZE = 1024, 512  # pixels
OPACITY_MEAN = 2.0  # logit; a skin is nearly opaque
TEXEL_SCALE, NORMAL_SCALE = 0.6, 0.35
REFERENCE_GRID, REFERENCE_SIZE, REFERENCE_REPEATS = 128, 96, 2  # the readable rasteriser is slow
MATRIX = 1024  # side of the matrix product that gives the arithmetic speed of the machine
# Operations of one alpha: two subtractions, s and q, their squares, the polynomial and three squarings, opacity, cap, floor,
# transmittance, weight. A multiply-add counts as two, as in the matrix product.
ALPHA_OPERATIONS = 30
CHANNEL_OPERATIONS = 2

ALTERNATIVES: dict[str, str] = {
    "gsplat": "CUDA only",
    "diff_gaussian_rasterization": "CUDA only; three channels",
    "taichi_splatting": "CUDA only",
    "gswarp": "CUDA only, through Warp; three channels",
    "splax": "CUDA only, through JAX and Warp",
    "msplat": "Metal only",
    "gausscam": "WebGPU: color and depth in whole numbers, no gradients; a CPU only where it poses as a Vulkan device",
}
"""Published rasterisers in the Python package index. None draws feature channels, or differentiates, on a CPU."""


def head_scene(grid: int, features: int = FEATURES, seed: int = 1) -> Gaussians:
    """Return the open head as Gaussians, one a texel, in head space.

    Args:
        grid: N_g.
        features: Feature channels.
        seed: Of opacities, colors and features.
    """
    import torch

    from ..head import load_open_head
    from ..model.layout import texel_layout
    from ..model.texels import TexelAnchor, place_gaussians
    from ..splat import Gaussians

    head = load_open_head()
    layout = texel_layout(head.uv, head.uv_faces, grid)
    anchor = TexelAnchor(layout, head.faces, head.uv_faces, len(head.v_template))
    random = torch.Generator().manual_seed(seed)
    with torch.no_grad():
        frames = anchor(torch.from_numpy(np.array(head.v_template)))
        count = len(layout)
        placed = place_gaussians(frames, torch.zeros(count, 10), 0.01, 0.2, None, TEXEL_SCALE, NORMAL_SCALE)
        opacities = torch.sigmoid(OPACITY_MEAN + torch.randn(count, generator=random))
        colors = torch.rand(count, 3, generator=random)
        extra = torch.randn(count, features, generator=random)
    return Gaussians(placed.means, placed.quats, placed.scales, opacities, colors, extra)


def measure(best_times: BestTimes, repeats: int, quick: bool, device: str) -> dict[str, Any]:
    """Return all sections, by name.

    Args:
        best_times: Times alternatives in turns.
        repeats: Of each.
        quick: A smaller picture.
        device: Kind of device: "cpu", "cuda" ...
    """
    scenes = {grid: head_scene(grid).to(device) for grid in GRIDS}
    size = QUICK_SIZE if quick else PAPER_SIZE
    sections = {
        "rasteriser": channels(best_times, scenes[GRIDS[-1]], size, repeats),
        "rasteriser against plain torch": against_torch(best_times, scenes[REFERENCE_GRID]),
        "rasteriser by N_g": grids(best_times, scenes, size, repeats),
    }
    if device == "cpu" and importlib.util.find_spec("numba") is not None:
        sections["rasteriser by threads"] = threads(best_times, scenes[GRIDS[-1]], size, repeats)
        sections["rasteriser and arithmetic"] = arithmetic(best_times, scenes[GRIDS[-1]], size, repeats)
    return sections


def channels(best_times: BestTimes, scene: Gaussians, size: int, repeats: int) -> dict[str, Any]:
    """Compare 3 and 36 channels, forward and with gradients."""
    plain = dataclasses.replace(scene, features=None)
    calls = {
        "color, alpha, depth": lambda: _forward(plain, size),
        f"with {FEATURES} features": lambda: _forward(scene, size),
        f"with {FEATURES} features and gradients": _with_gradients(scene, size),
    }
    times = best_times(calls, repeats)
    first = times["color, alpha, depth"]
    return {
        "scene": f"{len(scene)} Gaussians (N_g {GRIDS[-1]}), {size}x{size}",
        **{name: {"ratio": seconds / first, "ms": 1e3 * seconds} for name, seconds in times.items()},
    }


def against_torch(best_times: BestTimes, scene: Gaussians) -> dict[str, Any]:
    """Compare the fastest rasteriser with the readable one, on a scene that the latter can manage."""
    from ..splat import choose_backend

    fastest = choose_backend(scene.means.device.type)
    result: dict[str, Any] = {"compared": f"{fastest}, {len(scene)} Gaussians, {REFERENCE_SIZE}x{REFERENCE_SIZE}"}
    for name, make in (("forward", _forward_call), ("forward and backward", _with_gradients)):
        times = best_times({backend: make(scene, REFERENCE_SIZE, backend) for backend in ("torch", fastest)}, REFERENCE_REPEATS)
        result[name] = {"times faster": times["torch"] / times[fastest], "ms": 1e3 * times[fastest]}
    return result


def grids(best_times: BestTimes, scenes: Mapping[int, Gaussians], size: int, repeats: int) -> dict[str, Any]:
    """Compare numbers of Gaussians."""
    times = best_times({str(grid): _forward_call(scene, size) for grid, scene in scenes.items()}, repeats)
    first = times[str(GRIDS[0])]
    return {
        f"N_g {grid}": {"Gaussians": len(scene), "ratio": times[str(grid)] / first, "ms": 1e3 * times[str(grid)]}
        for grid, scene in scenes.items()
    }


def threads(best_times: BestTimes, scene: Gaussians, size: int, repeats: int) -> dict[str, Any]:
    """Compare numbers of threads, forward and with gradients."""
    from ..compute.devices import limit_rasteriser_threads
    from ..compute.threads import thread_count

    before = thread_count()
    most = os.cpu_count() or 1
    counts = sorted({1, *(1 << k for k in range(1, most.bit_length()) if 1 << k < most), most})

    def limited(count: int, call: Callable[[], object]) -> Callable[[], object]:
        def run() -> None:
            limit_rasteriser_threads(count)
            call()

        return run

    try:
        forward = best_times({str(n): limited(n, _forward_call(scene, size)) for n in counts}, repeats)
        both = best_times({str(n): limited(n, _with_gradients(scene, size)) for n in counts}, repeats)
    finally:
        limit_rasteriser_threads(before)
    return {
        f"{n} threads": {
            "speed forward": forward["1"] / forward[str(n)],
            "speed with gradients": both["1"] / both[str(n)],
            "ms forward": 1e3 * forward[str(n)],
        }
        for n in counts
    }


def arithmetic(best_times: BestTimes, scene: Gaussians, size: int, repeats: int) -> dict[str, Any]:
    """Relate the rasteriser's time to the time that its operations would take at the speed of a matrix product.

    Three limits, each a time: of the pairs of a pixel and a Gaussian that the rules of 3DGS blend, which nothing can leave out;
    of what our blocks of pixels compute; of what 16 x 16 tiles without anything finer would compute.
    """
    import torch

    from ..splat import GaussianArrays
    from ..splat.cpu.count import count_work
    from ..splat.cpu.drawing import draw
    from ..splat.rules import TILE, View

    view = View.of(Camera.orbit(size, size))
    inputs = GaussianArrays(*(getattr(scene, name).numpy() for name in GaussianArrays._fields)).prepared()
    ground = np.zeros((1, 1, 3), np.float32)
    _, drawing = draw(inputs, ground, view, False)
    work = count_work(drawing, size, size)
    left, right = torch.rand(MATRIX, MATRIX), torch.rand(MATRIX, MATRIX)
    times = best_times({"draw": lambda: draw(inputs, ground, view, False), "product": lambda: left @ right}, repeats)
    speed = 2 * MATRIX**3 / times["product"]
    colors = CHANNEL_OPERATIONS * (4 + FEATURES)
    tiled = int((drawing.ends - drawing.starts[:-1]).sum()) * TILE**2
    counts = {
        "blended pairs": (work.needed, work.needed * (ALPHA_OPERATIONS + colors)),
        "our blocks": (work.evaluated, work.evaluated * ALPHA_OPERATIONS + work.blended * colors),
        "whole tiles": (tiled, tiled * (ALPHA_OPERATIONS + colors)),
    }
    return {
        "ms": 1e3 * times["draw"],
        "matrix product, Gflop/s": speed / 1e9,
        "Gaussians seen": work.gaussians,
        "Gaussians times tiles": work.instances,
        **{
            name: {"alphas": pairs, "limit ms": 1e3 * operations / speed, "time / limit": times["draw"] * speed / operations}
            for name, (pairs, operations) in counts.items()
        },
    }


def alternatives() -> dict[str, str]:
    """Return what else is published and whether it is installed here."""
    return {
        name: f"installed; {note}" if importlib.util.find_spec(name) else f"not installed; {note}"
        for name, note in ALTERNATIVES.items()
    }


def _forward(scene: Gaussians, size: int, backend: str = "auto") -> None:
    import torch

    from ..splat import rasterize

    with torch.no_grad():
        rasterize(scene, Camera.orbit(size, size), backend=backend)
    if scene.means.device.type == "cuda":
        torch.cuda.synchronize()


def _forward_call(scene: Gaussians, size: int, backend: str = "auto") -> Callable[[], None]:
    return lambda: _forward(scene, size, backend)


def _with_gradients(scene: Gaussians, size: int, backend: str = "auto") -> Callable[[], None]:
    import torch

    from ..splat import rasterize

    leaves = {field.name: getattr(scene, field.name).clone().requires_grad_(True) for field in dataclasses.fields(scene)}
    learning = type(scene)(**leaves)

    def step() -> None:
        for leaf in leaves.values():
            leaf.grad = None
        out = rasterize(learning, Camera.orbit(size, size), backend=backend)
        pictures = [picture for picture in (out.rgb, out.alpha, out.depth, out.features) if picture is not None]
        torch.autograd.backward(pictures, [torch.ones_like(picture) for picture in pictures])
        if scene.means.device.type == "cuda":
            torch.cuda.synchronize()

    return step
