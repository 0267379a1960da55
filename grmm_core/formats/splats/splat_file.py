"""`.splat` files: headerless records of 32 bytes, written by the first web viewer and read by most.

Position and linear scale as float32, color and opacity as bytes, quaternion wxyz as bytes around 128. Color is that of the
constant harmonic; higher degrees are lost. y is down, as in the PLY files that these are made from. No library is needed for a
plain record array. Needs numpy only.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from ...files.access import atomic_write_bytes, bad_file, read_bytes
from ...files.format import Format
from .cloud import SH_C0, SplatCloud, clipped_colors, finish_reading, lost_harmonics

KIND = ".splat file"
RECORD = np.dtype([("position", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("rotation", "u1", 4)])
_MAX_BYTES = 4 << 30


def read_splat(path: Path, axes: str = "file") -> SplatCloud:
    """Read a `.splat` file. `axes` as in `ply.read_ply`. Raises `FileFormatError` and `FileAccessError`."""
    data = read_bytes(path, _MAX_BYTES)
    if len(data) == 0 or len(data) % RECORD.itemsize:
        raise bad_file(path, KIND, f"its {len(data)} bytes are no whole number of {RECORD.itemsize}-byte records")
    rows = np.frombuffer(data, RECORD)
    rgb = rows["rgba"][:, :3].astype(np.float32) / 255.0
    cloud = SplatCloud(
        rows["position"].astype(np.float32),
        (rows["rotation"].astype(np.float32) - 128.0) / 128.0,
        rows["scale"].astype(np.float32),
        rows["rgba"][:, 3].astype(np.float32) / 255.0,
        ((rgb - 0.5) / SH_C0)[:, None, :],
    )
    cloud = finish_reading(path, KIND, cloud)
    return cloud if axes == "y_up" else cloud.flipped()


def write_splat(path: str | os.PathLike[str], cloud: SplatCloud, axes: str = "file") -> list[str]:
    """Write a `.splat` file, the most visible splats first as viewers expect.

    Args:
        path: Target file.
        cloud: Splats, y up.
        axes: "file" turns y down, "y_up" keeps the numbers.

    Returns:
        What the file does not hold.

    Raises:
        ShapeError: The cloud is malformed.
        FileAccessError: The file cannot be written.
    """
    cloud = cloud.validated()
    cloud = cloud if axes == "y_up" else cloud.flipped()
    order = np.argsort(-cloud.scales.astype(np.float64).prod(1) * cloud.opacities, kind="stable")
    cloud = cloud.select(order)
    rows = np.zeros(cloud.count, RECORD)
    rows["position"], rows["scale"] = cloud.means, cloud.scales
    rows["rgba"][:, :3] = to_byte(cloud.colors() * 255.0)
    rows["rgba"][:, 3] = to_byte(cloud.opacities * 255.0)
    rows["rotation"] = to_byte(cloud.quats * 128.0 + 128.0)
    atomic_write_bytes(path, rows.tobytes())
    return [*clipped_colors(cloud, 0.0, 1.0), *lost_harmonics(cloud)]


def to_byte(values: np.ndarray) -> np.ndarray:
    """Round and clip to 0..255, uint8."""
    return np.clip(np.rint(values), 0, 255).astype(np.uint8)


FORMAT = Format(
    "splat",
    ".splat",
    "32 bytes a splat, no view dependence; read by web viewers",
    "splats",
    (".splat",),
    read_splat,
    write_splat,
)
