"""`.npz` files with everything about an avatar as plain arrays, for programs of one's own. Written only. Needs numpy only."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping

import numpy as np

from ..files.access import atomic_write_bytes
from ..files.format import Format


def write_arrays(path: str | os.PathLike[str], arrays: Mapping[str, np.ndarray]) -> None:
    """Write named arrays. Raises `FileAccessError`."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **dict(arrays))
    atomic_write_bytes(path, stream.getvalue())


FORMAT = Format("arrays", "Arrays (.npz)", "Mesh, splats and codes as plain numbers", "arrays", (".npz",), writer=write_arrays)
