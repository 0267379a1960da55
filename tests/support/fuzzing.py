"""Damaged files for the readers' tests: deterministic mutations, limits of memory and time, the verdict on what a reader did.

Mutations know containers: members of a zip, the contents of a gzip stream and the JSON of a `.glb` are changed inside, with the
checksums made right again, since otherwise the checksum alone would refuse nearly all of them. Called by the tests of readers
and by `tests/fuzz.py`, which reads as many as there is time for.
"""

from __future__ import annotations

import copy
import gzip
import io
import json
import random
import re
import signal
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from grmm_core.errors import GrmmError

_NUMBERS = (
    b"0",
    b"-1",
    b"1",
    b"255",
    b"65536",
    b"2147483647",
    b"4294967295",
    b"9" * 13,
    b"9" * 19,
    b"1e308",
    b"NaN",
    b"1e999",
    b"",
)
_ODD_VALUES = (None, True, -1, 1.5, 10**30, "", "x", [], [[]], {}, [None])  # of every type that JSON has
_WORDS = (0, 1, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 1 << 20, 10_000_000)
_PACKINGS = (zipfile.ZIP_STORED, zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED, zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA)
_SLOW_TO_PACK = 1 << 18  # bytes
EXTRA_MEMORY = 1 << 30  # bytes that reading a file may take beyond what the process had
SECONDS = 20.0  # for one file; honest readers take milliseconds
_LONGEST = 700  # characters of a sentence that names two paths


@dataclass
class Good:
    """A good file, or folder, of one kind.

    Attributes:
        path: What is read.
        read: The reader under test, called with `path`.
        victims: The files that are damaged, one at a time; `path` where there are none.
    """

    path: Path
    read: Callable[[Path], object]
    victims: tuple[Path, ...] = ()

    def contents(self) -> dict[Path, bytes]:
        """The undamaged victims."""
        return {path: path.read_bytes() for path in self.victims or (self.path,)}


class TookTooLong(BaseException):
    """A reader did not come back. No `Exception`, so that no reader takes it for damage."""


def mutate(data: bytes, rng: random.Random) -> bytes:
    """One damaged copy."""
    if data[:2] == b"PK" and rng.random() < 0.8:
        return _mutate_member(data, rng)
    if data[:2] == b"\x1f\x8b" and rng.random() < 0.8:
        return gzip.compress(_mutate_bytes(gzip.decompress(data), rng), 1)
    if data[:4] == b"glTF" and rng.random() < 0.4:
        return glb_with(data, _odd_document(glb_document(data), rng))
    if data[:1] in (b"{", b"[") and rng.random() < 0.4:
        return json.dumps(_odd_document(json.loads(data), rng)).encode()
    return _mutate_bytes(data, rng)


def _odd_document(document: Any, rng: random.Random) -> Any:
    """A copy of a JSON document with one value left out, doubled or exchanged for one of another type."""
    changed = copy.deepcopy(document)
    holder, key = rng.choice(list(_places(changed)))
    kind = rng.randrange(4)
    if kind == 0:
        del holder[key]
    elif kind == 1 and isinstance(holder, list):
        holder.extend([holder[key]] * rng.choice((1, 3, 100)))
    else:
        holder[key] = rng.choice(_ODD_VALUES)
    return changed


def _places(node: Any) -> Iterator[tuple[Any, Any]]:
    """Every value below a node, by its holder and key; of long lists some."""
    keys = list(node) if isinstance(node, dict) else range(min(len(node), 6))
    for key in keys:
        yield node, key
        if isinstance(node[key], (dict, list)):
            yield from _places(node[key])


def _mutate_bytes(data: bytes, rng: random.Random) -> bytes:
    result = bytearray(data)
    # Headers decide what is allocated, so half of the changes go there.
    end = min(len(result), 600) if rng.random() < 0.5 else len(result)
    for _ in range(rng.choice((1, 1, 1, 2, 5, 20))):
        if not result:
            break
        at = rng.randrange(max(1, min(end, len(result))))
        kind = rng.randrange(7)
        if kind == 0:
            result[at] ^= 1 << rng.randrange(8)
        elif kind == 1:
            result[at] = rng.choice((0, 1, 0x7F, 0x80, 0xFF))
        elif kind == 2:
            del result[at:]
        elif kind == 3:
            del result[at : at + rng.choice((1, 2, 4, 16, 100))]
        elif kind == 4:
            result[at:at] = bytes(rng.randrange(256) for _ in range(rng.choice((1, 4, 16))))
        elif kind == 5:
            result[at : at + 4] = rng.choice(_WORDS).to_bytes(4, "little")
        else:
            numbers = list(re.finditer(rb"-?\d+(?:\.\d+)?", bytes(result[:4000])))
            if numbers:
                match = rng.choice(numbers)
                result[match.start() : match.end()] = rng.choice(_NUMBERS)
    return bytes(result)


