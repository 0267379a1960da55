"""Recorded performances on the command line: their options, and what an avatar plays of them."""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from ..controls.frame import Controls
from ..errors import FileFormatError
from ..formats import format_to_read, formats
from ..head import HeadModel, load_flame
from ..performance import Performance, resample, to_arkit
from ..session import AvatarInfo
from .common import add_format_options, options_of

_NEEDS_FLAME = "{what} needs your own FLAME file (generic_model.pkl or flame2023.pkl); name it with --flame."


def add_playing(playing: argparse._ActionsContainer) -> None:
    """Add --performance, --fps, --flame and the options of the files' readers."""
    playing.add_argument("--performance", type=Path, metavar="FILE", help="a recording that the avatar plays, on top of --set")
    playing.add_argument("--fps", type=float, metavar="N", help="frames a second that are written (default: the recording's)")
    playing.add_argument("--flame", metavar="FILE", help="your FLAME file, for FLAME's parameters and GaussianAvatars folders")
    add_format_options(playing, formats("performance", read=True), "reading")


def performance_of(args: argparse.Namespace) -> Performance | None:
    """The recording, at the rate that is asked for."""
    if args.performance is None:
        return None
    found = format_to_read(args.performance, "performance")
    read: Performance = found.read(args.performance, **options_of(args, found, "reading"))
    return read if args.fps is None else resample(read, args.fps)


def playable(played: Performance, avatar: AvatarInfo, args: argparse.Namespace) -> Performance:
    """A recording that the avatar can play: FLAME's coefficients become ARKit weights for the open head."""
    if played.expression is None or avatar.head_name.startswith("flame"):
        return played
    return to_arkit(played, flame_of(args, f"{args.performance} has FLAME's coefficients and"))


def flame_of(args: argparse.Namespace, what: str) -> HeadModel:
    """The user's FLAME model, which `what` needs. Raises `FileFormatError` where none is named."""
    named = args.flame or args.head
    if not named:
        raise FileFormatError(_NEEDS_FLAME.format(what=what))
    return load_flame(named)


def together(controls: Controls, frame: Controls) -> Controls:
    """What --set asks for and what a frame of the recording adds to it."""
    both, added = controls.copy(), frame.validate()
    both.aligned, both.pose = both.aligned + added.aligned, both.pose + added.pose
    if added.expression.size:
        both.expression = np.pad(both.expression, (0, max(0, added.expression.size - both.expression.size)))
        both.expression[: added.expression.size] += added.expression
    return both
