"""Avatars of other projects: GaussianAvatars (PLY + FLAME track), CAP4D (animated PLY), LAM (zip of glb + offsets).

Called by the Blender importers, which give them a rig: GaussianAvatars and CAP4D splats ride on triangles
(`binding.place_on_mesh`), LAM's on the vertices of a mesh with ARKit morph targets. Needs numpy only.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ..errors import FileAccessError, FileFormatError, ShapeError
from ..performance.flame_npz import read_flame_npz
from ..performance.types import Performance
from . import read_splats
from .archive import member, read_members
from .binding import place_on_mesh
from .cloud import SH_C0, SplatCloud, bad_file
from .mesh import Mesh, read_gltf_mesh
from .ply import columns, has_element, read_elements, read_ply, splats_from_rows, write_ply
from .sog import Decoder

FLAME_TEETH_FACES = 10144
PLY_NAME, TRACK_NAME = "point_cloud.ply", "flame_param.npz"
_LAM_KIND, _CAP4D_KIND = "LAM archive", "CAP4D file"
_LAM_LIMIT = 1 << 30
_MAX_FRAMES = 100_000


def read_avatar(
    path: str | os.PathLike[str], decode: Decoder | None = None
) -> GaussianAvatar | AnimatedAvatar | LamAvatar | SplatCloud:
    """Read an avatar of another project, or plain splats, by what is in the file.

    Args:
        path: A .zip (LAM), a .ply (CAP4D, GaussianAvatars or 3DGS), a folder with `point_cloud.ply`, or any splat file.
        decode: Decodes the pictures of a SOG file where Pillow is not installed (see `sog.read_sog`).

    Raises:
        FileFormatError, FileAccessError, BackendError: As the readers of the formats.
    """
    path = Path(path)
    if path.suffix.lower() == ".zip":
        return read_lam(path)
    if path.is_dir():
        return read_gaussian_avatar(path)
    if path.suffix.lower() != ".ply":
        is_sog = path.suffix.lower() == ".sog" or path.name.lower() == "meta.json"
        return read_splats(path, decode=decode) if is_sog else read_splats(path)
    if has_element(path, "base_vertex"):
        return read_cap4d(path)
    cloud = read_ply(path)
    return cloud if cloud.binding is None else _with_track(path, cloud)


@dataclass
class GaussianAvatar:
    """A GaussianAvatars export: splats bound to the triangles of FLAME with teeth, and the track of the recorded person.

    Attributes:
        cloud: With `binding`; 10144 faces.
        track: FLAME parameters, or None where the folder has none.
    """

    cloud: SplatCloud
    track: Performance | None


def read_gaussian_avatar(path: str | os.PathLike[str]) -> GaussianAvatar:
    """Read `point_cloud.ply` and, if it lies beside it, `flame_param.npz`.

    Args:
        path: The PLY file or its folder. The user's FLAME file is needed to pose the result.

    Raises:
        FileFormatError: Damaged, or not bound to FLAME's triangles.
        FileAccessError: Missing or unreadable.
    """
    path = Path(path)
    path = path / PLY_NAME if path.is_dir() else path
    cloud = read_ply(path)
    if cloud.binding is None:
        raise FileFormatError(f"{path} is an ordinary splat file and no GaussianAvatars avatar; import it as splats.")
    return _with_track(path, cloud)


def _with_track(path: Path, cloud: SplatCloud) -> GaussianAvatar:
    """Check bound splats and add the track that lies beside them."""
    if cloud.binding is not None and int(cloud.binding.max()) >= FLAME_TEETH_FACES:
        raise FileFormatError(
            f"{path} is bound to more triangles than FLAME with teeth has ({FLAME_TEETH_FACES}); check its head model."
        )
    track_path = path.parent / TRACK_NAME
    return GaussianAvatar(cloud, read_flame_npz(track_path) if track_path.exists() else None)


def write_gaussian_avatar(folder: str | os.PathLike[str], avatar: GaussianAvatar) -> None:
    """Write `point_cloud.ply` and `flame_param.npz` to an existing folder. Raises `ShapeError` and `FileAccessError`."""
    from ..performance.writing import write_performance

    if avatar.cloud.binding is None:
        raise ShapeError("A GaussianAvatars avatar needs splats bound to triangles; bind them first.")
    folder = Path(folder)
    if not folder.is_dir():
        raise FileAccessError(f"{folder} is not a folder; create it or choose another.")
    write_ply(folder / PLY_NAME, avatar.cloud)
    if avatar.track is not None:
        write_performance(folder / TRACK_NAME, avatar.track)


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
    elements = read_elements(path, _CAP4D_KIND).elements
    for name in ("faces", "base_vertex", "vertex"):
        if name not in elements:
            raise bad_file(path, _CAP4D_KIND, f"it has no element {name!r}")
    base = _xyz(path, elements["base_vertex"], "base_vertex")
    corner_names = ("index_0", "index_1", "index_2")
    if not set(corner_names) <= set(elements["faces"].dtype.names or ()):
        raise bad_file(path, _CAP4D_KIND, "its faces have no corners")
    faces = np.stack([elements["faces"][name].astype(np.int64) for name in corner_names], 1)
    if faces.size == 0 or faces.min() < 0 or faces.max() >= base.shape[0]:
        raise bad_file(path, _CAP4D_KIND, "its faces refer to vertices that it does not have")
    cloud = splats_from_rows(path, elements["vertex"], _CAP4D_KIND)
    if cloud.binding is None or int(cloud.binding.max()) >= faces.shape[0]:
        raise bad_file(path, _CAP4D_KIND, "its splats are bound to triangles that it does not have")
    deltas = []
    while f"delta_vertex_{len(deltas):05d}" in elements and len(deltas) < _MAX_FRAMES:
        number = f"{len(deltas):05d}"
        rows = elements[f"delta_vertex_{number}"]
        bounds = [elements.get(f"meta_delta_{end}_{number}") for end in ("min", "max")]
        if rows.shape[0] != base.shape[0] or any(bound is None or bound.shape[0] != 1 for bound in bounds):
            raise bad_file(path, _CAP4D_KIND, f"frame {len(deltas)} is incomplete")
        low, high = (_xyz(path, bound, "meta_delta")[0] for bound in bounds if bound is not None)
        values = _xyz(path, rows, "delta_vertex")
        is_bytes = all(rows.dtype[axis] == np.uint8 for axis in "xyz")
        deltas.append((values.astype(np.uint8) if is_bytes else values, low, high))
    return AnimatedAvatar(cloud, faces, base, deltas)


def _xyz(path: Path, rows: np.ndarray, name: str) -> np.ndarray:
    """Finite x, y, z of an element, [rows, 3] float32."""
    if not {"x", "y", "z"} <= set(rows.dtype.names or ()) or any(rows.dtype[axis].subdtype is not None for axis in "xyz"):
        raise bad_file(path, _CAP4D_KIND, f"its element {name!r} has no x, y, z")
    values = columns(rows, ["x", "y", "z"])
    if values.shape[0] == 0 or not np.isfinite(values).all():
        raise bad_file(path, _CAP4D_KIND, f"its element {name!r} is empty or not finite")
    return values


@dataclass
class LamAvatar:
    """A LAM avatar: one splat a vertex of a mesh with ARKit morph targets.

    Attributes:
        mesh: Vertices, faces and morph targets by ARKit name.
        cloud: Splats at rest, in the order of the vertices.
    """

    mesh: Mesh
    cloud: SplatCloud

    def splats(self, weights: dict[str, float]) -> SplatCloud:
        """Splats with morph targets applied; unknown names do nothing."""
        moved = self.cloud.means.copy()
        for name, weight in weights.items():
            if weight and name in self.mesh.morphs:
                moved += np.float32(weight) * self.mesh.morphs[name]
        return replace(self.cloud, means=moved)


def read_lam(path: str | os.PathLike[str]) -> LamAvatar:
    """Read a LAM zip: `skin.glb` with morph targets, and `offset.ply` with a splat for every vertex in the same order.

    In `offset.ply` positions are offsets to the vertices and f_dc is plain RGB, no harmonic.

    Raises:
        FileFormatError: Damaged, a member is missing, or numbers of splats and vertices differ.
        FileAccessError: Missing or unreadable.
    """
    path = Path(path)
    contents = read_members(path, _LAM_KIND, _LAM_LIMIT)
    mesh = read_gltf_mesh(path, member(path, _LAM_KIND, contents, "skin.glb"))
    elements = read_elements(path, _LAM_KIND, member(path, _LAM_KIND, contents, "offset.ply")).elements
    cloud = splats_from_rows(path, elements["vertex"], _LAM_KIND) if "vertex" in elements else None
    if cloud is None or cloud.count != mesh.vertices.shape[0]:
        found = 0 if cloud is None else cloud.count
        raise bad_file(path, _LAM_KIND, f"it has {found} splats for {mesh.vertices.shape[0]} vertices")
    rgb = np.clip(cloud.sh[:, 0], 0.0, 1.0)
    cloud = replace(cloud, means=cloud.means + mesh.vertices, sh=((rgb - 0.5) / SH_C0)[:, None, :].astype(np.float32))
    return LamAvatar(mesh, cloud)
