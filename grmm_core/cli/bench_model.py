"""The model's part of `grmm bench`: the stages of one frame, of trained weights or of a configuration with random ones.

Called by `bench.py`, whose `best_times` it is given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ..geometry.camera import Camera

if TYPE_CHECKING:
    from torch import Tensor

    from ..model.grmm import GRMM

BestTimes = Callable[[Mapping[str, Callable[[], object]], int], dict[str, float]]

PER_AVATAR, PER_VIEW = ("opacity",), ("appearance",)  # what an animated expression seen by a fixed camera computes once


def stages(best_times: BestTimes, model: GRMM, inputs: Mapping[str, Tensor], size: int, repeats: int) -> dict[str, Any]:
    """Time the stages of a frame: share of each and milliseconds.

    Args:
        best_times: Times alternatives in turns.
        model: In evaluation mode.
        inputs: z_id [Z], z_exp [Y], expression [E], pose [5, 3], shape [S], on the model's device.
        size: Side of the picture, pixels.
        repeats: Of each stage.
    """
    import torch

    from ..model.grmm import JAW, NECK, euler_to_rotvec
    from ..splat import Gaussians, rasterize

    camera = Camera.orbit(size, size)
    z_id, z_exp, expression, pose, shape = (inputs[name] for name in ("z_id", "z_exp", "expression", "pose", "shape"))

    def whole(call: Callable[[], object]) -> Callable[[], object]:
        if model.device.type != "cuda":
            return call

        def run() -> None:
            call()
            torch.cuda.synchronize()

        return run

    with torch.inference_mode():
        view = model.view_direction(camera)
        turns = euler_to_rotvec(pose[[NECK, JAW]])
        displacement = model.displacement(z_id[None], z_exp[None], turns[:1], turns[1:], expression[None])
        vertices = model.vertices(shape[None], expression[None], pose[None], displacement)[0]
        offsets = model.offsets(z_id, z_exp)
        placed = model.geometry(vertices, offsets)
        colors, features = model.appearance(z_id, view)
        colors = colors + model.expression_colors(z_id, z_exp)
        gaussians = Gaussians(placed.means, placed.quats, placed.scales, model.opacity(z_id), colors, features)
        raster = rasterize(gaussians, camera)
        calls: dict[str, Callable[[], object]] = {
            "opacity": lambda: model.opacity(z_id),
            "appearance": lambda: model.appearance(z_id, view),
            "offsets": lambda: model.offsets(z_id, z_exp),
            "expression colors": lambda: model.expression_colors(z_id, z_exp),
            "displacement": lambda: model.displacement(z_id[None], z_exp[None], turns[:1], turns[1:], expression[None]),
            "skinning": lambda: model.vertices(shape[None], expression[None], pose[None], displacement),
            "placing": lambda: model.geometry(vertices, offsets),
            "rasterising": lambda: rasterize(gaussians, camera),
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
    from ..session.local import choose_device, describe_device

    there = choose_device(device)
    torch.manual_seed(0)
    model = GRMM(load_open_head(), PRESETS[name]).to(there).eval().requires_grad_(False)
    random = torch.Generator().manual_seed(1)
    sizes = {"z_id": model.z_id_size, "z_exp": model.z_exp_size}
    inputs = {key: torch.randn(length, generator=random) for key, length in sizes.items()}
    inputs |= {"expression": torch.zeros(len(model.head_model.expression_names)), "pose": torch.zeros(5, 3)}
    inputs["shape"] = torch.zeros(model.head_model.shape_dirs.shape[-1])
    found = stages(best_times, model, {key: value.to(there) for key, value in inputs.items()}, size, repeats)
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
