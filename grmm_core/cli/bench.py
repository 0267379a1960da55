"""`grmm bench`: where the time of a frame goes on this machine, as ratios measured in one run.

Times of one run are comparable, those of two runs are not (other programs, clock speeds): every figure is the best of several
repeats, alternatives are timed in turns, and the table leads with ratios.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from ..camera import Camera
from ..controls import Controls
from ..session import Instance, RenderOptions, create_session
from .common import add_model

if TYPE_CHECKING:
    from ..session.local import LocalSession
    from ..splat import Gaussians

REPEATS = 7
QUICK_REPEATS = 3
FRAME_SIZE = 512
RESOLUTIONS = (256, 512, 1024)
LODS = (0, 1, 2)
REFERENCE_LOD = 2  # the readable rasteriser is slow: compare on a sixteenth of the Gaussians
REFERENCE_SIZE = 96
REFERENCE_REPEATS = 2
TILE_PIXELS = 256
MATRIX = 1024  # side of the matrix product that gives the arithmetic speed of the machine
ALTERNATIVES = {"gsplat": "needs CUDA", "diff_gaussian_rasterization": "needs CUDA; three channels"}


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser("bench", help="measure where the time goes", description="Measure where the time goes.")
    parser.add_argument("--quick", action="store_true", help="fewer repeats and no 1024-pixel pictures")
    add_model(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure and show the tables."""
    repeats = QUICK_REPEATS if args.quick else REPEATS
    resolutions = RESOLUTIONS[:-1] if args.quick else RESOLUTIONS
    from ..session.local import LocalSession

    with LocalSession(args.weights, args.device, args.threads) as session:
        avatar = session.open("default")
        session.warm_up()
        status = session.status()
        result: dict[str, Any] = {
            "weights": avatar.weights_name,
            "gaussians": avatar.gaussian_count,
            "channels": 3 + avatar.feature_count,
            "device": status.device,
            "threads": status.threads,
        }
        sections: dict[str, Callable[[], dict[str, Any]]] = {
            "stages": lambda: stages(session, avatar.id, repeats),
            "caching": lambda: caching(session, avatar.id, repeats),
            "rasterisers": lambda: rasterisers(session, avatar.id),
            "resolution": lambda: scaling(session, avatar.id, repeats, resolutions, "size"),
            "detail": lambda: scaling(session, avatar.id, repeats, LODS, "lod"),
            "arithmetic": lambda: arithmetic(session, avatar.id, repeats),
        }
        with args.console.progress("measuring", len(sections) + 1) as bar:
            for name, measure in sections.items():
                bar.advance(0, name)
                result[name] = measure()
                bar.advance(1, name)
            result["worker"] = worker(session, args, repeats)
    result["peak memory MiB"] = peak_memory_mib()
    result["alternatives"] = {
        name: f"installed; {note}" if importlib.util.find_spec(name) else f"not installed; {note}"
        for name, note in ALTERNATIVES.items()
    }
    _show(args.console, result)
    return result


