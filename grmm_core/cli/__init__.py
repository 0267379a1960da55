"""The `grmm` command: one module for each sub-command, all with the same manners.

A command module has ``add_parser(subparsers)``, which adds a parser named like the module, and ``run(args)``, which does the
work and returns None, a mapping (the result, printed as one object under ``--json``) or an exit code. ``args.console`` is the
`console.Console` to write with. Commands that take a while offer ``--events``. Command modules are light to import: torch is
loaded in ``run``. A command whose module is not installed is not offered.

Errors meant for the user are one sentence on stderr and exit code 1; wrong usage is exit code 2; ``--debug`` shows tracebacks.
"""

from __future__ import annotations

import argparse
import importlib
import importlib.util
import logging
import os
import sys
import warnings
from collections.abc import Mapping, Sequence
from types import ModuleType

from .. import __version__
from ..errors import GrmmError
from .console import Console

COMMANDS = ("info", "render", "fit", "track", "speak", "capture", "train", "evaluate", "export", "sample", "bench")
EXIT_OK, EXIT_ERROR, EXIT_USAGE = 0, 1, 2


def main(argv: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        argv: Arguments without the program's name; those of the process when None.

    Returns:
        The exit code: 0, 1 for an error, 2 for wrong usage.
    """
    _let_others_work()
    try:
        code = _run(argv)
        sys.stdout.flush()  # a pipe that is closed is noticed here, not at exit
    except BrokenPipeError:
        # The reader of our output (a pager, head) has left; Python must not complain about it at exit either.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_ERROR
    except KeyboardInterrupt:  # while the commands were loaded
        sys.stderr.write("grmm: Cancelled.\n")
        return EXIT_ERROR
    return code


def _let_others_work() -> None:
    """Have libraries' threads sleep while they wait for one another; torch and numpy read this when they are loaded.

    By default they spin. Where another program has a core, each of thousands of short operations then waits for a thread that
    does not run: of torch's the same work took 18 times as long on two threads as on one; 10,000 inverses of 2 x 2 by numpy,
    whose threads cannot be told to sleep, took seconds instead of 0.03.
    """
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")


def _run(argv: Sequence[str] | None) -> int:
    """As `main`, but for a closed pipe, which help and lists meet as well, and for Ctrl-C while commands are loaded."""
    parser, modules = build_parser()
    try:
        args = parser.parse_args(argv)
    except SystemExit as stop:  # argparse has printed the help or what is wrong
        return int(stop.code or 0)
    console = Console(args.json, as_events=getattr(args, "events", False))
    args.console = console
    logging.basicConfig(
        level=logging.DEBUG if args.debug else logging.WARNING, format="%(levelname)s %(name)s: %(message)s", stream=sys.stderr
    )
    if not args.debug:
        warnings.simplefilter("ignore")  # those of libraries are for developers
    try:
        result = modules[args.command].run(args)
        if isinstance(result, int):
            return result
        if isinstance(result, Mapping):
            console.result(result)
    except GrmmError as error:
        return _fail(args, console, str(error))
    except KeyboardInterrupt:
        return _fail(args, console, "Cancelled.")
    except ModuleNotFoundError as error:
        return _fail(args, console, f"The Python {sys.executable} lacks the package {error.name}; install it there.")
    except MemoryError:
        return _fail(args, console, "There is not enough memory; choose a smaller size or close other programs.")
    except BrokenPipeError:
        raise
    except Exception as error:  # noqa: BLE001 - the last line of defence: no traceback unless it is asked for
        if _out_of_gpu_memory(error):
            return _fail(args, console, "The graphics card has not enough memory; choose a smaller size or --device cpu.")
        return _fail(args, console, f"Internal error ({type(error).__name__}: {error}); run again with --debug and report it.")
    return EXIT_OK


def build_parser() -> tuple[argparse.ArgumentParser, dict[str, ModuleType]]:
    """Return the parser and the modules of the commands that are installed."""
    parser = argparse.ArgumentParser(prog="grmm", description="Gaussian residual morphable model of the human head.")
    parser.add_argument("--version", action="version", version=f"grmm {__version__}")
    subparsers = parser.add_subparsers(dest="command", metavar="COMMAND", required=True)
    modules: dict[str, ModuleType] = {}
    for name in COMMANDS:
        if importlib.util.find_spec(f"{__name__}.{name}") is None:
            continue
        modules[name] = importlib.import_module(f".{name}", __name__)
        modules[name].add_parser(subparsers)
        command = subparsers.choices[name]
        command.add_argument("--json", action="store_true", help="print the result as one JSON object on stdout")
        command.add_argument("--debug", action="store_true", help="show log messages, and tracebacks of errors")
    return parser, modules


def _out_of_gpu_memory(error: Exception) -> bool:
    """Whether torch found a graphics card full; torch is not imported for the question."""
    torch = sys.modules.get("torch")
    return torch is not None and isinstance(error, torch.OutOfMemoryError)


def _fail(args: argparse.Namespace, console: Console, message: str) -> int:
    if args.debug:
        logging.getLogger(__name__).exception("the command failed")
    console.error(message)
    return EXIT_ERROR
