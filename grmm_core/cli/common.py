"""Arguments that several commands share, and what they mean."""

from __future__ import annotations

import argparse
import signal
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import Any

from ..controls.frame import Controls, parse_assignments
from ..controls.table import settable
from ..errors import ControlError, FileAccessError
from ..files.format import Format, OptionsOf, options_of_formats
from ..fitting.request import DEVICES
from ..hair import SETTINGS, HairSettings, groom_names
from ..hair.roots import GROUPS, SCALP
from ..hair.settings import Setting
from ..jobs.cluster import Cluster, open_cluster
from ..session.values import AvatarInfo
from ..session.wearing import GROOM_PREFIX, NO_HAIR, OWN_HAIR, PARTS, RANDOM_PREFIX, HairUse
from .console import Console


def add_avatar(parser: argparse.ArgumentParser) -> None:
    """Add the avatar as the first argument."""
    parser.add_argument("avatar", metavar="AVATAR", help="a .grmm file, 'default', 'library:NAME', or 'sample:SEED'")


def add_output(parser: argparse.ArgumentParser, text: str, required: bool = True) -> None:
    """Add -o/--output."""
    parser.add_argument("-o", "--output", metavar="FILE", required=required, type=Path, help=text)


def add_model(parser: argparse.ArgumentParser) -> None:
    """Add --device, --weights, --head and --threads."""
    parser.add_argument("--device", choices=DEVICES, default="auto", help="where the model runs (default: %(default)s)")
    parser.add_argument("--weights", metavar="NAME|FILE", help="trained weights (default: the embedded ones)")
    parser.add_argument("--head", metavar="FILE", help="your FLAME file, for weights that were trained on FLAME")
    parser.add_argument("--threads", type=positive_int, metavar="N", help="CPU threads (default: all)")


def add_controls(parser: argparse.ArgumentParser) -> None:
    """Add --set and --list-controls. AVATAR comes before --set, which takes every word up to the next option."""
    others = [name for name, control in settable() if control.unit != "weight" and control.source == "property"]
    parser.add_argument(
        "--set",
        action="extend",
        nargs="+",
        default=[],
        metavar="NAME=VALUE",
        dest="assignments",
        help="set a control: an ARKit name such as jawOpen, an aligned expression such as laugh, jaw.x, neck.y, eyes.yaw "
        f"(angles in radians), {', '.join(others)}; any number, and --set may be repeated",
    )
    parser.add_argument("--list-controls", action=_ListControls, nargs=0, help="print what --set takes, and leave")


class _ListControls(argparse.Action):
    """Print the table of controls."""

    def __call__(self, parser: argparse.ArgumentParser, *_: object) -> None:
        rows = [(name, f"{c.limits.low:.4g} to {c.limits.high:.4g}", c.unit, c.description) for name, c in settable()]
        Console().table(("name", "range", "unit", "what it is"), rows)
        parser.exit()


def add_format_options(parser: argparse._ActionsContainer, known: Iterable[Format], which: OptionsOf) -> None:
    """Add the options of formats, each once, as flags: --spz-version for an option `spz_version`."""
    for option in options_of_formats(known, which):
        flag = f"--{option.identifier.replace('_', '-')}"
        text = f"{option.description} (default: {option.default})"
        if isinstance(option.default, bool):
            parser.add_argument(flag, action=argparse.BooleanOptionalAction, default=option.default, help=option.description)
        else:
            choices = [value for value, _ in option.choices] or None
            parser.add_argument(flag, type=type(option.default), choices=choices, default=option.default, help=text)


def options_of(args: argparse.Namespace, entry: Format, which: OptionsOf) -> dict[str, Any]:
    """Return a format's options as the flags set them, by the names that its reader or writer has for them."""
    return {option.name: getattr(args, option.identifier) for option in getattr(entry, which)}


def add_hair(parser: argparse.ArgumentParser) -> None:
    """Add --hair, --brows, --beard, --lashes and --hair-set."""
    for part in GROUPS:
        what, more = ("what the avatar wears", ", random:SEED") if part == GROUPS[SCALP] else ("likewise", "")
        parser.add_argument(
            "--hair" if part == GROUPS[SCALP] else f"--{part}", metavar="NAME", default=OWN_HAIR,
            help=f"{what}: own (default), none{more}, or one of {', '.join(groom_names(part))}",
        )  # fmt: skip
    names = ", ".join(f"{row.name} ({row.low:g} to {row.high:g})" for row in SETTINGS)
    parser.add_argument(
        "--hair-set", action="extend", nargs="+", default=[], metavar="NAME=VALUE",
        help=f"strands: {names}; those of one part alone as for example brows.melanin",
    )  # fmt: skip


def chooses_hair(args: argparse.Namespace) -> bool:
    """Whether an option of `add_hair` is given."""
    return bool(args.hair_set) or any(one != OWN_HAIR for one in (args.hair, args.brows, args.beard, args.lashes))


