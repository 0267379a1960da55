"""What a command writes: the only place of the core that touches stdout and stderr.

Results go to stdout (under ``--json`` as one object, and nothing else), messages and the progress bar to stderr; the bar is
drawn on a terminal only. Under ``--events`` stdout has one JSON object a line, for a program that started this one: progress
as it comes, and at the end the result or the error.
"""

from __future__ import annotations

import json
import math
import sys
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from typing import Any, TextIO

from ..jobs.progress import Progress, ProgressCallback
from ..jobs.stages import JobStages

BAR_WIDTH = 28
REDRAW_SECONDS = 0.1


class Console:
    """Writes results, messages and progress.

    Attributes:
        as_json: The caller wants one JSON object on stdout.
        as_events: The caller wants one JSON object a line.
    """

    def __init__(
        self, as_json: bool = False, stdout: TextIO | None = None, stderr: TextIO | None = None, as_events: bool = False
    ) -> None:
        self.as_json, self.as_events = as_json or as_events, as_events
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
        text = " ".join(text.split())
        self.event("error", message=text)
        self._stderr.write(f"grmm: {text}\n")

    def result(self, values: Mapping[str, Any]) -> None:
        """Write the command's result as one JSON object; silent without ``--json``."""
        if self.as_events:
            self.event("done", **values)
        elif self.as_json:
            self._stdout.write(json.dumps(plain(values), ensure_ascii=False) + "\n")

    def event(self, kind: str, **values: object) -> None:
        """Write an event and hand it to the reader at once; silent without ``--events``."""
        if self.as_events:
            self._stdout.write(json.dumps({"event": kind, **plain(values)}, ensure_ascii=False) + "\n")
            self._stdout.flush()

    def table(self, header: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
        """Write aligned columns for people; silent under ``--json``."""
        cells = [list(header), *([str(cell) for cell in row] for row in rows)]
        widths = [max(len(row[column]) for row in cells) for column in range(len(header))]
        for row in cells:
            self.line("  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip())

    @property
    def draws_bars(self) -> bool:
        """Whether somebody watches a terminal."""
        return not self.as_json and self._stderr.isatty()

    @contextmanager
    def progress(self, stages: JobStages) -> Iterator[ProgressCallback]:
        """Show how far a piece of work is while the block runs: a bar on a terminal, or events.

        Args:
            stages: Of the work.
        """
        bar = _Bar(stages, self._stderr if self.draws_bars else None)

        def show(progress: Progress) -> None:
            self.event("progress", **progress.to_json())
            bar.draw(progress)

        try:
            yield show
        finally:
            bar.close()


class _Bar:
    """A progress bar; `stream` None draws nothing."""

    def __init__(self, stages: JobStages, stream: TextIO | None) -> None:
        self._stages, self._stream = stages, stream
        self._drawn = -REDRAW_SECONDS

    def draw(self, progress: Progress) -> None:
        """Draw it anew, but not too often."""
        now = time.monotonic()
        if self._stream is None or now - self._drawn < REDRAW_SECONDS:
            return
        self._drawn = now
        filled = round(progress.fraction * BAR_WIDTH)
        bar = "#" * filled + "." * (BAR_WIDTH - filled)
        self._stream.write(f"\r\x1b[K{self._stages.label} [{bar}] {progress.fraction:.0%} {progress.text(self._stages)}")
        self._stream.flush()

    def close(self) -> None:
        """Remove the bar."""
        if self._stream is not None:
            self._stream.write("\r\x1b[K")
            self._stream.flush()
            self._stream = None


def plain(value: Any) -> Any:
    """Return a JSON value; NaN and infinity, which JSON lacks, become null."""
    import numpy as np  # its library of matrix products reads settings of the command when it is loaded

    if isinstance(value, Mapping):
        return {str(name): plain(item) for name, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, (list, tuple, set, frozenset)):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if value is None or isinstance(value, (bool, int, float, str)):
        return value
    return str(value)
