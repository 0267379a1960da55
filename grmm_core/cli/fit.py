"""`grmm fit`: make an avatar of the person in one or several photos, or of everybody in a folder."""

from __future__ import annotations

import argparse
import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from ..avatar import EXTENSION
from ..errors import ConfigError, SessionError
from ..files.access import make_folder
from ..fitting.folder import interrupted_request
from ..fitting.presets import PRESETS
from ..fitting.request import FacesRequest, FitRequest, faces_by_photo
from ..jobs.progress import Reporter
from ..jobs.stages import FIND_FACES, FIT, PEOPLE
from .common import StopOnSignal, add_cluster, add_events, add_model, add_output, cluster_of, make_absolute, positive_int
from .console import Console

CONSENT = "Make avatars only of people who have agreed; the file says that it was made from photos."


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    text = "make an avatar from photos"
    parser = subparsers.add_parser("fit", help=text, description=f"M{text[1:]}. {CONSENT}")
    parser.add_argument(
        "photos", metavar="PHOTO", nargs="*", type=Path,
        help="photos of one person; the first gives the light. Without any --resume goes on with what was asked. A folder "
        "alone: each photo in it shows a person, and so do all photos of a folder in it",
    )  # fmt: skip
    add_output(
        parser, "the .grmm file to write, of a folder of people the folder; not needed with --find-faces", required=False
    )
    parser.add_argument(
        "--find-faces", "--look", type=Path, metavar="DIR", help="only draw what is found in each photo, to DIR/found_N.png"
    )
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
    add_cluster(parser)
    add_events(parser)
    add_model(parser)


def run(args: argparse.Namespace) -> dict[str, Any] | int:
    """Fit, and write the file. Raises `GrmmError`s."""
    folder = len(args.photos) == 1 and args.photos[0].is_dir()
    if args.cluster and not folder:
        raise ConfigError("A cluster is for a folder of people; name one, or leave out --cluster.")
    with StopOnSignal() as stop:
        if folder and args.find_faces is None:
            return _fit_people(args, stop)
        if args.find_faces is not None:
            return _find_faces(FacesRequest.from_arguments(args), args.console, stop)
        if args.resume and not args.photos and args.output is not None:
            return _fit(interrupted_request(args.output, args.work), args.console, stop)
        return _fit(FitRequest.from_arguments(args), args.console, stop)


def _find_faces(request: FacesRequest, console: Console, stop: StopOnSignal) -> dict[str, Any]:
    """Draw faces, landmarks and outline of each photo, so that the user can check the choice."""
    make_folder(request.folder)
    pictures, missing, found = [], [], []
    with console.progress(FIND_FACES) as show:
        report = Reporter(FIND_FACES, show, lambda: stop.requested)
        report("load", 0.0)

        from ..files.access import atomic_write_bytes
        from ..fitting.api import check_face
        from ..fitting.faces_picture import draw_faces
        from ..fitting.track import analyse_photo, check_turned
        from ..photo.load import load_photo
        from ..pictures.images import encode_png

        for index, (photo, wanted) in enumerate(zip(request.photos, faces_by_photo(request), strict=True)):
            report.part("analyse")(index / len(request.photos))
            analysed = analyse_photo(photo)
            found.append(analysed)
            count = len(analysed.faces)
            mask = load_photo(request.masks[index]).coverage() if request.masks else None
            missing += [(photo, wanted, count)] if wanted >= count else []
            path = request.folder / f"found_{index + 1}.png"
            atomic_write_bytes(path, encode_png(draw_faces(analysed, min(wanted, count - 1), mask)))
            pictures.append(str(path))
            boxes = [face.box / analysed.photo.scale for face in analysed.faces]
            console.event("faces", photo=str(photo), boxes=np.round(boxes, 1), picture=str(path))
            console.line(f"{photo.name}: {count} face{'s' * (count != 1)}, see {path}")
        report("analyse", 1.0)
    for photo, wanted, count in missing:  # said after all pictures are drawn: they show which numbers there are
        check_face(photo, wanted, count)
    check_turned(found, faces_by_photo(request))
    return {"pictures": pictures}


def _fit_people(args: argparse.Namespace, stop: StopOnSignal) -> dict[str, Any] | int:
    """Make an avatar of everybody in a folder; 1 where somebody has none."""
    from ..fitting.batch import fit_people

    if args.faces or args.masks or args.work or args.name:
        raise ConfigError("--face, --mask, --work and --name are for the photos of one person; leave them out for a folder.")
    if args.output is None:
        raise ConfigError("No folder for the avatars is named; add -o DIR.")
    folder, output = args.photos[0], args.output
    args.output = output / f"NAME{EXTENSION}"
    make_absolute(args, "weights", "head")
    people: dict[str, Any] = {}
    with cluster_of(args) as cluster, args.console.progress(PEOPLE) as show:
        args.threads = args.threads or (cluster.threads if cluster is not None else None)
        reporter = Reporter(PEOPLE, show, lambda: stop.requested)
        for person in fit_people(folder, output, FitRequest.from_arguments(args), reporter.part("people"), cluster):
            people[person.name] = dataclasses.asdict(person)
            args.console.message(f"{person.name}: {person.error or person.file}")
    failed = sum(bool(person["error"]) for person in people.values())
    args.console.line(f"{len(people) - failed} of {len(people)} people have an avatar in {output}.")
    args.console.line("They show real people: use them only with their agreement.")
    result = {"people": dict(sorted(people.items())), "fitted": len(people) - failed}
    if failed:
        args.console.result(result)
    return 1 if failed else result


def _fit(request: FitRequest, console: Console, stop: StopOnSignal) -> dict[str, Any]:
    from ..fitting.api import fit

    def faces(photo: Path, boxes: np.ndarray) -> None:
        console.event("faces", photo=str(photo), boxes=np.round(boxes, 1))
        if len(boxes) > 1:
            console.message(f"{photo.name} shows {len(boxes)} faces; --face N chooses, the largest is 1.")

    with console.progress(FIT) as show:
        try:
            result = fit(request, progress=show, on_faces=faces, cancelled=lambda: stop.requested)
        except MemoryError as error:
            raise SessionError("There is not enough memory; choose the preset fast or close other programs.") from error
    console.line(f"Wrote {result.path} in {result.seconds:.0f} s; color error {np.mean(result.rmse):.3f} in the photos.")
    for sentence in result.warnings:
        console.line(sentence)
    console.line("It shows a real person: use it only with that person's agreement.")
    return {
        "file": str(result.path), "avatar": str(result.path), "name": result.avatar.name, "seconds": result.seconds,
        "rmse": list(result.rmse), "landmark_error": list(result.landmark_error),
        "warnings": list(result.warnings), "photos": [photo.name for photo in result.avatar.provenance.photos],
    }  # fmt: skip