def best_times(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Time alternatives in turns and return the best seconds of each."""
    best = dict.fromkeys(calls, float("inf"))
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            best[name] = min(best[name], time.perf_counter() - start)
    return best


def stages(session: LocalSession, avatar_id: int, repeats: int) -> dict[str, Any]:
    """Time the stages of a frame in which everything is new: share of each and milliseconds."""
    import torch

    from ..model.grmm import JAW, NECK, euler_to_rotvec
    from ..splat import Gaussians, rasterize

    evaluator, target = session.evaluator, session.target(avatar_id)
    model = target.model
    camera = Camera.orbit(FRAME_SIZE, FRAME_SIZE)
    inputs = evaluator.inputs(target, Controls().set_named({"jawOpen": 0.3}))
    with torch.inference_mode():
        view = model.view_direction(camera)
        z_id, z_exp, expression, pose, shape = (
            torch.from_numpy(array).to(model.device)
            for array in (inputs.z_id, inputs.z_exp, inputs.expression, inputs.pose, inputs.shape)
        )
        turns = euler_to_rotvec(pose[[NECK, JAW]])
        vertices, displacement = evaluator.mesh(target, inputs)
        offsets = model.offsets(z_id, z_exp)
        placed = model.geometry(vertices, offsets)
        colors, features = model.appearance(z_id, view)
        gaussians = Gaussians(placed.means, placed.quats, placed.scales, model.opacity(z_id), colors, features)
        raster = rasterize(gaussians, camera)
        calls: dict[str, Callable[[], object]] = {
            "opacity": lambda: model.opacity(z_id),
            "appearance": lambda: model.appearance(z_id, view),
            "offsets": lambda: model.offsets(z_id, z_exp),
            "displacement": lambda: model.displacement(z_id[None], z_exp[None], turns[:1], turns[1:], expression[None]),
            "skinning": lambda: model.vertices(shape[None], expression[None], pose[None], displacement[None]),
            "placing": lambda: model.geometry(vertices, offsets),
            "rasterising": lambda: rasterize(gaussians, camera),
            "refining": lambda: model.refine(raster),
        }
        times = best_times(calls, repeats)
    total = sum(times.values())
    return {name: {"share": seconds / total, "ms": 1e3 * seconds} for name, seconds in times.items()}


def caching(session: LocalSession, avatar_id: int, repeats: int) -> dict[str, Any]:
    """Compare frames in which everything, the expression, the camera, or nothing has changed."""
    step = iter(range(1 << 30))

    def frame(name: str) -> Callable[[], object]:
        def draw() -> None:
            number = next(step)
            if name == "everything":
                session.evaluator.cache.clear()
            jaw = 0.001 * (number % 500) if name == "expression" else 0.0
            yaw = 0.1 * (number % 500) if name == "camera" else 0.0
            controls = Controls().set_named({"jawOpen": jaw})
            session.render([Instance(avatar_id, controls)], Camera.orbit(FRAME_SIZE, FRAME_SIZE, yaw))

        return draw

    times = best_times({name: frame(name) for name in ("nothing", "camera", "expression", "everything")}, repeats)
    return {name: {"ratio": s / times["everything"], "ms": 1e3 * s} for name, s in times.items()}


def rasterisers(session: LocalSession, avatar_id: int) -> dict[str, Any]:
    """Compare the fastest rasteriser with the readable one, forward and with gradients."""
    import torch

    from ..splat import choose_backend, rasterize

    camera = Camera.orbit(REFERENCE_SIZE, REFERENCE_SIZE)
    gaussians = _gaussians(session, avatar_id, REFERENCE_LOD)
    fastest = choose_backend(gaussians.means.device.type)
    leaf = gaussians.means.clone().requires_grad_(True)

    def forward(backend: str) -> Callable[[], object]:
        return lambda: rasterize(gaussians, camera, backend=backend)

    def both(backend: str) -> Callable[[], object]:
        from dataclasses import replace

        def step() -> None:
            leaf.grad = None
            out = rasterize(replace(gaussians, means=leaf), camera, backend=backend)
            (out.rgb.sum() + out.features.sum()).backward()

        return step

    with torch.no_grad():
        plain = best_times({backend: forward(backend) for backend in ("torch", fastest)}, REFERENCE_REPEATS)
    gradients = best_times({backend: both(backend) for backend in ("torch", fastest)}, REFERENCE_REPEATS)
    return {
        "compared": f"{fastest} against torch, {len(gaussians)} Gaussians, {REFERENCE_SIZE}x{REFERENCE_SIZE}",
        "forward": {"times faster": plain["torch"] / plain[fastest], "ms": 1e3 * plain[fastest]},
        "forward and backward": {"times faster": gradients["torch"] / gradients[fastest], "ms": 1e3 * gradients[fastest]},
    }


def scaling(
    session: LocalSession, avatar_id: int, repeats: int, values: tuple[int, ...], what: str
) -> dict[str, Any]:
    """Time whole frames, with new expressions, over picture sizes or levels of detail; ratios to the first."""
    step = iter(range(1 << 30))

    def frame(value: int) -> Callable[[], object]:
        size = value if what == "size" else FRAME_SIZE
        options = RenderOptions(lod=value if what == "lod" else 0)

        def draw() -> None:
            controls = Controls().set_named({"jawOpen": 0.001 * (next(step) % 500)})
            session.render([Instance(avatar_id, controls)], Camera.orbit(size, size), options)

        return draw

    times = best_times({str(value): frame(value) for value in values}, repeats)
    first = times[str(values[0])]
    return {name: {"ratio": seconds / first, "ms": 1e3 * seconds} for name, seconds in times.items()}


def arithmetic(session: LocalSession, avatar_id: int, repeats: int) -> dict[str, Any]:
    """Relate the rasteriser's work to what the machine can do, on the CPU.

    Counted are pairs of a pixel and a Gaussian in whose 16x16 tiles it lies, up to where the tile ends: no exact rasteriser
    with such tiles needs more. The yardstick is a matrix product on the same threads.
    """
    import torch

    from ..splat.rules import View

    gaussians = _gaussians(session, avatar_id, 0)
    if gaussians.means.device.type != "cpu" or importlib.util.find_spec("numba") is None:
        return {}
    from ..splat.cpu.function import draw

    camera = Camera.orbit(FRAME_SIZE, FRAME_SIZE)
    view = View.of(camera)
    parts = (gaussians.means, gaussians.quats, gaussians.scales, gaussians.opacities, gaussians.colors, gaussians.features)
    inputs = [part.contiguous().numpy() for part in parts]
    background = np.zeros((1, 1, 3), np.float32)
    _, drawing = draw(inputs, background, view, False)
    pairs = int((drawing.ends - drawing.starts[:-1]).sum()) * TILE_PIXELS
    left, right = torch.rand(MATRIX, MATRIX), torch.rand(MATRIX, MATRIX)
    times = best_times({"draw": lambda: draw(inputs, background, view, False), "product": lambda: left @ right}, repeats)
    per_pair = 2 * (5 + inputs[5].shape[1]) + 20  # colours, depth and features; the exponent, alpha and transmittance
    peak = 2 * MATRIX**3 / times["product"]
    return {
        "pixel-splat pairs": pairs,
        "pairs per nanosecond": pairs / times["draw"] / 1e9,
        "share of matrix-product speed": pairs * per_pair / times["draw"] / peak,
    }


def worker(session: LocalSession, args: argparse.Namespace, repeats: int) -> dict[str, Any]:
    """Compare the worker process with this one: what crossing the boundary costs."""
    camera = Camera.orbit(FRAME_SIZE, FRAME_SIZE)
    with create_session("worker", sys.executable, args.weights, args.device, args.threads) as other:
        sessions = {"local": session, "worker": other}
        ids = {name: each.open("default").id for name, each in sessions.items()}
        calls = {
            f"{name} {what}": (
                (lambda each=each, name=name: each.deform(ids[name], Controls()))
                if what == "mesh"
                else (lambda each=each, name=name: each.render([Instance(ids[name])], camera))
            )
            for name, each in sessions.items()
            for what in ("mesh", "frame")
        }
        times = best_times(calls, repeats)
    return {
        what: {"ratio": times[f"worker {what}"] / times[f"local {what}"], "ms": 1e3 * times[f"worker {what}"]}
        for what in ("mesh", "frame")
    }


def peak_memory_mib() -> float | None:
    """Return the largest resident memory of this process so far, where the system tells."""
    try:
        import resource
    except ImportError:  # Windows
        return None
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1 << 20) if sys.platform == "darwin" else peak / (1 << 10)


def _gaussians(session: LocalSession, avatar_id: int, lod: int) -> Gaussians:
    import torch

    evaluator, target = session.evaluator, session.target(avatar_id)
    with torch.no_grad():
        found = evaluator.gaussians(target, evaluator.inputs(target, Controls()), np.array([0.0, 0.0, 1.0]), lod)
    # tensors made under inference mode cannot take part in gradients
    parts = (found.means, found.quats, found.scales, found.opacities, found.colors, found.features)
    return type(found)(*(part.clone() for part in parts))


def _show(console: Any, result: Mapping[str, Any]) -> None:
    for name, value in result.items():
        if not isinstance(value, Mapping):
            console.line(f"{name}: {_text(value)}")
            continue
        console.line(f"\n{name}")
        rows = [(key, item) for key, item in value.items() if isinstance(item, Mapping)]
        for key, item in value.items():
            if not isinstance(item, Mapping):
                console.line(f"  {key}: {_text(item)}")
        if rows:
            columns = list(rows[0][1])
            console.table(["  ", *columns], [(f"  {key}", *(_text(item[c], c) for c in columns)) for key, item in rows])


def _text(value: Any, column: str = "") -> str:
    if column == "share":
        return f"{value:.0%}"
    return f"{value:.3g}" if isinstance(value, float) else str(value)