def hair_of(args: argparse.Namespace, avatar: AvatarInfo) -> HairUse:
    """Return the hair that --hair, --hair-set and so on ask for; what they do not say is as the avatar has it.

    Another style takes the person's color over, as in Blender's panel.

    Raises:
        ControlError: There is no such part or setting, or the value is out of its range.
    """
    values: dict[str, dict[str, float]] = {}
    for name, value in parse_assignments(args.hair_set).items():
        part, _, setting = name.rpartition(".")
        if part and part not in PARTS:
            raise ControlError(f"Hair has no part {part!r} with settings of its own; it has {', '.join(PARTS)}.")
        _check_range(name, value, next((row for row in SETTINGS if row.name == setting), None))
        values.setdefault(part, {})[setting] = value
    main = values.pop("", {})
    own = avatar.hair or HairSettings()
    settings = own.changed(**main)
    parts = {
        part: (avatar.hair_parts.get(part) or settings.for_part(GROUPS.index(part))).changed(**changes)
        for part, changes in values.items()
    }
    named = args.hair in (OWN_HAIR, NO_HAIR) or args.hair.startswith(RANDOM_PREFIX)
    groom = args.hair if named else GROOM_PREFIX + args.hair.removeprefix(GROOM_PREFIX)
    worn = None if groom == OWN_HAIR and not main else settings
    return HairUse(groom, worn, brows=args.brows, beard=args.beard, lashes=args.lashes, parts=parts)


def _check_range(name: str, value: float, row: Setting | None) -> None:
    """Refuse a value that would be taken for another one. An unknown setting is refused later, by its name."""
    if row is not None and not row.low <= value <= row.high:
        raise ControlError(f"Hair's {name} is {value:g}; it goes from {row.low:g} to {row.high:g}.")


def add_events(parser: argparse.ArgumentParser) -> None:
    """Add --events, for commands that take a while."""
    parser.add_argument("--events", action="store_true", help="write progress and result as one JSON object a line on stdout")


def add_cluster(parser: argparse.ArgumentParser) -> None:
    """Add --cluster, for commands whose work has pieces."""
    parser.add_argument(
        "--cluster", metavar="ADDRESS|local:N",
        help="do the work on a Dask scheduler's workers, or in N processes of this machine (docs/farm.md)",
    )  # fmt: skip


@contextmanager
def cluster_of(args: argparse.Namespace) -> Iterator[Cluster | None]:
    """Connect to the cluster that is named while the block runs, and say what there is. Raises `GrmmError`s."""
    with open_cluster(args.cluster) as cluster:
        if cluster is not None:
            args.console.message(cluster.description)
        yield cluster


def make_absolute(args: argparse.Namespace, *options: str) -> None:
    """Name the files that options name from the root: workers of a cluster have other working folders."""

    def absolute(value: Any) -> Any:
        if isinstance(value, list):
            return [absolute(one) for one in value]
        return type(value)(Path(value).absolute()) if value and Path(value).exists() else value  # else a name of ours

    for option in options:
        setattr(args, option, absolute(getattr(args, option)))


def controls_of(args: argparse.Namespace) -> Controls:
    """Return the controls that --set asks for. Raises `ControlError`."""
    return Controls().set_named(parse_assignments(args.assignments))


def check_folder(path: Path) -> None:
    """Refuse a file name whose folder is missing before minutes of work are spent. Raises `FileAccessError`."""
    if not path.parent.is_dir():
        raise FileAccessError(f"The folder {path.parent} does not exist; make it or choose another one.")
    if path.is_dir():
        raise FileAccessError(f"{path} is a folder; give a file name.")


def picture_size(text: str) -> tuple[int, int]:
    """Parse ``512`` or ``640x480`` into width and height; an argparse type."""
    parts = text.lower().split("x")
    if len(parts) > 2 or not all(part.isascii() and part.isdigit() and 0 < int(part) <= 65536 for part in parts):
        raise argparse.ArgumentTypeError(f"{text!r} is not a picture size; write 512 or 640x480")
    return int(parts[0]), int(parts[-1])


def positive_int(text: str) -> int:
    """Parse a whole number above 0; an argparse type."""
    if not (text.isascii() and text.isdigit() and 0 < int(text) < 1 << 31):
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number above 0")
    return int(text)


def count(text: str) -> int:
    """Parse a whole number of 0 or more; an argparse type."""
    return 0 if text == "0" else positive_int(text)


class StopOnSignal:
    """Turns the first SIGINT or SIGTERM into a request, so that the state is saved; the second one interrupts."""

    def __init__(self) -> None:
        self.requested = False
        self._previous: dict[int, Any] = {}

    def __enter__(self) -> StopOnSignal:
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
