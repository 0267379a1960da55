"""A Blender with a window on a virtual screen, driven from outside.

Needs Xvfb, openbox, xdotool and ImageMagick's `import` beside Blender, in this system or, with `root`, in a folder that holds
another one (chroot): `WalkedBlender(output, root=Path("/opt/sid"))`. Keys go by keycode, because a key by its name arrives
with modifiers on some layouts; Escape by name, because xdotool takes its keycode, 9, for the digit.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from pathlib import Path
from typing import Any, Self

KEYS: dict[str, int | str] = {
    "F3": 69, "F12": 96, "Escape": "Escape", "Return": 36, "space": 65, "Tab": 23, "Delete": 119, "ctrl": 37, "shift": 50,
    "alt": 64, "a": 38, "g": 42, "n": 57, "z": 52, "s": 39, "r": 27, "x": 53, "0": 90, "1": 87, "5": 84, "period": 91,
}  # fmt: skip
SIZE = (1600, 1000)
START_SECONDS = 120.0
DRAG_SECONDS = 120.0
SETTLE_SECONDS = 600.0  # the first splats take minutes on a busy machine
_BUSY = """
import sys
found = {end: module for name, module in list(sys.modules.items()) for end in ("viewport.overlay", "engine.view")
         if name.endswith("grmm_blender." + end)}
