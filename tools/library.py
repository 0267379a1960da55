"""`python -m tools.library WORK`: rebuild the avatars of `grmm_core/assets/avatars` from the embedded weights.

Captures more pictures of four of the people whom the weights were trained on and trains each of them alone. Run it again to go
on after an interruption. Needs bpy; an hour or two on two cores.
"""

from __future__ import annotations

import argparse
import shutil
import subprocess
import sys
from pathlib import Path

from grmm_core.avatar import EXTENSION
from grmm_core.avatar.library import LIBRARY_FOLDER

LICENCE = "CC0-1.0"
SEED = 21  # of the embedded weights' capture
PEOPLE = {  # name in the library to number in the capture and display name
    "default": (42, "Default head"),
    "short": (97, "Short hair"),
    "beard": (15, "Bearded man"),
    "afro": (46, "Woman with an afro"),
}
CAPTURE = ("--subjects", "110", "--shots", "16", "--cameras", "5", "--size", "512", "--samples", "4", "--seed", str(SEED))


def main() -> int:
    """Capture, train and copy; returns the exit code of the first command that fails, or 0."""
    parser = argparse.ArgumentParser(description="Rebuild the avatars that come with the package.")
    parser.add_argument("work", type=Path, help="folder for pictures and training runs")
    parser.add_argument("--minutes", type=float, default=15.0, help="of training a person (default: %(default)s)")
    arguments = parser.parse_args()
    data = arguments.work / "capture"
    numbers = [str(number) for number, _ in PEOPLE.values()]
    code = _grmm("capture", str(data), *CAPTURE, "--only", *numbers)
    for name, (number, title) in PEOPLE.items():
        person, run = f"s{SEED:04d}_{number:04d}", arguments.work / name
        code = code or _grmm(
            "train", "person", "--data", str(data), "--out", str(run), "--name", title, "--licence", LICENCE, "--resume",
            "--set", f"person={person}", f"minutes={arguments.minutes}",
        )  # fmt: skip
        if not code:
            shutil.copy2(run / f"{person}{EXTENSION}", LIBRARY_FOLDER / f"{name}{EXTENSION}")
    return code


def _grmm(*arguments: str) -> int:
    return subprocess.run([sys.executable, "-m", "grmm_core", *arguments], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
