"""`grmm bench`: where the time of a frame goes on this machine, as ratios measured in one run.

Times of one run are comparable, those of two runs are not (other programs, clock speeds): every figure is the best of several
repeats, alternatives are timed in turns, and the table leads with ratios.
"""

from __future__ import annotations

import argparse
import itertools
import statistics
import sys
import time
from collections.abc import Callable, Hashable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

from ..controls.frame import Controls
from ..errors import RuntimeMissingError
from ..geometry.camera import Camera
from ..hair.packaged import HEAD
from ..jobs.progress import Reporter
from ..jobs.stages import BENCHMARK
from ..light.lamps import Lighting
from ..light.parse import lighting_of
from ..light.shading import Response
from ..session import (
    EngineName,
    HairUse,
    Instance,
    RenderOptions,
    create_session,
    has_plain_engine,
    has_torch,
    make_local_session,
)
from . import bench_model, bench_splat
from .common import add_events, add_model, positive_int

if TYPE_CHECKING:
    from ..model.grmm import GRMM
    from ..session.local import LocalSession

REPEATS = 7
QUICK_REPEATS = 3
FRAME_SIZE = 512
FILLING = 9  # new expressions after which caches of an avatar are full
RESOLUTIONS = (256, 512, 1024)
LODS = (0, 1, 2)
BEHIND = " from behind"
HAIR = ("none", "groom:crop", "groom:long", "none" + BEHIND, "groom:long" + BEHIND)
CONFIGURATIONS = ("paper", "base", "small")
CONFIGURATION_SIZE = 1024


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser("bench", help="measure where the time goes", description="Measure where the time goes.")
    parser.add_argument("--quick", action="store_true", help="fewer repeats and no 1024-pixel pictures")
    parser.add_argument(
        "--config", choices=CONFIGURATIONS, help="only the stages of this configuration at its full size, with random weights"
    )
    parser.add_argument("--size", type=positive_int, default=CONFIGURATION_SIZE, help="pixels of --config (%(default)s)")
    parser.add_argument(
        "--engine", choices=("auto", "torch", "plain"), default="auto",
        help="what draws: torch, or numpy, numba and onnxruntime (default: what sessions take here)",
    )  # fmt: skip
    add_model(parser)
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Measure and show the tables."""
    repeats = QUICK_REPEATS if args.quick else REPEATS
    if args.config is not None:
        result = bench_model.configuration(best_times, args.config, args.size, args.device, repeats)
        result["peak memory MiB"] = peak_memory_mib()
        _show(args.console, result)
        return result
    resolutions = RESOLUTIONS[:-1] if args.quick else RESOLUTIONS
    with make_local_session(args.weights, args.device, args.threads, args.head, args.engine) as session:
        avatar = session.open("default")
        session.warm_up()
        status = session.status()
        result = {
            "weights": avatar.weights_name,
            "gaussians": avatar.gaussian_count,
            "channels": 3 + avatar.feature_count,
            "engine": status.engine,
            "device": status.device,
            "threads": status.threads,
        }
        sections: dict[str, Callable[[], dict[str, Any]]] = {
            **({"stages": lambda: stages(session, avatar.id, repeats)} if status.engine == "torch" else {}),
            **({"engines": lambda: engines(session, args, repeats)} if has_torch() and has_plain_engine() else {}),
            "caching": lambda: caching(session, avatar.id, repeats),
            "light": lambda: light(session, avatar.id, repeats),
            "resolution": lambda: scaling(session, avatar.id, repeats, resolutions, "size"),
            "detail": lambda: scaling(session, avatar.id, repeats, LODS, "lod"),
            **({"hair": lambda: scaling(session, avatar.id, repeats, HAIR, "hair")} if avatar.head_name == HEAD else {}),
        }
        with args.console.progress(BENCHMARK) as show:
            report = Reporter(BENCHMARK, show)
            for name, measure in sections.items():
                report(name, 0.0)
                result[name] = measure()
            report("worker", 0.0)
            result["worker"] = worker(session, args, repeats)
            report("rasteriser", 0.0)
            result["peak memory of frames MiB"] = peak_memory_mib()
            if has_torch():
                result |= bench_splat.measure(best_times, repeats, args.quick, status.device.split()[0])
    result["peak memory MiB"] = peak_memory_mib()
    result["alternatives"] = bench_splat.alternatives()
    _show(args.console, result)
    return result


Name = TypeVar("Name", bound=Hashable)
_CHANGES = (0.618034 * number % 1.0 for number in itertools.count())
"""Numbers of 0..1 that do not come again in a run, so that no frame finds what another one has left."""


def times_of(calls: Mapping[Name, Callable[[], object]], repeats: int) -> dict[Name, list[float]]:
    """Time alternatives in turns and return the seconds of each turn."""
    times: dict[Name, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            start = time.perf_counter()
            call()
            times[name].append(time.perf_counter() - start)
    return times


def best_times(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, float]:
    """Time alternatives in turns, after one call each, and return the best seconds of each."""
    for call in calls.values():
        call()
    return {name: min(seconds) for name, seconds in times_of(calls, repeats).items()}


def _model(session: LocalSession, avatar_id: int) -> GRMM:
    from ..model.grmm import GRMM

    model = session.target(avatar_id).model
    if not isinstance(model, GRMM):
        raise RuntimeMissingError("Only the model of torch is measured; install torch.")
    return model


def stages(session: LocalSession, avatar_id: int, repeats: int) -> dict[str, Any]:
    """Time the stages of a frame of an avatar in which everything is new."""
    target = session.target(avatar_id)
    inputs = session.evaluator.inputs(target, Controls().set_named({"jawOpen": 0.3}))
    return bench_model.stages(best_times, _model(session, avatar_id), inputs, FRAME_SIZE, repeats)


def caching(session: LocalSession, avatar_id: int, repeats: int) -> dict[str, Any]:
    """Compare frames in which everything, the expression, the camera, or nothing has changed."""
    times = best_times(frames(session, avatar_id), repeats)
    return {name: {"ratio": s / times["everything"], "ms": 1e3 * s} for name, s in times.items()}


def engines(session: LocalSession, args: argparse.Namespace, repeats: int) -> dict[str, Any]:
    """Compare the engine without torch with torch's, on the same frames in turns: the ratio is its time over torch's."""
    another: EngineName = "plain" if session.engine.name == "torch" else "torch"
    with make_local_session(args.weights, args.device, args.threads, args.head, another) as other:
        calls = {each.engine.name: frames(each, each.open("default").id) for each in (session, other)}
        times = best_times({f"{name} {what}": call for name, of in calls.items() for what, call in of.items()}, repeats)
    return {
        what: {"ratio": times[f"plain {what}"] / times[f"torch {what}"], "ms": 1e3 * times[f"plain {what}"]}
        for what in calls["plain"]
    }


def light(session: LocalSession, avatar_id: int, repeats: int) -> dict[str, Any]:
    """Compare frames in four lights and a world with those in the studio's light, in turns: the ratio is lit over unlit.

    Caches keep some expressions' shadows and light. Until they are full each new expression touches memory that the system has
    not given out before (4,000 pages lit, 25 to 50 ms of the system's time), then what is forgotten is used again. So the first
    expressions of an avatar are a row of their own. Medians, not the least: expressions cost more and less by themselves.
    """
    lighting = lighting_of(["lamp:45,35,42", "lamp:-40,10,7,1,0.8,0.6", "lamp:150,20,30", "sun:20,60,2", "world:0.05"])
    lit, unlit = frames(session, avatar_id, lighting), frames(session, avatar_id)
    names = ("nothing", "camera", "expression")
    for of in (lit, unlit):
        of["nothing"]()
    rows = {"first expressions": times_of({"lit": lit["expression"], "unlit": unlit["expression"]}, FILLING)}
    calls = {(name, which): of[name] for which, of in (("lit", lit), ("unlit", unlit)) for name in names}
    times = times_of(calls, max(repeats, FILLING))
    rows |= {name: {which: times[name, which] for which in ("lit", "unlit")} for name in names}
    found = {name: [statistics.median(row[which]) for which in ("lit", "unlit")] for name, row in rows.items()}
    return {
        name: {"ratio": found[name][0] / found[name][1], "ms": 1e3 * found[name][0]} for name in (*names, "first expressions")
    }


def frames(session: LocalSession, avatar_id: int, lighting: Lighting | None = None) -> dict[str, Callable[[], object]]:
    """Calls that draw a frame in which nothing, the camera, the expression, or everything, identity included, has changed."""
    response, options = None if lighting is None else Response(), RenderOptions(lighting=lighting)

    def frame(name: str) -> Callable[[], object]:
        def draw() -> None:
            change = next(_CHANGES)
            everything = name == "everything"
            values = {"jawOpen": 0.5 * change} if everything or name == "expression" else {}
            controls = Controls().set_named(values | ({"shape.0": change} if everything else {}))
            yaw = 50.0 * change if everything or name == "camera" else 0.0
            session.render(
                [Instance(avatar_id, controls, response=response)], Camera.orbit(FRAME_SIZE, FRAME_SIZE, yaw), options
            )

        return draw

    return {name: frame(name) for name in ("nothing", "camera", "expression", "everything")}


def scaling(session: LocalSession, avatar_id: int, repeats: int, values: tuple[Any, ...], what: str) -> dict[str, Any]:
    """Time whole frames, with new expressions, over picture sizes, levels of detail or hair; ratios to the first."""

    def frame(value: Any) -> Callable[[], object]:
        size = value if what == "size" else FRAME_SIZE
        options = RenderOptions(lod=value if what == "lod" else 0)
        hair = HairUse(value.removesuffix(BEHIND)) if what == "hair" else HairUse()
        yaw = 180.0 if what == "hair" and value.endswith(BEHIND) else 0.0

        def draw() -> None:
            controls = Controls().set_named({"jawOpen": 0.5 * next(_CHANGES)})
            session.render([Instance(avatar_id, controls, hair=hair)], Camera.orbit(size, size, yaw), options)

        return draw

    times = best_times({str(value): frame(value) for value in values}, repeats)
    first = times[str(values[0])]
    return {name: {"ratio": seconds / first, "ms": 1e3 * seconds} for name, seconds in times.items()}


def worker(session: LocalSession, args: argparse.Namespace, repeats: int) -> dict[str, Any]:
    """Compare the worker process with this one: what crossing the boundary costs."""
    camera = Camera.orbit(FRAME_SIZE, FRAME_SIZE)
    settings = (args.weights, args.device, args.threads, args.head, args.engine)
    with create_session("worker", sys.executable, *settings) as other:
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
