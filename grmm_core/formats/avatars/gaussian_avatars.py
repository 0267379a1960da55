"""GaussianAvatars: splats bound to the triangles of FLAME with teeth, and the FLAME track of the recorded person.

A folder with `point_cloud.ply` and `flame_param.npz`, or the PLY file alone. Called by the Blender importer, which gives it a
rig of the user's FLAME, and by the exporters. Needs numpy only.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from ...errors import FileAccessError, FileFormatError, ShapeError
from ...files.format import Format
from ...performance.types import Performance
from ..performances.flame_npz import read_flame_npz, write_flame_npz
from ..splats.cloud import MAX_DEGREE, SplatCloud
from ..splats.ply import read_layout, read_ply, write_ply

FLAME_TEETH_FACES, FLAME_TEETH_VERTICES = 10144, 5143
PLY_NAME, TRACK_NAME = "point_cloud.ply", "flame_param.npz"


@dataclass
class GaussianAvatar:
    """A GaussianAvatars export: splats bound to the triangles of FLAME with teeth, and the track of the recorded person.

    Attributes:
        cloud: With `binding`; 10144 faces.
        track: FLAME parameters, or None where the folder has none.
    """

    cloud: SplatCloud
    track: Performance | None

    def summary(self) -> dict[str, object]:
        """Facts for people: what `grmm info` shows."""
        return self.cloud.summary() | ({"track": self.track.summary()} if self.track is not None else {})


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
    cloud = cloud.with_degree(cloud.used_degree)
    track_path = path.parent / TRACK_NAME
    return GaussianAvatar(cloud, read_flame_npz(track_path) if track_path.exists() else None)


def write_gaussian_avatar(folder: str | os.PathLike[str], avatar: GaussianAvatar) -> None:
    """Write `point_cloud.ply` and `flame_param.npz` to an existing folder, as that project's loader wants them.

    It takes harmonics of degree 3 alone, so that missing ones are written as zeros.

    Raises:
        ShapeError: The splats are not bound to triangles.
        FileAccessError: The folder is missing, or a file cannot be written.
    """
    if avatar.cloud.binding is None:
        raise ShapeError("A GaussianAvatars avatar needs splats bound to triangles; bind them first.")
    folder = Path(folder)
    if not folder.is_dir():
        raise FileAccessError(f"{folder} is not a folder; create it or choose another.")
    write_ply(folder / PLY_NAME, avatar.cloud.with_degree(MAX_DEGREE))
    if avatar.track is not None:
        write_flame_npz(folder / TRACK_NAME, avatar.track, vertex_count=FLAME_TEETH_VERTICES)


def _recognises(path: Path, start: bytes) -> bool:
    return (path / PLY_NAME).exists() if path.is_dir() else "binding_0" in read_layout(path).get("vertex", ())


FORMAT = Format(
    "gaussian-avatars", "GaussianAvatars folder",
    f"{PLY_NAME} (splats bound to FLAME's triangles) and {TRACK_NAME} (the animation)", "avatar",
    (), read_gaussian_avatar, write_gaussian_avatar, _recognises, (".ply",), folder=True,
)  # fmt: skip
