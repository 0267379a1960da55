"""Use the extension for hours and watch what it leaves: `python -m tools.soak [--minutes 60] [--engine plain] [--output FILE]`.

Needs the bpy wheel in this Python, and torch beside it for the fits. The model runs in a worker of this Python. Each round
does all of these once, in a shuffled order, with people whom no round before has met:

===========  ==========================================================================================
``play``     a recorded performance is imported, played and removed again
``render``   an animation of a few frames and a still behind a mesh
``fit``      a fit of a photo is begun and cancelled at a random moment
``files``    the scene is saved, another begun, the first opened again; splats are exported and imported
``people``   a random person is added, drawn and deleted
===========  ==========================================================================================

After each round, once the worker has had nothing to do for a moment: resident memory of Blender, without what the C library
keeps free, and of the worker, their threads and open files, child processes, and files in the temporary folder. What grows by
more than `GROWTH` between the second and the last quarter of the run, and beyond all of the second, is a failure, and so are
a worker that had to be started again, and a file that is left behind.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import statistics
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tools.bench_blender import _module, with_extension
from tools.build_extension import BuildError

PHOTO = Path(__file__).resolve().parent.parent / "tests" / "data" / "photos" / "astronaut.jpg"
SEED = 0
GROWTH = 0.05
ROW = ("minutes", "blender_mb", "worker_mb", "threads", "open_files", "children", "temporary")
FRAMES = 12  # rendered
PLAYED = 60  # of the performance, at 30 a second
FULL_FRAMES, FULL_BYTES, MOST_FRAMES = 40, 1 << 20, 2000  # the cache is full where so many frames add no more
FIT_SECONDS = 25.0  # at most, before it is cancelled
PROCESSES = Path("/proc")


class Soak:
    """One session of Blender that is used in turns.

    Args:
        folder: For its files.
        engine: "plain" or "torch".
    """

    def __init__(self, folder: Path, engine: str) -> None:
        import bpy

        self._bpy, self._folder, self._chance = bpy, folder, random.Random(SEED)
        self._host, self._rounds = _module("grmm_blender.session_host"), 0
        make = self._host.create_session
        self._host.create_session = lambda *arguments, **options: make(*arguments, **options, engine=engine)
        self._host.configure(self._host.RuntimeSettings(mode="worker", device="cpu"))
        self._turns: tuple[Callable[[], None], ...] = (self.play, self.render, self.fit, self.files, self.people)
        self.cancelled: dict[str, int] = {}
        self._write_performance()
        self._new_scene()
        self._fill_cache()

    def round(self) -> None:
        """Do everything once."""
        self._rounds += 1
        for turn in self._chance.sample(self._turns, len(self._turns)):
            turn()

    def _write_performance(self) -> None:
        names = ("jawOpen", "mouthSmileLeft", "eyeBlinkRight", "browInnerUp")
        rows = [["Timecode", "BlendshapeCount", *names]]
        for number in range(PLAYED):
            values = [f"{self._chance.random():.4f}" for _ in names]
            rows.append([f"00:00:{number // 30:02d}:{number % 30:02d}.000", "61", *values])
        (self._folder / "performance.csv").write_text("".join(",".join(row) + "\n" for row in rows))

    def _fill_cache(self) -> None:
        """Draw people, then new expressions until the worker keeps no more: what grows from here on is no cache."""
        core, session = _module("grmm_core.session"), self._host.get_session()
        avatar, camera = session.open("default").id, _module("grmm_core.geometry.camera").Camera.orbit(96, 96)
        for seed in range(_module("grmm_core.session.wardrobe").READY):
            session.render([core.Instance(session.sample(seed).id)], camera, core.RenderOptions())
        controls, before = _module("grmm_core.controls.frame").Controls(), 0
        for frame in range(MOST_FRAMES):
            shown = controls.set_named({"jawOpen": self._chance.random(), "browInnerUp": self._chance.random()})
            session.render([core.Instance(avatar, shown)], camera, core.RenderOptions())
            if frame % FULL_FRAMES == 0:
                now = session.status().memory_bytes
                if 0 < now <= before + FULL_BYTES:
                    return
                before = now

    def _new_scene(self) -> None:
        bpy = self._bpy
        bpy.ops.wm.read_homefile(use_empty=True)
        bpy.ops.grmm.add_head()
        scene, camera = bpy.context.scene, bpy.data.objects.new("Camera", bpy.data.cameras.new("Camera"))
        scene.collection.objects.link(camera)
        camera.location, camera.rotation_euler, camera.data.lens = (0.0, -1.1, 0.0), (1.5708, 0.0, 0.0), 85.0
        scene.camera, scene.render.engine = camera, "GRMM"
        scene.render.resolution_x = scene.render.resolution_y = 160
        scene.frame_end = FRAMES

    def _head(self) -> Any:
        return _module("grmm_blender.scene.avatars").avatars_in(self._bpy.context.scene)[0].object

    def _select(self, item: Any) -> None:
        self._bpy.ops.object.select_all(action="DESELECT")
        item.select_set(True)
        self._bpy.context.view_layer.objects.active = item

    def play(self) -> None:
        """Import a performance, play it, take it off."""
        head, scene = self._head(), self._bpy.context.scene
        self._select(head)
        self._bpy.ops.grmm.import_performance(filepath=str(self._folder / "performance.csv"))
        for frame in range(PLAYED):
            scene.frame_set(frame)
            self._bpy.context.evaluated_depsgraph_get()
        for owner in (head, head.parent):
            if owner.animation_data is not None and owner.animation_data.action is not None:
                self._bpy.data.actions.remove(owner.animation_data.action)
        scene.frame_end = FRAMES

    def render(self) -> None:
        """Render an animation into files, and a still behind a mesh."""
        scene, head = self._bpy.context.scene, self._head()
        for frame, value in ((1, 0.0), (FRAMES, self._chance.random())):
            head["jawOpen"] = value
            head.keyframe_insert('["jawOpen"]', frame=frame)
        scene.render.filepath = str(self._folder / "frame_")
        self._bpy.ops.render.render(animation=True)
        self._bpy.ops.mesh.primitive_uv_sphere_add(radius=0.06, location=(0.05, -0.3, 0.0))
        sphere = self._bpy.context.object
        self._bpy.ops.render.render()
        mesh = sphere.data
        self._bpy.data.objects.remove(sphere)
        self._bpy.data.meshes.remove(mesh)

    def fit(self) -> None:
        """Begin a fit and cancel it."""
        request = _module("grmm_core.fitting.request").FitRequest((PHOTO,), self._folder / "person.grmm", "fast", threads=1)
        job = _module("grmm_blender.fitting.job").FitJob.start(sys.executable, request)
        ends = time.monotonic() + self._chance.uniform(0.5, FIT_SECONDS)
        while job.running and time.monotonic() < ends:
            time.sleep(0.05)
        stage = job.status.progress.stage or "start"
        job.cancel()
        state = job.wait(60.0).state
        if state != "cancelled":
            raise RuntimeError(f"A fit that was cancelled is {state}: {job.status.message}")
        self.cancelled[stage] = self.cancelled.get(stage, 0) + 1

    def files(self) -> None:
        """Save and open the scene, with a cloud of splats that has been exported from it."""
        bpy, path, splats = self._bpy, self._folder / "scene.blend", self._folder / "head.ply"
        self._select(self._head())
        bpy.ops.grmm.export_splats(filepath=str(splats))
        bpy.ops.grmm.import_splats(filepath=str(splats))
        bpy.ops.wm.save_as_mainfile(filepath=str(path))
        bpy.ops.wm.read_homefile(use_empty=True)
        bpy.ops.wm.open_mainfile(filepath=str(path))
        bpy.ops.render.render()
        self._new_scene()

    def people(self) -> None:
        """Add somebody new, draw and delete them."""
        bpy, known = self._bpy, set(self._bpy.data.objects)
        bpy.ops.grmm.add_head(person="RANDOM", seed=1000 + self._rounds)
        bpy.ops.render.render()
        for item in set(bpy.data.objects) - known:
            bpy.data.objects.remove(item)
        bpy.ops.outliner.orphans_purge(do_recursive=True)

    def left(self) -> dict[str, int]:
        """What there is now, of `ROW`."""
        time.sleep(_module("grmm_core.session.worker").IDLE_SECONDS + 1.0)  # it gives back what it has freed
        status, own = self._host.get_session().status(), PROCESSES / "self"
        memory = _module("grmm_core.compute.memory").resident_memory
        before = memory()
        _module("grmm_core.compute.memory").give_back()  # glibc keeps up to 64 MB that nobody holds, more or less by chance
        places = [own, PROCESSES / str(status.pid)]
        return {
            "blender_mb": memory() >> 20, "kept_mb": before - memory() >> 20, "worker_mb": status.memory_bytes >> 20,
            "threads": sum(len(list((place / "task").iterdir())) for place in places),
            "open_files": sum(len(list((place / "fd").iterdir())) for place in places),
            "children": sum(_parent(place) == os.getpid() for place in PROCESSES.iterdir() if place.name.isdigit()),
            "temporary": sum(path.is_file() for path in Path(tempfile.gettempdir()).rglob("*")),
        }  # fmt: skip

    @property
    def restarts(self) -> int:
        """How often the worker had to be started again."""
        return int(self._host.get_session().status().restarts)

    def end(self) -> list[str]:
        """Close the session; returns what lies in the folder and should not."""
        self._host.shutdown()
        expected = {"performance.csv", "scene.blend", "scene.blend1", "head.ply", "person.grmm.fit"}
        expected |= {f"frame_{number:04d}.png" for number in range(1, FRAMES + 1)}
        return sorted({path.name for path in self._folder.iterdir()} - expected)


def _parent(process: Path) -> int:
    try:
        return int((process / "stat").read_text().rpartition(")")[2].split()[1])
    except OSError:  # it has ended meanwhile
        return 0


def soak(minutes: float, engine: str, folder: Path) -> dict[str, Any]:
    """Run for so many minutes; returns the rows and what is wrong."""
    use = Soak(folder, engine)
    begin = time.monotonic()
    rows: list[dict[str, Any]] = []
    while not rows or time.monotonic() - begin < 60.0 * minutes:
        use.round()
        rows.append({"minutes": round((time.monotonic() - begin) / 60.0, 1), **use.left()})
        print("  ".join(f"{name} {rows[-1][name]}" for name in ROW), flush=True)
    restarts, strangers = use.restarts, use.end()
    return {
        "engine": engine, "rounds": len(rows), "cancelled in": use.cancelled, "restarts": restarts, "rows": rows,
        "wrong": faults(rows, restarts, strangers),
    }  # fmt: skip


def faults(rows: list[dict[str, Any]], restarts: int, strangers: list[str]) -> list[str]:
    """What is wrong, a sentence each."""
    found = [f"The worker was started again {restarts} times."] if restarts else []
    found += [f"Left in the folder: {', '.join(strangers)}."] if strangers else []
    quarter = len(rows) // 4
    for name in ROW[1:] if quarter else ():
        parts = rows[quarter : 2 * quarter], rows[-quarter:]
        early, late = (statistics.median(row[name] for row in part) for part in parts)
        # more than at any time early on, too: a thread that comes and goes is no growth
        if late > max(early * (1.0 + GROWTH), *(row[name] for row in parts[0])):
            found.append(f"{name} grew from {early:g} to {late:g}.")
    return found


def main() -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(description="Use the extension for hours and watch what it leaves.")
    parser.add_argument("--minutes", type=float, default=60.0, help="how long (default: %(default)g)")
    parser.add_argument("--engine", choices=("plain", "torch"), default="plain", help="of the worker (default: %(default)s)")
    parser.add_argument("--output", type=Path, help="write the figures as JSON")
    arguments = parser.parse_args()
    if not (PROCESSES / "self" / "fd").is_dir():
        print("soak: this system has no /proc to look at; use Linux.", file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory(prefix="grmm-soak-") as place:
        folder, temporary = Path(place, "files"), Path(place, "tmp")
        folder.mkdir()
        temporary.mkdir()
        os.environ["TMPDIR"] = tempfile.tempdir = str(temporary)
        try:
            result = with_extension(lambda: soak(arguments.minutes, arguments.engine, folder))
        except BuildError as error:
            print(f"soak: {error}", file=sys.stderr)
            return 1
    print(f"{result['rounds']} rounds; fits cancelled in {result['cancelled in']}")
    for sentence in result["wrong"] or ["Nothing is wrong."]:
        print(sentence)
    if arguments.output:
        arguments.output.parent.mkdir(parents=True, exist_ok=True)
        arguments.output.write_text(json.dumps(result, indent=1), "utf-8")
    return 1 if result["wrong"] else 0


if __name__ == "__main__":
    sys.exit(main())
