"""Measure a frame change with every control animated: `python -m tools.bench_blender [--frames N] [--output FILE]`.

Needs the bpy wheel in this Python. The extension is built and installed into an empty user folder, as its tests do, so that
what is measured is what a user gets. Each figure is the least and the median of many frames of one run, alternatives in
turns: times of different runs or machines say nothing about each other. On a busy machine look at the processor's time, and
at the ratio to Blender alone.

=================  =================================================================================
``blender``        Blender's own work: curves, drivers, shape keys, armature (our handlers taken out)
``extension``      the same with the extension's handlers: joints and small shape components follow
``performance``    only what a performance animates: named expressions and bones
``still``          a frame change of the same scene without any animation on the head
``enable``         importing and registering the extension, compiled before, as Blender does when it starts
=================  =================================================================================
"""

from __future__ import annotations

import argparse
import ast
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from tools.build_extension import BuildError, build

MODULE = "bl_ext.user_default.grmm"
KEYED_FRAMES = (1, 41, 81)
BONES = ("root", "neck", "jaw", "left_eye", "right_eye")
WARM_UP = 5
GOAL = 10.0  # milliseconds, for the median of `extension` on Blender 5.2
ENABLE_GOAL = 300.0  # milliseconds
ENABLE_RUNS = 5
_ENABLE = f"""
import os, sys, time
import bpy, addon_utils, numpy
start, worked = time.perf_counter(), time.process_time()
if addon_utils.enable({MODULE!r}, default_set=True) is None:
    os._exit(1)
sys.stdout.write(repr((1e3 * (time.perf_counter() - start), 1e3 * (time.process_time() - worked))))
sys.stdout.flush()
os._exit(0)  # the wheel's end can hang
"""


def measure(frames: int) -> dict[str, Any]:
    """Build the scene and time it; returns milliseconds by name."""
    import bpy
    import numpy as np

    table, handlers = _module("grmm_core.controls.table"), _module("grmm_blender.handlers")
    property_path = _module("grmm_blender.rig.custom_properties").property_path
    generator = np.random.default_rng(0)
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.ops.grmm.add_head()
    avatar = _module("grmm_blender.rig.avatar").avatar_of(bpy.context.object)
    avatar.object.grmm.live_detail = False  # the model's own time is not Blender's
    arrays_of_head = [control.name for control in table.ARRAYS]
    for frame in KEYED_FRAMES:
        for name in table.EXPRESSION_NAMES:
            avatar.object[name] = float(generator.uniform(0.0, 0.5))
            avatar.object.keyframe_insert(property_path(name), frame=frame)
        for name in arrays_of_head:
            avatar.object[name] = generator.uniform(-0.3, 0.3, len(avatar.object[name])).tolist()
            avatar.object.keyframe_insert(property_path(name), frame=frame)
        for name in BONES:
            avatar.armature.pose.bones[name].rotation_euler = generator.uniform(-0.3, 0.3, 3)
            avatar.armature.pose.bones[name].keyframe_insert("rotation_euler", frame=frame)
    curves = list(_module("grmm_blender.rig.actions").action_curves(avatar.object))
    arrays = [c for c in curves if any(c.data_path == property_path(n) for n in arrays_of_head)]
    result: dict[str, Any] = {"blender": bpy.app.version_string, "curves": len(curves) + 3 * len(BONES)}
    times: dict[str, list[tuple[float, float]]] = {"blender": [], "extension": []}
    for _ in range(2):  # in turns
        with _without(handlers):
            times["blender"] += _frame_times(frames)
        times["extension"] += _frame_times(frames)
    for curve in arrays:
        curve.mute = True
    times["performance"] = _frame_times(frames)
    avatar.object.animation_data.action = None
    avatar.armature.animation_data.action = None
    times["still"] = _frame_times(frames)
    times["enable"] = _enable_times()
    result["ms"] = {}
    for name, each in times.items():
        wall, processor = zip(*each, strict=True)
        result["ms"][name] = {"least": min(wall), "median": statistics.median(wall), "processor": min(processor)}
    return result


def _frame_times(frames: int) -> list[tuple[float, float]]:
    """Milliseconds of each of `frames` frame changes, with the mesh evaluated: elapsed, and of the processor on all threads."""
    import bpy

    scene, found = bpy.context.scene, []
    first, last = KEYED_FRAMES[0], KEYED_FRAMES[-1]
    for number in range(WARM_UP + frames):
        frame = first + (7 * number) % (last - first)
        start, worked = time.perf_counter(), time.process_time()
        scene.frame_set(frame)
        bpy.context.evaluated_depsgraph_get()
        found.append((1e3 * (time.perf_counter() - start), 1e3 * (time.process_time() - worked)))
    return found[WARM_UP:]


def _enable_times() -> list[tuple[float, float]]:
    """Milliseconds, as `_frame_times`, that the installed extension takes to be enabled, each in a process of its own."""
    found = []
    variables = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}
    for _ in range(1 + ENABLE_RUNS):  # the first compiles
        done = subprocess.run(
            [sys.executable, "-c", _ENABLE], env=variables, capture_output=True, text=True, timeout=300, check=True
        )
        wall, worked = ast.literal_eval(done.stdout[done.stdout.rindex("(") :])
        found.append((wall, worked))
    return found[1:]


@contextmanager
def _without(handlers: Any) -> Iterator[None]:
    """Take the extension's handlers out for a while."""
    handlers.unregister()
    try:
        yield
    finally:
        handlers.register()


def _module(name: str) -> Any:
    import importlib

    return importlib.import_module(f"{MODULE}.{name}")


def with_extension(call: Callable[[], dict[str, Any]]) -> dict[str, Any]:
    """Install the built extension into an empty user folder of Blender, and run `call` with it enabled."""
    with tempfile.TemporaryDirectory(prefix="grmm-bench-") as folder:
        archive = build(Path(folder))
        os.environ["BLENDER_USER_RESOURCES"] = str(Path(folder) / "user")
        import bpy

        bpy.ops.extensions.package_install_files(filepath=str(archive), repo="user_default", enable_on_install=True)
        return call()


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure a frame change in Blender with every control animated.")
    parser.add_argument("--frames", type=int, default=60, help="frames for each figure (default: 60)")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    arguments = parser.parse_args()
    try:
        result = with_extension(lambda: measure(arguments.frames))
    except BuildError as error:
        print(f"bench_blender: {error}", file=sys.stderr)
        return 1
    print(f"Blender {result['blender']}, {result['curves']} animated channels, milliseconds a frame change")
    for name, values in result["ms"].items():
        print(
            f"  {name:12} least {values['least']:6.2f}   median {values['median']:6.2f}   processor {values['processor']:6.2f}"
        )
    extension, alone, enable = (result["ms"][name] for name in ("extension", "blender", "enable"))
    ratios = {kind: extension[kind] / alone[kind] for kind in extension}
    print("  extension / blender: " + "   ".join(f"{kind} {ratio:.2f}" for kind, ratio in ratios.items()))
    for what, goal, ms in (("frame change", GOAL, extension["median"]), ("enabling", ENABLE_GOAL, enable["median"])):
        print(f"goal {what} {goal:g} ms: {'met' if ms <= goal else 'missed'} ({ms:.2f} ms in the median)")
    if arguments.output:
        arguments.output.write_text(json.dumps(result, indent=1), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
