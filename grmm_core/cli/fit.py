"""`grmm fit`: make an avatar of the person in one or several photos."""

from __future__ import annotations

import argparse
import json
import math
import os
import signal
import sys
from pathlib import Path
from types import FrameType
from typing import Any

import numpy as np

from ..errors import CancelledError, ConfigError, GrmmError
from ..fitting.presets import PRESETS
from .common import add_model, add_output, check_folder, positive_int

CONSENT = "Make avatars only of people who have agreed; the file says that it was made from photos."


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    text = "make an avatar from photos"
    parser = subparsers.add_parser("fit", help=text, description=f"M{text[1:]}. {CONSENT}")
    parser.add_argument("photos", metavar="PHOTO", nargs="+", type=Path, help="photos of one person; the first gives the light")
    add_output(parser, "the .grmm file to write; not needed with --look", required=False)
    parser.add_argument("--look", type=Path, metavar="DIR", help="only draw what is found in each photo, to DIR/found_N.png")
    parser.add_argument("--preset", choices=tuple(PRESETS), default="standard", help="amount of work (default: %(default)s)")
    parser.add_argument(
        "--face", action="append", default=[], type=positive_int, metavar="N", dest="faces",
        help="which face, the largest is 1 (the default); once for all photos, or once for each, in their order",
    )  # fmt: skip
    parser.add_argument(
        "--mask", action="append", default=[], type=Path, metavar="FILE", dest="masks",
        help="picture of the person's outline, white on black; once for each photo, in their order",
    )  # fmt: skip
    parser.add_argument("--resume", action="store_true", help="go on with an interrupted fit of the same photos")
    parser.add_argument("--work", type=Path, metavar="DIR", help="folder for the state (default: beside the output)")
    parser.add_argument("--name", default="", help="display name of the avatar (default: the file's name)")
    parser.add_argument("--events", action="store_true", help="write progress as one JSON object a line on stdout")
    add_model(parser)


def run(args: argparse.Namespace) -> dict[str, Any] | int:
    """Fit, and write the file. Raises `GrmmError`s; under --events they are written as the last event, too."""
    events = _Events(args.events)
    with _StopOnSignal() as stop:
        try:
            if args.look is not None:
                return _look(args, events, stop)
            return _run(args, events, stop)
        except GrmmError as error:
            events.write(event="error", message=str(error))
            raise
        except MemoryError:
            events.write(event="error", message="There is not enough memory; choose the preset fast or close other programs.")
            raise


def _look(args: argparse.Namespace, events: _Events, stop: _StopOnSignal) -> dict[str, Any] | int:
    """Draw faces, landmarks and outline of each photo, so that the user can check the choice."""
    from ..files.access import atomic_write_bytes, make_folder
    from ..fitting.api import check_face, check_faces, check_masks, read_mask
    from ..fitting.look import found_picture
    from ..fitting.track import analyse_photo
    from ..pictures.images import encode_png

    check_masks(args.photos, args.masks)
    check_faces(args.photos, args.faces)
    make_folder(args.look)
    pictures, missing = [], []
    for index, photo in enumerate(args.photos):
        if stop.requested:
            raise CancelledError("Looking at the photos was cancelled.")
        found = analyse_photo(photo)
        mask = read_mask(args.masks[index]) if args.masks else None
        chosen = args.faces[index] if len(args.faces) == len(args.photos) else (args.faces or [1])[0]
        face = min(chosen, len(found.faces)) - 1
        missing += [(photo, chosen, len(found.faces))] if chosen - 1 != face else []
        path = args.look / f"found_{index + 1}.png"
        atomic_write_bytes(path, encode_png(found_picture(found, face, mask)))
        pictures.append(str(path))
        events.write(event="found", photo=str(photo), picture=str(path), faces=len(found.faces))
        if not args.events:
            args.console.line(f"{photo.name}: {len(found.faces)} face{'s' * (len(found.faces) != 1)}, see {path}")
    for photo, chosen, count in missing:  # said after all pictures are drawn: they show which numbers there are
        check_face(photo, chosen - 1, count)
    return 0 if args.events else {"pictures": pictures}


def _run(args: argparse.Namespace, events: _Events, stop: _StopOnSignal) -> dict[str, Any] | int:
    # Threads of torch that wait for one another spin by default. Where another program has a core, each of the thousands of
    # short operations of a fit then waits for a thread that is not running: the same work took 18 times as long on two threads
    # as on one. Read by the library when torch is loaded, so it must be set before.
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    from ..fitting.api import fit

    if args.output is None:
        raise ConfigError("No avatar file is named; add -o NAME.grmm.")
    check_folder(args.output)
    with args.console.progress("fitting", 100) as bar:
        done = 0
        stages: dict[str, float] = {}

        def show(stage: str, share: float, left: float, preview: str) -> None:
            nonlocal done
            stages[stage] = share
            now = int(100 * (0.05 * stages.get("analyse", 0.0) + 0.15 * stages.get("track", 0.0)
                             + 0.3 * stages.get("codes", 0.0) + 0.5 * stages.get("decoders", 0.0)))  # fmt: skip
            bar.advance(max(0, now - done), stage if math.isnan(left) else f"{stage}, about {left:.0f} s left")
            done = max(done, now)
            seconds = None if math.isnan(left) else round(left, 1)
            events.write(event="progress", stage=stage, fraction=round(share, 4), seconds_left=seconds, preview=preview)

        def faces(photo: str, boxes: np.ndarray) -> None:
            events.write(event="faces", photo=photo, boxes=np.round(boxes, 1).tolist())
            if len(boxes) > 1:
                args.console.message(f"{Path(photo).name} shows {len(boxes)} faces; --face N chooses, the largest is 1.")

        result = fit(
            args.photos, args.output, preset=args.preset, faces=[face - 1 for face in args.faces] or [0], masks=args.masks,
            weights=args.weights, head=args.head, device=args.device, threads=args.threads, work=args.work, resume=args.resume,
            name=args.name, progress=show, on_faces=faces, cancelled=lambda: stop.requested,
        )  # fmt: skip
    events.write(event="done", avatar=str(result.path))
    if args.events:
        return 0
    args.console.line(f"Wrote {result.path} in {result.seconds:.0f} s; color error {np.mean(result.rmse):.3f} in the photos.")
    args.console.line("It shows a real person: use it only with that person's agreement.")
    return {
        "file": str(result.path), "name": result.avatar.name, "seconds": result.seconds, "rmse": list(result.rmse),
        "landmark_error": list(result.landmark_error), "photos": [photo.name for photo in result.avatar.provenance.photos],
    }  # fmt: skip


class _Events:
    """Writes one JSON object a line on stdout, for a program that started this one."""

    def __init__(self, active: bool) -> None:
        self._active = active

    def write(self, **values: Any) -> None:
        """Write an event and hand it to the reader at once."""
        if self._active:
            sys.stdout.write(json.dumps(values, ensure_ascii=False) + "\n")
            sys.stdout.flush()


class _StopOnSignal:
    """Turns the first SIGINT or SIGTERM into a request, so that the state is saved; the second one interrupts."""

    def __init__(self) -> None:
        self.requested = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> _StopOnSignal:
        for number in (signal.SIGINT, signal.SIGTERM):
            self._previous[number] = signal.signal(number, self._handle)
        return self

    def __exit__(self, *_: object) -> None:
        for number, handler in self._previous.items():
            signal.signal(number, handler)

    def _handle(self, _number: int, _frame: FrameType | None) -> None:
        if self.requested:
            raise KeyboardInterrupt
        self.requested = True
