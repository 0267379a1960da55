"""The model's part of `grmm bench`: the stages of one frame, of trained weights or of a configuration with random ones.

Called by `bench.py`, whose `best_times` it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..compute.devices import choose_device, describe_device
from ..geometry.camera import Camera
from ..model.inputs import ModelInputs

if TYPE_CHECKING:
    from ..model.grmm import GRMM

BestTimes = Callable[[Mapping[str, Callable[[], object]], int], dict[str, float]]

PER_AVATAR, PER_VIEW = ("opacity",), ("appearance",)  # what an animated expression seen by a fixed camera computes once


def stages(best_times: BestTimes, model: GRMM, frame: ModelInputs[np.ndarray], size: int, repeats: int) -> dict[str, Any]:
    """Time the stages of a frame: share of each and milliseconds.

    Args:
        best_times: Times alternatives in turns.
        model: In evaluation mode.
        frame: What is drawn.
        size: Side of the picture, pixels.
        repeats: Of each stage.
    """
    import torch

    from ..splat import rasterize

    camera = Camera.orbit(size, size)

    def whole(call: Callable[[], object]) -> Callable[[], object]:
        if model.device.type != "cuda":
            return call

        def run() -> None:
            call()
            torch.cuda.synchronize()

        return run

    with torch.inference_mode():
        inputs, view = model.tensors(frame), model.view_direction(camera)
        z_id, z_exp, expression = inputs.z_id, inputs.z_exp, inputs.expression
        mesh, attributes = model.mesh(inputs), model.attributes(inputs, view)
        gaussians = model.gaussians(mesh.vertices, attributes)
        raster = rasterize(gaussians, camera, antialiased=model.config.antialias)
        calls: dict[str, Callable[[], object]] = {
            "opacity": lambda: model.opacity(z_id),
            "appearance": lambda: model.appearance(z_id, view),
            "offsets": lambda: model.offsets(z_id, z_exp),
            "expression colors": lambda: model.expression_colors(z_id, z_exp),
            "displacement": lambda: model.displacement(inputs),
            "skinning": lambda: model.head(inputs.shape, expression, inputs.pose, mesh.displacement),
            "placing": lambda: model.geometry(mesh.vertices, attributes.offsets),
            "rasterising": lambda: rasterize(gaussians, camera, antialiased=model.config.antialias),
            "refining": lambda: model.refine(raster),
        }
        times = best_times({name: whole(call) for name, call in calls.items()}, repeats)
    total = sum(times.values())
    return {name: {"share": seconds / total, "ms": 1e3 * seconds} for name, seconds in times.items()}


def configuration(best_times: BestTimes, name: str, size: int, device: str, repeats: int) -> dict[str, Any]:
    """Time a configuration at its full size with random weights, on the open head.

    Args:
        best_times: Times alternatives in turns.
        name: Of `model.config.PRESETS`.
        size: Side of the picture, pixels.
        device: "auto", "cpu", "cuda" or "mps".
        repeats: Of each stage.

    Raises:
        BackendError: The device is not there.
    """
    import torch

    from ..head import load_open_head
    from ..model.config import PRESETS
    from ..model.grmm import GRMM

    there = choose_device(device)
    torch.manual_seed(0)
    model = GRMM(load_open_head(), PRESETS[name]).to(there).eval().requires_grad_(False)
    random = torch.Generator().manual_seed(1)
    z_id, z_exp = (torch.randn(length, generator=random).numpy() for length in (model.z_id_size, model.z_exp_size))
    head = model.head_model
    rest = (np.zeros(head.shape_count), np.zeros(head.expression_count), np.zeros((5, 3)))
    found = stages(best_times, model, ModelInputs(z_id, z_exp, *rest), size, repeats)
    milliseconds = {stage: row["ms"] for stage, row in found.items()}
    animated = sum(time for stage, time in milliseconds.items() if stage not in (*PER_AVATAR, *PER_VIEW))
    return {
        "configuration": name,
        "device": describe_device(there),
        "picture": f"{size}x{size}",
        "Gaussians": model.gaussian_count,
        "parameters": sum(parameter.numel() for parameter in model.parameters()),
        "stages": found,
        "frames a second": {
            "everything new": {"per second": 1e3 / sum(milliseconds.values())},
            "animated expression": {"per second": 1e3 / animated},
        },
    }
