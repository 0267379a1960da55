"""Readers that do what no reader may: what `tests/fuzz.py` has to notice. Each behaves on the good file."""

from __future__ import annotations

import ctypes
import os
import time
from collections.abc import Callable
from pathlib import Path

from fuzzing import Good

GOOD = b"good" * 8


def _kind(misbehave: Callable[[], object]) -> Callable[[Path], Good]:
    def make(folder: Path) -> Good:
        (folder / "a.bin").write_bytes(GOOD)
        return Good(folder / "a.bin", lambda path: path.read_bytes() == GOOD or misbehave())

    return make


def _fail() -> None:
    raise ValueError("no sentence")


def _hang() -> None:
    while True:  # within C, where no signal is heard
        ctypes.PyDLL(None).sleep(60)


KINDS = {
    "raises": _kind(_fail),
    "takes memory": _kind(lambda: bytearray(4 << 30)),
    "leaves": _kind(lambda: os._exit(3)),
    "hangs": _kind(_hang),
    "waits": _kind(lambda: time.sleep(600)),
}
