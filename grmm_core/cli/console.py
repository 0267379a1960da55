"""What a command writes: the only place of the core that touches stdout and stderr.

Results go to stdout (under ``--json`` as one object, and nothing else), messages and the progress bar to stderr; the bar is
drawn on a terminal only.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

import numpy as np

BAR_WIDTH = 28
REDRAW_SECONDS = 0.1


class Console:
    """Writes results, messages and progress.

    Attributes:
        as_json: The caller wants one JSON object on stdout.
    """

    def __init__(self, as_json: bool = False, stdout: TextIO | None = None, stderr: TextIO | None = None) -> None:
        self.as_json = as_json
        self._stdout = sys.stdout if stdout is None else stdout
        self._stderr = sys.stderr if stderr is None else stderr

    def line(self, text: str = "") -> None:
        """Write a line for people on stdout; silent under ``--json``."""
        if not self.as_json:
            self._stdout.write(f"{text}\n")

    def message(self, text: str) -> None:
        """Write a line for people on stderr; silent under ``--json``."""
        if not self.as_json:
            self._stderr.write(f"{text}\n")

    def error(self, text: str) -> None:
        """Write what went wrong, one sentence, on stderr."""
        self._stderr.write(f"grmm: {' '.join(text.split())}\n")

    def result(self, values: Mapping[str, Any]) -> None:
        """Write the command's result as one JSON object; silent without ``--json``."""
        if self.as_json:
            self._stdout.write(json.dumps(_plain(values), ensure_ascii=False) + "\n")

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Write aligned columns for people; silent under ``--json``."""
        cells = [list(header), *([str(cell) for cell in row] for row in rows)]
        widths = [max(len(row[column]) for row in cells) for column in range(len(header))]
        for row in cells:
            self.line("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())

    def flush(self) -> None:
        """Hand everything to the system now, so that a closed pipe is noticed here."""
        self._stdout.flush()

    @contextmanager
    def progress(self, label: str, total: int) -> Iterator[Progress]:
        """Show a bar on a terminal while the block runs.

        Args:
            label: What is being done.
            total: Number of steps.
        """
        bar = Progress(label, total, self._stderr if self._stderr.isatty() and not self.as_json else None)
        try:
            yield bar
        finally:
            bar.close()


class Progress:
    """A progress bar; `stream` None draws nothing."""

    def __init__(self, label: str, total: int, stream: TextIO | None) -> None:
        self._label = label
        self._total = max(total, 1)
        self._stream = stream
        self._done = 0
        self._note = ""
        self._start = time.monotonic()
        self._drawn = 0.0
        self._draw()

    def advance(self, steps: int = 1, note: str = "") -> None:
        """Count finished steps and show a short note behind the bar."""
        self._done += steps
        self._note = note
        if time.monotonic() - self._drawn > REDRAW_SECONDS:
            self._draw()

    def close(self) -> None:
        """Remove the bar."""
        if self._stream is not None:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
            self._stream = None

    def _draw(self) -> None:
        if self._stream is None:
            return
        self._drawn = time.monotonic()
        part = min(self._done / self._total, 1.0)
        filled = round(part * BAR_WIDTH)
        elapsed = self._drawn - self._start
        left = f" {elapsed / part * (1.0 - part):.0f} s left" if 0.02 < part < 1.0 and elapsed > 1.0 else ""
        bar = "#" * filled + "." * (BAR_WIDTH - filled)
        self._stream.write(f"\r\x1b[K{self._label} [{bar}] {self._done}/{self._total}{left} {self._note}".rstrip())
        self._stream.flush()


def _plain(value: Any) -> Any:
    """Return a JSON value; NaN and infinity, which JSON lacks, become null."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    if isinstance(value, (list, tuple, set, frozenset)):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float) and not np.isfinite(value):
        return None
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
