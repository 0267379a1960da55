"""CAP4D: an animated PLY, splats on the triangles of a mesh that moves from frame to frame.

Called by the Blender importer. Needs numpy only.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ...files.access import bad_file
from ...files.format import Format
from ..splats.cloud import SplatCloud
from ..splats.ply import columns, read_elements, read_layout, splats_from_rows
from .binding import place_on_mesh

KIND = "CAP4D file"
_MAX_FRAMES = 100_000


@dataclass
class AnimatedAvatar:
    """A CAP4D animated PLY.

    Attributes:
        cloud: Splats bound to triangles.
        faces: [F, 3].
        frames: Vertices of every frame in metres, [T, V, 3] float32, as bytes or floats with their range until asked for.
    """

    cloud: SplatCloud
    faces: np.ndarray
    base: np.ndarray
    deltas: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)

    def summary(self) -> dict[str, object]:
        """Facts for people: what `grmm info` shows."""
        return self.cloud.summary() | {"vertices": len(self.base), "frames": self.frame_count}

    @property
    def frame_count(self) -> int:
        """Number of frames; 1 where the file has no animation."""
        return max(1, len(self.deltas))

    def vertices(self, frame: int) -> np.ndarray:
        """Mesh of a frame, [V, 3] metres."""
        if not self.deltas:
            return self.base
        values, low, high = self.deltas[frame]
        share = values.astype(np.float32) / (255.0 if values.dtype == np.uint8 else 1.0)
        return (self.base + low + share * (high - low)).astype(np.float32)

    def splats(self, frame: int) -> SplatCloud:
        """Free splats of a frame."""
        return place_on_mesh(self.cloud, self.vertices(frame), self.faces)


def read_cap4d(path: str | os.PathLike[str]) -> AnimatedAvatar:
    """Read a CAP4D animated PLY: `faces`, `base_vertex`, `vertex`, then per frame a range and normalised offsets.

    Raises:
        FileFormatError: Damaged, or an element is missing or of another size.
        FileAccessError: Missing or unreadable.
    """
    path = Path(path)
    elements = read_elements(path, KIND).elements
    for name in ("faces", "base_vertex", "vertex"):
        if name not in elements:
            raise bad_file(path, KIND, f"it has no element {name!r}")
    base = _xyz(path, elements["base_vertex"], "base_vertex")
    corner_names = ("index_0", "index_1", "index_2")
    if not set(corner_names) <= set(elements["faces"].dtype.names or ()):
        raise bad_file(path, KIND, "its faces have no corners")
    faces = np.stack([elements["faces"][name].astype(np.int64) for name in corner_names], 1)
    if faces.size == 0 or faces.min() < 0 or faces.max() >= base.shape[0]:
        raise bad_file(path, KIND, "its faces refer to vertices that it does not have")
    cloud = splats_from_rows(path, elements["vertex"], KIND)
    if cloud.binding is None or int(cloud.binding.max()) >= faces.shape[0]:
        raise bad_file(path, KIND, "its splats are bound to triangles that it does not have")
    deltas: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    while f"delta_vertex_{len(deltas):05d}" in elements and len(deltas) < _MAX_FRAMES:
        number = f"{len(deltas):05d}"
        rows = elements[f"delta_vertex_{number}"]
        bounds = [elements.get(f"meta_delta_{end}_{number}") for end in ("min", "max")]
        if rows.shape[0] != base.shape[0] or any(bound is None or bound.shape[0] != 1 for bound in bounds):
            raise bad_file(path, KIND, f"frame {len(deltas)} is incomplete")
        low, high = (_xyz(path, bound, "meta_delta")[0] for bound in bounds if bound is not None)
        values = _xyz(path, rows, "delta_vertex")
        is_bytes = all(rows.dtype[axis] == np.uint8 for axis in "xyz")
        deltas.append((values.astype(np.uint8) if is_bytes else values, low, high))
    return AnimatedAvatar(cloud, faces, base, deltas)


def _xyz(path: Path, rows: np.ndarray, name: str) -> np.ndarray:
    """Finite x, y, z of an element, [rows, 3] float32."""
    if not {"x", "y", "z"} <= set(rows.dtype.names or ()) or any(rows.dtype[axis].subdtype is not None for axis in "xyz"):
        raise bad_file(path, KIND, f"its element {name!r} has no x, y, z")
    values = columns(rows, ["x", "y", "z"])
    if values.shape[0] == 0 or not np.isfinite(values).all():
        raise bad_file(path, KIND, f"its element {name!r} is empty or not finite")
    return values


FORMAT = Format(
    "cap4d", "CAP4D (.ply)", "Splats on a mesh that plays the file's frames", "sequence",
    (), read_cap4d, recognises=lambda path, start: "base_vertex" in read_layout(path), shared_suffixes=(".ply",),
)  # fmt: skip
