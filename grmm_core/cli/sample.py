"""`grmm sample`: draw a new person from the model."""

from __future__ import annotations

import argparse
from typing import Any

from ..avatar.file import EXTENSION
from ..errors import ConfigError
from ..session import create_session
from .common import add_model, add_output, check_folder


def add_parser(subparsers: Any) -> None:
    """Add the command."""
    parser = subparsers.add_parser("sample", help="draw a new person from the model", description="Draw a new person.")
    parser.add_argument("--seed", type=int, default=0, help="equal seeds give equal people (default: %(default)s)")
    add_output(parser, "the .grmm file to write")
    add_model(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Draw the person and write the file."""
    if args.output.suffix != EXTENSION:
        raise ConfigError(f"{args.output} does not end in {EXTENSION}; a person is written as such a file.")
    check_folder(args.output)
    with create_session(weights=args.weights, device=args.device, threads=args.threads, head=args.head) as session:
        avatar = session.sample(args.seed)
        session.save(avatar.id, args.output)
    args.console.line(f"Wrote {args.output} ({avatar.name}).")
    return {"file": str(args.output), "name": avatar.name, "seed": args.seed, "weights": avatar.weights_name}
