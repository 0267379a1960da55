"""Measure what the render engine adds to the core's own time: `python -m tools.bench_engine [--frames N] [--output FILE]`.

Needs the bpy wheel in this Python; where it has no torch, the environment variable GRMM_WORKER_PYTHON names an interpreter for
the worker. Renders an animation in which the expression changes with every frame. In each frame the time inside the session's
`render` (the core) and inside the engine's `render` (everything that Blender asks of us) are taken together, so that nothing
else on the machine can favour one of them.

===============  =====================================================================================
``core``         the session's picture
``engine``       the same and what the engine does around it: scene, camera, passes, handing over
``overhead``     engine / core - 1; the goal is 5%
``around``       processor time of Blender's thread in the engine but outside of the core: little changed by a busy machine
``frame``        the whole frame as Blender renders it, without saving: evaluation and frame handlers too
===============  =====================================================================================
"""

from __future__ import annotations

import argparse
import itertools
import json
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.bench_blender import _module, with_extension
from tools.build_extension import BuildError

SIZE = 512
WARM_UP = 2
GOAL = 0.05
RATE = 24  # frames a second
PATIENCE = 60.0  # seconds
ROUND_TABLE = 40_000  # triangles, about, of the mesh that stands in front in the second scene


def measure(frames: int, size: int) -> dict[str, Any]:
    """Build the scenes and time them; returns milliseconds and ratios by scene."""
    import bpy

    scene = _scene(size)
    result: dict[str, Any] = {"blender": bpy.app.version_string, "size": size, "plain": _timed(scene, frames)}
    bpy.ops.mesh.primitive_uv_sphere_add(segments=200, ring_count=ROUND_TABLE // 400, radius=0.06, location=(0.05, -0.3, 0.0))
    result["mesh in front"] = _timed(scene, frames)
    camera = scene.camera
    for frame, place in ((1, -0.05), (200, 0.05)):
        camera.location.x = place
        camera.keyframe_insert("location", frame=frame)
    result["camera moves"] = _timed(scene, frames)
    camera.animation_data_clear()
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.grmm_passes.use_mask = layer.grmm_passes.use_raw = layer.grmm_passes.use_normal = True
    result["mesh and passes"] = _timed(scene, frames)
    result["view"] = {level: _view_parts(scene, frames, size, level) for level in ("final", "playing")}
    result["played"] = _played(scene, frames, size)
    result["session"] = _module("grmm_blender.session_host").get_session().status().kind
    return result


def _scene(size: int) -> Any:
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    scene = bpy.context.scene
    bpy.ops.grmm.add_head()
    head = _module("grmm_blender.rig.avatar").avatar_of(bpy.context.object).object
    for frame, value in ((1, 0.0), (200, 1.0)):
        head["jawOpen"] = value
        head.keyframe_insert('["jawOpen"]', frame=frame)
    camera = bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler, camera.data.lens = (0.0, -1.1, 0.0), (1.5708, 0.0, 0.0), 85.0
    scene.camera = camera
    scene.render.engine = "GRMM"
    scene.render.resolution_x = scene.render.resolution_y = size
    scene.render.film_transparent = True
    return scene


def _timed(scene: Any, frames: int) -> dict[str, Any]:
    """Times of `frames` different frames, the first ones left out."""
    final = _module("grmm_blender.engine.final")
    session = _module("grmm_blender.session_host").get_session()
    spent: dict[str, list[tuple[float, float]]] = {"core": [], "engine": [], "frame": []}
    engine_render, core_render = final.render, session.render
    final.render = _timing(engine_render, spent["engine"])
    session.render = _timing(core_render, spent["core"])
    try:
        for number in range(WARM_UP + frames):
            _timing(_frame, spent["frame"])(scene, 2 + number)
    finally:
        final.render = engine_render
        del session.render
    times = {name: values[WARM_UP:] for name, values in spent.items()}
    pairs = list(zip(times["engine"], times["core"], strict=True))
    ratios = [whole[0] / core[0] - 1.0 for whole, core in pairs]
    least = {name: min(wall for wall, _ in values) for name, values in times.items()}
    least["around"] = min(whole[1] - core[1] for whole, core in pairs)
    return {
        "ms": {name: 1e3 * seconds for name, seconds in least.items()},
        "overhead": {"least": min(ratios), "median": statistics.median(ratios)},
    }


def _view_parts(scene: Any, frames: int, size: int, level: str) -> dict[str, float]:
    """Least milliseconds of the parts of a refined frame on the rendered view's path, but for drawing the texture.

    Of a still picture ("final") or of a frame of playback ("playing"), one after the other.
    """
    import bpy

    jobs = _module("grmm_blender.engine.view_jobs").ViewJobs()
    renderer = _module("grmm_blender.engine.view").ViewRenderer(jobs)
    requests, frame_type = _module("grmm_blender.engine.view_jobs").ViewRequest, _module("grmm_blender.scene.shot").Frame
    session = _module("grmm_blender.session_host").get_session()
    camera = _module("grmm_core.geometry.camera").Camera.orbit(size, size)
    render, rows = session.render, []
    core: list[tuple[float, float]] = []
    session.render = _timing(render, core)
    try:
        for number in range(WARM_UP + frames):
            marks = [time.perf_counter()]
            scene.frame_set(2 + number)
            marks.append(time.perf_counter())
            found = renderer._copy(bpy.context.evaluated_depsgraph_get())
            marks.append(time.perf_counter())
            frame = frame_type(found.shot, camera, (0.01, 100.0))
            request = jobs._wanted = requests(frame, found.preview, found.final)
            jobs._in_the_way = False  # as the frame change has asked
            jobs._publish(request, level, frame, getattr(found, level))
            marks.append(time.perf_counter())
            parts = [after - before for before, after in itertools.pairwise(marks)]
            rows.append((*parts, core[-1][0], parts[2] - core[-1][0], sum(parts)))
    finally:
        session.render = render
    names = ("frame change", "scene", "picture", "of it session", "of it engine", "in all")
    return {name: 1e3 * min(column) for name, column in zip(names, zip(*rows[WARM_UP:], strict=True), strict=True)}


class _Player:
    """Asks for frames of playback as the rendered view does, in the place of a window; the mesh does without learned detail."""

    def __init__(self, scene: Any, size: int) -> None:
        self._scene = scene
        self.jobs = _module("grmm_blender.engine.view_jobs").ViewJobs()
        self._renderer = _module("grmm_blender.engine.view").ViewRenderer(self.jobs)
        self._camera = _module("grmm_core.geometry.camera").Camera.orbit(size, size)

    def ask(self, number: int) -> None:
        """Make a frame and ask for its picture."""
        import bpy

        requests, frame_type = _module("grmm_blender.engine.view_jobs").ViewRequest, _module("grmm_blender.scene.shot").Frame
        self._scene.frame_set(2 + number % 190)
        found = self._renderer._copy(bpy.context.evaluated_depsgraph_get())
        frame = frame_type(found.shot, self._camera, (0.01, 100.0))
        self.jobs.request(requests(frame, found.preview, found.final, 0.0, found.playing, PATIENCE))

    def came(self, seconds: float) -> bool:
        """Wait for a picture; whether it came."""
        came = self.jobs.wait_for_news(seconds) and self.jobs.take() is not None
        if self.jobs.error:
            raise BuildError(f"A frame of playback was not drawn: {self.jobs.error}")
        return came


def _played(scene: Any, frames: int, size: int) -> dict[str, float]:
    """Playback in the rendered view, every picture of full size.

    Returns:
        "ms": Milliseconds a frame, in the mean, as fast as they come: Blender makes the next frame while one is drawn.
        "shown": Pictures a second where Blender makes `RATE` frames a second by the clock, as in a window.
    """
    player = _Player(scene, size)
    head = next(obj for obj in scene.objects if obj.type == "MESH" and obj.grmm.live_detail)
    head.grmm.live_detail = False
    started, asked = 0.0, 0
    for number in range(WARM_UP + 4 * frames):
        if number == WARM_UP:
            started = time.perf_counter()
        player.ask(number)
        asked += 1
        if asked > 1 and number:  # one is drawn, one waits
            asked = asked - 1 if player.came(PATIENCE) else 0
    player.jobs.wait(PATIENCE)
    result = {"ms": 1e3 * (time.perf_counter() - started) / (4 * frames)}
    player.came(0.0)
    shown, number, started = 0, 0, time.perf_counter()
    while number < 4 * frames:
        player.ask(number)
        number = max(number + 1, int((time.perf_counter() - started) * RATE))  # what is late is left out
        while (left := started + number / RATE - time.perf_counter()) > 0.0:
            if player.came(left):
                shown += 1
            elif not player.jobs.busy:
                time.sleep(max(0.0, min(left, 0.01)))
    seconds = time.perf_counter() - started
    player.jobs.wait(PATIENCE)
    result["shown"] = (shown + player.came(0.0)) / seconds
    head.grmm.live_detail = True
    return result


def _frame(scene: Any, number: int) -> None:
    import bpy

    scene.frame_set(number)
    bpy.ops.render.render()


def _timing(function: Callable[..., Any], seconds: list[tuple[float, float]]) -> Callable[..., Any]:
    """Return the function with its times noted: elapsed, and of this thread's processor."""

    def timed(*arguments: Any, **options: Any) -> Any:
        start, worked = time.perf_counter(), time.thread_time()
        try:
            return function(*arguments, **options)
        finally:
            seconds.append((time.perf_counter() - start, time.thread_time() - worked))

    return timed


def main() -> int:
    """Measure and print; returns the exit code."""
    parser = argparse.ArgumentParser(description="Measure what the render engine adds to the core's own time.")
    parser.add_argument("--frames", type=int, default=12, help="frames for each figure (default: 12)")
    parser.add_argument("--size", type=int, default=SIZE, help=f"pixels of a side (default: {SIZE})")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    arguments = parser.parse_args()
    try:
        result = with_extension(lambda: measure(arguments.frames, arguments.size))
    except BuildError as error:
        print(f"bench_engine: {error}", file=sys.stderr)
        return 1
    print(f"Blender {result['blender']}, {result['size']} x {result['size']}, session: {result['session']}")
    for level, measured in result["view"].items():
        parts = ", ".join(f"{name} {ms:.1f}" for name, ms in measured.items())
        print(f"  refined frame of the rendered view ({level}), least, ms: {parts}")
    ms, shown = result["played"]["ms"], result["played"]["shown"]
    print(
        f"  playback in the rendered view, in the mean: {ms:.1f} ms a frame, {1e3 / ms:.1f} a second; "
        f"at {RATE} frames a second by the clock {shown:.1f} pictures a second"
    )
    scenes = {name: value for name, value in result.items() if isinstance(value, dict) and "overhead" in value}
    for name, values in scenes.items():
        ms, overhead = values["ms"], values["overhead"]
        print(
            f"  {name:16} core {ms['core']:7.1f} ms   engine {ms['engine']:7.1f} ms   frame {ms['frame']:7.1f} ms   "
            f"overhead {overhead['median']:6.1%} (least {overhead['least']:.1%})   around {ms['around']:.1f} ms"
        )
    for name, values in scenes.items():
        reached = values["overhead"]["median"]
        print(f"goal {GOAL:.0%}, {name}: {'met' if reached <= GOAL else 'missed'} ({reached:.1%})")
    if arguments.output:
        arguments.output.write_text(json.dumps(result, indent=1), "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
