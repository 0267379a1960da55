"""`grmm capture`: render an open training set of random people with Cycles."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path
from typing import Any

from ..errors import RuntimeMissingError
from ..jobs.progress import Progress
from ..jobs.stages import CAPTURE
from .common import add_cluster, add_events, cluster_of


def add_parser(subparsers: Any) -> None:
    """Add the parser of the sub-command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "capture",
        help="render a training set of random people (needs bpy)",
        description="Render random people with Cycles. Run it again to continue; --cluster shares the work.",
    )
    parser.add_argument("folder", metavar="DIR", type=Path, help="folder of the data set")
    parser.add_argument("--subjects", type=int, default=24, metavar="N", help="people (default: %(default)s)")
    parser.add_argument(
        "--expressions", default="all", metavar="all|NAMES", help="aligned expressions that are used (default: all 60)"
    )
    parser.add_argument(
        "--shots", type=int, default=12, metavar="N", help="expression mixes of each person (default: %(default)s)"
    )
    parser.add_argument(
        "--cameras", type=int, default=4, metavar="N", help="views of each shot, at most 24 (default: %(default)s)"
    )
    parser.add_argument("--size", type=int, default=384, metavar="PX", help="side of the pictures (default: %(default)s)")
    parser.add_argument(
        "--samples", type=int, default=4, metavar="N", help="samples a pixel before the denoiser (default: %(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="seed of everything (default: %(default)s)")
    parser.add_argument(
        "--only", type=int, nargs="+", default=[], metavar="N", help="render these people alone, by number from 0"
    )
    parser.add_argument("--varied-light", action="store_true", help="another light for every shot instead of the even rig")
    parser.add_argument("--subsurface", action="store_true", help="light scattering in the skin; slower")
    parser.add_argument("--no-depth", action="store_true", help="leave out the depth maps")
    parser.add_argument(
        "--bare", nargs="?", const="all", default="", metavar="all|rest|only",
        help="render every view without hair as well; rest: after the neutral shot the bare head alone; only: it alone always",
    )  # fmt: skip
    parser.add_argument("--layers", action="store_true", help="write part masks, albedo and normals")
    parser.add_argument(
        "--lights", default="", metavar="all|NAMES", help="show every view in these lights too, such as key,sunset"
    )
    parser.add_argument(
        "--splits", default="", metavar="NAMES",
        help="render only views of these splits, such as camera,expression,person: held-out views again with more samples",
    )  # fmt: skip
    parser.add_argument(
        "--framing", default="", metavar="mouth", help="mouth: open mouths from near instead of heads and faces"
    )
    parser.add_argument(
        "--threads", type=int, default=2, metavar="N", help="render threads of each process (default: %(default)s)"
    )
    add_cluster(parser)
    parser.add_argument("--sheet", type=Path, metavar="FILE", help="only make a contact sheet of what the folder holds")
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Render what is missing. Raises `GrmmError`s."""
    if importlib.util.find_spec("grmm_studio") is None:
        raise RuntimeMissingError("The capture studio is not installed; run the command in the project's folder.")
    if args.sheet:
        from grmm_studio.sheet import write_sheet

        count = write_sheet(args.folder, args.sheet)
        args.console.message(f"{count} pictures on {args.sheet}")
        return {"pictures": count, "sheet": str(args.sheet)}
    if importlib.util.find_spec("bpy") is None:
        raise RuntimeMissingError(
            "Rendering needs Blender's Python module; install it with pip install bpy==4.5.15 on Python 3.11."
        )
    from grmm_studio.capture import run_job
    from grmm_studio.settings import CaptureSettings

    settings = CaptureSettings(
        args.subjects, args.shots, args.cameras, args.size, args.samples, args.seed, args.expressions, args.varied_light,
        args.subsurface, not args.no_depth, args.bare, args.layers, args.lights,
        args.splits, args.framing,
    )  # fmt: skip

    with cluster_of(args) as cluster, args.console.progress(CAPTURE) as show:

        def report(progress: Progress) -> None:
            show(progress)
            if not args.console.draws_bars:
                args.console.message(progress.text(CAPTURE))

        outcome = run_job(args.folder.absolute(), settings, args.threads, report, args.only, cluster)
    text = f"{outcome.complete} of {outcome.total} shots are complete, {outcome.made} of them made now"
    if outcome.in_work:
        text += f"; other processes hold {outcome.in_work}, run the command again if they end before these are made"
    args.console.message(f"{text}.")
    return {
        "folder": str(args.folder), "shots": outcome.made, "complete": outcome.complete, "total": outcome.total,
        "in_work": outcome.in_work,
    }  # fmt: skip
