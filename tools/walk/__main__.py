"""`python -m tools.walk ZIP --output FOLDER [--root FOLDER]`: walk with a built extension, print what went wrong."""

from __future__ import annotations

import argparse
import signal
import sys
from pathlib import Path

from .blender import WalkedBlender
from .order import walk


def main() -> int:
    """Walk through all steps in a window; returns the exit code."""
    parser = argparse.ArgumentParser(description="Walk through a real Blender with a window, with a built extension.")
    parser.add_argument("extension", type=Path, help="zip of the extension")
    parser.add_argument("--output", type=Path, default=Path("out/walk"), help="folder for pictures and the console's text")
    parser.add_argument("--root", type=Path, help="folder of another system, with Blender, Xvfb, openbox and xdotool (chroot)")
    parser.add_argument("--display", default=":77", help="name for the virtual screen (default: %(default)s)")
    parser.add_argument("--python", default="", help="a Python with torch, as Blender sees it: a photo becomes an avatar then")
    parser.add_argument("--pictures", type=Path, metavar="FOLDER", help="make the documents' pictures there instead of walking")
    parser.add_argument("--rate", action="store_true", help="measure how many frames a second are played instead of walking")
    arguments = parser.parse_args()
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))  # so that Blender and the screen end as well
    with WalkedBlender(arguments.output, arguments.root, display=arguments.display) as blender:
        blender.torch_python = arguments.python
        if arguments.rate:
            from .rate import measure

            measure(blender, arguments.extension)
            return 0
        if arguments.pictures is not None:
            from .pictures import take

            take(blender, arguments.extension, arguments.pictures)
            return 0
        problems = walk(blender, arguments.extension)
    for problem in problems:
        print(problem)
    print(f"{arguments.output} has the pictures; {len(problems)} problems")
    return 1 if problems else 0


if __name__ == "__main__":
    sys.exit(main())