splats, rendered = (getattr(module, "_viewports", None) for module in map(found.get, ("viewport.overlay", "engine.view")))
waiting = [view.jobs for view in (splats or {}).values()] + [view._jobs for view in rendered or ()]
result = any(jobs._thread is not None for jobs in waiting)
"""


class WalkError(Exception):
    """Blender did not start, or a snippet failed."""


class WalkedBlender:
    """Blender in a window of the virtual screen, until the `with` block ends.

    Args:
        output: Folder for pictures and the console's text.
        root: Folder of another system in which everything runs, or None for this one.
        home: User folder of Blender, kept between walks where given; else one that starts empty.
        display: Name of the virtual screen; one that nothing else uses.
    """

    def __init__(self, output: Path, root: Path | None = None, home: Path | None = None, display: str = ":77") -> None:
        self.output = output
        self._root, self._display = root, display
        shared = (root or Path("/")) / "tmp"
        self.shared = Path(tempfile.mkdtemp(prefix="grmm-walk-", dir=shared))
        self.torch_python = ""  # an interpreter with torch, as Blender sees it; steps that need one are left out without
        self._home = home
        self._processes: list[subprocess.Popen[bytes]] = []
        self._count = 0
        self._pictures = 0

    def inner(self, path: Path) -> str:
        """Return a path below `shared` as Blender sees it."""
        return "/" + str(path.relative_to(self._root or Path("/")))

    def __enter__(self) -> Self:
        self.output.mkdir(parents=True, exist_ok=True)
        for name in ("inside.py", "waits.py", "drag_source.py"):
            shutil.copy(Path(__file__).with_name(name), self.shared / name)
        snippets = self.shared / "snippets"
        snippets.mkdir()
        width, height = SIZE
        self._start(["Xvfb", self._display, "-screen", "0", f"{width}x{height}x24", "+extension", "GLX"])
        time.sleep(1.0)
        self._start(["openbox"])
        begin = [
            "blender",
            "--window-geometry",
            "0",
            "0",
            str(width),
            str(height),
            "--python",
            self.inner(self.shared / "inside.py"),
        ]
        self._start([*begin, "--", self.inner(snippets)])
        self.run("result = bpy.app.version_string", START_SECONDS)
        return self

    def __exit__(self, *_: object) -> None:
        for process in reversed(self._processes):
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGTERM)
        for process in self._processes:
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
        shutil.copy(self.shared / "console.txt", self.output / "console.txt")
        shutil.rmtree(self.shared, ignore_errors=True)

    @property
    def console(self) -> str:
        """What Blender has written to its console."""
        return (self.shared / "console.txt").read_text("utf-8", errors="replace")

    @property
    def waits(self) -> list[dict[str, Any]]:
        """What kept Blender's main thread so far, see `waits.Watch`."""
        path = self.shared / "waits.txt"
        return [json.loads(line) for line in path.read_text("utf-8").splitlines()] if path.exists() else []

    def run(self, snippet: str, timeout: float = 60.0) -> Any:
        """Run Python inside the live window and return its `result`. Raises `WalkError` with its traceback."""
        self._count += 1
        path = self.shared / "snippets" / f"{self._count:05d}.py"
        path.with_suffix(".part").write_text(snippet, "utf-8")
        path.with_suffix(".part").rename(path)
        answer = path.with_suffix(".json")
        deadline = time.monotonic() + timeout
        while not answer.exists():
            if time.monotonic() > deadline or self._processes[-1].poll() is not None:
                raise WalkError(f"Blender did not answer:\n{snippet}\n{self.console[-2000:]}")
            time.sleep(0.05)
        found = json.loads(answer.read_text("utf-8"))
        if "error" in found:
            raise WalkError(f"{snippet}\n{found['error']}")
        return found["result"]

    def key(self, *names: str) -> None:
        """Press keys together, the last one with the others held: `key("ctrl", "z")`."""
        codes = [str(KEYS[name]) for name in names]
        held, last = codes[:-1], codes[-1]
        steps = [part for code in held for part in ("keydown", code)] + ["key", last]
        steps += [part for code in reversed(held) for part in ("keyup", code)]
        self._command(["xdotool", *steps])
        time.sleep(0.3)

    def type(self, text: str) -> None:
        """Type text into what has the focus."""
        self._command(["xdotool", "type", "--delay", "30", text])
        time.sleep(0.3)

    def move(self, x: int, y: int) -> None:
        """Move the mouse to pixels from the upper left corner of the screen."""
        self._command(["xdotool", "mousemove", str(x), str(y)])
        time.sleep(0.2)

    def click(self, x: int, y: int, button: int = 1) -> None:
        """Click at pixels from the upper left corner of the screen."""
        self.move(x, y)
        self._command(["xdotool", "click", str(button)])
        time.sleep(0.3)

    def drop(self, path: str, x: int, y: int) -> None:
        """Drag a file, by its path as Blender sees it, onto the window, to pixels of the screen. Raises `WalkError`."""
        self.move(x, y)
        source = self.inner(self.shared / "drag_source.py")
        command = self._inside(["python3", source, self._window(), str(x), str(y), path])
        done = subprocess.run(
            command, env=self._environment(), capture_output=True, text=True, timeout=DRAG_SECONDS, check=False
        )
        if done.returncode:
            raise WalkError(f"{path} cannot be dropped: {done.stdout}{done.stderr}")
        self._command(["xdotool", "mousemove", str(x + 1), str(y)])  # Blender looks where the mouse is

    def _window(self) -> str:
        """Number of Blender's own window for X."""
        command = self._inside(["xdotool", "search", "--onlyvisible", "--class", "Blender"])
        return subprocess.run(
            command, env=self._environment(), capture_output=True, text=True, timeout=60.0, check=True
        ).stdout.split()[0]

    def settle(self) -> None:
        """Wait until no viewport has splats or pictures under way. Raises `WalkError` where that does not end."""
        deadline, still = time.monotonic() + SETTLE_SECONDS, 0
        while still < 2:  # what has just ended may ask for more with the next draw
            still = 0 if self.run(_BUSY, SETTLE_SECONDS) else still + 1
            if time.monotonic() > deadline:
                raise WalkError(f"the viewport is not finished after {SETTLE_SECONDS:.0f} s")
            time.sleep(0.5)

    def picture(self, title: str, wait: float = 1.5, settled: bool = True) -> Path:
        """Wait for Blender to draw, unless `settled` is off also for all that viewports wait for, and save a numbered PNG."""
        time.sleep(wait)
        if settled:
            self.settle()
        self._pictures += 1
        path = self.output / f"{self._pictures:02d}_{title}.png"
        inside = self.shared / "shot.png"
        self._command(["import", "-silent", "-window", "root", self.inner(inside)])
        shutil.copy(inside, path)
        return path

    def background(self, *arguments: str, timeout: float) -> None:
        """Run another Blender of the same user, such as `-b FILE -f 1`; its text goes to the console. Raises `WalkError`."""
        with (self.shared / "console.txt").open("ab") as console:
            command = self._inside(["blender", *arguments])
            done = subprocess.run(
                command, env=self._environment(), stdout=console, stderr=console, timeout=timeout, check=False
            )
        if done.returncode:
            raise WalkError(f"blender {' '.join(arguments)} ends with {done.returncode}")

    def bring(self, path: Path, name: str) -> Path:
        """Copy a file to where Blender can read it."""
        return Path(shutil.copy(path, self.shared / name))

    def processor_seconds(self) -> float:
        """Time that Blender, its worker and the screen have had on processors so far, 0 where the system does not tell."""
        ticks = 0
        for entry in Path("/proc").glob("[0-9]*"):
            try:
                if f"GRMM_WALK={self.shared.name}\0".encode() in (entry / "environ").read_bytes():
                    ticks += sum(map(int, (entry / "stat").read_text("utf-8").rpartition(")")[2].split()[11:13]))
            except OSError:  # gone meanwhile
                continue
        return ticks / os.sysconf("SC_CLK_TCK")

    def note(self, text: str) -> None:
        """Say something about a step, such as how long it took."""
        print(text, flush=True)

    def keep(self, path: Path, title: str) -> None:
        """Copy a file that Blender wrote beside the pictures."""
        self._pictures += 1
        shutil.copy(path, self.output / f"{self._pictures:02d}_{title}{path.suffix}")

    def _environment(self) -> dict[str, str]:
        home = self.inner(self.shared / "home") if self._home is None else str(self._home)
        (self.shared / "home").mkdir(exist_ok=True)
        return {
            "PATH": "/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin", "HOME": home, "DISPLAY": self._display,
            "GRMM_WALK": self.shared.name, "LIBGL_ALWAYS_SOFTWARE": "1", "LANG": "C.UTF-8", "OMP_WAIT_POLICY": "PASSIVE",
        }  # fmt: skip

    def _inside(self, command: list[str]) -> list[str]:
        return command if self._root is None else ["chroot", str(self._root), *command]

    def _start(self, command: list[str]) -> None:
        with (self.shared / "console.txt").open("ab") as console:
            self._processes.append(
                subprocess.Popen(
                    self._inside(command), env=self._environment(), stdout=console, stderr=console, start_new_session=True
                )
            )

    def _command(self, command: list[str]) -> None:
        subprocess.run(self._inside(command), env=self._environment(), check=True, timeout=60.0)
