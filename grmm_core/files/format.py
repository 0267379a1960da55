"""What a file format says about itself. Every format's module has one `Format`; `formats.registry` collects them.

The command line, the Blender operators and the file browsers read nothing else: names, suffixes, options and their defaults
stand here once. Needs the standard library only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from ..errors import FileFormatError

Holds = Literal["splats", "mesh", "avatar", "sequence", "performance", "arrays"]
"""Gaussians; triangles; a rigged avatar; moving Gaussians; recorded motion; plain numbers for programs of one's own."""
Value = bool | int | float | str


OptionsOf = Literal["reading", "writing"]


@dataclass(frozen=True)
class Option:
    """A choice in reading or writing a format.

    Attributes:
        name: Keyword argument of the reader or writer.
        label: Short name for people.
        description: What it does, one sentence without a full stop.
        default: Its value and by that its type.
        choices: The only values that it takes, with a label each; empty for any of the type.
        key: What it is called among the options of all formats, where `name` alone would not be clear.
    """

    name: str
    label: str
    description: str
    default: Value
    choices: tuple[tuple[Value, str], ...] = ()
    key: str = ""

    @property
    def identifier(self) -> str:
        """Name among the options of all formats: of the command line's flag and of the operator's property."""
        return self.key or self.name


@dataclass(frozen=True)
class Format:
    """One file format.

    Attributes:
        name: Identifier, such as "spz".
        label: Name for people, such as "SPZ (.spz)".
        description: What it is good for, one sentence without a full stop.
        holds: What is in such a file.
        suffixes: Endings of its files, lower case with the point; the first is the one that is written.
        reader: Called with a path and the options of `reading`; returns what `holds` says. None where it is not read.
        writer: Called with a path, what is to be written and the options of `writing`; returns sentences about what the
            format could not hold, or nothing. None where it is not written.
        recognises: Whether a file is of this format, from its path and its first bytes; None where the suffix decides.
        shared_suffixes: Further endings that belong to other programs as well: read when chosen, not taken when dropped.
        file_names: Whole names of files that are read whatever their suffix says.
        folder: It is read from and written to a folder.
        morphs: A mesh keeps named morph targets.
        reading, writing: Options.
        needs: Packages beyond numpy, each with what it is needed for.
    """

    name: str
    label: str
    description: str
    holds: Holds
    suffixes: tuple[str, ...]
    reader: Callable[..., Any] | None = None
    writer: Callable[..., Iterable[str] | None] | None = None
    recognises: Callable[[Path, bytes], bool] | None = None
    shared_suffixes: tuple[str, ...] = ()
    file_names: tuple[str, ...] = ()
    folder: bool = False
    morphs: bool = False
    reading: tuple[Option, ...] = ()
    writing: tuple[Option, ...] = ()
    needs: dict[str, str] = field(default_factory=dict)

    @property
    def written_suffixes(self) -> tuple[str, ...]:
        """Endings of names that ask for this format; none for a folder."""
        return () if self.folder or self.writer is None else self.suffixes or self.shared_suffixes

    @property
    def suffix(self) -> str:
        """The ending that is written, "" for a folder."""
        return next(iter(self.written_suffixes), "")

    def read(self, path: Path, **options: Any) -> Any:
        """Call the reader. Raises `FileFormatError` where there is none, and as the reader."""
        if self.reader is None:
            raise FileFormatError(f"{path} cannot be read: {self.label} is only written; choose another file.")
        return self.reader(path, **options)

    def write(self, path: Path, content: Any, **options: Any) -> tuple[str, ...]:
        """Call the writer; returns sentences about what the format could not hold.

        Raises `FileFormatError` where there is none, and as the writer.
        """
        if self.writer is None:
            raise FileFormatError(f"{path} cannot be written: {self.label} is only read; choose another format.")
        return tuple(self.writer(path, content, **options) or ())

    def fits(self, path: Path) -> bool:
        """Whether the name of a file says that it may be of this format."""
        name = path.name.lower()
        return name in self.file_names or name.endswith((*self.suffixes, *self.shared_suffixes))


def options_of_formats(entries: Iterable[Format], which: OptionsOf) -> list[Option]:
    """Options of formats, each once."""
    return list({option.identifier: option for one in entries for option in getattr(one, which)}.values())
