"""`grmm train`: train a model on captured data."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..avatar import EXTENSION
from ..errors import CancelledError, ConfigError
from ..jobs.stages import TRAINING
from .common import StopOnSignal, add_events
from .console import Console

if TYPE_CHECKING:
    from ..training.trainer import Trainer

FOLLOW_STEPS = 100


def add_parser(subparsers: Any) -> None:
    """Add the parser of the sub-command."""
    parser: argparse.ArgumentParser = subparsers.add_parser(
        "train",
        help="train a model on captured data",
        description="Train a model. Ctrl-C saves a checkpoint, --resume continues. Processes: torchrun -m grmm_core train.",
    )
    parser.add_argument(
        "config",
        metavar="CONFIG",
        help="TOML file, or of the project: surface, expressions, regions, small, small_no_residuals, person, paper",
    )
    parser.add_argument(
        "--data", nargs="+", metavar="DIR", required=True,
        help="data sets of grmm capture, or of VHAP, RenderMe-360, NeRSemble (found by looking at the folder)",
    )  # fmt: skip
    parser.add_argument("--head", metavar="FILE", help="your FLAME file, for data sets with FLAME parameters")
    parser.add_argument("--out", default="out/training", metavar="DIR", help="folder for checkpoints, previews and weights")
    parser.add_argument("--resume", action="store_true", help="continue from the checkpoint in the folder")
    parser.add_argument("--follow", action="store_true", help="the captures are still running: take up new shots now and then")
    parser.add_argument(
        "--set", action="extend", nargs="+", default=[], metavar="NAME=VALUE", help="change settings of the [training] table"
    )
    parser.add_argument("--device", default="auto", help="auto, cpu, cuda or mps")
    parser.add_argument("--name", metavar="TEXT", help="name of the avatar, where person=NAME is set; else the person's")
    parser.add_argument("--licence", default="", metavar="TEXT", help="what may be done with the avatar")
    parser.add_argument("--default-person", metavar="NAME", help="person who becomes the default avatar; else the mean")
    add_events(parser)


def run(args: argparse.Namespace) -> dict[str, Any] | int | None:
    """Train, and write the weights at the end; of several processes the first one alone says so. Raises `GrmmError`s."""
    from ..head import load_flame
    from ..session import create_session
    from ..session.presenting import save_presented
    from ..training.capture import capture_views
    from ..training.captured_hair import captured_hair
    from ..training.config import load_config
    from ..training.personal import of_the_weights
    from ..training.trainer import CHECKPOINT, Trainer

    settings = ({"refresh_every": FOLLOW_STEPS} if args.follow else {}) | _settings(args.set)
    config = load_config(args.config, settings)
    source, head = capture_views(
        args.data,
        args.follow,
        load_flame(args.head) if args.head else None,
        config.person,
        config.bare or bool(config.person and of_the_weights(config).model.hairless),
        bool(config.losses.get("detail")),
    )
    person = _person(source.people, args.default_person)
    if (Path(args.out) / CHECKPOINT).exists() and not args.resume:
        raise ConfigError(f"{args.out} holds a checkpoint already; add --resume or choose another folder with --out.")
    trainer = Trainer(config, head, source, args.out, _device(args.device))
    console = args.console if trainer.rank == 0 else Console(as_json=True)  # silent
    if args.resume:
        console.message(_continued(trainer) if trainer.resume() else f"There is no checkpoint in {args.out}; starting anew.")
    with StopOnSignal() as stop, console.progress(TRAINING) as show:
        try:
            trainer.run(show if trainer.rank == 0 else None, lambda: stop.requested)
        except CancelledError:
            if trainer.rank == 0:
                raise
            return 1
    if trainer.rank:
        return None
    path = Path(args.out) / (f"{config.person}{EXTENSION}" if config.person else f"{config.name}.safetensors")
    if config.person:
        hair = captured_hair(source.datasets, config.person, head) if trainer.config.model.hairless else None
        avatar = trainer.person_avatar(args.name or config.person, args.licence, hair)
        with create_session("local", weights=config.init_from, head=args.head) as session:
            save_presented(avatar, path, session)
    else:
        hours = round(trainer.seconds / 3600, 3)
        provenance: dict[str, Any] = {"seed": config.seed, "steps": trainer.step_count, "hours": hours}
        provenance |= {"data": [Path(d).name for d in args.data], "views": len(source.training)}
        trainer.save_weights(path, provenance, person)
    console.line(f"Wrote {path} after {trainer.step_count} steps, {trainer.seconds / 60:.1f} minutes.")
    kind = "avatar" if config.person else "weights"
    return {kind: str(path), "steps": trainer.step_count, "seconds": trainer.seconds, **trainer.metrics}


def _continued(trainer: Trainer) -> str:
    changes = "; ".join(trainer.differences)
    return f"Continuing after step {trainer.step_count}" + (f", not as it began: {changes}." if changes else ".")


def _settings(assignments: list[str]) -> dict[str, Any]:
    """Parse NAME=VALUE with true or false, whole numbers, numbers or text."""
    values: dict[str, Any] = {}
    for text in assignments:
        name, separator, value = text.partition("=")
        if not separator:
            raise ConfigError(f"{text!r} is not of the form NAME=VALUE; write for example steps=2000.")
        if value in ("true", "false"):
            values[name.strip()] = value == "true"
            continue
        for kind in (int, float, str):
            try:
                values[name.strip()] = kind(value)
                break
            except ValueError:
                continue
    return values


def _person(people: tuple[str, ...], name: str | None) -> int | None:
    if name is None:
        return None
    if name not in people:
        raise ConfigError(f"There is no person {name!r} in the data; there are {', '.join(people)}.")
    return people.index(name)


def _device(name: str) -> str:
    import torch

    from ..errors import BackendError

    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    if name.startswith("cuda") and not torch.cuda.is_available():
        raise BackendError("There is no CUDA device; use --device cpu.")
    # under torchrun each process has a card of its own
    return f"cuda:{os.environ['LOCAL_RANK']}" if name == "cuda" and "LOCAL_RANK" in os.environ else name
