"""`python -m tools.demo --out out [--performance FILE]`: see the package's docstring."""

from __future__ import annotations

import argparse
import atexit
import os
import subprocess
import sys
import time
from pathlib import Path

from grmm_core.errors import GrmmError

from ..build_extension import build
from .performance import write_performance


def main() -> int:
    """Run all steps; returns the exit code."""
    parser = argparse.ArgumentParser(description="Render an animated avatar through Blender into a folder.")
    parser.add_argument("--out", type=Path, default=Path("out"))
    parser.add_argument("--performance", type=Path, help="ARKit JSON or Live Link Face CSV (default: the demonstration's own)")
    parser.add_argument("--only-scene", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    out = arguments.out.resolve()
    performance = arguments.performance.resolve() if arguments.performance else out / "performance.json"
    try:
        if arguments.only_scene:
            return _render_scene(out, performance)
        return _run(out, performance, own=arguments.performance is None)
    except GrmmError as error:
        print(f"demo: {error}", file=sys.stderr)
        return 1


def _run(out: Path, performance: Path, own: bool) -> int:
    started = time.monotonic()
    (out / "frames").mkdir(parents=True, exist_ok=True)
    for old in (out / "frames").glob("*.png"):
        old.unlink()
    if own:
        write_performance(performance)
    # Blender gets a process of its own: its exit must not take the rest of the demonstration with it.
    command = [sys.executable, "-m", "tools.demo", "--only-scene", "--out", str(out), "--performance", str(performance)]
    if subprocess.run(command, check=False).returncode != 0:
        print("demo: Blender did not finish; its messages are above.", file=sys.stderr)
        return 1
    from grmm_core.session import create_session

    from .sheet import write_sheet

    print("demo: drawing the contact sheet", flush=True)
    with create_session() as session:
        write_sheet(out / "contact_sheet.png", session, sorted((out / "frames").glob("*.png")))
    seconds = time.monotonic() - started
    print(f"demo: done in {seconds:.0f} s; look at {out / 'contact_sheet.png'} and {out / 'performance.mp4'}")
    return 0


def _render_scene(out: Path, performance: Path) -> int:
    from .scene import render_sequence

    extension = build(out / "extension")
    frames = render_sequence(extension, performance, out, lambda line: print(f"demo: {line}", flush=True))
    return 0 if frames else 1


if __name__ == "__main__":
    code = main()
    if "bpy" in sys.modules:  # the wheel now and then waits forever in a destructor of its own
        atexit._run_exitfuncs()
        sys.stdout.flush()
        os._exit(code)
    sys.exit(code)
