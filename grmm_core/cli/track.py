"""`grmm track`: capture the performance of a face in a video."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ..jobs.stages import TRACK
from ..video.request import TrackRequest
from .common import StopOnSignal, add_events, add_output, positive_int


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    text = "capture the performance of a face in a video"
    parser = subparsers.add_parser(
        "track", help=text, description=f"C{text[1:]}, as ARKit weights. Use videos only of people who have agreed."
    )
    parser.add_argument("video", metavar="VIDEO", type=Path, help="a phone's or a webcam's video of one face, from the front")
    add_output(parser, "the ARKit JSON file to write")
    parser.add_argument("--person", type=Path, metavar="AVATAR", help="a .grmm of the same person, whose shape is used")
    parser.add_argument(
        "--start", type=float, default=0.0, metavar="S", help="first second that is used (default: %(default)s)"
    )
    parser.add_argument("--end", type=float, metavar="S", help="last second (default: the video's)")
    parser.add_argument("--face", type=positive_int, default=1, metavar="N", help="which face, the largest is 1 (the default)")
    parser.add_argument("--threads", type=positive_int, metavar="N", help="CPU threads (default: all)")
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Track, and write the file. Raises `GrmmError`s."""
    request = TrackRequest.from_arguments(args)
    begin = time.monotonic()
    with StopOnSignal() as stop, args.console.progress(TRACK) as show:
        import torch

        from ..video.api import track

        if request.threads:
            torch.set_num_threads(request.threads)
        done = track(request, progress=show, cancelled=lambda: stop.requested)
    seconds, performance = time.monotonic() - begin, done.performance
    args.console.line(f"Wrote {done.path}: {performance.frame_count} frames, {performance.duration:.1f} s, in {seconds:.0f} s.")
    for sentence in performance.warnings:
        args.console.line(sentence)
    return {
        "file": str(done.path), "performance": str(done.path), "frames": performance.frame_count, "fps": performance.fps,
        "seconds": seconds, "landmark_error": done.error, "warnings": list(performance.warnings),
    }  # fmt: skip
