"""Opening a data folder of any known format by looking at it.

Used by training and the command line. The readers of other projects' data are imported only where their format is found.
"""

from __future__ import annotations

import os
from pathlib import Path

from ..errors import FileAccessError, FileFormatError
from ..head import HeadModel
from .dataset import CaptureDataset

MANIFEST = "dataset.json"


def is_dataset(folder: str | os.PathLike[str]) -> bool:
    """Whether a folder looks like a data set of a known format."""
    from .readers_nersemble import is_nersemble
    from .readers_renderme import is_renderme
    from .readers_vhap import is_vhap

    path = Path(folder)
    return (path / MANIFEST).is_file() or any(test(path) for test in (is_vhap, is_nersemble, is_renderme))


def open_dataset(folder: str | os.PathLike[str], head: HeadModel | None = None) -> CaptureDataset:
    """Open a data set.

    Args:
        folder: A capture of this project, a VHAP export, RenderMe-360, or NeRSemble's FLAME avatar benchmark.
        head: The user's FLAME, for the last three.

    Raises:
        FileAccessError: The folder is missing.
        FileFormatError: Damaged, or of another format.
        ConfigError: FLAME is needed and was not given.
        RuntimeMissingError: A library for the format is not installed.
    """
    from .readers_nersemble import NersembleDataset, is_nersemble
    from .readers_renderme import RenderMeDataset, is_renderme
    from .readers_vhap import VhapDataset, is_vhap

    path = Path(folder)
    if not path.is_dir():
        raise FileAccessError(f"The data folder {path} does not exist; check its name.")
    if (path / MANIFEST).is_file():
        return CaptureDataset(path)
    if is_vhap(path):
        return VhapDataset(path, head)
    if is_nersemble(path):
        return NersembleDataset(path, head)
    if is_renderme(path):
        return RenderMeDataset(path, head)
    raise FileFormatError(
        f"{path} is no data set that is known here; give a folder of grmm capture, VHAP, RenderMe-360 or NeRSemble."
    )
