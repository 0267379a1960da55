"""`python -m tools.library WORK`: rebuild the avatars of `grmm_core/assets/avatars` from the embedded weights.

Captures more pictures of sixteen of the people whom the weights were trained on, with and without hair, and trains each of them
alone. Run it again to go on after an interruption. Needs bpy; two or three hours on two cores. `--hair` grows nothing but the
hair of the avatars that are there anew: minutes, without bpy.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from pathlib import Path

from grmm_core.avatar import EXTENSION, load_avatar
from grmm_core.avatar.library import LIBRARY_FOLDER
from grmm_core.session import create_session
from grmm_core.session.presenting import save_presented

from .library_hair import Dresser

LICENCE = "CC0-1.0"
SEED = 31  # of the embedded weights' capture
PEOPLE = {  # name in the library to number in the capture and display name: women, then men
    "layered": (9, "Woman, 31, layered hair"),
    "long": (17, "Woman, 23, long hair"),
    "curly": (19, "Woman, 19, curls"),
    "default": (29, "Woman, 43, layered hair"),
    "ringlets": (57, "Woman, 35, ringlets"),
    "bun": (5, "Woman, 78, grey bun"),
    "afro": (31, "Woman, 68, afro"),
    "pixie": (89, "Woman, 44, pixie cut"),
    "curls": (0, "Man, 35, curls"),
    "locs": (18, "Man, 34, locs and goatee"),
    "beard": (30, "Man, 46, full beard"),
    "freckles": (64, "Man, 32, quiff and freckles"),
    "grey": (100, "Man, 64, grey crop"),
    "side_part": (134, "Man, 41, side parting and beard"),
    "bald": (80, "Man, 37, bald"),
    "slick": (4, "Man, 27, slicked back"),
}
CAPTURE = (
    "--subjects", "168", "--shots", "12", "--cameras", "5", "--size", "512", "--samples", "4", "--seed", str(SEED),
    "--bare", "rest", "--layers",
)  # fmt: skip


def main() -> int:
    """Capture, train and copy; returns the exit code of the first command that fails, or 0."""
    parser = argparse.ArgumentParser(description="Rebuild the avatars that come with the package.")
    parser.add_argument("work", type=Path, nargs="?", help="folder for pictures and training runs")
    parser.add_argument("--steps", type=int, default=400, help="of training a person (default: %(default)s)")
    parser.add_argument("--hair", action="store_true", help="only the hair of the avatars that are there")
    parser.add_argument("--only", nargs="+", choices=tuple(PEOPLE), metavar="NAME", help="these avatars alone")
    arguments = parser.parse_args()
    chosen = {name: PEOPLE[name] for name in arguments.only or PEOPLE}
    if arguments.hair:
        _dress({name: LIBRARY_FOLDER / f"{name}{EXTENSION}" for name in chosen})
        return 0
    if arguments.work is None:
        parser.error("name a folder for pictures and training runs, or give --hair")
    data = arguments.work / "capture"
    code = _grmm("capture", str(data), *CAPTURE, "--only", *(str(number) for number, _ in chosen.values()))
    for name, (number, title) in chosen.items():
        person, run = f"s{SEED:04d}_{number:04d}", arguments.work / name
        code = code or _grmm(
            "train", "person", "--data", str(data), "--out", str(run), "--name", title, "--licence", LICENCE, "--resume",
            "--set", f"person={person}", f"steps={arguments.steps}",
        )  # fmt: skip
        if not code:
            _dress({name: run / f"{person}{EXTENSION}"})
    return code


def _dress(files: dict[str, Path]) -> None:
    """Write avatars of the library by name, as the files have them but for their hair."""
    dresser = Dresser()
    with create_session() as session:
        for name, file in files.items():
            avatar = dresser.dressed(load_avatar(file), SEED, PEOPLE[name][0])
            save_presented(avatar, LIBRARY_FOLDER / f"{name}{EXTENSION}", session)


def _grmm(*arguments: str) -> int:
    return subprocess.run([sys.executable, "-m", "grmm_core", *arguments], check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
