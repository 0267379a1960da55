"""Training samples in files of a folder that may grow while they are read."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np


def save_shard(path: Path, samples: Sequence[object], names: Sequence[str]) -> None:
    """Write some attributes of samples, arrays of one shape each, as one file, whole or not at all."""
    part = path.with_suffix(".part.npz")
    np.savez(part, **{name: np.stack([getattr(sample, name) for sample in samples]) for name in names})
    part.rename(path)


class Shards:
    """Samples of a folder and those in it.

    Attributes:
        rows: Arrays of each sample, by name.
    """

    def __init__(self, folder: Path, names: Sequence[str]) -> None:
        self.folder, self._read = folder, set[Path]()
        self.rows: dict[str, list[np.ndarray]] = {name: [] for name in names}

    def refresh(self) -> int:
        """Read new files; returns the number of samples."""
        for path in sorted(set(self.folder.rglob("shard_*.npz")) - set(self.folder.rglob("*.part.npz")) - self._read):
            self._read.add(path)
            with np.load(path) as arrays:
                for name, rows in self.rows.items():
                    rows += list(arrays[name])
        return len(next(iter(self.rows.values())))

    def stacked(self, name: str, numbers: np.ndarray) -> np.ndarray:
        """One array of some samples, [B, ...]."""
        return np.stack([self.rows[name][i] for i in numbers])
