"""The numbers of a run while it trains: a line of `METRICS` for each step, and TensorBoard's files. Used by `trainer`.

`metric_plots` draws them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from ..errors import FileAccessError, RuntimeMissingError
from ..files.access import describe_os_error

METRICS = "metrics.jsonl"


class MetricsLog:
    """Appends to the files of a run's folder.

    Args:
        folder: Of the run.
        tensorboard: Write TensorBoard's files as well.

    Raises:
        RuntimeMissingError: TensorBoard is wanted and not installed.
    """

    def __init__(self, folder: Path, tensorboard: bool) -> None:
        self.path = folder / METRICS
        self._make_writer = _tensorboard() if tensorboard else None
        self.writer: Any = None  # made with the first numbers, when it is known after which step they are written

    def write(self, step: int, metrics: Mapping[str, float]) -> None:
        """Append what was measured after a step. Raises `FileAccessError`."""
        if self._make_writer is not None:
            if self.writer is None:  # what an earlier process wrote of the steps from here on is done again
                self.writer = self._make_writer(str(self.path.parent), purge_step=step)
            for name, value in metrics.items():
                self.writer.add_scalar(name, value, step)
        try:
            with self.path.open("a", encoding="utf-8") as file:
                file.write(json.dumps({k: round(v, 6) for k, v in metrics.items()}) + "\n")
        except OSError as error:
            raise FileAccessError(f"Cannot write {self.path}: {describe_os_error(error)}; free some space.") from error

    def close(self) -> None:
        """Finish TensorBoard's file; the next numbers begin another."""
        if self.writer is not None:
            self.writer.close()
            self.writer = None


def _tensorboard() -> Any:
    """The class that writes TensorBoard files. Raises `RuntimeMissingError` where the package is missing."""
    try:
        from torch.utils.tensorboard import SummaryWriter
    except ImportError as error:
        raise RuntimeMissingError(
            "TensorBoard is not installed or not complete; run pip install tensorboard, or switch the setting off."
        ) from error
    return SummaryWriter