def odd_documents(document: Any) -> Iterator[Any]:
    """Copies of a JSON document with one value left out or exchanged for one of another type; of long lists the first three."""
    for path in _paths(document):
        for value in (*_ODD_VALUES, _ODD_VALUES):  # the tuple itself stands for: leave it out
            changed = copy.deepcopy(document)
            holder = changed
            for key in path[:-1]:
                holder = holder[key]
            if value is _ODD_VALUES:
                del holder[path[-1]]
            else:
                holder[path[-1]] = value
            yield changed


def _paths(node: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    if path:
        yield path
    if isinstance(node, dict):
        for key, value in node.items():
            yield from _paths(value, (*path, key))
    elif isinstance(node, list):
        for index, value in enumerate(node[:3]):
            yield from _paths(value, (*path, index))


def glb_with(data: bytes, document: Any) -> bytes:
    """A `.glb` with another JSON part."""
    length = int.from_bytes(data[12:16], "little")
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = data[20 + length :]
    head = b"glTF" + (2).to_bytes(4, "little") + (20 + len(text) + len(rest)).to_bytes(4, "little")
    return head + len(text).to_bytes(4, "little") + b"JSON" + text + rest


def glb_document(data: bytes) -> Any:
    """The JSON part of a `.glb`."""
    return json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")])


def read_or_refuse(read: Callable[[Path], object], path: Path) -> str:
    """Read a file: "read", or "refused" where the reader raises one sentence. Every other exception passes through."""
    try:
        read(path)
    except GrmmError as error:
        text = str(error)
        if "\n" in text or len(text) > _LONGEST or not text.endswith((".", "?")):
            raise AssertionError(f"not one short sentence: {text!r}") from error
        return "refused"
    return "read"


def _mutate_member(data: bytes, rng: random.Random) -> bytes:
    """A zip with one member changed, renamed or left out."""
    buffer = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(data)) as source, zipfile.ZipFile(buffer, "w") as target:
        names = source.namelist()
        victim = rng.choice(names)
        for name in names:
            content = source.read(name)
            if name == victim:
                kind = rng.randrange(10)
                if kind == 0:
                    continue
                if kind == 1:
                    name = rng.choice(("../" + name, "/tmp/" + name, "x" * 300, name.upper(), "a\\b"))
                else:
                    content = _mutate_bytes(content, rng)
            packing = rng.choice(_PACKINGS) if len(content) < _SLOW_TO_PACK else zipfile.ZIP_STORED
            target.writestr(zipfile.ZipInfo(name), content, packing)  # without the time of day
    return buffer.getvalue() if rng.random() < 0.8 else _mutate_bytes(buffer.getvalue(), rng)


@contextmanager
def memory_limit(extra: int) -> Iterator[None]:
    """Let the process take at most `extra` bytes more address space than it has now; beyond, Python raises MemoryError."""
    import resource  # Unix only, and this module is imported everywhere

    pages = int(Path("/proc/self/statm").read_text().split()[0])
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + extra, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))


@contextmanager
def time_limit(seconds: float) -> Iterator[None]:
    """Raise `TookTooLong` in the block after so many seconds, as soon as the interpreter has its turn."""

    def stop(*_: object) -> None:
        raise TookTooLong(f"not read within {seconds:g} seconds")

    before = signal.signal(signal.SIGALRM, stop)
    signal.setitimer(signal.ITIMER_REAL, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
        signal.signal(signal.SIGALRM, before)


def damaged(contents: dict[Path, bytes], kind: str, seed: int, number: int) -> tuple[Path, bytes]:
    """The damaged copy number `number` of a kind: which file, and what is in it. Equal numbers give equal copies."""
    rng = random.Random(f"{seed} {kind} {number}")
    victim = rng.choice(sorted(contents))
    return victim, mutate(contents[victim], rng)
