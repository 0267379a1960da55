"""Text files of rows and columns, as people's programs and countries write them.

Called by the readers of Live Link Face, Audio2Face-3D and Face Cap recordings. UTF-8 and UTF-16, commas, semicolons or tabs
between cells, decimal points or commas, commas left over at the end of lines. Needs numpy only.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ...files.access import bad_file, read_bytes
from ...jobs.progress import Share
from .repair import MAX_FILE_BYTES, MAX_FRAMES

_REPORT_EVERY = 4096
_MAX_COLUMNS = 1000
_MAX_VALUE = 1e6  # larger numbers are damage
_MARKS = ((b"\xef\xbb\xbf", "utf-8"), (b"\xff\xfe", "utf-16-le"), (b"\xfe\xff", "utf-16-be"))


@dataclass
class Table:
    """Rows of numbers under names.

    Attributes:
        names: Of the columns.
        texts: Cells of the column that was asked for as text, None where there is none.
        values: Numbers, [rows, columns]; what is missing or no number is NaN.
    """

    names: list[str]
    texts: list[str] | None
    values: np.ndarray

    def column(self, name: str) -> int | None:
        """Index of a column, whatever its case."""
        return next((k for k, found in enumerate(self.names) if found.lower() == name.lower()), None)


def decode_text(path: Path, kind: str, data: bytes) -> str:
    """Text of a file in UTF-8, or in UTF-16 with or without its mark. Raises `FileFormatError` for anything else."""
    try:
        text = data.decode(encoding_of(data)).removeprefix("\ufeff")
    except UnicodeDecodeError as error:
        raise bad_file(path, kind, "it is not text") from error
    if "\0" in text:
        raise bad_file(path, kind, "it is not text")
    return text


def encoding_of(data: bytes) -> str:
    """Name of the encoding that the first bytes of a text speak for."""
    for mark, encoding in _MARKS:
        if data.startswith(mark):
            return encoding
    start = data[:200]
    if start[1::2].count(0) > len(start) // 4:
        return "utf-16-le"
    return "utf-16-be" if start[0::2].count(0) > len(start) // 4 else "utf-8"


def start_text(start: bytes) -> str:
    """The first bytes of a file as lower-case text without mark and leading space; "" where they are none."""
    return start.decode(encoding_of(start), "ignore").removeprefix("\ufeff").lstrip().lower()


def read_table(path: Path, kind: str, text_column: str, progress: Share | None = None) -> Table:
    """Read a file whose first line names its columns.

    Args:
        path: The file.
        kind: What it was taken for, for messages.
        text_column: Name of the column that is kept as text, such as a time code.
        progress: Called with the fraction done.

    Raises:
        FileFormatError: It has no columns or no rows, or rows with more cells than there are columns.
        FileAccessError: Missing, unreadable or too large.
    """
    text = decode_text(path, kind, read_bytes(path, MAX_FILE_BYTES))
    estimate = max(text.count("\n"), 1)
    rows = split_rows(path, kind, text)
    names = _without_trailing([name.strip() for name in next(rows, [])])
    if not 2 <= len(names) <= _MAX_COLUMNS:
        raise bad_file(path, kind, "its first line does not name columns")
    code = next((k for k, name in enumerate(names) if name.lower() == text_column), None)
    texts: list[str] = []
    blocks: list[np.ndarray] = []
    block: list[list[str]] = []
    for count, row in enumerate(rows, 1):
        cells = row if len(row) <= len(names) else _without_trailing(row)
        if len(cells) > len(names):
            reason = f"row {count + 1} has {len(cells)} cells for {len(names)} columns"
            raise bad_file(path, kind, f"{reason}; decimal commas need semicolons or tabs between the cells")
        cells = cells + [""] * (len(names) - len(cells))
        if code is not None:
            texts.append(cells[code].strip())
            cells[code] = ""
        block.append(cells)
        if count > MAX_FRAMES:
            raise bad_file(path, kind, f"it has more than {MAX_FRAMES} frames")
        if len(block) == _REPORT_EVERY:
            blocks.append(to_floats(block))
            block = []
            if progress:
                progress(min(0.1 + 0.8 * count / estimate, 0.9))
    if block:
        blocks.append(to_floats(block))
    if not blocks:
        raise bad_file(path, kind, "it has no frames")
    return Table(names, texts if code is not None else None, np.concatenate(blocks))


def split_rows(path: Path, kind: str, text: str) -> Iterator[list[str]]:
    """Rows of cells, those without any content left out; the delimiter is what the first line has most of."""
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    try:
        yield from (row for row in csv.reader(io.StringIO(text), delimiter=delimiter) if any(row))
    except csv.Error as error:
        raise bad_file(path, kind, "it is not comma-separated text") from error


def to_floats(rows: list[list[str]]) -> np.ndarray:
    """Cells to numbers, [rows, columns]; what is empty, no number or absurdly large is NaN."""
    flat = [cell or "nan" for row in rows for cell in row]
    try:
        values = np.fromiter(map(float, flat), np.float64, len(flat))
    except ValueError:
        values = np.fromiter(map(_float_or_nan, flat), np.float64, len(flat))
    values[~(np.abs(values) < _MAX_VALUE)] = np.nan
    return values.reshape(len(rows), -1)


def _float_or_nan(cell: str) -> float:
    try:
        return float(cell.replace(",", "."))
    except ValueError:
        return float("nan")


def _without_trailing(cells: list[str]) -> list[str]:
    """Cells without the empty ones at the end."""
    count = len(cells)
    while count and not cells[count - 1].strip():
        count -= 1
    return cells[:count]
