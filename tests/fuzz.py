"""`python tests/fuzz.py [--minutes M | --files N]`: damaged files into every reader and the command line, until time is up.

Every outcome must be a result or a typed error of one sentence, within 1 GiB of memory and 20 seconds. Readers run in processes
of their own, so that one that crashes or hangs costs one file. What fails is kept, with the reason, in a folder that
`--replay FOLDER` reads again. `make fuzz` runs this; `tests/core/test_fuzz.py` reads the first copies of each kind.

Copy number N of a kind is the same for the same seed on every machine and in every run.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib
import itertools
import json
import logging
import multiprocessing
import os
import resource
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests" / "support")]

from fuzzing import EXTRA_MEMORY, SECONDS, TookTooLong, damaged, memory_limit, read_or_refuse, time_limit  # noqa: E402
from good_files import KINDS, LARGE, Maker  # noqa: E402

SLICE, LARGE_SHARE = 500, 10  # copies that one process reads; of kinds that take long the tenth part
_PATIENCE = 3 * SECONDS  # seconds without news after which a process is ended: a hang that no signal stops
_READY = 120.0  # seconds for imports and the good file
OUTCOMES = ("refused", "read", "failed")

News = Callable[[int, str, float], object]
"""Hears the number of a copy, its outcome ("" when its reading begins), and how many seconds it took."""


def read_slice(name: str, make: Maker, seed: int, numbers: range, failures: Path, news: News) -> None:
    """Read damaged copies of one kind in this process; a failing one is kept below `failures`."""
    with tempfile.TemporaryDirectory(prefix="grmm-fuzz-") as temporary, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # arithmetic on damaged numbers, which are refused afterwards
        folder = Path(temporary) / "case"
        folder.mkdir()
        good = make(folder)
        good_copy = Path(temporary) / "good"
        shutil.copytree(folder, good_copy)
        with contextlib.suppress(Exception):
            good.read(good.path)  # imports what is imported lazily, before memory is limited; words need not be read
        contents = good.contents()
        with memory_limit(EXTRA_MEMORY):
            for number in numbers:
                news(number, "", 0.0)
                victim, data = damaged(contents, name, seed, number)
                victim.write_bytes(data)
                start = time.perf_counter()
                try:
                    with time_limit(SECONDS):
                        outcome = read_or_refuse(good.read, good.path)
                except (Exception, TookTooLong, SystemExit) as error:  # noqa: BLE001 - whatever else it is has failed
                    outcome = "failed"
                    keep(failures, name, seed, number, folder, "".join(traceback.format_exception(error)))
                news(number, outcome, time.perf_counter() - start)
                victim.write_bytes(contents[victim])


def keep(failures: Path, name: str, seed: int, number: int, folder: Path, reason: str) -> None:
    """Keep a failing case: the folder as it was read, which kind it is, and why."""
    target = failures / f"{name.replace(' ', '-')}-{seed}-{number}"
    shutil.rmtree(target, ignore_errors=True)
    shutil.copytree(folder, target / "files")
    (target / "case.json").write_text(json.dumps({"kind": name, "seed": seed, "number": number}))
    (target / "reason.txt").write_text(reason)


def replay(case: Path) -> str:
    """Read a kept case again: "read", "refused", or its exception."""
    name = json.loads((case / "case.json").read_text())["kind"]
    with tempfile.TemporaryDirectory(prefix="grmm-fuzz-") as temporary:
        folder = Path(temporary) / "case"
        folder.mkdir()
        good = KINDS[name](folder)
        shutil.copytree(case / "files", folder, dirs_exist_ok=True)
        with memory_limit(EXTRA_MEMORY), time_limit(SECONDS):
            return read_or_refuse(good.read, good.path)


def _child(module: str, name: str, seed: int, numbers: range, failures: str, pipe: Any) -> None:
    logging.disable(logging.CRITICAL)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with open(os.devnull, "w") as nowhere, contextlib.redirect_stderr(nowhere):
        make = importlib.import_module(module).KINDS[name]
        read_slice(name, make, seed, numbers, Path(failures), lambda *news: pipe.send(news))
    pipe.close()


def watch_slice(
    name: str, seed: int, numbers: range, failures: Path, module: str = "good_files", patience: float = _PATIENCE
) -> tuple[Counter[str], float]:
    """Read copies in a process of its own, and in another one what remains when it dies or hangs.

    Args:
        name: The kind.
        seed: Of the damage.
        numbers: Which copies.
        failures: Folder for failing ones.
        module: Whose `KINDS` has the kind.
        patience: Seconds without news after which the process is ended.

    Returns:
        How many came out how, and the longest time that one took, seconds.
    """
    outcomes: Counter[str] = Counter()
    longest, context = 0.0, multiprocessing.get_context("spawn")
    while numbers:
        ours, theirs = context.Pipe(duplex=False)
        process = context.Process(target=_child, args=(module, name, seed, numbers, str(failures), theirs))
        process.start()
        theirs.close()
        begun, reason = None, ""
        try:
            while ours.poll(_READY if begun is None else patience):
                number, outcome, seconds = ours.recv()
                begun = number
                if outcome:
                    outcomes[outcome] += 1
                    longest = max(longest, seconds)
                    numbers = range(number + 1, numbers.stop)
                    begun = number + 1
            reason = "it hangs, and no signal stops it"
        except EOFError:
            process.join(patience)
            reason = f"its process ended with code {process.exitcode}"
        if process.is_alive():
            process.kill()
            process.join()
        if numbers:  # it did not come to its end
            if begun is None:
                raise RuntimeError(f"The kind {name!r} does not start: {reason}.")
            outcomes["failed"] += 1
            _keep_again(failures, name, importlib.import_module(module).KINDS[name], seed, numbers.start, reason)
            numbers = range(numbers.start + 1, numbers.stop)
    return outcomes, longest


def _keep_again(failures: Path, name: str, make: Maker, seed: int, number: int, reason: str) -> None:
    """Make the copy anew whose reading took its process down, and keep it."""
    with tempfile.TemporaryDirectory(prefix="grmm-fuzz-") as temporary:
        victim, data = damaged(make(Path(temporary)).contents(), name, seed, number)
        victim.write_bytes(data)
        keep(failures, name, seed, number, Path(temporary), reason)


def run(files: int | None, seconds: float, seed: int, failures: Path, kinds: list[str]) -> dict[str, Counter[str]]:
    """Read slices of all kinds in turn until enough files are read or time is up; prints a table."""
    totals = {name: Counter[str]() for name in kinds}
    slowest = dict.fromkeys(kinds, 0.0)
    slices = {name: SLICE // LARGE_SHARE if name in LARGE else SLICE for name in kinds}
    start, whole = time.monotonic(), sum(slices.values())
    for turn in itertools.count():
        for name, size in slices.items():
            end = (turn + 1) * size if files is None else min((turn + 1) * size, -(-files * size // whole))
            if turn * size >= end or (files is None and time.monotonic() - start > seconds):
                continue
            counted, longest = watch_slice(name, seed, range(turn * size, end), failures)
            totals[name] += counted
            slowest[name] = max(slowest[name], longest)
            done, failed = (sum(total[key] for total in totals.values() for key in keys) for keys in (OUTCOMES, ("failed",)))
            print(f"{time.monotonic() - start:7.0f} s  {done:7d} files  {failed} failed  {name}", file=sys.stderr, flush=True)
        if (time.monotonic() - start > seconds) if files is None else ((turn + 1) * whole >= files):
            break
    print("| file | copies | refused with one sentence | still readable | anything else | longest |\n|---|---|---|---|---|---|")
    for name, total in totals.items():
        cells = (total.total(), *(total[outcome] for outcome in OUTCOMES), f"{slowest[name]:.1f} s")
        print(f"| {name} | {' | '.join(map(str, cells))} |")
    every = sum(totals.values(), Counter())
    print(f"| **all** | {every.total()} | {' | '.join(str(every[outcome]) for outcome in OUTCOMES)} | |")
    return totals


def main() -> int:
    """Run, or replay."""
    parser = argparse.ArgumentParser(description="Read damaged files of every kind.")
    parser.add_argument("--minutes", type=float, default=60.0, help="how long, without --files (default: %(default)g)")
    parser.add_argument("--files", type=int, help="read about so many files, however long that takes")
    parser.add_argument("--seed", type=int, default=0, help="of the damage (default: %(default)s)")
    parser.add_argument("--kinds", nargs="+", choices=list(KINDS), default=list(KINDS), metavar="KIND", help="only these")
    parser.add_argument(
        "--failures", type=Path, default=ROOT / "out" / "fuzz", help="folder of failing cases (default: out/fuzz)"
    )
    parser.add_argument("--replay", type=Path, metavar="FOLDER", help="read one failing case again, and show what happens")
    args = parser.parse_args()
    if args.replay:
        print(replay(args.replay))
        return 0
    totals = run(args.files, 60.0 * args.minutes, args.seed, args.failures, args.kinds)
    failed = sum(total["failed"] for total in totals.values())
    if failed:
        print(f"{failed} cases failed; they are kept in {args.failures}.", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
