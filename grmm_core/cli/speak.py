"""`grmm speak`: make the performance for a recorded voice."""

from __future__ import annotations

import argparse
import time
from pathlib import Path
from typing import Any

from ..errors import FileFormatError
from ..files.access import read_bytes
from ..jobs.stages import SPEAK
from ..voice.request import ENGLISH, LANGUAGES, SpeakRequest
from .common import StopOnSignal, add_events, add_output

_MOST_TEXT = 1 << 20  # bytes: more than an hour of speech


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    text = "make the performance for a recorded voice"
    parser = subparsers.add_parser("speak", help=text, description=f"M{text[1:]}, as ARKit weights.")
    parser.add_argument("recording", metavar="RECORDING", type=Path, help="a sound file of one voice, or a video with it")
    add_output(parser, "the ARKit JSON file to write")
    said = parser.add_mutually_exclusive_group()
    said.add_argument("--text", default="", metavar="WORDS", help="what is said, in English, which makes lips more exact")
    said.add_argument("--text-file", type=Path, metavar="FILE", help="a text file (UTF-8) of it")
    parser.add_argument(
        "--language", choices=LANGUAGES, default=ENGLISH, help="english is heard in words, others in sounds (%(default)s)"
    )
    parser.add_argument("--strength", type=float, default=1.0, metavar="X", help="of lips and jaw, 0 to 2 (%(default)s)")
    parser.add_argument(
        "--liveliness", type=float, default=1.0, metavar="X", help="of brows, eyes and head, 0 to 2 (%(default)s)"
    )
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="draws other looks and blinks (default: %(default)s)")
    parser.add_argument(
        "--start", type=float, default=0.0, metavar="S", help="first second that is used (default: %(default)s)"
    )
    parser.add_argument("--end", type=float, metavar="S", help="last second (default: the recording's)")
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Listen, and write the file. Raises `GrmmError`s."""
    if args.text_file is not None:
        args.text = _read_text(args.text_file)
    request = SpeakRequest.from_arguments(args)
    begin = time.monotonic()
    with StopOnSignal() as stop, args.console.progress(SPEAK) as show:
        from ..voice.api import speak

        done = speak(request, progress=show, cancelled=lambda: stop.requested)
    seconds, performance = time.monotonic() - begin, done.performance
    args.console.line(f"Wrote {done.path}: {performance.frame_count} frames, {performance.duration:.1f} s, in {seconds:.0f} s.")
    if done.heard.text and not request.text:
        args.console.line(f"Heard: {done.heard.text}")
    for sentence in performance.warnings:
        args.console.line(sentence)
    return {
        "file": str(done.path), "performance": str(done.path), "frames": performance.frame_count, "fps": performance.fps,
        "seconds": seconds, "heard": done.heard.text, "warnings": list(performance.warnings),
    }  # fmt: skip


def _read_text(path: Path) -> str:
    try:
        return read_bytes(path, limit=_MOST_TEXT).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path} is no UTF-8 text; save it as UTF-8.") from error
